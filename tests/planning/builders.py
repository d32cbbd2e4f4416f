"""What tests of goals and of requests ask with."""

from dataclasses import replace
from typing import Any

import numpy as np

from optipromp.core.errors import (
    Code,
)
from optipromp.core.planning import Plan
from optipromp.core.scenes import Scene, SceneObject

UP = np.array([0.0, 0.0, 1.0])
END = np.array([-0.9, 0.7, 0.4, -1.9, 0.3, 1.9, 0.5])


def block(role: Any, shape: Any, at: Any, name: str = "block") -> SceneObject:
    return SceneObject(name, role, shape, np.asarray(at, dtype=float))


def without(scene: Scene, *roles: str) -> Scene:
    return replace(scene, objects=tuple(o for o in scene.objects if o.role not in roles))


def assert_success(result: Plan) -> None:
    assert result.status is Code.SUCCESS, result.message
    assert result.success
    assert result.metrics.limit_violation == 0.0
    assert result.metrics.goal_error <= 1e-3
