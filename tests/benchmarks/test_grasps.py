"""A hand that touches what it is about to grasp: refused, and reached where the two may touch."""

from dataclasses import replace

import pytest

import optipromp
from benchmarks.furniture import generate
from benchmarks.grasps import touching
from optipromp.core.errors import Code
from optipromp.core.scenes.scene import JointGoal


@pytest.mark.slow
def test_a_goal_at_which_the_hand_touches_one_thing_needs_the_pair() -> None:
    table = generate("table-pick", 61_000)
    found = touching(table, 1)
    assert found is not None
    goal, thing = found
    scene = replace(table, goal=JointGoal(goal))
    assert optipromp.plan(scene).status is Code.GOAL_IN_COLLISION
    paired = replace(scene, may_touch=(("tool", thing),))
    made = optipromp.plan(paired)
    assert made.success, made.message
    bare = optipromp.judge(scene, made.trajectory).judgement.contacts
    assert {(one.link, one.other) for one in bare} == {("tool", thing)}
