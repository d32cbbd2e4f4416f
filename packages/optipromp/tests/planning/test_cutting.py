"""Where a scissor cuts, on the target's stem above the fruit, and how the fruit hangs from it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.robots.builders import INNER

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.shapes import Box
from optipromp.core.planning.cutting import hung, steady
from optipromp.core.planning.parameters import CUTTING
from optipromp.core.planning.task import aimed_at_stem, resolve
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots import Cup, Mounted, Scissor, Solid
from optipromp.core.robots.mounted import Load
from optipromp.core.scenes import Scene, Stem, ToolSpec
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.trajectory import Trajectory
from optipromp_sim.generate import generate

BLADES = Scissor(0.06, blade_length=0.09, depth=0.008)
BOX = Load("box", (Solid("box", Box((0.02, 0.02, 0.02)), np.array([0.0, 0.05, -0.1])),))


def hanging(points: np.ndarray | None = None) -> Scene:
    """One fruit that hangs, with a stem through ``points`` (k, 3) from its centre [m]."""
    scene = generate("limp", 3)
    fruit = scene.target
    stem = Stem.along(fruit.position, scene.up, 0.15)
    if points is not None:
        stem = Stem(fruit.position + points)
    return replace(scene, objects=(replace(fruit, stem=stem),))


@pytest.mark.parametrize(
    "tool", [BLADES, Mounted(BLADES), Mounted(BLADES, loads=(BOX,)), Scissor(0.06, cut=0.03)]
)
def test_the_approach_ends_on_the_stem_a_cut_above_the_fruit(tool: Scissor | Mounted) -> None:
    scene = hanging()
    found = aimed_at_stem(scene, tool)
    cut = 0.03 if tool == Scissor(0.06, cut=0.03) else 0.02
    assert found.approach.shift == pytest.approx((scene.target.radius + cut) * scene.up, abs=1e-3)
    assert (found.approach.cone, found.approach.aside) == (0.0, 0.0)
    assert found.aim == pytest.approx(scene.target.position + found.approach.shift)


def test_a_bent_stem_is_cut_where_it_is() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.025], [0.1, 0.0, 0.025], [0.1, 0.0, 0.2]])
    found = aimed_at_stem(hanging(points), BLADES).approach.shift
    assert found[2] == pytest.approx(0.025, abs=1e-6)
    assert 0.02 < found[0] < 0.05


def test_a_short_stem_is_cut_half_way() -> None:
    short = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.04]])
    scene = hanging(short)
    long = aimed_at_stem(hanging(), Scissor(0.06, cut=1e-6)).approach.shift[2]
    found = aimed_at_stem(scene, BLADES).approach.shift[2]
    assert found == pytest.approx(0.5 * (long + 0.04), abs=1e-3)


def test_what_a_scene_states_stays() -> None:
    scene = hanging()
    stated = replace(scene, approach=replace(scene.approach, shift=np.array([0.0, 0.0, 0.05])))
    assert aimed_at_stem(stated, BLADES) is stated
    tilted = replace(scene, approach=replace(scene.approach, cone=10.0, aside=0.01))
    approach = aimed_at_stem(tilted, BLADES).approach
    assert (approach.cone, approach.aside) == (10.0, 0.01)
    assert aimed_at_stem(scene, Cup(0.03)) is scene
    bare = replace(scene, objects=(replace(scene.target, stem=None),))
    assert aimed_at_stem(bare, BLADES) is bare


@pytest.mark.parametrize(
    ("aside", "missed"),
    [((0, 0), False), ((0, 0.015), False), ((0.015, 0), True), ((0, 0.04), True)],
)
def test_the_push_model_tells_whether_the_stem_ends_between_the_blades(aside, missed):
    """The blades are narrow along x_g and open along y_g."""
    scene = aimed_at_stem(hanging(), BLADES)
    x_g, y_g, z_g = scene.frame
    model = Hanging(scene, BLADES, (), scene.aim - 0.15 * z_g, INNER)
    end = scene.aim + aside[0] * x_g + aside[1] * y_g
    points = end + np.linspace(-0.15, 0.0, 60)[:, None] * z_g
    axes = np.tile(z_g, (60, 1))
    assert model.led(0, points, axes).harm.missed is missed
    below = points - 0.02 * z_g
    assert model.led(0, below, axes).harm.missed


def vine() -> Scene:
    """A pepper with a green one beside it, cut from the side."""
    return generate("vine", 10)


def test_from_the_side_the_axis_may_vary_and_the_place_may_not() -> None:
    approach = resolve(vine()).scene.approach
    assert (approach.cone, approach.aside) == (None, 0.0)


@pytest.mark.parametrize(
    ("aside", "missed"),
    [((0, 0, 0), False), ((0, 0.013, 0), False), ((0, 0.04, 0), True), ((0, 0, -0.03), True)],
)
def test_the_push_model_tells_stems_between_blades_from_the_side(aside, missed) -> None:
    """Along x_g, the stem, y_g, the opening, and z_g, the approach."""
    task = resolve(vine())
    scene = replace(task.scene, objects=(task.scene.target,))
    z_g = scene.frame[2]
    model = Hanging(scene, task.robot.tool, (), scene.aim - 0.1 * z_g, INNER)
    points = scene.aim + aside @ scene.frame + np.linspace(-0.1, 0.0, 60)[:, None] * z_g
    assert model.led(0, points, np.tile(z_g, (60, 1))).harm.missed is missed


def test_another_stem_between_the_blades_is_harm() -> None:
    task = resolve(vine())
    scene, target = task.scene, task.scene.target
    z_g, beside = scene.frame[2], -0.02 * scene.frame[2] + 0.001 * scene.frame[1]
    stem = replace(target.stem, points=target.stem.points + beside)
    other = replace(target, id="n", role="pushable", position=target.position + beside, stem=stem)
    scene = replace(scene, objects=(target, other))
    model = Hanging(scene, task.robot.tool, (other,), scene.aim - 0.1 * z_g, INNER)
    points = scene.aim + np.linspace(-0.1, 0.0, 60)[:, None] * z_g
    assert model.led(0, points, np.tile(z_g, (60, 1))).harm.inside > 0.03


@pytest.mark.parametrize(
    ("preset", "seed"), [("vine", 0), ("vine", 1), ("vine", 10), ("trusses", 0), ("trusses", 1)]
)
def test_what_hangs_is_held_by_its_shapes_wherever_it_swings(preset, seed) -> None:
    """Turned about the place of the cut, from plumb, by up to lean, sway and tilt together."""
    task = resolve(generate(preset, seed))
    scene, robot = task.scene, task.robot
    taken = [item for item in scene.objects if item.stem and item.id.startswith("ripe")]
    fruits, path = hung(scene, robot, robot.home)
    axes = robot.segment_frames(robot.home)[1][-1] @ robot.tool_rotation
    np.testing.assert_allclose(axes @ path.upright.axis, scene.up, atol=1e-9)
    off = np.array([item.position for item in taken]) - scene.aim
    line = -np.average(off, axis=0, weights=[item.shape.volume for item in taken])
    line /= np.linalg.norm(line)
    most = np.arccos(line @ scene.up) + CUTTING.sway + CUTTING.tilt
    plumb = Rotation.align_vectors([scene.up], [line])[0]
    for item, fruit in zip(taken, fruits, strict=True):
        solid = pack([(fruit.shape, fruit.position, from_quaternion(fruit.orientation))])
        own = item.shape.mesh().vertices @ item.rotation.T + item.position - scene.aim
        for turn in np.linspace(0.0, 2.0 * np.pi, 9):
            swing = Rotation.from_rotvec(most * np.array([np.cos(turn), np.sin(turn), 0.0]))
            away, _ = distances(solid, (swing * plumb).apply(own) @ axes)
            assert away.max() < 2e-3


def test_a_truss_is_cut_above_all_of_its_fruits_and_by_nothing_but_a_scissor_from_the_side() -> (
    None
):
    scene = generate("trusses", 0)
    approach, task = scene.approach, resolve(scene)
    top = max(item.stem.root[2] for item in scene.taken[1:])
    assert task.scene.aim[2] - top > 0.015
    assert not task.neighbours
    assert resolve(scene.approached(replace(approach, truss=False))).scene.aim[2] < top
    roles = {"ripe": "pushable", "ripe-1": "target"}
    other = scene.each(lambda item: replace(item, role=roles.get(item.id, item.role)))
    below = replace(scene, approach=replace(approach, direction=scene.up))
    for wrong, remedy in (
        (replace(scene, tool=ToolSpec("cup", {"radius": 0.03})), "kind: scissor"),
        (other, "at the end of the stem"),
        (below, "a level approach.direction"),
    ):
        with pytest.raises(InvalidSceneError, match=remedy):
            resolve(wrong)


@pytest.mark.parametrize("waves", [0, 2])
def test_a_steady_motion_sways_a_pendulum_as_little_as_it_says(waves: int) -> None:
    """The pendulum is integrated, as long as the cut is from the fruit's centre."""
    task = resolve(vine())
    robot, share = task.robot, np.linspace(0.0, 1.0, 40)
    turned = 0.3 * share + 0.1 * np.sin(np.pi * share) ** 2 * np.sin(2.0 * np.pi * waves * share)
    q = robot.home + turned[:, None] * np.eye(7)[0]
    fast = Trajectory.through(q, 0.01, robot.joint_names)
    long = float(np.linalg.norm(task.scene.approach.shift))
    sways = []
    for motion in (fast, steady(task.scene, robot, fast)):
        times = np.arange(0.0, motion.duration + 3.0, 1e-3)
        points, _ = robot.tool_pose(motion.sample(times)[0])
        gain = np.gradient(np.gradient(points, 1e-3, axis=0), 1e-3, axis=0)[:, :2]
        swing, speed = np.zeros((2, 2))
        most = 0.0
        for a in gain:
            speed -= 1e-3 * (9.81 * swing + a) / long
            swing = swing + 1e-3 * speed
            most = max(most, float(np.linalg.norm(swing)))
        sways.append(most)
    assert sways[0] > CUTTING.sway
    assert 0.1 * CUTTING.sway < sways[1] <= CUTTING.sway
