"""``optipromp ros-node``: the planner as a node of ROS 2; the only file that imports rclpy."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import get_context
from time import monotonic_ns
from typing import TYPE_CHECKING, Any

import optipromp
from optipromp.cli.command import command
from optipromp.cli.console import Recorded, say_if_compiling
from optipromp.core.errors import InvalidRequestError, OptiPrompError

if TYPE_CHECKING:
    from optipromp_eyes.watcher import Watcher
    from optipromp_ros import DetectionParameters, GuardFilter, LiveScene, Message, PickLoop


@command(reports=False)
def ros_node(
    scene: str,
    /,
    prefix: str = "",
    rate: float | None = None,
    demonstrations: Recorded = None,
    execute: str | None = None,
    loop: bool = False,
    detections: str = "~/detections",
    pictures: str | None = None,
    eyes: str | None = None,
    role: list[str] | None = None,
    guard: str | None = None,
) -> None:
    """Plan on request: a node of ROS 2 with MoveIt's service GetMotionPlan.

    Listens to planning_scene, collision_object and joint_states. Offers the service
    optipromp/plan, and publishes optipromp/joint_trajectory and display_planned_path.
    Needs ROS 2 (rclpy, moveit_msgs, control_msgs) and the extra ros.

    With --loop it picks in closed loop: it listens to optipromp/detections (vision_msgs), or to a
    camera's --pictures, in which it finds fruits and stems itself, to
    joint_states and tf_static, publishes optipromp/joint_trajectory and optipromp/status, and
    ends with the pick.

    With --guard it filters somebody's velocities of joints, or of the tool, for a
    velocity controller (--execute), so that they harm nothing (docs/guard.md).

    Examples:
        optipromp ros-node my-scene.yaml --prefix fr3_
        optipromp ros-node my-scene.yaml --execute /arm_controller/follow_joint_trajectory
        optipromp ros-node my-scene.yaml --loop --role ripe=target:stem --role unripe=pushable \\
            --execute /arm_controller/joint_trajectory
        optipromp ros-node my-scene.yaml --guard /policy/commands \\
            --execute /velocity_controller/commands
        optipromp ros-node my-scene.yaml --loop --pictures /camera/color/image_raw,\\
        /camera/aligned_depth_to_color/image_raw,/camera/color/camera_info

    Args:
        scene (SCENE): Gives robot, tool and what no topic says.
        prefix (TEXT): Before joint and link names in ROS, as in fr3_.
        rate (HZ): Of the points; the plan's own if left out.
        execute (ACTION): FollowJointTrajectory action that gets each success; with --loop or
            --guard the topic of the controller.
        loop: Pick in closed loop by detections, at once.
        detections (TOPIC): With --loop or --guard: of the Detection3DArray messages.
        pictures (COLOUR,DEPTH,INFO): With --loop, in place of detections: topics of a camera, Image
            (or CompressedImage by its usual end) and CameraInfo; or one of PointCloud2.
        eyes (CROP|FILE): Of --pictures: see 'see --eyes'; by default of the scene's crop.
        role (CLASS=ROLE): Role of a detected class; :stem: z is its stem.
        guard (TOPIC): Of the Float64MultiArray commands that are filtered.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError:
        raise InvalidRequestError(
            "ros-node needs ROS 2 and finds no rclpy: source the setup.bash of a ROS 2 "
            "installation, and start it with the Python of that installation"
        ) from None
    from optipromp_ros import GuardFilter, LiveScene, PickLoop
    from optipromp_ros.live import DETECTIONS

    say_if_compiling()
    if guard is not None:
        meaning = None if role is None else _meaning(role)
        filtered = GuardFilter(optipromp.load_scene(scene), meaning, prefix)
        _filter(filtered, guard, execute or "~/commands", detections)
        return
    if loop:
        meaning = None if role is None else _meaning(role)
        seen = {detections: DETECTIONS} if pictures is None else _types(pictures)
        place = optipromp.load_scene(scene)
        with _watcher(place, pictures is not None, eyes) as watcher:
            pick = PickLoop(place, parameters=meaning, rate=rate, prefix=prefix, watcher=watcher)
            _pick(pick, seen, execute or "~/joint_trajectory")
        return
    settings = {"prefix": prefix, "rate": rate, "demonstrations": demonstrations}
    _serve(LiveScene.of(optipromp.load_scene(scene), prefix), settings, execute)


