"""What tests of goals and of requests ask with."""

from dataclasses import replace
from typing import Any

import numpy as np

from optipromp.core.errors import Code
from optipromp.core.planning import Plan
from optipromp.core.scenes import Scene, SceneObject, scene_from_dict

UP = np.array([0.0, 0.0, 1.0])
END = np.array([-0.9, 0.7, 0.4, -1.9, 0.3, 1.9, 0.5])


def block(role: Any, shape: Any, at: Any, name: str = "block") -> SceneObject:
    return SceneObject(name, role, shape, np.asarray(at, dtype=float))


def beside_a_box(goal: Any, **more: Any) -> Scene:
    """As a file states it: a Panda, a box before it, and a goal."""
    box = {
        "id": "box", "role": "static", "shape": {"box": {"size": [0.2, 0.2, 0.4]}},
        "position": [0.5, 0.0, 0.2],
    }  # fmt: skip
    start = [0, -0.3, 0, -2.2, 0, 1.9, 0.8]
    given = {"name": "s", "robot": "panda", "objects": [box], "goal": goal, "start": start}
    return scene_from_dict(given | more)


def tool_speed(made: Plan, begin: float = 0.0) -> float:
    """Largest speed of the tool after ``begin`` [s]."""
    times = np.arange(begin, made.trajectory.duration, 2e-3)
    points, _ = made.robot.tool_pose(made.trajectory.sample(times)[0])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).max() / 2e-3)


def without(scene: Scene, *roles: str) -> Scene:
    return replace(scene, objects=tuple(o for o in scene.objects if o.role not in roles))


def assert_success(result: Plan) -> None:
    assert result.status is Code.SUCCESS, result.message
    assert result.success
    assert result.metrics.limit_violation == 0.0
    assert result.metrics.goal_error <= 1e-3
