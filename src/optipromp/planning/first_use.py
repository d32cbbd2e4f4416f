"""Compiling every kernel, before the first plan on a machine."""

import math
import subprocess
import sys

from optipromp.planning import foresight
from optipromp.planning.many import cores
from optipromp.planning.options import PlanOptions
from optipromp.planning.plan import plan, warm_up
from optipromp.planning.setup import bind
from optipromp.planning.starts import sides, tool_path
from optipromp.scenes.io import load_scene

SCENE = "scenario-3"


def compile_kernels() -> None:
    """Fill Numba's cache.

    The model of pushes takes nearly as long to compile as all the rest; where there is a second
    core, a process of its own does it.
    """
    other = None
    if cores() > 1:
        code = f"from {__name__} import compile_foresight as run; run()"
        other = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    try:
        plan(SCENE, options=PlanOptions(foresight=False, timeout=math.inf))
        if other is not None:
            other.wait()
    finally:
        if other is not None:
            other.kill()  # where the wait was interrupted
            other.wait()
    warm_up()  # whatever is missing still


def compile_foresight() -> None:
    """Compile what :mod:`optipromp.planning.foresight` runs."""
    setup, options = bind(load_scene(SCENE)), PlanOptions()
    model = foresight.foresight(setup)
    model.of_path(tool_path(setup, options, sides(setup, options)[0]))