def _serve(world: "LiveScene", settings: dict[str, Any], execute: str | None) -> None:
    """Carry messages between ROS and :func:`optipromp_ros.answer` until the node is shut down."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from moveit_msgs.srv import GetMotionPlan
    from rclpy.action import ActionClient
    from rclpy.executors import ExternalShutdownException
    from rclpy.serialization import deserialize_message

    from optipromp_ros import Message, answer, to_bytes
    from optipromp_ros.trajectories import JOINT_TRAJECTORY
    from optipromp_ros.types import copied

    def heard(item: Message, _: str) -> None:
        nonlocal world
        world = world.heard(item)

    def plan(request: Any, response: Any) -> Any:
        asked = copied(request.motion_plan_request, "moveit_msgs/msg/MotionPlanRequest")
        found = answer(world, asked, **settings)
        kind = type(response.motion_plan_response)
        response.motion_plan_response = deserialize_message(to_bytes(found.response), kind)
        if found.display is not None:
            display(found.display)
        if found.trajectory is not None:
            publish(found.trajectory)
            if controller is not None:
                motion = deserialize_message(to_bytes(found.trajectory), _kind(JOINT_TRAJECTORY))
                controller.send_goal_async(FollowJointTrajectory.Goal(trajectory=motion))
        return response

    rclpy.init()
    node = rclpy.create_node("optipromp")
    publish = _publisher(node, "~/joint_trajectory", JOINT_TRAJECTORY)
    display = _publisher(node, "display_planned_path", "moveit_msgs/msg/DisplayTrajectory")
    controller = ActionClient(node, FollowJointTrajectory, execute) if execute else None
    _listen(node, "planning_scene", "moveit_msgs/msg/PlanningScene", heard)
    _listen(node, "collision_object", "moveit_msgs/msg/CollisionObject", heard)
    _listen(node, "joint_states", "sensor_msgs/msg/JointState", heard)
    node.create_service(GetMotionPlan, "~/plan", plan)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


def _filter(filtered: "GuardFilter", asked: str, moved: str, detections: str) -> None:
    """Carry commands between ROS and the guard until the node is shut down."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from optipromp_ros.guard import COMMAND
    from optipromp_ros.live import DETECTIONS
    from optipromp_ros.types import STATUS

    def heard(item: "Message", _: str) -> None:
        filtered.heard(item, node.get_clock().now().nanoseconds)

    def tick() -> None:
        send(filtered.tick(node.get_clock().now().nanoseconds))
        status(filtered.status())

    rclpy.init()
    node = rclpy.create_node("optipromp")
    send = _publisher(node, moved, COMMAND)
    status = _publisher(node, "~/status", STATUS)
    _listen(node, asked, COMMAND, heard, 1)  # the newest
    _listen(node, "joint_states", "sensor_msgs/msg/JointState", heard, 1)
    _listen(node, detections, DETECTIONS, heard)
    node.create_timer(filtered.guard.parameters.period, tick)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


def _kind(name: str) -> Any:
    """The class that ROS made of a message type."""
    package, _, last = name.split("/")
    return getattr(import_module(f"{package}.msg"), last)


def _publisher(node: Any, topic: str, name: str) -> Callable[["Message"], None]:
    """What publishes messages of the type ``name``."""
    from optipromp_ros import to_bytes

    made = node.create_publisher(_kind(name), topic, 10)
    return lambda item: made.publish(to_bytes(item))


def _listen(
    node: Any, topic: str, name: str, take: Callable[["Message", str], None], qos: Any = 10
) -> None:
    """Let ``take`` have the messages of a topic, as they came: rclpy's ``serialize_message`` puts
    bytes of no meaning behind them."""
    from optipromp_ros import from_bytes

    def heard(data: bytes) -> None:
        try:
            take(from_bytes(data, name), topic)
        except OptiPrompError as error:
            node.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=5.0)

    node.create_subscription(_kind(name), topic, heard, qos, raw=True)


def _meaning(given: list[str]) -> "DetectionParameters":
    """Classes with their roles, as ``CLASS=ROLE`` or ``CLASS=ROLE:stem``."""
    from optipromp_ros import DetectionParameters

    roles, stems = {}, []
    for text in given:
        name, equals, rest = text.rpartition("=")
        role, colon, stem = rest.partition(":")
        if not name or not equals or (colon and stem != "stem"):
            raise InvalidRequestError(f"--role is {text!r}: must be CLASS=ROLE or CLASS=ROLE:stem")
        roles[name] = role
        stems += [name] if stem else []
    return DetectionParameters(roles=roles, stems=tuple(stems))


def _types(pictures: str) -> dict[str, str]:
    """The topics of a camera with their types, by how the topics end."""
    from optipromp_ros.images import CAMERA_INFO, CLOUD, COMPRESSED, IMAGE

    ends = {"camera_info": CAMERA_INFO, "compressed": COMPRESSED, "compressedDepth": COMPRESSED}
    topics = [name.strip() for name in pictures.split(",")]
    if len(topics) not in (1, 3) or "" in topics:
        raise InvalidRequestError(
            f"--pictures is {pictures!r}: must be the topics of colour, depth and camera_info, "
            "with commas, or that of a cloud"
        )
    usual = CLOUD if len(topics) == 1 else IMAGE
    return {name: ends.get(name.rpartition("/")[2], usual) for name in topics}


@contextmanager
def _watcher(
    scene: "optipromp.Scene", wanted: bool, eyes: str | None
) -> Iterator["Watcher | None"]:
    """What looks at pictures, in a process of its own; None if none come."""
    if not wanted:
        yield None
        return
    from optipromp_eyes.parameters import eyes_of
    from optipromp_eyes.watcher import Watcher

    p = eyes_of(scene.crop, eyes)
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        yield Watcher(up=scene.up, parameters=p, executor=process)


def _pick(loop: "PickLoop", seen: dict[str, str], moved: str) -> None:
    """Carry messages between ROS and the loop until the pick has ended and its curve is sent."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data

    from optipromp_ros.images import PICTURES
    from optipromp_ros.trajectories import JOINT_TRAJECTORY
    from optipromp_ros.types import STATUS

    def tick() -> None:
        clock = node.get_clock()
        steady = None if clock.ros_time_is_active else monotonic_ns()  # a simulation's may be slow
        made = loop.tick(clock.now().nanoseconds, steady)
        if made is not None:
            curve(made)
        status(loop.status())
        if loop.ended:
            raise ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node("optipromp")
    curve = _publisher(node, moved, JOINT_TRAJECTORY)
    status = _publisher(node, "~/status", STATUS)
    kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # as tf2 sends it
    _listen(node, "/tf_static", "tf2_msgs/msg/TFMessage", loop.heard, kept)
    _listen(node, "joint_states", "sensor_msgs/msg/JointState", loop.heard, 1)  # the newest
    for topic, name in seen.items():
        qos = qos_profile_sensor_data if name in PICTURES else 10
        _listen(node, topic, name, loop.heard, qos)
    node.create_timer(loop.controller.parameters.period, tick)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
