"""The node of ROS 2 where there is no ROS 2.

The shell runs here against a stand-in for ROS's client library, on every Python; with rclpy itself
it runs in ``tests/ros/real``. What the shell calls is tested in ``tests/ros/test_service.py``.
"""

import sys
import time
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.perception.shots import shot_of
from tests.ros.camera_messages import FRAME, compressed, frames, image, info
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.core.planning.task import posed
from optipromp.core.scenes import load_scene
from optipromp_ros import (
    from_bytes,
    message,
    planning_scene,
    read_trajectories,
    to_bytes,
    typestore,
)
from optipromp_ros.trajectories import nanoseconds, time_message
from optipromp_ros.types import constants

SCENE = load_scene("scenario-3")
RESPONSE = "moveit_msgs/msg/MotionPlanResponse"
runner = CliRunner()


def test_without_rclpy_it_says_what_is_missing() -> None:
    result = runner.invoke(app, ["ros-node", "scenario-3"])
    assert result.exit_code == 2
    assert "error INVALID_REQUEST: ros-node needs ROS 2 and finds no rclpy" in result.stderr
    assert len(result.stderr.splitlines()) == 1


class Future:
    """One that is done, or never will be."""

    def __init__(self, node: Any, result: Any) -> None:
        self.node, self.given = node, result

    def done(self) -> bool:
        if self.given is None:
            self.node.now += 1_000_000_000  # [ns] while it is waited for
        return self.given is not None

    def result(self) -> Any:
        return self.given


class Controller:
    """An action client of rclpy whose server does as a test says."""

    def __init__(self, node: Any) -> None:
        self.node, self.there, self.accepted = node, True, True
        self.answers = self.ends = True
        self.status, self.code = 4, 0

    def wait_for_server(self, timeout_sec: float) -> bool:
        return self.there

    def send_goal_async(self, goal: Any) -> Future:
        self.node.sent.append((self.action, goal.trajectory))
        result = SimpleNamespace(error_code=self.code, error_string="late")
        done = SimpleNamespace(status=self.status, result=result) if self.ends else None
        handle = SimpleNamespace(
            accepted=self.accepted, get_result_async=lambda: Future(self.node, done)
        )
        return Future(self.node, handle if self.answers else None)


class Node:
    """What a node of rclpy is asked for, and what it sends."""

    def __init__(self) -> None:
        self.heard: dict[str, Any] = {}
        self.services: dict[str, Any] = {}
        self.sent: list[tuple[str, Any]] = []
        self.warnings: list[str] = []
        self.now = 1_790_000_000_000_000_000  # [ns]
        self.controller = Controller(self)
        self.session: Any = session

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, qos: Any, *, raw: bool
    ) -> None:
        assert raw, "rclpy's serialize_message gives other bytes than those that came"
        self.heard[topic] = (kind, callback)

    def create_publisher(self, kind: Any, topic: str, qos: int) -> Any:
        def publish(data: bytes) -> None:
            self.sent.append((topic, from_bytes(data, kind.__msgtype__)))

        return SimpleNamespace(publish=publish)

    def create_service(self, kind: Any, name: str, callback: Any, *, callback_group: Any) -> None:
        self.services[name] = callback

    def create_timer(self, period: float, callback: Any) -> None:
        self.timer = period, callback

    def get_clock(self) -> Any:
        now = SimpleNamespace(nanoseconds=self.now)
        return SimpleNamespace(now=lambda: now, ros_time_is_active=True)

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda text, **_: self.warnings.append(text))

    def hear(self, topic: str, item: Any) -> None:
        kind, callback = self.heard[topic]
        assert isinstance(item, kind)
        data = to_bytes(item)
        callback(data + bytes(-len(data) % 4))  # as they come: whole words


