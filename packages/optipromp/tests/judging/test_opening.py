"""The target's width across the approach against the tool's opening."""

from dataclasses import replace

import numpy as np
import pytest
from tests.judging.builders import UP, moving, obj

from optipromp.core import judging
from optipromp.core.arrays import frame_along
from optipromp.core.geometry import Ellipsoid, Sphere
from optipromp.core.judging import Judgement
from optipromp.core.robots.grippers import FingerGripper, Suction
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool
from optipromp.core.scenes import Approach, Scene, SceneObject

LEANING = frame_along(np.array([0.6, 0.0, 0.8]))
LONG = Ellipsoid((0.03, 0.03, 0.05))
HALF = 1e3 * np.hypot(0.03 * 0.8, 0.05 * 0.6)  # [mm] across the vertical


def judged(robot: Robot, target: SceneObject) -> Judgement:
    """The gantry's tool comes to the target from below."""
    q = np.linspace([0.0, 0.0, -0.3], [0.0, 0.0, 0.0], 9)
    at = robot.tool_pose(q[-1])[0]
    scene = Scene("s", "robot", (replace(target, position=at),), approach=Approach(direction=UP))
    return judging.judge(scene, robot, moving(robot, q), stem_side=False)


def test_a_target_wider_than_the_opening_is_a_violation(gantry: Robot) -> None:
    narrow = with_tool(gantry, Cup(0.05, opening=0.076))
    (wrong,) = judged(narrow, obj("target", LONG, np.zeros(3), LEANING)).violations
    assert (wrong.kind, wrong.subject, wrong.unit) == ("opening", "object", "m")
    assert wrong.amount == pytest.approx(1e-3 * HALF - 0.038, rel=1e-3)
    assert str(wrong) == (
        f"the half width of object across the approach is {HALF:.1f} mm, that of the tool's "
        "opening 38.0 mm"
    )
    assert judged(narrow, obj("target", LONG, np.zeros(3))).violations == ()  # upright


def test_a_target_with_little_room_is_a_note(gantry: Robot) -> None:
    tight, roomy = (with_tool(gantry, Cup(0.05, opening=wide)) for wide in (0.078, 0.08))
    leaning = obj("target", LONG, np.zeros(3), LEANING)
    told = judged(tight, leaning)
    assert told.violations == ()
    assert f"{HALF:.1f} mm, that of the tool's opening 39.0 mm" in told.notes[0]
    assert judged(roomy, leaning).notes == ()


def test_fingers_and_suction_cups_take_hold_of_wider_targets(gantry: Robot) -> None:
    ball = obj("target", Sphere(0.06), np.zeros(3))
    for tool in (FingerGripper(opening=0.08), Suction(0.015)):
        told = judged(with_tool(gantry, tool), ball)
        assert "opening" not in [each.kind for each in told.violations]
    assert [each.kind for each in judged(gantry, ball).violations] == ["opening"]
