"""Scenes in other frames: the base somewhere in the world, detections in a camera's frame."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tests.scenes.documents import FRUIT, MINIMAL, with_fruit, with_object

from optipromp import plan
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import HalfSpace, Sphere, distances
from optipromp.core.pushing.packs.standing import applies
from optipromp.core.pushing.stems.bending import stems
from optipromp.core.robots.tools import make_tool
from optipromp.core.scenes import (
    Pose,
    PoseGoal,
    Scene,
    SceneObject,
    Stem,
    load_scene,
    save_scene,
    scene_from_dict,
    scene_to_dict,
)
from optipromp.core.scenes.scene import obstacles_of
from optipromp_sim.generate import generate

FLOOR = SceneObject("floor", "static", HalfSpace(), np.array([0.0, 0.0, -0.2]))
CAMERA = Pose([0.6, -0.4, 0.5], [0.1, 0.7, -0.7, 0.1])

unit_quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: np.array(q) / math.hypot(*q))
)
poses = st.builds(Pose, st.tuples(*[st.floats(-5, 5)] * 3), unit_quaternions)


def rich() -> Scene:
    """Scenario 4 with a floor, a camera, a covariance along no axis and a turned pack."""
    scene = load_scene("scenario-4")
    spread = np.array([[4e-5, 1e-5, 0.0], [1e-5, 2e-5, 5e-6], [0.0, 5e-6, 9e-5]])
    first, *others = scene.objects
    seen = replace(first, covariance=spread, orientation=[0.6, 0.0, 0.8, 0.0])
    return replace(scene, objects=(seen, *others, FLOOR), camera=CAMERA)


def assert_same_scene(a: Scene, b: Scene, atol: float) -> None:
    """Every value that has a frame is the same."""
    np.testing.assert_allclose(a.positions, b.positions, atol=atol)
    np.testing.assert_allclose(a.rotations, b.rotations, atol=atol)
    for one, other in zip(a.objects, b.objects, strict=True):
        assert (one.stem is None) == (other.stem is None)
        if one.stem is not None and other.stem is not None:
            np.testing.assert_allclose(one.stem.points, other.stem.points, atol=atol)
        if one.covariance is not None:
            np.testing.assert_allclose(one.covariance, other.covariance, atol=atol)
    np.testing.assert_allclose(a.frame, b.frame, atol=atol)
    if isinstance(a.goal, PoseGoal) and isinstance(b.goal, PoseGoal):
        np.testing.assert_allclose(a.goal.position, b.goal.position, atol=atol)
        np.testing.assert_allclose(a.goal.axis, b.goal.axis, atol=atol)
    pairs = [(a.base, b.base)]
    assert (a.camera is None) == (b.camera is None)
    if a.camera is not None and b.camera is not None:
        pairs.append((a.camera, b.camera))
    for one_pose, other_pose in pairs:
        np.testing.assert_allclose(one_pose.position, other_pose.position, atol=atol)
        np.testing.assert_allclose(one_pose.rotation, other_pose.rotation, atol=atol)


@settings(max_examples=60, deadline=None)
@given(poses, poses)
def test_poses_are_a_group(a: Pose, b: Pose) -> None:
    turn = Rotation.from_quat(a.orientation, scalar_first=True)
    np.testing.assert_allclose(a.rotation, turn.as_matrix(), atol=1e-12)
    x = np.array([[0.3, -0.2, 0.9], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose((a @ b) @ x, a @ (b @ x), atol=1e-12)
    np.testing.assert_allclose(a.inverse() @ (a @ x), x, atol=1e-12)
    np.testing.assert_allclose((a @ a.inverse()).rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(Pose(a.position, a.rotation).rotation, a.rotation, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(poses)
def test_there_and_back_is_the_same(pose: Pose) -> None:
    scene = rich()
    assert_same_scene(scene.transformed(pose).transformed(pose.inverse()), scene, 1e-12)
    goal = replace(scene, objects=(), goal=PoseGoal([0.4, 0.1, 0.7], [1.0, 2.0, 3.0]))
    assert_same_scene(goal.transformed(pose).transformed(pose.inverse()), goal, 1e-12)


@settings(max_examples=40, deadline=None)
@given(poses)
def test_only_the_frame_changes(pose: Pose) -> None:
    scene = rich()
    other = scene.transformed(pose)
    gaps, moved = (s.positions[:, None] - s.positions[None] for s in (scene, other))
    np.testing.assert_allclose(
        np.linalg.norm(moved, axis=2), np.linalg.norm(gaps, axis=2), atol=1e-12
    )
    points = np.random.default_rng(0).uniform(-0.5, 1.5, (20, 3))
    here, _ = distances(obstacles_of(scene), points)
    there, _ = distances(obstacles_of(other), pose @ points)
    np.testing.assert_allclose(there, here, atol=1e-12)
    # nothing has moved in the world
    np.testing.assert_allclose(other.base @ other.positions, scene.positions, atol=1e-12)
    np.testing.assert_allclose(other.up, pose.rotation[:, 2], atol=1e-12)
    # an uncertain direction is as uncertain as before
    along = np.array([0.48, 0.6, 0.64])
    turned, first, second = pose.rotation @ along, scene.objects[0], other.objects[0]
    expected = along @ first.covariance @ along
    assert turned @ second.covariance @ turned == pytest.approx(expected, rel=1e-9)
    # a stem is as stiff as before: gravity pulls along it as it did
    fruits = [item for item in scene.objects if item.stem is not None]
    again = [item for item in other.objects if item.stem is not None]
    np.testing.assert_allclose(
        np.linalg.eigvalsh(stems(again, other.up).stiffness),
        np.linalg.eigvalsh(stems(fruits, scene.up).stiffness), rtol=1e-6,
    )  # fmt: skip


def test_a_board_is_level_whatever_the_base() -> None:
    scene = generate("shelf", seed=77003)
    tool = make_tool(scene.tool.kind, scene.tool.parameters)
    assert applies(scene, tool)
    tilted = scene.transformed(Pose([0.0, 0.0, 0.0], [math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0]))
    assert applies(tilted, tool)
    assert not applies(replace(tilted, base=Pose()), tool)


def in_the_world(scene: Scene, base: Pose, camera: Pose, seen: tuple[str, ...]) -> dict:
    """The document of a scene whose base stands at ``base``; objects ``seen`` by the camera."""
    document = copy.deepcopy(scene_to_dict(scene))
    turns = {
        "world": Rotation.from_quat(base.orientation, scalar_first=True),
        "camera": Rotation.from_quat(
            camera.inverse().orientation, scalar_first=True
        ),
    }  # fmt: skip

    def point(x: list[float], frame: str) -> list[float]:
        away = camera.position if frame == "camera" else np.zeros(3)
        shift = base.position if frame == "world" else np.zeros(3)
        return (turns[frame].apply(np.array(x) - away) + shift).tolist()

    for item in document["objects"]:
        frame = "camera" if item["id"] in seen else "world"
        if frame == "camera":
            item["frame"] = "camera"
        item["position"] = point(item["position"], frame)
        own = Rotation.from_quat(item.get("orientation", [1, 0, 0, 0]), scalar_first=True)
        item["orientation"] = (turns[frame] * own).as_quat(scalar_first=True).tolist()
        if "stem" in item:
            item["stem"]["root"] = point(item["stem"]["root"], frame)
        if "covariance" in item:
            turn = turns[frame].as_matrix()
            item["covariance"] = (turn @ np.array(item["covariance"]) @ turn.T).tolist()
    for key in ("direction", "lateral"):
        document["approach"][key] = turns["world"].apply(document["approach"][key]).tolist()
    placed = Rotation.from_quat(camera.orientation, scalar_first=True)
    document["base"] = {
        "position": base.position.tolist(), "orientation": base.orientation.tolist(),
    }  # fmt: skip
    document["camera"] = {
        "position": point(camera.position.tolist(), "world"),
        "orientation": (turns["world"] * placed).as_quat(scalar_first=True).tolist(),
    }
    return document


@pytest.mark.filterwarnings("ignore:.* would stand")  # gravity has any direction
@settings(max_examples=25, deadline=None)
@given(poses, poses)
def test_a_file_states_the_world_and_what_the_camera_saw(base: Pose, camera: Pose) -> None:
    scene = replace(rich(), camera=camera)
    seen = (scene.objects[0].id, scene.objects[2].id)
    loaded = scene_from_dict(in_the_world(scene, base, camera, seen))
    assert_same_scene(loaded, replace(scene, base=base), 1e-12)


def test_the_plan_does_not_depend_on_where_the_base_stands() -> None:
    scene = load_scene("scenario-4")
    base = Pose([31.0, -12.0, 0.8], [math.cos(0.4), 0.0, 0.0, math.sin(0.4)])
    moved = scene_from_dict(in_the_world(scene, base, CAMERA, ("ripe",)))
    here, there = plan(scene), plan(moved)
    assert here.success
    assert there.success
    np.testing.assert_allclose(there.trajectory.positions, here.trajectory.positions, atol=1e-6)


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_base_and_camera_come_back_from_a_file(tmp_path, suffix) -> None:
    base = Pose([3.0, -1.0, 0.7], [0.5, -0.5, 0.5, 0.5])
    scene = replace(rich(), base=base)
    save_scene(scene, tmp_path / f"scene.{suffix}")
    again = load_scene(tmp_path / f"scene.{suffix}")
    assert_same_scene(again, scene, 1e-15)
    np.testing.assert_array_equal(again.positions, scene.positions)
    np.testing.assert_array_equal(again.rotations, scene.rotations)
    np.testing.assert_array_equal(again.base.orientation, base.orientation)


def test_frames_scale_and_default() -> None:
    fruit = FRUIT | {"position": [100.0, 0.0, 200.0]}
    document = MINIMAL | {
        "objects": [fruit | {"frame": "camera"}, fruit | {"id": "b", "role": "avoid"}],
        "base": {"position": [1000.0, 0.0, 0.0]}, "camera": {"position": [1500.0, 0.0, 500.0]},
        "frame": "base", "scale": 0.001,
    }  # fmt: skip
    scene = scene_from_dict(document)
    np.testing.assert_allclose(scene.positions, [[0.6, 0.0, 0.7], [0.1, 0.0, 0.2]], atol=1e-15)
    np.testing.assert_allclose(scene.base.position, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(scene.camera.position, [0.5, 0.0, 0.5])


def test_up_of_the_world_is_the_default_of_the_approach() -> None:
    half = math.sqrt(0.5)
    lying = {"position": [0.0, 0.0, 0.0], "orientation": [half, 0.0, half, 0.0]}  # z along world x
    given_up = scene_from_dict(MINIMAL | {"base": lying, "frame": "base"})
    np.testing.assert_allclose(given_up.approach.direction, [-1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(given_up.up, [-1.0, 0.0, 0.0], atol=1e-15)
    own = scene_from_dict(
        MINIMAL | {"base": lying, "frame": "base", "approach": {"direction": [0, 0, 1]}}
    )
    np.testing.assert_allclose(own.approach.direction, [0.0, 0.0, 1.0])
    world = scene_from_dict(MINIMAL | {"base": lying, "approach": {"direction": [1, 0, 0]}})
    np.testing.assert_allclose(world.approach.direction, [0.0, 0.0, 1.0], atol=1e-15)


def test_a_goal_is_in_the_frame_of_the_file() -> None:
    half = math.sqrt(0.5)
    document = MINIMAL | {
        "objects": [],
        "goal": {"position": [1.0, 2.5, 0.9], "axis": [0, 1, 0]},
        "base": {"position": [1.0, 2.0, 0.1], "orientation": [half, 0, 0, half]},
    }
    goal = scene_from_dict(document).goal
    assert isinstance(goal, PoseGoal)
    np.testing.assert_allclose(goal.position, [0.5, 0.0, 0.8], atol=1e-15)
    np.testing.assert_allclose(goal.axis, [1.0, 0.0, 0.0], atol=1e-15)
    inside = document | {"frame": "base"}
    np.testing.assert_array_equal(scene_from_dict(inside).goal.position, [1.0, 2.5, 0.9])


def test_a_stem_by_direction_and_length() -> None:
    scene = scene_from_dict(
        with_fruit(stem={"direction": [0, 3, 4], "length": 0.2, "radius": 0.002})
    )
    stem = Stem.along(scene.target.position, [0.0, 0.3, 0.4], 0.2, 0.002)
    np.testing.assert_array_equal(scene.target.stem.points, stem.points)
    np.testing.assert_allclose(stem.root - scene.target.position, [0.0, 0.12, 0.16])
    assert (stem.radius, stem.length) == (0.002, pytest.approx(0.2))
    with pytest.raises(InvalidSceneError, match=r"stem.direction is \[0.0, 0.0, 0.0\]"):
        Stem.along([0, 0, 0], [0, 0, 0], 0.2)
    with pytest.raises(InvalidSceneError, match=r"stem.length is -1.0: must be above 0"):
        Stem.along([0, 0, 0], [0, 0, 1], -1.0)


def test_python_says_what_the_file_says() -> None:
    at, turned = [0.4, 0.0, 0.8], [0.8, 0.0, 0.6, 0.0]
    one = SceneObject("n1", "pushable", Sphere(0.015), at, orientation=turned, sigma=0.005)
    other = scene_from_dict(with_object(orientation=turned, sigma=0.005)).pushables[0]
    np.testing.assert_array_equal(one.orientation, other.orientation)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    matrix = SceneObject("n1", "pushable", Sphere(0.015), at, one.rotation)
    np.testing.assert_allclose(matrix.orientation, turned, atol=1e-15)
    np.testing.assert_array_equal(replace(one, position=at).rotation, one.rotation)
    np.testing.assert_array_equal(replace(one, position=at).covariance, one.covariance)
    with pytest.raises(InvalidSceneError, match="is no rotation"):
        replace(one, orientation=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(InvalidSceneError, match="is no rotation"):
        Pose(at, 2.0 * np.eye(3))
    with pytest.raises(InvalidSceneError, match="has length 2"):
        Pose(at, [2.0, 0.0, 0.0, 0.0])
    with pytest.raises(InvalidSceneError, match="covariance and sigma"):
        SceneObject("a", "avoid", Sphere(0.1), at, covariance=np.eye(3), sigma=0.1)
    with pytest.raises(InvalidSceneError, match=r"sigma is -1\.0: must be 0 to 10"):
        SceneObject("a", "avoid", Sphere(0.1), at, sigma=-1.0)
