"""Compiles every kernel before the first plan on a machine."""

import subprocess
import sys
from dataclasses import replace

from optipromp.planning.plan import warm_up
from optipromp.processes import cores
from optipromp.scenes.io import load_scene

SCENE = "scenario-3"


def compile_kernels() -> None:
    """Fill Numba's cache.

    The push model takes nearly as long to compile as all other kernels. Where there is a second
    core, another process compiles it, while this one plans where nothing is to be pushed.
    """
    scene = load_scene(SCENE)
    bare = replace(scene, objects=tuple(o for o in scene.objects if o.role != "pushable"))
    other = None
    if cores() > 1:
        code = f"from {__name__} import compile_push_model as run; run()"
        other = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    try:
        warm_up(bare)
        if other is not None:
            other.wait()
    finally:
        if other is not None:
            other.kill()  # where the wait was interrupted
            other.wait()
    warm_up()  # the kernels that are still missing


def compile_push_model() -> None:
    """Compile what predicts a push."""
    from optipromp.planning.prediction import push_model
    from optipromp.planning.task import resolve

    task = resolve(load_scene(SCENE))
    model = push_model(task, task.robot.home)
    assert model is not None
    path = model.path(model.first()[0])
    model.predict(path.points, path.points)
