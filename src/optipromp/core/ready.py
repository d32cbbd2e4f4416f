"""Imported to be ready to plan: by the server that helper processes come from."""

import contextlib
import gc
import os

from optipromp.core.processes import THREADS

os.environ.update(THREADS)  # before anything starts threads

with contextlib.suppress(Exception):  # a helper then compiles by itself, and says what is wrong
    from optipromp.core.planning.plan import warm_up

    warm_up()

gc.freeze()  # collecting in a helper would copy the pages that it shares with the server
