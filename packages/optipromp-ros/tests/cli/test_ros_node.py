"""The node of ROS 2 where there is no ROS 2.

The shell runs here against a stand-in for ROS's client library, on every Python, where a controller
or a message does what real ones seldom do. With rclpy itself it runs in ``tests/ros/real``. What
the shell calls is tested in ``tests/ros``.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.core.planning.task import posed
from optipromp.core.scenes import load_scene
from optipromp_ros import (
    from_bytes,
    message,
    planning_scene,
    to_bytes,
    typestore,
)
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
        self.session: Any = None

    def create_subscription(
        self, kind: Any, topic: str, callback: Any, qos: Any, *, raw: bool
    ) -> Any:
        assert raw, "rclpy's serialize_message gives other bytes than those that came"
        self.heard[topic] = (kind, callback)
        handle = SimpleNamespace(take_message=lambda kind, raw: None)
        return SimpleNamespace(msg_type=kind, handle=handle)

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
    kept = SimpleNamespace(TRANSIENT_LOCAL=1, VOLATILE=2)
    sure = SimpleNamespace(RELIABLE=1, BEST_EFFORT=2)
    module("rclpy.qos", QoSProfile=dict, DurabilityPolicy=kept, ReliabilityPolicy=sure)
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


NAMES = [f"fr3_joint{k}" for k in range(1, 8)]
ACTION = "/arm_controller/follow_joint_trajectory"


def state(q: Any = SCENE.start, names: Any = NAMES, **fields: Any) -> Any:
    still = {"velocity": np.zeros(len(names)), **fields}
    return message("sensor_msgs/msg/JointState", name=names, position=q, **still)


def ask(node: Node, **fields: Any) -> Any:
    """The answer to a request; it is among what the node sent, too."""
    asked = message("moveit_msgs/msg/MotionPlanRequest", **fields)
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
            assert "joint states are 1.10 s old" in told.message
        elif moved > 0.01:
            assert (
                "START_INVALID: not executed: the plan begins 0.011 from where joint"
                in told.message
            )

    serve(node, script, "--execute", ACTION)
    assert (ACTION in dict(node.sent)) == (moved == 0.009)
    assert ("~/joint_trajectory" in dict(node.sent)) == (moved == 0.009)


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


def test_a_role_or_topics_that_are_none_are_refused(node: Node) -> None:
    for option, text, told in (
        ("role", "red", "--role is 'red'"), ("role", "red=static", "role of class 'red'"),
        ("pictures", "/a,/b", "must be the topics of colour, depth and camera_info"),
    ):  # fmt: skip
        result = runner.invoke(app, ["ros-node", "scenario-4", "--loop", f"--{option}", text])
        assert result.exit_code == 2
        assert told in result.stderr
