"""The tool's speed among fruits that hang: pushes are predicted for a slow tool."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.judging.builders import obj, to

from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.geometry import Sphere
from optipromp.core.judging.speed import FASTER, NEAR, PUSHED
from optipromp.core.planning.verdict import Verdict
from optipromp.core.pushing.model import Prediction, Told
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import SceneObject, Stem
from optipromp.core.trajectory import Trajectory

TARGET, FRUIT, RADIUS = np.array([0.0, 0.0, 0.75]), np.array([0.0, 0.0, 0.6]), 0.015


def hung(name: str, role: Any, place: np.ndarray) -> SceneObject:
    stem = Stem(np.array([place, place + [0.0, 0.0, 0.2]]))
    return SceneObject(name, role, Sphere(RADIUS), place, stem=stem)


def upward(gantry: Robot, speed: Any, aside: float = 0.06) -> Trajectory:
    """The tool goes up beside the fruit, ``speed(height)`` fast half-way between its waypoints."""
    height = np.linspace(0.2, 0.75, 111)
    path = np.column_stack([np.full(111, aside), np.zeros(111), height - 0.13])
    path[-6:, 0] = np.linspace(aside, 0.0, 6)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    times = np.append(0.0, np.cumsum(steps / [speed(h) for h in 0.5 * (height[1:] + height[:-1])]))
    return Trajectory.through(path, times, gantry.joint_names)


def judged(gantry: Robot, motion: Trajectory, **changes: Any) -> judging.Judgement:
    objects = hung("ripe", "target", TARGET), hung("n", "pushable", FRUIT)
    scene = replace(to(None, *objects), **changes)
    return judging.judge(scene, gantry, motion, stem_side=False)


def speeds(found: judging.Judgement) -> list[judging.Violation]:
    return [v for v in found.violations if v.kind == "speed"]


def test_the_speed_is_that_of_the_push_model() -> None:
    assert PUSH.hanging.speed == PUSHED


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.15, 0.4])
def test_a_tool_that_is_too_fast_among_fruits_is_told(speed: float, gantry: Robot) -> None:
    motion = upward(gantry, lambda h: speed if 0.5 < h < 0.7 else 0.05)
    found = judged(gantry, motion)
    told = speeds(found)
    _, velocity, _ = motion.sample(np.linspace(0.0, motion.duration, 20_000))
    largest = np.linalg.norm(velocity, axis=1).max()  # the gantry's tool moves as its joints do
    assert 0.97 * largest < found.metrics.approach_speed <= largest  # type: ignore[operator]
    assert bool(told) == (speed > PUSHED * (1.0 + FASTER))
    for violation in told:
        assert violation.amount == found.metrics.approach_speed
        assert violation.unit == "m/s"
        assert violation.time is not None
        assert 0.49 < motion.at(violation.time).q[2] + 0.13 < 0.71
        assert f"moves at {violation.amount:.3f} m/s among fruits" in str(violation)


def test_a_short_burst_between_waypoints_is_seen(gantry: Robot) -> None:
    motion = upward(gantry, lambda h: 0.4 if 0.599 < h < 0.604 else 0.05)
    assert motion.duration > 9.0
    assert judged(gantry, motion).metrics.approach_speed > 0.2  # type: ignore[operator]


def test_elsewhere_the_tool_may_be_fast(gantry: Robot) -> None:
    """Below the fruit, beside it, and where nothing that hangs is to be pushed."""
    low = FRUIT[2] - RADIUS - NEAR - 0.02 - 0.03  # the rim is 0.02 above the tool point
    early = judged(gantry, upward(gantry, lambda h: 0.4 if h < low else 0.05))
    assert speeds(early) == []
    assert 0.04 < early.metrics.approach_speed < 0.11  # type: ignore[operator]
    fast = upward(gantry, lambda h: 0.4)
    assert len(speeds(judged(gantry, fast))) == 1
    far = judged(gantry, upward(gantry, lambda h: 0.4 if h < 0.65 else 0.02, aside=0.2))
    assert speeds(far) == []
    ripe, n = hung("ripe", "target", TARGET), hung("n", "pushable", FRUIT)
    for objects in (
        (ripe,), (ripe, replace(n, role="avoid")), (ripe, replace(n, stem=None)),
        (obj("target", Sphere(RADIUS), TARGET, name="ripe"), n),
    ):  # fmt: skip
        found = judged(gantry, fast, objects=objects)
        assert speeds(found) == []
        assert found.metrics.approach_speed is None


def test_too_fast_is_no_success_and_harm_stays_harm(gantry: Robot) -> None:
    """A push that harms a slow tool's fruits harms those of a fast one."""
    found = judged(gantry, upward(gantry, lambda h: 0.4))
    alone = replace(found, violations=tuple(speeds(found)))
    for harm, code in ((0.1, Code.INVALID_PLAN), (2.0, Code.HARM_PREDICTED)):
        verdict = Verdict(alone, Prediction(harm, 1.0, lambda: Told("n", "is crushed")))
        assert verdict.status is code
        assert "m/s among fruits" in verdict.message
    assert "harm is predicted: n is crushed" in verdict.message
    both = replace(found, violations=(*alone.violations, judging.Violation("goal", "far")))
    assert Verdict(both, Prediction(2.0, 1.0)).status is Code.INVALID_PLAN
