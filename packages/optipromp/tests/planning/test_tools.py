"""A plan with a tool of each kind, and with one of the user's own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.robots import builders
from tests.robots.builders import INNER, probe

from optipromp.core.planning import Plan, judge, plan
from optipromp.core.planning.task import resolve
from optipromp.core.pushing.packs.standing import Standing, plane
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots import Cup, Mounted, Scissor, load_robot, with_tool
from optipromp.core.scenes import Scene, ToolSpec, load_scene
from optipromp.looks.viewer.reach import tool_faces
from optipromp_sim.generate import generate

SMALL = replace(generate("cluster", 5), tool=None)  # two fruits in the way of a target
FREER = replace(generate("cluster", 7), tool=None)  # where fingers and blades come straight
LONG = Scissor(0.06, blade_length=0.09, blade_width=0.02, depth=0.008)  # a fruit fits in
TOOLS = {**builders.TOOLS, "scissor": LONG}


def given(name: str) -> Scene:
    return FREER if TOOLS[name].fingers else SMALL


@cache
def made(name: str) -> Plan:
    return plan(given(name), robot=with_tool(load_robot("panda"), TOOLS[name]))


@pytest.mark.parametrize("name", TOOLS)
def test_a_small_scene_is_planned_with_each_tool(name: str) -> None:
    result, target = made(name), given(name).target
    assert result.robot.tool is TOOLS[name]
    assert result.success, result.message
    tool, aim = TOOLS[name], target.position
    flange = with_tool(load_robot("panda"), tool).tool_pose(result.trajectory.positions[-1])
    if name == "scissor":  # on the stem, and ``cut`` from the fruit
        line = target.stem.vector / np.linalg.norm(target.stem.vector)
        aim = aim + (target.radius + tool.cut) * line
    np.testing.assert_allclose(flange[0], aim, atol=2e-3)
    assert judge(given(name), result.trajectory, robot=result.robot).status == result.status


def test_the_robot_takes_the_place_of_the_scenes() -> None:
    scene = replace(FREER, tool=ToolSpec("finger_gripper", {"opening": 0.06, "turn": 0.4}))
    np.testing.assert_array_equal(
        plan(scene).trajectory.positions, made("finger_gripper").trajectory.positions
    )
    assert resolve(scene, made("cup").robot).robot is made("cup").robot


@pytest.mark.parametrize("name", ["finger_gripper", "scissor"])
def test_fingers_end_level(name: str) -> None:
    robot, q = made(name).robot, made(name).trajectory.positions[-1:]
    turned = robot.segment_frames(q)[1][0, -1] @ robot.flange_rotation
    opens = turned @ TOOLS[name].rotation[:, 1]
    assert abs(opens @ given(name).frame[0]) < np.sin(np.deg2rad(2.0))


def test_the_push_model_has_the_cone_of_a_cup_however_it_is_mounted() -> None:
    cup = Cup(0.03, taper=45)
    for tool, cone in ((cup, 0.02), (Mounted(cup, (0.0, 0.0, 0.03)), 0.02), (Cup(0.03), 0.0)):
        task = resolve(load_scene("scenario-3"), with_tool(load_robot("panda"), tool))
        model = Hanging(task.scene, tool, task.scene.pushables, task.camera, 0.03)
        assert model.cup.cone == pytest.approx(cone)


@pytest.mark.parametrize("name", TOOLS)
def test_each_tool_pushes_what_hangs(name: str) -> None:
    task = resolve(load_scene("scenario-3"), with_tool(load_robot("panda"), TOOLS[name]))
    model = Hanging(task.scene, TOOLS[name], task.scene.pushables, task.camera, 0.03)
    inner, outer = TOOLS[name].mouth
    assert model.cup.inner == (inner if inner > 0.0 else -outer)
    straight = np.linspace(task.camera, task.scene.target.position, 60)
    up = np.tile(task.scene.frame[2], (60, 1))
    far = straight + 0.5 * task.scene.frame[0]
    if inner > 0.0:
        place = "between the blades" if name == "scissor" else "inside"
        assert model.cause(far, up)[1] == f"is not {place} at the end"
    else:  # it takes hold of nothing: to be far away does no harm
        assert model.harm(far, up, model.states) == 0.0


def test_a_solid_tool_pushes_a_fruit_that_a_cup_swallows() -> None:
    scene = load_scene("scenario-3")
    fruit = scene.pushables[0]
    up = np.tile(scene.frame[2], (60, 1))
    moved = {}
    for name, end in (("mesh", 0.0), ("probe", 0.018)):  # the probe's tip is 18 mm behind its point
        points = fruit.position + np.linspace(-0.12, end, 60)[:, None] * scene.frame[2]
        model = Hanging(scene, TOOLS[name], scene.pushables, points[0], INNER)
        found = model.moved(points, up)
        at = found.positions[found.ids.index(fruit.id)]
        moved[name] = float(np.linalg.norm(at - fruit.position))
        within = np.linalg.norm(np.cross(at - points[-1], up[0])) < INNER
        assert within or name == "probe"
    assert moved["mesh"] < 0.01
    assert moved["probe"] > 0.01


@pytest.fixture(scope="module")
def shelf() -> Scene:
    return replace(generate("shelf", 1), tool=None)


@pytest.mark.parametrize("name", TOOLS)
def test_each_tool_pushes_what_stands(name: str, shelf: Scene) -> None:
    tool = TOOLS[name]
    model = Standing(shelf, tool)
    assert len(model.bench.hand.size) == len(tool.outline())
    straight = np.linspace([model.board.entry, 0.0, 0.0], np.zeros(3), 60)
    points = shelf.target.position + straight @ shelf.frame[[2, 1, 0]]
    axes = np.tile(shelf.frame[2], (60, 1))
    assert model.harm(points, axes, model.states) > 0.0
    assert np.isfinite(model.moved(points, axes).positions).all()


def test_of_a_tool_that_takes_hold_of_nothing_no_target_is_too_deep(shelf: Scene) -> None:
    """The bar's tool point is 18 mm before it: a target there is neither beyond nor between."""
    bench = plane(shelf, probe()).bench
    assert bench.mouth[1:].tolist() == [np.inf, 0.0]
    hand = plane(shelf, TOOLS["franka_hand"]).bench
    assert hand.mouth[2] == 0.04


def test_a_tool_of_the_users_own_has_a_push_model() -> None:
    task = resolve(load_scene("scenario-3"), with_tool(load_robot("panda"), TOOLS["spoon"]))
    assert isinstance(task.push_model(task.start), Hanging)


@pytest.mark.parametrize("name", TOOLS)
def test_each_tool_is_drawn_where_it_is(name: str) -> None:
    robot, tool = with_tool(load_robot("panda"), TOOLS[name]), TOOLS[name]
    point, axis = robot.tool_pose(robot.home)
    faces = tool_faces(robot, robot.home).reshape(-1, 3)
    height = (faces - point) @ axis
    if name != "spoon":  # its bowl ends before what it holds
        assert height.max() == pytest.approx(tool.depth, abs=1e-9)
    centers = robot.sphere_centers(robot.home)[robot.spheres.link == len(robot.link_names) - 1]
    cover = tool.spheres()
    away = np.linalg.norm(faces[:, None] - centers, axis=2) - cover[:, 3]
    if name != "franka_hand":
        assert away.min(axis=1).max() < (2e-3 if name == "cup" else 1e-9)
