"""An arm link may pass where the tool has pushed an object away, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from tests.judging.builders import moving, obj, to

from optipromp.core import judging
from optipromp.core.geometry import Box
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import JointGoal, Stem
from optipromp.core.trajectory import Trajectory

STANDING = Box((0.04, 0.04, 0.9))  # from the ball of y, 0.5 below, up to the tool


def along_x(gantry: Robot, *stops: float) -> Trajectory:
    """The gantry along x, at rest in y and z."""
    x = np.interp(np.linspace(0.0, 1.0, 161), np.linspace(0.0, 1.0, len(stops)), stops)
    return moving(gantry, np.column_stack([x, np.zeros((161, 2))]), 0.1)


def test_a_link_may_pass_where_the_tool_has_pushed_an_object_away(gantry: Robot) -> None:
    """The cup (radius 50 mm) meets the box before the ball of y (20 mm) does, and goes deeper."""
    stands = obj("pushable", STANDING, [0.3, 0.0, -0.2])
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), stands)
    judgement = judging.judge(scene, gantry, along_x(gantry, 0.0, 0.27))
    assert not judgement.violations
    assert not judgement.contacts
    (note,) = judgement.notes
    assert note.startswith("y passes where object stood")
    # where it stood is what is measured
    assert judgement.metrics.clearance_pushable == pytest.approx(-0.01, abs=1e-3)


@pytest.mark.parametrize("role", ["static", "avoid"])
def test_only_what_may_be_pushed_is_pushed_away(role: str, gantry: Robot) -> None:
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), obj(role, STANDING, [0.3, 0.0, -0.2]))
    judgement = judging.judge(scene, gantry, along_x(gantry, 0.0, 0.27))
    assert judgement.violations
    assert not judgement.notes


def test_what_hangs_swings_back(gantry: Robot) -> None:
    stem = Stem(np.array([[0.3, 0.0, 0.25], [0.3, 0.0, 0.45]]))
    hung = replace(obj("pushable", STANDING, [0.3, 0.0, -0.2]), stem=stem)
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), hung)
    (contact,) = judging.judge(scene, gantry, along_x(gantry, 0.0, 0.27)).contacts
    assert (contact.link, contact.other) == ("y", "object")


def test_a_link_where_the_tool_never_comes_pushes(gantry: Robot) -> None:
    low = obj("pushable", Box((0.04, 0.04, 0.2)), [0.3, 0.0, -0.5])  # the tool never comes there
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), low)
    (contact,) = judging.judge(scene, gantry, along_x(gantry, 0.0, 0.27)).contacts
    assert contact.link == "y"


def test_no_deeper_than_the_tool_was(gantry: Robot) -> None:
    """The tool brushes the object's top by 5 mm; the link then goes in by more."""
    tall = obj("pushable", Box((0.3, 0.02, 0.5)), [0.3, 0.0, -0.255])  # its top at -5 mm
    q = np.zeros((161, 3))
    q[:, 0] = np.interp(np.linspace(0.0, 1.0, 161), [0.0, 0.5, 1.0], [0.0, 0.0, 0.4])
    scene = to(JointGoal(q[-1]), tall)
    (contact,) = judging.judge(scene, gantry, moving(gantry, q, 0.1)).contacts
    assert contact.link == "y"
    assert contact.depth > 0.02


def test_the_tool_must_have_been_there_before(gantry: Robot) -> None:
    """From the other end: the link comes to the object's place first, the tool only later."""
    low = obj("pushable", Box((0.04, 0.04, 0.2)), [0.3, 0.0, -0.5])
    q = np.vstack([
        np.column_stack([np.linspace(0.0, 0.27, 80), np.zeros((80, 2))]),
        np.column_stack([np.full(80, 0.27), np.zeros(80), np.linspace(0.0, -0.63, 80)]),
    ])  # fmt: skip
    scene = to(JointGoal(q[-1]), low)
    contacts = judging.judge(scene, gantry, moving(gantry, q, 0.1)).contacts
    assert ("y", "object") in {(contact.link, contact.other) for contact in contacts}
