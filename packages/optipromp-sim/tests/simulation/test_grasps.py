"""Suction cups, scissors, grippers of meshes and turned mounts, planned and simulated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.robots.builders import prism, write_obj
from tests.simulation.bench import clean

from optipromp.core.geometry import Box, distances, pack
from optipromp.core.planning import plan
from optipromp.core.planning.legs import plan_pick
from optipromp.core.robots import FingerGripper, MeshTool, Scissor, ik, load_robot, with_tool
from optipromp.core.robots.ik import level
from optipromp.core.robots.mounted import Mounted
from optipromp.core.robots.tools import make_tool
from optipromp.core.scenes import (
    JointGoal,
    PoseGoal,
    SceneObject,
    ToolSpec,
    load_scene,
    save_scene,
    scene_to_dict,
)
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.trajectory import Trajectory
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Cause, simulate

QUARTER = float(np.cos(np.pi / 4.0))  # of a quaternion of a quarter turn


TALL = {  # a fruit fits between its blades
    "opening": 0.06, "blade_length": 0.09, "blade_width": 0.016, "depth": 0.008,
}  # fmt: skip
SHEAR = ToolSpec("scissor", TALL)


def above(scene, height):
    """The scene, approached to the point ``height`` [m] over the target's centre on its stem."""
    target = scene.target
    line = target.stem.vector / np.linalg.norm(target.stem.vector)
    approach = replace(scene.approach, shift=height * line, cone=0.0, aside=0.0)
    return replace(scene, approach=approach)


def alone(scene, *others):
    kept = [item for item in scene.objects if item.role == "target" or item.id in others]
    return replace(scene, objects=tuple(kept))


def test_a_scissor_cuts_the_stem_of_the_target() -> None:
    scene = replace(alone(generate("limp", 3)), tool=SHEAR)
    run = clean(plan(scene))
    assert run.outcome.cut.stems == ("ripe",)
    assert run.outcome.picked
    assert run.outcome.message.startswith("the stem of ripe alone is cut")
    assert not run.outcome.torn
    assert list(run.outcome.to_dict()["cut"]["stems"]) == ["ripe"]
    assert run.rollout.attached[0, 0]
    assert not run.rollout.attached[-1, 0]
    away = np.linalg.norm(run.rollout.fruit_positions[:, 0] - run.rollout.tool_point, axis=1)
    assert away[-30:] == pytest.approx(away[-1], abs=1e-3)  # it hangs from the blades


def test_a_scissor_that_ends_at_the_fruit_cuts_nothing() -> None:
    scene = above(replace(alone(generate("limp", 3)), tool=SHEAR), 0.001)
    run = simulate(plan(scene))
    assert run.outcome.picked is False
    assert not run.success
    assert run.outcome.cause is Cause.CUT_OTHER
    assert run.outcome.cut.stems == ()
    assert run.outcome.cut.fruits == ("ripe",)
    assert "the blades closed on ripe" in run.outcome.message
    assert "the stem of ripe is not cut" in run.outcome.message
    assert run.rollout.attached.all()


def test_a_stem_between_the_blades_that_is_not_the_targets_is_told() -> None:
    scene = above(replace(alone(generate("limp", 3)), tool=SHEAR), 0.032)
    ripe = scene.target
    aside = np.array([0.0, 0.022, 0.05])
    stem = replace(ripe.stem, points=ripe.stem.points + aside)
    other = replace(ripe, id="n1", role="pushable", position=ripe.position + aside, stem=stem)
    low = replace(other, position=other.position, stem=replace(stem, radius=0.001))
    made = plan(scene)
    run = simulate(made.trajectory, replace(scene, objects=(ripe, low)), robot=made.robot)
    assert Cause.CUT_OTHER in run.outcome.causes
    assert not run.success


