"""Imported by the server of helper processes: loads and compiles everything that planning needs."""

import contextlib
import gc
import os

from optipromp.core.processes import THREADS

os.environ.update(THREADS)  # before anything starts threads

with contextlib.suppress(Exception):  # a helper then compiles itself, and reports the error
    from optipromp.core.planning.warming import warm_up

    warm_up()

gc.freeze()  # collection in a helper would copy the pages that it shares with the server
