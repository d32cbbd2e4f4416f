"""The Franka hand in the simulation: its geometry, its grip, and a pick off a shelf."""

import numpy as np
import pytest

from optipromp.core.planning import plan
from optipromp.core.planning.task import resolve
from optipromp.core.robots.tools import FrankaHand
from optipromp_bench.experiments.trials import attempt
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Cause, simulate
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.world import build

HAND = FrankaHand()


@pytest.fixture(scope="module")
def scene():
    return generate("shelf", 1)


@pytest.fixture(scope="module")
def run(scene):
    return simulate(plan(scene))


def test_the_fingers_are_apart_and_the_tool_point_is_free(scene):
    mujoco = engine()
    robot = resolve(scene).robot
    world = build(scene, robot)
    data = world.data(scene.start)
    point, axis = robot.tool_pose(scene.start)
    _, turns = robot.segment_frames(scene.start)
    opens = (turns[-1] @ robot.flange_rotation @ HAND.rotation)[:, 1]
    hand = np.array([g for g in range(world.model.ngeom) if "hand:" in world.model.geom(g).name])
    assert len(hand) == 5
    # a ray from the tool point meets a pad after 40 mm on either side, and the palm behind
    for way, away in ((opens, 0.04), (-opens, 0.04), (-axis, HAND.reach - HAND.front)):
        met = np.zeros(1, dtype=np.int32)
        distance = mujoco.mj_ray(world.model, data, point, way, None, 1, -1, met)
        assert distance == pytest.approx(away, abs=1e-3)
        assert met[0] in hand


def test_a_can_is_picked_off_a_shelf(run):
    assert run.success, run.outcome.message
    assert run.outcome.picked
    assert "between the fingers" in run.outcome.message
    assert run.outcome.static_contacts == ()
    assert run.outcome.target_displacement < 0.005


def test_straight_through_the_packs_it_is_not(scene, run):
    outcome = simulate(attempt(scene, "straight").trajectory, scene).outcome
    assert outcome.cause in (Cause.CRUSHED, Cause.NOT_PICKED, Cause.SWALLOWED_OTHER)
    assert outcome.unripe_peak_force > run.outcome.unripe_peak_force
