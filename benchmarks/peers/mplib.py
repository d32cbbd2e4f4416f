"""MPlib: RRT-Connect in C++ with FCL, its path timed by TOPP-RA."""

import json
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.common import Answer, Planner, at_limits, goal_configurations
from benchmarks.peers.description import TIP, obstacles, srdf, urdf
from benchmarks.registry import NotAvailableError
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import Scene

PYTHON = "MPLIB_PYTHON"
WORKER = Path(__file__).with_name("mplib_worker.py")
LONGEST = 5.0  # [s] of search
STEP = 0.01  # [s] between the points it returns
WANTED = (
    f"MPlib's wheels crash with NumPy 2, which this library needs; set {PYTHON} to the interpreter "
    "of an environment with 'mplib' and 'numpy<2'"
)


def rrt_connect() -> Planner:
    """MPlib's planner to our goal configurations, in a process with an older NumPy.

    Obstacles are links of the model that do not move: only so can its SRDF say that the tool may
    push what the arm must not touch.

    Raises:
        NotAvailableError: no such interpreter, or it has no MPlib.
    """
    python = os.environ.get(PYTHON)
    if not python:
        raise NotAvailableError(WANTED)
    worker = subprocess.Popen(
        [python, "-I", str(WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    if "mplib" not in _answer(worker, {}):
        raise NotAvailableError(f"{PYTHON} names an interpreter without MPlib")

    def solve(scene: Scene, seed: int) -> Answer:
        began = time.perf_counter()
        setup = resolve(scene)
        goals = goal_configurations(setup, seed)
        ours = time.perf_counter() - began
        if not len(goals):
            return Answer(None, "no goal configuration")
        robot, objects = setup.robot, obstacles(scene)
        with tempfile.TemporaryDirectory() as folder:
            model, meaning = Path(folder) / "robot.urdf", Path(folder) / "robot.srdf"
            model.write_text(urdf(robot, objects), encoding="utf-8")
            meaning.write_text(srdf(robot, objects), encoding="utf-8")
            found = _answer(worker, {
                "urdf": str(model), "srdf": str(meaning), "tip": TIP, "seed": seed,
                "velocity": robot.velocity.tolist(), "acceleration": robot.acceleration.tolist(),
                "start": setup.start.tolist(), "goals": goals.tolist(), "step": STEP,
                "longest": LONGEST,
            })  # fmt: skip
        if not found:
            raise RuntimeError("MPlib's process ended")
        seconds = ours + float(found["seconds"])
        if found["position"] is None:
            return Answer(None, str(found["status"]), seconds)
        q = np.array(found["position"])
        q[0] = setup.start
        return Answer(at_limits(setup, q), "", seconds)  # its own timing leaves them a little

    return solve


def _answer(worker: subprocess.Popen[str], asked: dict[str, Any]) -> dict[str, Any]:
    """Ask (nothing: just listen), and return the next line that is a JSON document."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    if asked:
        worker.stdin.write(json.dumps(asked) + "\n")
        worker.stdin.flush()
    for line in worker.stdout:
        if line.startswith("{"):
            return dict(json.loads(line))
    return {}