@pytest.mark.parametrize(
    ("preset", "seed", "opening"), [("vine", 10, 0.04), ("vine", 10, 0.12), ("trusses", 1, 0.04)]
)
def test_what_is_cut_from_the_side_hangs_from_the_blades(preset, seed, opening) -> None:
    """A pepper, or a whole truss; all fruits stay in the shapes that the plan has at the tool."""
    scene = generate(preset, seed)
    tool = ToolSpec("scissor", {**scene.tool.parameters, "opening": opening})
    picked = plan_pick(replace(scene, tool=tool))
    run = clean(picked)
    assert "side of its stem" not in picked.message
    assert set(run.outcome.cut.stems) == {item.id for item in scene.taken}
    assert not run.outcome.torn
    rollout, after = run.rollout, np.flatnonzero(run.rollout.times > run.outcome.cut.time)
    for item, held in zip(scene.taken, picked.legs["retreat"].scene.attached, strict=True):
        solid = pack([(held.shape, held.position, from_quaternion(held.orientation))])
        k, least = rollout.fruit_ids.index(item.id), min(item.shape.measure.half)
        for row in after[::20]:
            axes = run.robot.segment_frames(rollout.q[row])[1][-1] @ run.robot.tool_rotation
            at = (rollout.fruit_positions[row, k] - rollout.tool_point[row]) @ axes
            assert distances(solid, [at])[0].item() < 1e-3 - least
    assert np.linalg.norm(rollout.tool_point[-1] - rollout.tool_point[after[0]]) > 0.09


def test_a_truss_whose_highest_fruit_stays_on_the_plant_is_not_picked() -> None:
    """A fruit that nobody saw grows behind the stem, from above the place of the cut."""
    made = plan(generate("trusses", 0))
    scene, (target, seen, *_) = made.scene, made.scene.taken
    line = target.stem.vector / np.linalg.norm(target.stem.vector)
    root = scene.aim + 0.03 * line  # more than a piece of the stem
    place = root + 0.045 * scene.frame[2] - 0.02 * scene.up
    stem = replace(seen.stem, points=np.array([place, root]))
    hidden = replace(seen, id="hidden", position=place, stem=stem)
    run = simulate(made, replace(scene, objects=(*scene.objects, hidden)))
    assert set(run.outcome.cut.stems) == {item.id for item in scene.taken}
    assert Cause.NOT_PICKED in run.outcome.causes


def test_what_the_hanging_fruit_would_meet_on_the_way_out_is_told() -> None:
    """A post that the blades pass over, and the fruit below them does not."""
    scene = generate("vine", 10)
    ripe, ahead = scene.target, scene.frame[2]
    place = ripe.position - (ripe.radius + 0.03) * ahead
    wall = SceneObject("wall", "static", Box((0.01, 0.3, 0.06)), place)
    walled = replace(scene, objects=(*scene.objects, wall))
    assert plan(walled).success
    legs = plan_pick(walled).legs
    assert not legs["retreat"].success
    assert "ripe enters wall" in legs["retreat"].message


def test_blades_from_the_side_cut_the_stem_nearest_the_goal() -> None:
    """A scene with a goal in place of a target; the arm moves straight to it."""
    scene = alone(generate("limp", 3))
    ripe, way = scene.target, np.array([1.0, 0.0, 0.0])
    at = ripe.position + 0.05 * ripe.stem.vector / np.linalg.norm(ripe.stem.vector)
    robot = with_tool(load_robot("panda"), Scissor(0.05))
    begin = level(robot, ik.solve(robot, at - 0.12 * way, way).joints, scene.up)[:1]
    line = at + np.linspace(-0.12, 0.0, 25)[:, None] * way
    q, errors = ik.track(robot, line, np.tile(way, (25, 1)), begin[0])
    assert errors.max() < 1e-4
    motion = Trajectory.through(level(robot, q, scene.up, path=True), 4.0, robot.joint_names)
    for goal in (PoseGoal(at, way), JointGoal(motion.positions[-1])):
        fruit = replace(ripe, role="pushable")
        run = simulate(motion, replace(scene, objects=(fruit,), goal=goal), robot=robot)
        assert run.success, run.outcome.message
        assert run.outcome.picked
        assert run.outcome.cut.stems == ("ripe",)
        assert run.outcome.target is None


def test_a_suction_cup_picks_what_its_lip_touches(tmp_path) -> None:
    scene = replace(generate("cluster", 3), tool=ToolSpec("suction", {"radius": 0.012}))
    save_scene(scene, tmp_path / "scene.yaml")
    run = clean(plan(load_scene(tmp_path / "scene.yaml")))
    assert run.outcome.picked
    assert "at the lip" in run.outcome.message
    short = replace(scene, tool=ToolSpec("suction", {"radius": 0.012, "fruit": 0.03}))
    away = simulate(plan(short))  # the lip ends 10 mm below the fruit
    assert away.outcome.picked is False
    assert away.outcome.cause is Cause.NOT_PICKED


