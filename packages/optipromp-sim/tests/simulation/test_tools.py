"""Tools of every kind in the simulation: their bodies, what they take hold of, and runs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from tests.robots.builders import INNER, SIDES, TOOLS, mesh_cup, probe
from tests.simulation.bench import clean

from optipromp.core.planning import plan, plan_pick
from optipromp.core.pushing.stems.cup import Mouth, cup_distance
from optipromp.core.robots import Cup, FingerGripper, Scissor, Tool, load_robot, with_tool
from optipromp.core.robots.tools import cone_of
from optipromp.core.scenes import JointGoal, Scene, ToolSpec, load_scene
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Cause, SimulationParameters, simulate
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.world import build


def equipped(tool: Tool):
    return with_tool(load_robot("panda"), tool)


@pytest.mark.parametrize("name", TOOLS)
def test_its_solids_are_the_geoms_of_its_body(name):
    tool, mujoco = TOOLS[name], engine()
    robot, scene = equipped(tool), load_scene("scenario-3")
    model = build(scene, robot).model
    body = model.body("tool").id
    of_tool = [model.geom(k).name.startswith("tool:") for k in range(model.ngeom)]
    assert sum(of_tool) == len(tool.solids())
    data = mujoco.MjData(model)
    data.qpos[: robot.n_segments] = robot.home
    mujoco.mj_forward(model, data)
    origins, rotations = robot.segment_frames(robot.home)
    flange = origins[-1] + rotations[-1] @ robot.flange_translation
    turned = rotations[-1] @ robot.flange_rotation
    np.testing.assert_allclose(data.xpos[body], flange, atol=1e-9)
    for solid in tool.solids():
        geom = model.geom(f"tool:{solid.name}").id
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            own = model.mesh_vert[first : first + count]
            placed = data.geom_xpos[geom] + own @ data.geom_xmat[geom].reshape(3, 3).T
            corners = flange + solid.corners @ turned.T
            for end in (np.min, np.max):
                np.testing.assert_allclose(end(placed, axis=0), end(corners, axis=0), atol=1e-6)
        else:
            middle = flange + turned @ solid.position
            np.testing.assert_allclose(data.geom_xpos[geom], middle, atol=1e-9)
    parameters = SimulationParameters().robot
    mass = parameters.hand_mass if tool.fingers else parameters.tool_mass
    assert model.body_mass[body] == pytest.approx(mass)
    np.testing.assert_allclose(model.body_ipos[body], tool.inertia(mass)[0], atol=1e-12)
    wanted = np.sort(np.linalg.eigvalsh(tool.inertia(mass)[1]))
    np.testing.assert_allclose(np.sort(model.body_inertia[body]), wanted, rtol=1e-6)


def test_a_ray_in_the_mouth_of_a_mesh_meets_its_walls():
    """The pieces collide where the mesh has them: INNER from the axis, all round."""
    mujoco, robot = engine(), equipped(mesh_cup())
    world = build(load_scene("scenario-3"), robot)
    data = world.data(robot.home)
    point, axis = robot.tool_pose(robot.home)
    turned = robot.segment_frames(robot.home)[1][-1] @ robot.flange_rotation
    met = np.zeros(1, dtype=np.int32)
    for k in range(SIDES):
        turn = 2.0 * np.pi * (k + 0.5) / SIDES
        way = turned @ [np.cos(turn), np.sin(turn), 0.0]
        away = mujoco.mj_ray(world.model, data, point, way, None, 1, -1, met)
        assert away == pytest.approx(INNER, abs=1e-4)
        assert world.model.geom(int(met[0])).name.startswith("tool:piece")
    assert mujoco.mj_ray(world.model, data, point, axis, None, 1, -1, met) != pytest.approx(0.02)


@pytest.mark.parametrize("taper", [0.0, 30.0, 60.0])
def test_a_cup_collides_where_the_push_model_has_it(taper):
    """From points under the base, a ray against the gradient meets the cup at the distance."""
    tool, mujoco = Cup(0.03, taper=taper), engine()
    robot = equipped(tool)
    world = build(Scene("alone", robot.name, (), goal=JointGoal(robot.home)), robot)
    data, met = world.data(robot.home), np.zeros(1, dtype=np.int32)
    mujoco.mj_forward(world.model, data)
    base = tool.front - tool.reach
    cup = Mouth(*tool.mouth, base, tool.depth, 0.002, 0.01, end=-tool.reach, cone=cone_of(tool))
    point, axis = robot.tool_pose(robot.home)
    out = np.linalg.svd(axis[None])[2][1]
    for rho, under in itertools.product([0.012, 0.02, 0.028, 0.035], [0.003, 0.01, 0.03, 0.06]):
        d, along, up = cup_distance(rho, base - under, cup)
        if d > 1e-3:
            start, way = point + rho * out + (base - under) * axis, along * out + up * axis
            away = mujoco.mj_ray(world.model, data, start, -way, None, 1, -1, met)
            assert away == pytest.approx(d, abs=2e-4)
            assert world.model.geom(int(met[0])).name.startswith("tool:")


def test_a_cup_with_a_cone_is_planned_with_and_leaves():
    scene = generate("cluster", 3)
    tool = ToolSpec("cup", {**scene.tool.parameters, "taper": 45.0})
    assert clean(plan_pick(replace(scene, tool=tool))).robot.tool.taper == 45.0


def test_a_finger_gripper_picks_a_can_off_a_shelf():
    tool = FingerGripper(0.08, finger_length=0.055, palm_length=0.066, palm_width=0.16)
    run = clean(plan(generate("shelf", 1), robot=equipped(tool)))
    assert run.robot.tool is tool
    assert run.outcome.picked
    assert "between the fingers" in run.outcome.message


@pytest.mark.parametrize("scene", ["scenario-3", "scenario-4"])
def test_a_finger_gripper_takes_hold_of_the_target_alone(scene):
    """Its sides are open: n2 may come in from the side, which the push model tells."""
    refused = plan(scene, robot=equipped(FingerGripper(0.05)))
    assert "n2 is swallowed" in refused.message
    run = clean(plan(scene, robot=equipped(FingerGripper(0.05)), risk=0.1), seed=1)
    assert "between the fingers" in run.outcome.message


def test_a_mesh_with_a_mouth_swallows_a_fruit():
    run = clean(plan(generate("cluster", 3), robot=equipped(mesh_cup())))
    assert run.outcome.picked
    assert run.outcome.swallowed_at is not None


def test_a_tool_that_takes_hold_of_nothing_picks_nothing():
    run = simulate(plan(generate("cluster", 3), robot=equipped(probe())))
    assert run.outcome.picked is None
    assert run.outcome.swallowed_others == run.outcome.entered == ()
    assert run.outcome.cause is not Cause.NOT_PICKED
    assert run.outcome.target_displacement is not None


def test_a_bare_trajectory_is_simulated_with_the_robot_that_is_given():
    made = plan("scenario-3", robot=equipped(Scissor(0.05)))
    of_plan = simulate(made)
    given = simulate(made.trajectory, made.scene, robot=made.robot)
    assert given.outcome == of_plan.outcome
    assert simulate(made.trajectory, made.scene).robot.tool == Cup(0.05)


def test_the_margin_below_the_rim_counts_for_every_tool():
    """A target that ends at the tool point is deep enough for a margin less than the depth."""
    made = plan(generate("cluster", 3), robot=equipped(FingerGripper(0.05, depth=0.015)))
    for margin, picked in ((0.010, True), (0.030, False)):  # the depth is 0.015
        parameters = SimulationParameters().changed(thresholds={"inside_margin": margin})
        assert simulate(made, parameters=parameters).outcome.picked is picked
