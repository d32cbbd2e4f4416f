"""``optipromp ros-node``: the planner as a node of ROS 2; the only file that imports rclpy."""

import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from threading import Lock
from time import monotonic_ns, sleep
from typing import TYPE_CHECKING, Any

import optipromp
import optipromp_ros
from optipromp.cli.command import command
from optipromp.cli.console import Recorded, say_if_compiling
from optipromp.core.errors import ExecutionError, InvalidRequestError, OptiPrompError

if TYPE_CHECKING:
    from optipromp_eyes.watcher import Watcher
    from optipromp_ros import GuardFilter, LiveScene, Message, PickLoop

HERE = 1.0  # [s] in which a controller that runs is found: a choice
ACCEPTS = 5.0  # [s] in which a controller accepts a goal, or rejects it: a choice
LATE = 10.0  # [s] after a motion in which its result comes: a choice
SUCCEEDED = 4  # of action_msgs/GoalStatus
WAITING = 20
"""Messages of a topic that wait to be heard, at most, chosen: an arm's states are not pushed out by
its gripper's while a cycle runs, and 20 of an arm at 1 kHz are 20 ms late."""
PICTURES = 5  # likewise, which are large
OBJECTS = 1000  # likewise, of a scene, whose messages may come all at once
ALONE = 5.0  # [s] after which topics are named that nobody publishes: a choice


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
    wrench: str | None = None,
    eyes: str | None = None,
    role: list[str] | None = None,
    guard: str | None = None,
    takes_over: bool = False,
) -> None:
    """Plan on request: a node of ROS 2 with MoveIt's service GetMotionPlan.

    Listens to planning_scene, collision_object and joint_states. Offers the service
    optipromp/plan, and publishes optipromp/joint_trajectory, display_planned_path and
    optipromp/status.
    Needs ROS 2 (rclpy, moveit_msgs, control_msgs).

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
        wrench (TOPIC): With --loop: of WrenchStamped messages, the force of the world on the tool,
            which tells at the end whether the fruit is in it.
        eyes (CROP|FILE): Of --pictures: see 'see --eyes'; by default of the scene's crop.
        role (CLASS=ROLE): Role of a detected class; :stem: z is its stem.
        guard (TOPIC): Of the Float64MultiArray commands that are filtered.
        takes_over: With --guard: the loop picks where the guard holds the commands up.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError:
        raise InvalidRequestError(
            "ros-node needs ROS 2 and finds no rclpy: source the setup.bash of a ROS 2 "
            "installation, and start it with the Python of that installation"
        ) from None
    from optipromp_ros.guard import COMMAND
    from optipromp_ros.live import DETECTIONS
    from optipromp_ros.loop import WRENCH
    from optipromp_ros.trajectories import JOINT_TRAJECTORY

    say_if_compiling()
    place, meaning = optipromp.load_scene(scene), optipromp_ros.live.meaning(role or ())
    if guard is not None:
        filtered = optipromp_ros.GuardFilter(place, meaning, prefix, takes_over)
        asked = {guard: (COMMAND, 1), detections: (DETECTIONS, WAITING)}  # the newest command
        _run(filtered, COMMAND, execute or "~/commands", asked)
    elif loop:
        seen = {detections: DETECTIONS} if pictures is None else _types(pictures)
        seen |= {} if wrench is None else {wrench: WRENCH}
        with _watcher(place, pictures is not None, eyes) as watcher:
            pick = optipromp_ros.PickLoop(
                place, parameters=meaning, rate=rate, prefix=prefix, watcher=watcher
            )
            topics = {topic: (kind, PICTURES) for topic, kind in seen.items()}
            _run(pick, JOINT_TRAJECTORY, execute or "~/joint_trajectory", topics)
    else:
        settings = {"prefix": prefix, "rate": rate, "demonstrations": demonstrations}
        _serve(_World(optipromp_ros.LiveScene.of(place, prefix)), settings, execute)


class _World:
    """The world as it is known, which messages change one by one, whatever their threads."""

    def __init__(self, known: "LiveScene") -> None:
        self.known, self._lock = known, Lock()

    def change(
        self, after: Callable[["LiveScene"], "LiveScene"]
    ) -> tuple["LiveScene", "LiveScene"]:
        """Make it what is ``after`` it; the world before and after."""
        with self._lock:
            before, self.known = self.known, after(self.known)
            return before, self.known


def _serve(world: _World, settings: dict[str, Any], execute: str | None) -> None:
    """Carry messages between ROS and :func:`optipromp_ros.answer` until the node is shut down.

    Messages are heard while a plan is made or executed, so that where the arm is stays known.
    """
    import rclpy
    from moveit_msgs.srv import GetMotionPlan
    from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
    from rclpy.executors import MultiThreadedExecutor
    from rclpy.serialization import deserialize_message

    from optipromp_ros.loop import not_executed
    from optipromp_ros.trajectories import JOINT_TRAJECTORY
    from optipromp_ros.types import ERROR, OK, STATUS, WARN, copied, diagnostic

    def now() -> int:
        return int(node.get_clock().now().nanoseconds)

    def tell(level: int, words: str) -> None:
        status(diagnostic(level, "plan", words, world.known.robot.name))

    def heard(item: "Message", topic: str) -> None:
        before, after = world.change(lambda known: known.heard(item, now()))
        if after.arm.why and after.arm is not before.arm:
            warn(topic, after.arm.why)
        for what, why in after.unknown.items():
            if before.unknown.get(what) != why:
                node.get_logger().warning(f"{topic}: {why}")
                tell(WARN, f"not understood: {why}")

    def lost(topic: str, why: str) -> None:
        what, told = f"message of {topic}", f"a message of {topic}: {why}"
        world.change(lambda known: known.marked(what, told))

    def plan(request: Any, response: Any) -> Any:
        for waiting in topics:
            waiting()
        asked = copied(request.motion_plan_request, "moveit_msgs/msg/MotionPlanRequest")
        found = optipromp_ros.answer(world.known, asked, now=now(), **settings)
        if found.display is not None:
            display(found.display)
        if found.trajectory is not None:
            try:
                follow(found)
            except OptiPrompError as error:
                found = not_executed(asked, found, error)
        told = found.response.error_code
        tell(OK if told.val == 1 else ERROR, told.message)
        response.motion_plan_response = deserialize_message(
            optipromp_ros.to_bytes(found.response), type(response.motion_plan_response)
        )
        return response

    def follow(found: "optipromp_ros.PlanAnswer") -> None:
        """Publish a plan, and have the controller execute it to its end."""
        assert found.plan is not None
        motion = found.plan.trajectory

        def ready() -> None:
            world.known.arm.begins(motion.at(0.0), now())
            publish(found.trajectory)

        if controller is None:
            publish(found.trajectory)
            return
        controller(found.trajectory, motion.duration, ready)
        found.response.error_code.message += f"; {execute} executed it"

    rclpy.init()
    node = rclpy.create_node("optipromp")
    warn = _warner(node)
    publish = _publisher(node, "~/joint_trajectory", JOINT_TRAJECTORY)
    display = _publisher(node, "display_planned_path", "moveit_msgs/msg/DisplayTrajectory")
    status = _publisher(node, "~/status", STATUS)
    controller = _controller(node, execute, lambda words: tell(OK, words)) if execute else None
    scenes, objects = "moveit_msgs/msg/PlanningScene", "moveit_msgs/msg/CollisionObject"
    topics = (
        _listen(node, "planning_scene", scenes, heard, OBJECTS, lost=lost),
        _listen(node, "collision_object", objects, heard, OBJECTS, lost=lost),
        _listen(node, "joint_states", "sensor_msgs/msg/JointState", heard),
    )
    node.create_service(
        GetMotionPlan, "~/plan", plan, callback_group=MutuallyExclusiveCallbackGroup()
    )  # beside that of what is heard
    _spin(node, MultiThreadedExecutor(2), "joint_states")


def _controller(
    node: Any, action: str, tell: Callable[[str], None]
) -> Callable[["Message", float, Callable[[], None]], None]:
    """What has a controller execute a JointTrajectory to its end.

    It takes the message, its duration [s], and what is called right before it is sent. It raises
    ExecutionError where the controller is absent, rejects, or does not reach the end.
    """
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.serialization import deserialize_message

    from optipromp_ros.trajectories import JOINT_TRAJECTORY

    client = ActionClient(node, FollowJointTrajectory, action)

    def waited(future: Any, what: str, longest: float) -> Any:
        end = node.get_clock().now().nanoseconds + 1e9 * longest
        while not future.done():
            if node.get_clock().now().nanoseconds > end or not rclpy.ok():
                told = f"{action} gave no {what} within {longest:.1f} s"
                raise ExecutionError(f"{told}: the arm may move")
            sleep(0.01)
        return future.result()

    def execute(motion: "Message", duration: float, ready: Callable[[], None]) -> None:
        if not client.wait_for_server(timeout_sec=HERE):
            raise ExecutionError(f"no controller has the action {action}: nothing was sent")
        item = deserialize_message(optipromp_ros.to_bytes(motion), _kind(JOINT_TRAJECTORY))
        ready()
        goal = client.send_goal_async(FollowJointTrajectory.Goal(trajectory=item))
        handle = waited(goal, "answer to the goal", ACCEPTS)
        if not handle.accepted:
            raise ExecutionError(f"{action} rejected the plan: its log says why")
        tell(f"{action} accepted the plan")
        done = waited(handle.get_result_async(), "result", duration + LATE)
        if done.status != SUCCEEDED or done.result.error_code:
            raise ExecutionError(
                f"{action} did not reach the end: status {done.status} (must be {SUCCEEDED}), "
                f"error_code {done.result.error_code} {done.result.error_string!r}"
            )

    return execute


def _run(
    agent: "GuardFilter | PickLoop", kind: str, moved: str, topics: Mapping[str, tuple[str, int]]
) -> None:
    """Carry messages between ROS and the guard or the loop, until a pick has ended and its curve is
    sent, or the node is shut down; a guard brakes the arm then, as where an error ends the node.

    ROS's handlers of signals would end the topics first. The messages that move the arm are of the
    type ``kind``. Of ``topics`` beside joint states are given the type and how many may wait.
    """
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.signals import SignalHandlerOptions

    from optipromp_ros.frames import TF
    from optipromp_ros.types import STATUS

    guard = agent if isinstance(agent, optipromp_ros.GuardFilter) else None
    loop = agent if isinstance(agent, optipromp_ros.PickLoop) else None

    def heard(item: "Message", topic: str) -> None:
        if guard:
            guard.heard(item, node.get_clock().now().nanoseconds)
        if loop:
            loop.heard(item, topic)

    def tick() -> None:
        states()
        clock = node.get_clock()
        now = clock.now().nanoseconds
        if guard:
            send(guard.tick(now))
        if loop:
            steady = None if clock.ros_time_is_active else monotonic_ns()  # a simulation's: slow
            if (curve := loop.tick(now, steady)) is not None:
                send(curve)
        status(agent.status())
        if loop and loop.ended:
            raise ExternalShutdownException

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("optipromp")
    send, status = _publisher(node, moved, kind), _publisher(node, "~/status", STATUS)
    states = _listen(node, "joint_states", "sensor_msgs/msg/JointState", heard)
    if loop:
        _listen(node, "/tf_static", TF, heard, kept=True)
    for topic, (name, depth) in topics.items():
        _listen(node, topic, name, heard, depth)
    decides = agent.guard if isinstance(agent, optipromp_ros.GuardFilter) else agent.controller
    period = decides.parameters.period
    node.create_timer(period, tick)
    try:
        _spin(node, rclpy.get_global_executor(), "joint_states", *topics)
    finally:
        for made in guard.ending() if guard and rclpy.ok() else ():
            send(made)
            sleep(period)


def _spin(node: Any, executor: Any, *needed: str) -> None:
    """Let the node work until it is shut down; its log names ``needed`` topics that nobody has."""
    import rclpy
    from rclpy.clock import Clock, ClockType
    from rclpy.executors import ExternalShutdownException

    def look() -> None:
        alone.cancel()
        clock = ["/clock"] if node.get_clock().ros_time_is_active else []
        topics = map(node.resolve_topic_name, [*needed, *clock])
        if silent := [name for name in topics if not node.count_publishers(name)]:
            node.get_logger().warning(
                f"nobody publishes {', '.join(silent)}: start who does, on this ROS_DOMAIN_ID, or "
                "name its topic, as in --ros-args -r joint_states:=/arm/joint_states"
            )

    alone = node.create_timer(ALONE, look, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(HERE)  # a signal that comes as it begins to wait does not wake it
    except ExternalShutdownException:
        pass
    except RuntimeError:  # rclpy's RCLError, of a shutdown as it was about to wait
        if rclpy.ok():
            raise


def _kind(name: str) -> Any:
    """The class that ROS made of a message type."""
    package, _, last = name.split("/")
    return getattr(import_module(f"{package}.msg"), last)


def _publisher(node: Any, topic: str, name: str) -> Callable[["Message"], None]:
    """What publishes messages of the type ``name``."""
    made = node.create_publisher(_kind(name), topic, 10)
    return lambda item: made.publish(optipromp_ros.to_bytes(item))


def _listen(
    node: Any,
    topic: str,
    name: str,
    take: Callable[["Message", str], None],
    depth: int = WAITING,
    kept: bool = False,
    lost: Callable[[str, str], None] | None = None,
) -> Callable[[], None]:
    """Let ``take`` have the messages of a topic, as they came: rclpy's ``serialize_message`` puts
    bytes of no meaning behind them.

    Returns what has it take all that wait: an executor takes one of a topic between two cycles.

    Args:
        node: of rclpy.
        topic: its name.
        name: of its type.
        take: what gets each message, and the topic.
        depth: how many of them may wait.
        kept: also what was sent before, as tf2 sends it.
        lost: it hears of each message that cannot be decoded, as another release's. With it or
            ``kept`` no message is lost; else senders of both kinds are heard, as of best effort.
    """
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    warn = _warner(node)

    def heard(data: bytes) -> None:
        item = None
        try:
            item = optipromp_ros.from_bytes(data, name)
            take(item, topic)
        except OptiPrompError as error:
            warn(topic, error.message)
            if item is None and lost is not None:
                lost(topic, error.message)

    whole = kept or lost is not None
    qos = QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if whole else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )

    def hear(data: bytes) -> None:
        heard(data)
        waiting()

    def waiting() -> None:
        for _ in range(depth):
            if (taken := made.handle.take_message(made.msg_type, True)) is None:
                return
            heard(taken[0])

    made = node.create_subscription(_kind(name), topic, hear, qos, raw=True)
    return waiting


def _warner(node: Any) -> Callable[[str, str], None]:
    """What warns of a topic in the node's log, once of each thing, whatever the values in it."""
    said = set[str]()

    def warn(topic: str, why: str) -> None:
        text = f"{topic}: {why.removeprefix(f'{topic}: ')}"
        kind = re.sub(r"\d+\.\d+", "#", text)
        if kind not in said:
            said.add(kind)
            node.get_logger().warning(text)

    return warn


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