def test_a_suction_cup_at_a_wrong_angle_takes_hold_of_nothing() -> None:
    scene = replace(alone(generate("cluster", 3)), tool=ToolSpec("suction", {"radius": 0.012}))
    made = plan(scene)
    narrow = make_tool("suction", {**vars(made.robot.tool), "angle": 0.01})
    run = simulate(made, robot=with_tool(load_robot("panda"), narrow))
    assert run.outcome.picked is False


def gripper_files(folder: Path) -> dict[str, object]:
    """A palm and two fingers, 50 mm apart along x."""
    pad = np.array([[-0.005, -0.01], [0.005, -0.01], [0.005, 0.01], [-0.005, 0.01]])
    write_obj(folder / "palm.obj", *prism(8.0 * pad * [1.0, 0.3], 0.0, 0.08))
    for name, aside in (("left", 0.03), ("right", -0.03)):
        write_obj(folder / f"{name}.obj", *prism(pad + [aside, 0.0], 0.08, 0.13))
    return {"kind": "mesh", "file": "palm.obj", "fingers": ["left.obj", "right.obj"],
            "tool_point": [0.0, 0.0, 0.12]}  # fmt: skip


def test_a_gripper_of_meshes_is_the_gripper_of_boxes(tmp_path) -> None:
    stated = gripper_files(tmp_path)
    document = scene_to_dict(generate("cluster", 3)) | {"tool": stated}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(document))
    scene = load_scene(tmp_path / "scene.yaml")
    assert scene_to_dict(scene, base_dir=tmp_path)["tool"] == stated
    tool = make_tool(scene.tool.kind, scene.tool.parameters)
    boxes = FingerGripper(0.05, finger_length=0.05, palm_length=0.08, palm_width=0.08,
                          palm_thickness=0.048, turn=np.pi / 2.0)  # fmt: skip
    assert isinstance(tool, MeshTool)
    assert tool.fingers
    for name in ("front", "tip", "reach", "gripper_radius"):
        assert getattr(tool, name) == pytest.approx(getattr(boxes, name)), name
    assert tool.mouth == pytest.approx(boxes.mouth)
    assert abs(tool.rotation[:, 1] @ boxes.rotation[:, 1]) == pytest.approx(1.0)
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (2000, 3))
    assert (tool.holds(points, points) == boxes.holds(points, points)).all()
    run = clean(plan(scene))
    assert "between the fingers" in run.outcome.message


def test_a_mount_undoes_a_turned_flange() -> None:
    """The tool stands where it would on a plain flange: spheres, judge and simulation agree."""
    panda, angle = load_robot("panda"), -1.2
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0],
                     [-np.sin(angle), 0.0, np.cos(angle)]])  # fmt: skip
    aside = np.array([0.01, -0.02, 0.03])
    turned = replace(
        panda,
        flange_rotation=panda.flange_rotation @ turn.T,
        flange_translation=panda.flange_translation - panda.flange_rotation @ turn.T @ aside,
    )
    cup = make_tool("cup", {"radius": 0.025})
    half = 0.5 * angle
    mounted = Mounted(cup, tuple(aside), (np.cos(half), 0.0, np.sin(half), 0.0))
    plain, same = with_tool(panda, cup), with_tool(turned, mounted)
    assert np.allclose(plain.tool_point, same.tool_point)
    assert np.allclose(plain.tool_axis, same.tool_axis)
    assert np.allclose(plain.spheres.center, same.spheres.center)
    for one, other in zip(cup.outline(), mounted.outline(), strict=True):
        assert np.allclose(one, other)
    clean(plan(generate("cluster", 3), robot=same))


def test_a_mounted_scissor_is_a_scissor() -> None:
    scene = above(replace(alone(generate("limp", 3)), tool=SHEAR), 0.032)
    mount = (0.0, 0.0, 0.01), (QUARTER, 0.0, 0.0, QUARTER)
    run = simulate(plan(replace(scene, tool=ToolSpec("scissor", {**TALL, "mount": mount}))))
    assert run.outcome.picked
    assert isinstance(run.robot.tool, Mounted)
    assert isinstance(run.robot.tool.tool, Scissor)
