"""Scenes as messages of MoveIt and back: the convention, round trips, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.robots.meshes import FACES, TETRAHEDRON
from tests.ros.camera_messages import sent

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Sphere,
)
from optipromp.core.planning.task import posed
from optipromp.core.scenes import Approach, Pose, Scene, SceneObject, Stem, load_scene, scene_names
from optipromp.core.scenes.rotations import from_quaternion
from optipromp_ros import (
    LiveScene,
    collision_object,
    message,
    planning_scene,
    read_collision_object,
    read_planning_scene,
)
from optipromp_ros.frames import known_frames
from optipromp_ros.scenes import pose_message, read_pose

SHAPES = (
    Sphere(0.0151),
    Box((0.1, 0.2, 0.3)),
    Cylinder(0.02, 0.3),
    Capsule(0.02, 0.3),
    HalfSpace(),
    MeshShape(TETRAHEDRON, FACES),
    PointCloudShape(np.array([[0.0, 0, 0], [0.01, 0, 0.02], [0.3, 0.1, 0]]), 0.004),
)
TURN = from_quaternion((0.5, 0.5, -0.5, 0.5))
OBJECT = "moveit_msgs/msg/CollisionObject"


def same_object(one: SceneObject, other: SceneObject) -> None:
    assert (one.id, one.role, dict(one.physical)) == (other.id, other.role, dict(other.physical))
    assert type(one.shape) is type(other.shape)
    for name, value in vars(one.shape).items():
        if name not in ("path", "scale", "measure"):  # the last is of the others
            np.testing.assert_allclose(getattr(other.shape, name), value, atol=1e-9, rtol=0)
    np.testing.assert_allclose(other.position, one.position, atol=1e-9, rtol=0)
    np.testing.assert_allclose(other.rotation, one.rotation, atol=1e-9, rtol=0)
    assert (one.stem is None) == (other.stem is None)
    if one.stem is not None:
        assert other.stem.radius == one.stem.radius
        np.testing.assert_allclose(other.stem.points, one.stem.points, atol=1e-9, rtol=0)
    assert (one.covariance is None) == (other.covariance is None)
    if one.covariance is not None:
        assert np.array_equal(other.covariance, one.covariance)


@pytest.mark.parametrize(
    ("shape", "role"),
    [
        (shape, role)
        for shape in SHAPES
        for role in ("static", "avoid", "pushable", "target")
        if role in ("static", "avoid") or shape != HalfSpace()  # a fruit has an end
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_every_shape_and_role_round_trips(shape, role: str) -> None:
    item = SceneObject("a/b c", role, shape, np.array([0.3, -0.2, 1.5]), TURN)
    (back,) = read_collision_object(sent(collision_object(item, "link0")))
    same_object(item, back)


@settings(max_examples=40)
@given(
    position=st.tuples(*[st.floats(-2, 2)] * 3),
    quaternion=st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.hypot.reduce(q) > 0.1),
    bends=st.lists(st.tuples(*[st.floats(0.01, 0.2)] * 3), min_size=1, max_size=4),
    radius=st.floats(1e-4, 0.02),
)
def test_a_fruit_on_a_bent_stem_round_trips(position, quaternion, bends, radius) -> None:
    turn = from_quaternion(tuple(np.array(quaternion) / np.hypot.reduce(quaternion)))
    points = np.cumsum([position, *bends], axis=0)
    item = SceneObject(
        "n1", "pushable", Capsule(0.01, 0.03), np.array(position), turn, Stem(points, radius),
        np.diag([1e-4, 2e-4, 3e-4]), {"mass": 0.02},
    )  # fmt: skip
    (back,) = read_collision_object(sent(collision_object(item)))
    same_object(item, back)


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_round_trips(name: str) -> None:
    scene = load_scene(name)
    scene = replace(scene, approach=Approach(np.array([0.1, 0.2, 1.0]), np.array([0.3, 1.0, 0.0])))
    back = read_planning_scene(sent(planning_scene(scene, "fr3_")), scene, "fr3_")
    assert (back.name, back.robot, back.tool) == (scene.name, scene.robot, scene.tool)
    assert back.options == scene.options
    np.testing.assert_allclose(back.approach.frame, scene.approach.frame, atol=1e-9)
    assert back.approach.camera_distance == scene.approach.camera_distance
    np.testing.assert_allclose(back.start, scene.start, atol=1e-9)
    for one, other in zip(scene.objects, back.objects, strict=True):
        same_object(one, other)


def test_colors_and_ids_tell_the_role() -> None:
    scene = load_scene("scenario-4")
    item = planning_scene(scene)
    ids = [one.id for one in item.world.collision_objects]
    assert ids[:3] == ["target/ripe", "pushable/n1", "pushable/n2"]
    assert "table-top" in ids
    assert [one.id for one in item.object_colors] == ids
    ripe, green = (one.color for one in item.object_colors[:2])
    assert ripe.r > ripe.g
    assert green.g > green.r
    assert item.world.collision_objects[0].header.frame_id == "link0"


def test_a_static_id_that_looks_like_a_role_stays_static() -> None:
    item = SceneObject("avoid/x", "static", Sphere(0.1), np.zeros(3))
    message_ = collision_object(item)
    assert message_.id == "static/avoid/x"
    same_object(item, *read_collision_object(message_))


def by_hand(name: str, **fields):
    """A sphere as a user of MoveIt writes it: the pose in ``primitive_poses``."""
    where = message("geometry_msgs/msg/Pose", position=point(0.4, 0.1, 0.5))
    solid = message("shape_msgs/msg/SolidPrimitive", type=2, dimensions=[0.02])
    return message(
        OBJECT, **{"id": name, "primitives": [solid], "primitive_poses": [where], **fields}
    )


def point(x: float, y: float, z: float):
    return message("geometry_msgs/msg/Point", x=x, y=y, z=z)


def test_an_object_by_hand() -> None:
    """The pose of the only shape is the object's, and the stem's points start from there."""
    up = message("geometry_msgs/msg/Pose", position=point(0, 0, 0.1))
    frames = {
        "subframe_names": ["stem_1", "stem_0"],
        "subframe_poses": [up, message("geometry_msgs/msg/Pose")],
    }
    (item,) = read_collision_object(sent(by_hand("pushable/n1", **frames)))
    assert (item.id, item.role, item.shape) == ("n1", "pushable", Sphere(0.02))
    assert item.position.tolist() == [0.4, 0.1, 0.5]
    np.testing.assert_allclose(item.stem.points, [[0.4, 0.1, 0.5], [0.4, 0.1, 0.6]])


def test_a_table_of_several_boxes() -> None:
    box = message("shape_msgs/msg/SolidPrimitive", type=1, dimensions=[0.1, 0.1, 0.1])
    poses = [message("geometry_msgs/msg/Pose", position=point(x, 0, 0)) for x in (1, 2)]
    table = {"primitives": [box, box], "primitive_poses": poses}
    items = read_collision_object(by_hand("table", **table))
    assert [item.id for item in items] == ["table[0]", "table[1]"]
    assert [item.position[0] for item in items] == [1, 2]
    with pytest.raises(
        InvalidSceneError, match=r"'target/table': it has 2 shapes: .*must have one"
    ):
        read_collision_object(by_hand("target/table", **table))


@pytest.mark.parametrize("normal", [(0, 0, 2), (0, 0, -1), (1, 2, -3), (0.6, 0, 0.8)])
def test_a_plane_of_any_equation(normal) -> None:
    plane = message("shape_msgs/msg/Plane", coef=[*normal, -0.5])
    empty = {"primitives": [], "primitive_poses": []}
    (item,) = read_collision_object(by_hand("floor", planes=[plane], **empty))
    assert item.shape == HalfSpace()
    up = item.rotation[:, 2]
    np.testing.assert_allclose(up, np.array(normal) / np.hypot.reduce(normal), atol=1e-12)
    assert np.dot(normal, item.position) - 0.5 == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(item.rotation.T @ item.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(item.rotation) == pytest.approx(1.0)


def solid(kind: int, *sizes: float):
    return {"primitives": [message("shape_msgs/msg/SolidPrimitive", type=kind, dimensions=sizes)]}


def turned(**wxyz: float):
    turn = message("geometry_msgs/msg/Quaternion", **{"w": 0.0, **wxyz})
    return message("geometry_msgs/msg/Pose", position=point(0.5, 0, 0), orientation=turn)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (solid(4, 0.1, 0.1), r"'x': primitives\[0\] is a cone: must be a box"),
        (solid(9), "is of type 9: must be"),
        (solid(1, 0.1), "dimensions has 1 entries: must have 3"),
        (solid(2, -0.1), "sphere radius is -0.1: must be"),
        ({"primitives": []}, "1 primitive_poses for 0 shapes"),
        ({"primitives": [], "primitive_poses": []}, "it has no shape: must have"),
        ({"subframe_names": ["stem_0"]}, "0 subframe_poses for 1 subframe_names"),
        (
            {
                "subframe_names": ["stem_0", "stem_2"],
                "subframe_poses": [message("geometry_msgs/msg/Pose")] * 2,
            },
            "subframes stem_0, stem_2: a stem must have stem_0 at the fruit, stem_1",
        ),
        ({"pose": turned(w=0.5)}, "must be a unit quaternion"),
    ],
)
def test_what_cannot_be_an_object_is_refused_by_name(fields, words: str) -> None:
    with pytest.raises(InvalidSceneError, match=words):
        read_collision_object(by_hand("x", **fields))


@pytest.mark.parametrize(
    "text",
    [
        "{", "[1]", "3", '{"weight": 1}', '{"stem_radius": "thick"}', '{"covariance": "a"}',
        '{"covariance": [[1, 2], [3]]}', '{"physical": [1]}', '{"physical": {"mass": {}}}',
        '{"physical": {"mass": NaN}}', '{"camera_distance": [1]}', "[" * 100_000,
    ],
)  # fmt: skip
def test_further_quantities_that_are_none_are_refused(text: str) -> None:
    kind = message("object_recognition_msgs/msg/ObjectType", key="optipromp", db=text)
    with pytest.raises(InvalidSceneError, match=r"'x': type.db is .*: must be JSON with stem_radi"):
        read_collision_object(by_hand("x", type=kind))


def scene_message(*objects, **fields):
    world = message("moveit_msgs/msg/PlanningSceneWorld", collision_objects=list(objects))
    return message("moveit_msgs/msg/PlanningScene", **{"world": world, **fields})


def test_a_scene_by_hand_needs_no_file() -> None:
    scene = read_planning_scene(
        scene_message(by_hand("target/ripe"), by_hand("pole"), robot_model_name="panda")
    )
    assert isinstance(scene, Scene)
    assert (scene.robot, scene.target.id, scene.static[0].id) == ("panda", "ripe", "pole")


def test_differences_are_applied_to_what_is_known() -> None:
    scene = load_scene("scenario-4")
    world = LiveScene.of(scene)
    remove = by_hand("table-top", operation=1)
    move = by_hand("pushable/n1", operation=3, pose=pose_at(0.5, 0, 0))
    new = by_hand("avoid/leaf")
    after = world.heard(scene_message(remove, move, new, is_diff=True)).scene()
    assert "table-top" not in {item.id for item in after.objects}
    assert after.avoid[-1].id == "leaf"
    old, moved = (s.pushables[0] for s in (scene, after))
    assert moved.position.tolist() == [0.5, 0, 0]
    np.testing.assert_allclose(
        moved.stem.points - moved.position, (old.stem.points - old.position) @ old.rotation,
        atol=1e-12,
    )  # fmt: skip
    assert after.target.id == scene.target.id
    nothing = world.heard(by_hand("", operation=1))
    with pytest.raises(InvalidSceneError, match="no id begins with 'target/'"):
        nothing.scene()


def pose_at(x: float, y: float, z: float):
    return message("geometry_msgs/msg/Pose", position=point(x, y, z))


def test_joint_states_move_the_start() -> None:
    world = LiveScene.of(load_scene("scenario-4"))
    joints = [f"fr3_joint{k}" for k in (7, 6, 5, 4, 3, 2, 1)]
    state = message("sensor_msgs/msg/JointState", name=["finger", *joints], position=np.arange(8.0))
    assert world.heard(state).scene().start.tolist() == [7, 6, 5, 4, 3, 2, 1]


def test_what_is_not_there_cannot_be_removed_or_moved() -> None:
    world = LiveScene.of(load_scene("scenario-4"))
    with pytest.raises(InvalidSceneError, match="'x' is not there: must be added first"):
        world.heard(by_hand("x", operation=1))
    assert "'x': it is not there" in world.heard(by_hand("x", operation=3)).unknown["x"]


def in_frame(frame: str, name: str = "x", **fields):
    return by_hand(name, header=message("std_msgs/msg/Header", frame_id=frame), **fields)


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (in_frame("camera"), "header.frame_id is 'camera'"),
        (by_hand("x", pose=pose_at(np.nan, 0, 0)), "nan"),
        (by_hand("x", **solid(2, 0.0)), "radius"),
        (by_hand("x", **solid(2, -0.1)), "radius"),
        (by_hand("x", primitives=[]), "for 0 shapes"),
        (by_hand("x", pose=turned()), "unit quaternion"),
        (by_hand("x", pose=turned(w=np.nan)), "orientation"),
        (by_hand("x", operation=2), "operation is 2"),
    ],
)
@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("whole", [None, True, False])
def test_an_object_that_is_not_understood_is_unknown(bad, why: str, there, whole) -> None:
    """However it came; until it is added as it should be, or removed, or all is told anew."""
    world = LiveScene.of(load_scene("scenario-4"))
    if there:
        world = world.heard(by_hand("x"))
    others = (by_hand("pole"), by_hand("target/t")) if whole else (by_hand("pole"),)
    item = bad if whole is None else scene_message(bad, *others, is_diff=not whole)
    world = world.heard(item)
    assert list(world.unknown) == ["x"]
    with pytest.raises(InvalidSceneError, match=f"(?s)not understood: collision object 'x'.*{why}"):
        world.scene()
    if whole is not None:
        assert "pole" in world.held, "what is understood is there"
    still = world.heard(by_hand("x", operation=3, pose=pose_at(0.5, 0, 0)))
    assert list(still.unknown) == ["x"], "its shape is not known"
    for mended in (by_hand("x"), in_frame("camera", operation=1), by_hand("", operation=1),
                   scene_message(by_hand("target/t"))):  # fmt: skip
        assert not world.heard(mended).unknown


def test_an_object_in_the_frame_of_a_link_is_where_the_arm_holds_that() -> None:
    """Where the arm stands; while it moves, or is not known, nobody knows."""
    scene = load_scene("scenario-4")
    names, ball = posed(scene)[0].joint_names, in_frame("link7", pose=pose_at(0, 0, 0.1))
    still, moving = (
        message("sensor_msgs/msg/JointState", name=names, position=scene.start, velocity=[v] * 7)
        for v in (0.0, 0.3)
    )
    world = LiveScene.of(scene)
    found = world.heard(still).heard(ball).scene().static[-1]
    want = known_frames(world.robot, q=scene.start)["link7"] @ np.array([0.4, 0.1, 0.6])
    np.testing.assert_allclose(found.position, want, atol=1e-12)
    for unknown in (world, world.heard(moving)):
        assert "header.frame_id is 'link7'" in unknown.heard(ball).unknown["x"]


def test_a_motion_that_is_not_understood_is_mended_by_another() -> None:
    world = LiveScene.of(load_scene("scenario-4")).heard(by_hand("x"))
    lost = world.heard(in_frame("camera", operation=3))
    assert list(lost.unknown) == ["x"]
    found = lost.heard(by_hand("x", operation=3, pose=pose_at(0.5, 0, 0)))
    assert not found.unknown
    assert found.scene().static[-1].position.tolist() == [0.5, 0, 0]


def held_by_robot(operation: int):
    item = message("moveit_msgs/msg/AttachedCollisionObject", object=by_hand("cup"))
    item.object.operation = operation
    state = message("moveit_msgs/msg/RobotState", attached_collision_objects=[item])
    return scene_message(robot_state=state, is_diff=True)


def padded(value: float):
    link = message("moveit_msgs/msg/LinkPadding", link_name="link7", padding=value)
    return scene_message(by_hand("pole"), link_padding=[link], is_diff=True)


def test_what_a_scene_states_beside_objects_is_unknown_until_it_is_mended() -> None:
    world = LiveScene.of(load_scene("scenario-4"))
    lost = world.heard(padded(0.01))
    assert "pole" in lost.held
    assert list(lost.heard(by_hand("", operation=1)).unknown) == ["link_padding of 'link7'"]
    assert not lost.heard(padded(0.0)).unknown
    lost = world.heard(held_by_robot(0)).heard(by_hand("cup"))
    assert len(lost.unknown) == 1
    lost = lost.heard(held_by_robot(1))  # where it was put down is not told
    assert list(lost.unknown) == ["cup"]
    assert not lost.heard(by_hand("cup")).unknown


def test_a_start_that_is_not_understood_does_not_take_the_objects_along() -> None:
    state = message("sensor_msgs/msg/JointState", name=["joint1"], position=[0.0])
    robot_state = message("moveit_msgs/msg/RobotState", joint_state=state)
    world = LiveScene.of(load_scene("scenario-4"))
    lost = world.heard(scene_message(by_hand("pole"), robot_state=robot_state, is_diff=True))
    assert "pole" in lost.held
    with pytest.raises(InvalidSceneError, match=r"joint joint1, .* it names joint1"):
        lost.scene()
    assert not lost.at(world.scene().start).unknown


def test_another_message_is_refused() -> None:
    with pytest.raises(InvalidRequestError, match="must be a PlanningScene"):
        LiveScene.of(load_scene("scenario-4")).heard(message("std_msgs/msg/String"))


def test_a_fruit_that_moves_takes_stem_and_covariance_along() -> None:
    spread = np.diag([1e-4, 4e-4, 9e-4])
    stem = Stem(np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.4]]))
    item = SceneObject(
        "ripe", "target", Sphere(0.02), np.array([0.1, 0.2, 0.3]), np.eye(3), stem, spread
    )
    world = LiveScene.of(load_scene("scenario-4")).heard(by_hand("", operation=1))
    quarter = message("geometry_msgs/msg/Quaternion", x=np.sqrt(0.5), w=np.sqrt(0.5))
    there = message("geometry_msgs/msg/Pose", position=point(1, 0, 0), orientation=quarter)
    move = message(OBJECT, id="target/ripe", operation=3, pose=there)
    after = world.heard(collision_object(item)).heard(move).scene().target
    np.testing.assert_allclose(after.position, [1, 0, 0])
    np.testing.assert_allclose(after.stem.points, [[1, 0, 0], [1, -0.1, 0]], atol=1e-12)
    np.testing.assert_allclose(after.covariance, np.diag([1e-4, 9e-4, 4e-4]), atol=1e-12)


def test_objects_in_the_world_are_brought_into_the_base_frame() -> None:
    base = Pose(np.array([1.0, 2.0, 3.0]), from_quaternion((0.5, 0.5, 0.5, 0.5)))
    scene = replace(load_scene("scenario-4"), base=base)
    item = planning_scene(scene)
    for one in item.world.collision_objects:
        one.header.frame_id = "world"
        one.pose = pose_message(base @ read_pose(one.pose))
    back = read_planning_scene(item, like=scene)
    for one, other in zip(scene.objects, back.objects, strict=True):
        same_object(one, other)
    np.testing.assert_allclose(back.approach.frame, scene.approach.frame, atol=1e-9)
    assert back.base is base
    move = message(OBJECT, id="target/ripe", operation=3, pose=pose_message(base))
    move.header.frame_id = "world"
    at_base = LiveScene.of(scene).heard(move).scene().target
    np.testing.assert_allclose(at_base.position, np.zeros(3), atol=1e-9)
