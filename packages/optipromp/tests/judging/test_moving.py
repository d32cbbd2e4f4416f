"""The judge knows where avoid objects, pushables and their stems are at each time."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.judging.builders import gap, moving

from optipromp.core import judging
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import Scene, SceneObject, Stem
from optipromp.core.scenes.objects import ObjectMotion
from optipromp.core.scenes.scene import JointGoal
from optipromp.core.trajectory import Trajectory


@pytest.fixture(scope="module")
def swing(panda: Robot) -> Trajectory:
    """The first joint turns by 1.2 rad within 20 s."""
    return moving(panda, [panda.home, panda.home + np.eye(7)[0] * 1.2], 20.0)


def elbow(panda: Robot, made: Trajectory, time: float) -> np.ndarray:
    """The middle of the sphere of the arm (B_d) that is farthest from the axis of the swing."""
    spheres = panda.sphere_centers(made.at(time).q[None])[0][~np.asarray(panda.spheres.distal)]
    return spheres[np.argmax(np.linalg.norm(spheres[:, :2], axis=1))]


def visitor(role: Any, there: np.ndarray, at: float, stem: Stem | None = None) -> SceneObject:
    """A ball that is ``there`` at a time, and 6 s before and after out of the way."""
    out = 0.6 * there * [1.0, 1.0, 0.0] / np.linalg.norm(there[:2])  # away from the base
    times = np.array([at - 6.0, at, at + 6.0])
    motion = ObjectMotion(times, np.array([there + out, there, there + out]))
    place = motion.at(np.zeros(1))[0]
    if stem is not None:
        stem = replace(stem, points=stem.points + place)
    return SceneObject("ball", role, Sphere(0.03), place, motion=motion, stem=stem)


def judged(panda: Robot, made: Trajectory, item: SceneObject) -> judging.Judgement:
    goal = JointGoal(made.positions[-1])
    return judging.judge(Scene("s", "panda", (item,), goal=goal), panda, made)


def test_the_arm_meets_an_avoid_object_in_time_alone(panda: Robot, swing: Trajectory) -> None:
    """Clear at time 0 and for another timing; the depth is that of dense samples."""
    item = visitor("avoid", elbow(panda, swing, 10.0), 10.0)
    proximal = ~np.asarray(panda.spheres.distal)
    still = judged(panda, swing, replace(item, motion=None))
    assert not still.contacts
    met = judged(panda, swing, item)
    (contact,) = met.contacts
    truth = gap(panda, swing, item, proximal)
    assert truth < -0.03
    assert (contact.other, contact.role) == ("ball", "avoid")
    assert contact.depth == pytest.approx(-truth, abs=4e-3)
    assert contact.depth >= -truth - 1e-4  # never optimistic
    assert contact.time == pytest.approx(10.0, abs=1.0)
    assert met.metrics.clearance_avoid == pytest.approx(-contact.depth)
    assert met.metrics.clearance_avoid_tool == pytest.approx(
        gap(panda, swing, item, ~proximal), abs=4e-3
    )
    assert met.metrics.clearance_static is None
    late = judged(panda, swing, visitor("avoid", elbow(panda, swing, 10.0), 18.0))
    assert not late.contacts
    assert (late.metrics.clearance_avoid or 0.0) > 0.0


def test_last_link_and_tool_may_touch_what_moves_by_its_role(panda, swing):
    tip = panda.tool_pose(swing.at(10.0).q[None])[0][0]
    for role, minded in (("avoid", False), ("static", True)):
        found = judged(panda, swing, visitor(role, tip, 10.0))
        assert any("ball" in c.other for c in found.contacts) == minded
    assert found.metrics.clearance_static is not None


def test_the_stem_moves_with_its_fruit(panda: Robot, swing: Trajectory) -> None:
    """A stem hangs 0.15 m aside of its fruit; the arm meets the stem."""
    aside = np.array([0.0, 0.0, -0.4])
    middle = elbow(panda, swing, 10.0)
    stem = Stem(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.55]]))
    item = visitor("avoid", middle + aside, 10.0, stem)
    found = judged(panda, swing, item)
    assert "the stem of ball" in {c.other for c in found.contacts}
    assert not judged(panda, swing, replace(item, motion=None)).contacts


def test_a_pushable_is_in_the_arms_way_where_it_is_then(panda: Robot, swing: Trajectory) -> None:
    """The arm (B_d) must not meet it; 0.1 m/s is the most that its root is led."""
    there = elbow(panda, swing, 10.0)
    places = np.array([there - [0.0, 0.0, 0.9], there])
    stem = Stem(np.array([places[0], places[0] + [0.0, 0.0, 0.1]]))
    motion = ObjectMotion(np.array([0.0, 10.0]), places)
    item = SceneObject("ball", "pushable", Sphere(0.03), places[0], motion=motion, stem=stem)
    found = judged(panda, swing, item)
    assert {c.other for c in found.contacts} >= {"ball"}
    assert (found.metrics.clearance_pushable or 0.0) < 0.0
    assert not judged(panda, swing, replace(item, motion=None)).contacts


def test_a_contact_with_what_moves_at_the_start_is_one_at_the_start(panda, swing):
    item = visitor("avoid", elbow(panda, swing, 0.0), 0.0)
    assert [c.other for c in judged(panda, swing, item).at_start] == ["ball"]
    assert judging.touching(Scene("s", "panda", (item,), goal=JointGoal(panda.home)), panda,
                            panda.home)  # fmt: skip