class ExternalShutdownError(Exception):
    """How rclpy ends a node."""


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Node:
    """A node; ROS's modules are there while the test runs."""
    made = Node()
    kinds = typestore().types

    def module(name: str, **members: Any) -> None:
        item = ModuleType(name)
        vars(item).update(members)
        monkeypatch.setitem(sys.modules, name, item)

    def action_client(of: Node, kind: Any, name: str) -> Any:
        of.controller.action = name
        return of.controller

    module(
        "rclpy",
        init=lambda **_: None,
        create_node=lambda name: made,
        spin=lambda node, _=None: node.session(node),
        ok=lambda: True,
    )
    module("rclpy.signals", SignalHandlerOptions=SimpleNamespace(NO=0))
    module("rclpy.callback_groups", MutuallyExclusiveCallbackGroup=object)
    module("rclpy.action", ActionClient=action_client)
    module(
        "rclpy.executors",
        ExternalShutdownException=ExternalShutdownError,
        MultiThreadedExecutor=lambda threads: None,
    )
    module(
        "rclpy.serialization",
        deserialize_message=lambda data, kind: from_bytes(data, kind.__msgtype__),
    )
    durable = SimpleNamespace(TRANSIENT_LOCAL=1)
    module("rclpy.qos", QoSProfile=dict, DurabilityPolicy=durable, qos_profile_sensor_data=5)
    module("control_msgs", action=None)
    module("control_msgs.action", FollowJointTrajectory=SimpleNamespace(Goal=SimpleNamespace))
    module("moveit_msgs", msg=None)
    module("moveit_msgs.srv", GetMotionPlan=object)
    for package, names in (
        ("moveit_msgs", ("CollisionObject", "DisplayTrajectory", "PlanningScene")),
        ("sensor_msgs", ("CameraInfo", "CompressedImage", "Image", "JointState", "PointCloud2")),
        ("trajectory_msgs", ("JointTrajectory",)),
        ("vision_msgs", ("Detection3DArray",)),
        ("diagnostic_msgs", ("DiagnosticStatus",)),
        ("std_msgs", ("Float64MultiArray",)),
        ("tf2_msgs", ("TFMessage",)),
    ):
        module(package)
        module(f"{package}.msg", **{name: kinds[f"{package}/msg/{name}"] for name in names})
    return made


def foreign(item: Any) -> Any:
    """A message with the fields of another library's: no type's name, and bytes for a byte."""
    if isinstance(item, list):
        return [foreign(one) for one in item]
    if not hasattr(item, "__msgtype__"):
        return item
    known = dict(typestore().fielddefs[item.__msgtype__][1])
    made = {key: foreign(getattr(item, key)) for key in known}
    octets = [key for key, (_, what) in known.items() if what[0] == "octet"]
    return SimpleNamespace(**made | {key: bytes([made[key]]) for key in octets})


NAMES = [f"fr3_joint{k}" for k in range(1, 8)]
ACTION = "/arm_controller/follow_joint_trajectory"


def state(q: Any = SCENE.start, names: Any = NAMES, **fields: Any) -> Any:
    still = {"velocity": np.zeros(len(names)), **fields}
    return message("sensor_msgs/msg/JointState", name=names, position=q, **still)


def ask(node: Node, **fields: Any) -> Any:
    """The answer to a request; it is among what the node sent, too."""
    asked = foreign(message("moveit_msgs/msg/MotionPlanRequest", **fields))
    response = node.services["~/plan"](
        SimpleNamespace(motion_plan_request=asked),
        SimpleNamespace(motion_plan_response=message(RESPONSE)),
    )
    node.sent.append(("response", response.motion_plan_response))
    return response.motion_plan_response.error_code


def serve(node: Node, script: Any, *further: str) -> None:
    """Run the node through a script."""

    def run(node: Node) -> None:
        script()
        raise ExternalShutdownError

    node.session = run
    result = runner.invoke(app, ["ros-node", "scenario-4", "--prefix", "fr3_", *further])
    assert result.exit_code == 0, (result.stderr, result.exception)


def session(node: Node) -> None:
    """A scene, the arm, a gripper of its own, and two requests."""
    node.hear("planning_scene", planning_scene(SCENE, "fr3_"))
    node.hear("joint_states", state(SCENE.start + 0.01))
    for position in (0.0, 0.01):
        node.hear("joint_states", state([position], ["f"]))
    ask(node, group_name="arm")
    ask(node, planner_id="RRT")
    raise ExternalShutdownError


def test_the_shell_carries_messages_both_ways(node: Node) -> None:
    call = ["ros-node", "scenario-4", "--prefix", "fr3_", "--rate", "50", "--execute", ACTION]
    result = runner.invoke(app, call)
    assert result.exit_code == 0, result.stderr
    topics = [topic for topic, _ in node.sent]
    assert topics == [
        "display_planned_path", "~/joint_trajectory", ACTION, "~/status", "~/status", "response",
        "~/status", "response",
    ]  # fmt: skip
    display, motion, executed, accepted, ended, response, _, refusal = (one for _, one in node.sent)
    codes = constants("moveit_msgs/msg/MoveItErrorCodes")
    assert response.error_code.val == codes["SUCCESS"]
    assert response.group_name == "arm"
    assert accepted.message == f"{ACTION} accepted the plan"
    assert ended.message == response.error_code.message
    assert ended.message.endswith(f"; {ACTION} executed it")
    assert to_bytes(executed) == to_bytes(motion)
    (trajectory,) = read_trajectories(motion)
    np.testing.assert_allclose(trajectory.positions[0], SCENE.start + 0.01, atol=1e-9)
    np.testing.assert_allclose(np.diff(trajectory.times)[:-1], 0.02, atol=1e-9)
    assert trajectory.joint_names[0] == "fr3_joint1"
    assert len(display.trajectory) == 1
    assert "planner_id is 'RRT'" in refusal.error_code.message
    assert len(node.warnings) == 1
    assert node.warnings[0].startswith("joint_states: joint_states: joint fr3_joint1")


