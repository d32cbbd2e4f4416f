"""Compilation of the kernels, before the first plan."""

import contextlib
import functools
import math
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from optipromp.core.compiled import CACHED, in_cache
from optipromp.core.optimization.kernels import add_stiffness
from optipromp.core.planning import collision, planners
from optipromp.core.planning.attempt import attempt
from optipromp.core.planning.options import DEFAULTS
from optipromp.core.planning.result import Proposal
from optipromp.core.planning.task import Task, resolve
from optipromp.core.processes import cores
from optipromp.core.pushing.stems.hanging import Hanging, Leaving
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene

WARM_UP = "scenario-3"

_threads = functools.cache(ThreadpoolController)  # it finds the BLAS libraries once


def one_thread() -> Any:
    """The context in which BLAS has one thread: small matrices gain nothing from more."""
    return _threads().limit(limits=1, user_api="blas")


def warm_up() -> None:
    """Compile every kernel, or load it from the cache, before a plan's time counts."""
    _find_way(_attempt(load_scene(WARM_UP)))


def _attempt(scene: Scene) -> Task:
    """The task of a scene, after a plan of it."""
    task = resolve(scene)
    with one_thread():
        made: Any = attempt(task, planners.OptiProMP(), DEFAULTS, math.inf, str)
        made = made.made() if isinstance(made, Proposal) else made
    return task


def _find_way(task: Task) -> None:
    """Search a way round obstacles from the robot's home to itself."""
    home = task.robot.home[None]
    collision.way(task, home, home, np.random.default_rng(0))


@functools.cache
def compile_once() -> None:
    """Compile the kernels of most plans, once in a process, where Numba's cache lacks them.

    Kernels of few plans are compiled when they are called; a plan's clock stops meanwhile.
    """
    if not in_cache(add_stiffness):
        compile_kernels()


def compile_kernels(progress: Callable[[str], object] = str) -> None:
    """Fill Numba's cache; without one, compile the kernels of most plans.

    ``progress`` is called with a short text as each part begins.

    The kernels of push model and search of ways take as long to compile as all others. With a
    second core, another process compiles them, while this one plans where nothing hangs.
    """
    scene = load_scene(WARM_UP)
    bare = tuple(replace(o, stem=None) for o in scene.objects if o.role != "pushable")
    code = f"from {__name__} import compile_push_model as run; run()"
    both = cores() > 1 and CACHED and sys.executable
    with (
        subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        if both
        else contextlib.nullcontext()
    ) as other:
        try:
            progress("compiling the kernels of arm and obstacles")
            _attempt(replace(scene, objects=bare))
            if other is not None:
                progress("compiling the kernels of the push")
                other.wait()
        finally:
            if other is not None:
                other.kill()  # where the wait was interrupted
    progress("compiling the last kernels")
    warm_up()  # the kernels that are still missing


def compile_push_model() -> None:
    """Compile the kernels of the push model, in and out, and of the search of ways; until standard
    input ends, with the process that asked for it."""
    asker = threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True)
    asker.start()
    task = resolve(load_scene(WARM_UP))
    model = task.push_model(task.robot.home)
    assert isinstance(model, Hanging)
    path = model.candidates.path(model.candidates.spread(0)[0])
    assert model.predict(path.points, path.points).told
    assert Leaving(model, path.points, path.points).predict(path.points[::-1], path.points).told
    _find_way(task)
