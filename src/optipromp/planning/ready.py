"""Imported to be ready to plan: by the server that the helpers of ``plan_many`` come from."""

import contextlib

from optipromp.planning.plan import warm_up

with contextlib.suppress(Exception):  # a helper then compiles by itself, and says what is wrong
    warm_up()