@pytest.mark.parametrize(
    ("server", "words"),
    [
        ({"there": False}, f"no controller has the action {ACTION}: nothing was sent"),
        ({"accepted": False}, f"{ACTION} rejected the plan"),
        ({"answers": False}, f"{ACTION} gave no answer to the goal within 5.0 s: the arm may move"),
        ({"ends": False}, "gave no result within"),
        ({"status": 6, "code": -4}, "did not reach the end: status 6 (must be 4), error_code -4"),
        ({"code": -5}, "error_code -5 'late'"),
    ],
)
def test_what_becomes_of_a_plan_is_told(node: Node, server: Any, words: str) -> None:
    vars(node.controller).update(server)

    def script() -> None:
        node.hear("joint_states", state())
        told = ask(node)
        assert words in told.message
        assert told.val == constants("moveit_msgs/msg/MoveItErrorCodes")["CONTROL_FAILED"]

    serve(node, script, "--execute", ACTION)
    said = [item for topic, item in node.sent if topic == "~/status"]
    assert said[-1].level == 2
    assert words in said[-1].message
    assert not node.sent[-1][1].trajectory.joint_trajectory.points
    assert ("~/joint_trajectory" in dict(node.sent)) == node.controller.there


@pytest.mark.parametrize("moved", [0.009, 0.011, None])
def test_a_plan_is_sent_where_the_arm_is(node: Node, moved: float | None) -> None:
    """While it is planned the arm goes elsewhere, or is heard no more."""
    found = node.controller.wait_for_server

    def meanwhile(timeout_sec: float) -> bool:
        if moved is None:
            node.now += 1_100_000_000
        else:
            node.hear("joint_states", state(SCENE.start + moved))
        return found(timeout_sec)

    node.controller.wait_for_server = meanwhile

    def script() -> None:
        node.hear("joint_states", state())
        told = ask(node)
        assert (told.val == 1) == (moved == 0.009), told.message
        if moved is None:
            assert "joint states are 1.1 s old" in told.message
        elif moved > 0.01:
            assert (
                "START_INVALID: not executed: the plan begins 0.011 from where joint"
                in told.message
            )

    serve(node, script, "--execute", ACTION)
    assert (ACTION in dict(node.sent)) == (moved == 0.009)
    assert ("~/joint_trajectory" in dict(node.sent)) == (moved == 0.009)


def test_without_a_state_nothing_is_sent(node: Node) -> None:
    """Nor with an old one, one that was not understood, or an arm in motion."""
    old = time_message(node.now - 3_600_000_000_000)
    cases = (
        ({}, "no joint states were heard"),
        ({"names": NAMES[:3], "q": SCENE.start[:3]}, "joint fr3_joint4, fr3_joint5"),
        ({"q": np.full(7, np.nan)}, "fr3_joint1 is nan"),
        ({"header": message("std_msgs/msg/Header", stamp=old)}, "joint states are 3600.0 s old"),
        ({"velocity": np.full(7, 0.5)}, "the arm moves: joint1 at 0.5"),
        ({"velocity": np.full(7, np.nan)}, "state.velocity[0] is nan"),
        ({"names": [f"left_joint{k}" for k in range(1, 8)]}, "velocity[0] is nan"),  # as before
        ({"velocity": []}, "by their positions the arm stands for 0.00 s: must be 1 s"),
    )

    def script() -> None:
        for given, words in cases:
            if given:
                node.hear("joint_states", state(**given))
            told = ask(node)
            assert told.message.startswith("START_INVALID: "), told.message
            assert words in told.message
            assert told.message.endswith("; or state the start_state")
        node.hear("joint_states", state())
        node.now += 1_500_000_000
        assert "joint states are 1.5 s old: must be at most 1 s" in ask(node).message

    serve(node, script, "--execute", ACTION)
    assert {topic for topic, _ in node.sent} == {"~/status", "response"}


