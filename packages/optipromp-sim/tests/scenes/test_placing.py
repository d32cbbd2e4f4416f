"""Scenes placed in the reach of other robots than the one that they are stated for."""

import re

import numpy as np
import pytest
from tests.scenes.six_joints import six
from tests.simulation.bench import clean

from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning import plan
from optipromp.core.planning.options import Optimised
from optipromp.core.planning.task import resolve
from optipromp.core.robots import load_robot
from optipromp.core.robots.library import NOTHING
from optipromp_sim.generate import bunches, generate
from optipromp_sim.generate.placing import fitted

FINGERS = "".join(
    f'<link name="{side}"><collision><origin xyz="{aside} 0 0.08"/><geometry><box size="0.01 0.02 '
    f'0.16"/></geometry></collision></link><joint name="{side}" type="prismatic"><parent '
    f'link="tool0"/><child link="{side}"/><axis xyz="1 0 0"/><limit lower="0" upper="0.04" '
    'velocity="1"/></joint>'
    for side, aside in (("left_finger", 0.04), ("right_finger", -0.04))
)  # 0.16 m long


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("six") / "six.urdf"
    path.write_text(six())
    return path


def test_the_world_is_the_same_before_another_robot(arm) -> None:
    ours, panda = generate("cluster", 5, arm), generate("cluster", 5)
    there = ours.base @ ours.positions
    assert [item.id for item in ours.objects] == [item.id for item in panda.objects]
    assert np.allclose(there, panda.positions, atol=1e-9)
    assert np.allclose(ours.up, [0.0, 0.0, 1.0])
    point, axis = resolve(ours).robot.tool_pose(ours.start)
    assert np.allclose(ours.base @ point, bunches.START, atol=1e-6)
    assert axis @ ours.up > 1.0 - 1e-9


def test_the_arm_stays_below_the_lowest_pushable(arm) -> None:
    """Beside the cup no sphere but the last link's is as high as pushables hang."""
    scene = generate("cluster", 5, arm)
    assert scene.tool.parameters["length"] >= bunches.NECK
    robot = resolve(scene).robot
    point, axis = robot.tool_pose(scene.start)
    off = robot.sphere_centers(scene.start)[~robot.spheres.distal] - point
    along = off @ axis
    aside = np.linalg.norm(off - along[:, None] * axis, axis=1)
    radius = robot.spheres.radius[~robot.spheres.distal]
    assert (along + radius)[aside - radius < 0.1].max(initial=-1.0) < -0.15


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_another_robot_picks(arm) -> None:
    for seed in (3, 2):
        clean(plan(generate("cluster", seed, arm)))


def test_the_cup_stands_before_the_fingers_of_the_robot(tmp_path) -> None:
    path = tmp_path / "gripper.urdf"
    path.write_text(six(more=FINGERS))
    scene = generate("cluster", 5, path)
    robot = resolve(scene).robot  # or it warns
    assert {"left_finger", "right_finger"} <= set(robot.link_names)
    assert 0.16 <= scene.tool.parameters["length"] < 0.2


def test_a_robot_that_cannot_reach_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("optipromp_sim.generate.generator.MOST_UNFIT", 3)
    path = tmp_path / "small.urdf"
    path.write_text(six(0.2))
    with pytest.raises(InvalidRequestError, match=r"cluster-0: six .*no place.* by \d+ mm"):
        generate("cluster", 0, path)
    path.write_text(six().replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"'))
    with pytest.raises(InvalidRequestError, match=r"no place.*the tool|degrees off"):
        generate("cluster", 0, path)  # all axes are upright


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_the_base_is_placed_for_each_scene_where_no_place_serves_all() -> None:
    """The SCARA lifts by 0.51 m; its base stands elsewhere before each scene."""
    scenes = [generate("cluster", seed, "scara") for seed in (0, 1, 3)]
    assert len({tuple(scene.base.position.round(3)) for scene in scenes}) == 3
    for seed, scene in zip((0, 1, 3), scenes, strict=True):
        task, target = resolve(scene), scene.target
        assert target is not None
        point, axis = task.robot.tool_pose(scene.start)
        assert axis @ scene.up == pytest.approx(1.0)
        lowest = min(item.position @ scene.up - item.radius for item in scene.objects)
        assert point @ scene.up < lowest
        assert scene.approach.camera_distance < 0.1  # its reach is less than the Panda's
        radii = [item.radius for item in scene.objects]  # fruits do not shrink
        assert min(radii) >= bunches.FRUIT_RADII[0]
        again = generate("cluster", seed, "scara")
        assert np.array_equal(again.positions, scene.positions)


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
@pytest.mark.parametrize("turn", ["0 1.5708 0", "0 0 0.3"])
def test_a_flange_across_the_wrist_gets_a_mount(tmp_path, turn) -> None:
    """The last joint rolls the hand about y of its link; the flange's z is across it."""
    path = tmp_path / "across.urdf"
    text = six().replace('<child link="tool0"/><origin xyz="0 0 0.06"/>',
                         f'<child link="tool0"/><origin xyz="0 0.06 0" rpy="{turn}"/>')  # fmt: skip
    assert turn in text
    path.write_text(text)
    arm = load_robot(path)
    last = arm.kinematics.axis[-1]
    assert abs(arm.flange_rotation[:, 2] @ last) < 0.01
    scene = fitted(generate("cluster", 5), arm, str(path), NOTHING)
    robot = resolve(scene).robot
    assert robot.tool_axis @ last == pytest.approx(1.0)  # to the side on which the flange is
    assert robot.tool_pose(scene.start)[1] @ scene.up == pytest.approx(1.0)
    assert plan(scene).success


def test_shelves_are_for_the_panda(arm) -> None:
    with pytest.raises(InvalidRequestError, match="panda only"):
        generate("shelf", 0, arm)


@pytest.mark.parametrize("seed", [110_001, 110_002])
def test_joints_keep_the_distance_from_their_limits_that_a_plan_keeps(seed) -> None:
    """An arm that hangs its hand on a slide: the best place of the second is where it ends."""
    scara, scene = load_robot("scara"), generate("cluster", seed)
    scene = fitted(scene, scara, "scara", NOTHING)
    assert plan(scene).valid
    task = resolve(scene)
    inside = np.minimum(scene.start - task.robot.lower, task.robot.upper - scene.start)
    assert inside.min() > 0.999 * Optimised.limit_margin


def test_a_plan_tells_of_a_path_of_less_harm_that_its_arm_cannot_follow() -> None:
    told = re.compile(
        r"harm ([0-9.]+) of at most .*; note: a path of harm ([0-9.]+) is out of the "
    )
    found = []
    for seed in (60010, 60088, 60166, 60168):  # which of them tell differs by processor
        refused = plan(generate("cluster", seed, "scara"))
        if refused.status is Code.HARM_PREDICTED and (said := told.search(refused.message)):
            found.append(said)
    assert found
    assert all(float(said[1]) > float(said[2]) for said in found)