def crate(name: str, frame: str) -> Any:
    ball = message("shape_msgs/msg/SolidPrimitive", type=2, dimensions=[0.06])
    header = message("std_msgs/msg/Header", frame_id=frame)
    kind = "moveit_msgs/msg/CollisionObject"
    return message(kind, id=name, header=header, primitives=[ball], primitive_poses=[])


def test_obstacles_that_are_not_understood_are_told_once_each(node: Node) -> None:
    def script() -> None:
        node.hear("joint_states", state())
        for _ in range(3):
            for name in ("crate", "bag"):
                node.hear("collision_object", crate(name, "camera"))
        told = ask(node)
        assert told.message.startswith("INVALID_SCENE: not understood: collision object 'crate'")
        assert "collision object 'bag'" in told.message

    serve(node, script)
    assert [text.split(": header")[0] for text in node.warnings] == [
        "collision_object: collision object 'crate'", "collision_object: collision object 'bag'",
    ]  # fmt: skip


def test_a_message_that_cannot_be_decoded_leaves_the_world_unknown(node: Node) -> None:
    """Until a whole scene comes: nobody knows what it told."""

    def script() -> None:
        node.hear("joint_states", state())
        _, callback = node.heard["collision_object"]
        callback(to_bytes(crate("crate", ""))[:40])
        node.hear("collision_object", crate("bag", ""))
        told = ask(node)
        assert "INVALID_SCENE: not understood: a message of collision_object: 40 bytes" in (
            told.message
        )
        node.hear("planning_scene", planning_scene(SCENE, "fr3_"))
        assert ask(node).val == 1

    serve(node, script)


def looking(node: Node) -> None:
    """A camera at the base that sees one ripe fruit, for two seconds."""
    header = message("std_msgs/msg/Header", frame_id="fr3_link0")
    place = message("geometry_msgs/msg/Point", x=0.55, y=0.0, z=0.6)
    pose = message("geometry_msgs/msg/Pose", position=place)
    result = message(
        "vision_msgs/msg/ObjectHypothesisWithPose",
        hypothesis=message("vision_msgs/msg/ObjectHypothesis", class_id="red", score=1.0),
    )
    size = message("geometry_msgs/msg/Vector3", x=0.03, y=0.03, z=0.03)
    box = message("vision_msgs/msg/BoundingBox3D", center=pose, size=size)
    fruit = message("vision_msgs/msg/Detection3D", results=[result], bbox=box)
    names = [f"fr3_joint{k}" for k in range(1, 8)]
    period, tick = node.timer
    node.hear("/tf_static", message("tf2_msgs/msg/TFMessage"))
    for _ in range(round(2.0 / period)):
        header.stamp = time_message(node.now)
        fields = {"header": header, "name": names, "position": SCENE.start}
        node.hear("joint_states", message("sensor_msgs/msg/JointState", **fields))
        seen = message("vision_msgs/msg/Detection3DArray", header=header, detections=[fruit])
        node.hear("/camera/fruits", seen)
        tick()
        node.now += round(period * 1e9)
    node.hear("joint_states", message("sensor_msgs/msg/JointState", name=["f"], position=[0.0]))
    raise ExternalShutdownError


def test_the_shell_of_the_loop_carries_messages_both_ways(node: Node) -> None:
    node.session, begun = looking, node.now
    call = ["ros-node", "scenario-4", "--prefix", "fr3_", "--loop", "--role", "red=target:stem"]
    call += ["--execute", "/arm/joint_trajectory", "--detections", "/camera/fruits"]
    result = runner.invoke(app, call)
    assert result.exit_code == 0, result.stderr
    curves = [item for topic, item in node.sent if topic == "/arm/joint_trajectory"]
    states = [item for topic, item in node.sent if topic == "~/status"]
    assert len(curves) > 1
    assert curves[0].joint_names[0] == "fr3_joint1"
    assert begun < nanoseconds(curves[0].header.stamp) <= node.now
    assert states[0].message == "looking"
    assert states[-1].values[0].value == "go"
    assert len(node.warnings) == 1


def commanding(node: Node) -> None:
    """Somebody's policy: upwards at 0.5 m/s for a while, then too few values, then nothing."""
    command = "std_msgs/msg/Float64MultiArray"
    names = [f"fr3_joint{k}" for k in range(1, 8)]
    period, tick = node.timer
    tick()  # no state of the arm is known
    for k in range(60):
        state = message("sensor_msgs/msg/JointState", name=names, position=SCENE.start)
        node.hear("joint_states", state)
        if k < 20:
            node.hear("/policy", message(command, data=[0.0, 0.0, 0.5]))
        tick()
        node.now += round(period * 1e9)
    node.hear("/policy", message(command, data=[0.0, 0.0]))
    raise ExternalShutdownError


def test_the_guard_filters_the_commands_of_a_topic(node: Node) -> None:
    node.session = commanding
    call = ["ros-node", "scenario-4", "--prefix", "fr3_", "--guard", "/policy"]
    result = runner.invoke(app, [*call, "--execute", "/velocity/commands"])
    assert result.exit_code == 0, result.stderr
    sent = np.array([item.data for topic, item in node.sent if topic == "/velocity/commands"])
    assert sent.shape == (62, 7)  # one as it ends
    assert not sent[0].any()
    robot = posed(SCENE)[0]
    assert (np.abs(sent) <= robot.velocity).all()
    assert np.abs(sent[:21]).max() > 0.05
    told = [item.message for topic, item in node.sent if topic == "~/status"]
    assert told[:2] == ["no joint states", "as asked"]
    assert sent[-1] == pytest.approx(0.0, abs=1e-9)  # nothing was heard for long
    assert node.warnings == [
        "/policy: a command has 2 values: must be 7 velocities of joints, or 3 of the tool point"
    ]


@pytest.mark.parametrize("end", [ExternalShutdownError, SystemExit, ArithmeticError])
def test_a_guard_that_ends_brakes_first(node: Node, end: type[BaseException]) -> None:
    """By a signal, as the command line has it, or by an error."""

    def run(node: Node) -> None:
        period, tick = node.timer
        for _ in range(4):
            node.hear("joint_states", state())
            node.hear("/policy", message("std_msgs/msg/Float64MultiArray", data=[1.0] + [0.0] * 6))
            tick()
            node.now += round(period * 1e9)
        raise end

    node.session = run
    call = ["ros-node", "scenario-4", "--prefix", "fr3_", "--guard", "/policy"]
    runner.invoke(app, [*call, "--execute", "/velocity/commands"])
    sent = np.array([item.data for topic, item in node.sent if topic == "/velocity/commands"])
    assert sent[3][0] > 0.5
    most = 0.02 * posed(SCENE)[0].acceleration * (1 + 1e-6)
    assert (np.abs(np.diff(sent[3:], axis=0)) <= most).all()
    assert len(sent) > 5
    assert not sent[-1].any()


def photographing(node: Node) -> None:
    """A camera at the base whose picture comes until the fruit in it is tracked."""
    shot = shot_of()
    names = [f"fr3_joint{k}" for k in range(1, 8)]
    _, tick = node.timer
    mount = frames(0, ("fr3_link0", FRAME, shot.picture.camera.pose))
    node.hear("/tf_static", mount)
    about = info(shot.picture.camera)
    colour = compressed(shot.picture.rgb, 0, "png")
    depth = image(shot.picture.depth.astype(np.float32), "32FC1", 0)
    first, begun = node.now, time.monotonic()
    while not node.sent or int(node.sent[-1][1].values[1].value) < 3:
        gone = time.monotonic() - begun
        assert gone < 90.0  # [s] on a machine that is busy
        node.now = first + round(1e9 * gone)
        state = message("sensor_msgs/msg/JointState", name=names, position=SCENE.start)
        state.header.stamp = time_message(node.now)
        node.hear("joint_states", state)
        node.hear("/cam/camera_info", about)
        colour.header.stamp = depth.header.stamp = state.header.stamp
        node.hear("/cam/color/compressed", colour)
        node.hear("/cam/depth", depth)
        tick()
    raise ExternalShutdownError


def test_the_loop_sees_by_the_topics_of_a_camera(node: Node) -> None:
    node.session = photographing
    topics = "/cam/color/compressed, /cam/depth,/cam/camera_info"
    call = ["ros-node", "scenario-4", "--prefix", "fr3_", "--loop", "--pictures", topics]
    result = runner.invoke(app, call)
    assert result.exit_code == 0, result.stderr
    assert node.sent[-1][1].values[1].key == "fruits"
    assert node.warnings == []
    assert {"/cam/color/compressed", "/cam/depth"} <= set(node.heard)
    assert "~/detections" not in node.heard
    wrong = runner.invoke(app, ["ros-node", "scenario-4", "--loop", "--pictures", "/a,/b"])
    assert "must be the topics of colour, depth and camera_info" in wrong.stderr


def test_a_role_that_is_none_is_refused(node: Node) -> None:
    for text, told in (("red", "--role is 'red'"), ("red=static", "role of class 'red'")):
        result = runner.invoke(app, ["ros-node", "scenario-4", "--loop", "--role", text])
        assert result.exit_code == 2
        assert told in result.stderr
