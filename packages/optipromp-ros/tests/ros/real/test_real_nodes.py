"""The node among real nodes of ROS 2: rclpy, Fast DDS and processes of their own.

They run where ``.ci/real-ros`` has made an environment for them, on Python 3.11.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="no rclpy: .ci/real-ros brings it")
for package in ("moveit_msgs", "control_msgs", "tf2_msgs", "vision_msgs"):
    pytest.importorskip(package, reason=f"no {package}: tests/ros/real/build_messages.py makes it")

from control_msgs.action import FollowJointTrajectory  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import Pose as PoseMessage  # noqa: E402
from moveit_msgs.msg import (  # noqa: E402
    CollisionObject,
    Constraints,
    DisplayTrajectory,
    JointConstraint,
    MotionPlanRequest,
    OrientationConstraint,
    PlanningScene,
    PositionConstraint,
    RobotState,
)
from moveit_msgs.srv import GetMotionPlan  # noqa: E402
from rclpy.action import ActionServer, GoalResponse  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from tests.cli.fixtures import completed, invoke  # noqa: E402
from tests.perception.shots import shot_of  # noqa: E402
from tests.ros.camera_messages import FRAME, compressed, frames, image, info, states  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402
from vision_msgs.msg import Detection3DArray  # noqa: E402

from optipromp.core.planning.task import posed  # noqa: E402
from optipromp.core.scenes import Pose, load_scene  # noqa: E402
from optipromp.core.scenes.hand import tool_frame  # noqa: E402
from optipromp.core.scenes.io import save_scene  # noqa: E402
from optipromp_ros import (  # noqa: E402
    Recorded,
    from_bytes,
    message,
    planning_scene,
    to_bytes,
    write_bag,
)
from optipromp_ros.frames import TF, known_frames  # noqa: E402
from optipromp_ros.live import DETECTIONS  # noqa: E402
from optipromp_ros.recordings import JOINT_STATE, stamp_of  # noqa: E402
from optipromp_ros.scenes import pose_message  # noqa: E402
from optipromp_ros.trajectories import time_message  # noqa: E402
from optipromp_sim.generate import generate  # noqa: E402

pytestmark = pytest.mark.filterwarnings("default")  # ROS's own modules warn
SCENE = load_scene("scenario-3")
NAMES = [f"fr3_joint{k}" for k in range(1, 8)]
ROOT = Path(__file__).parents[5]
DURABLE = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LONGEST = 150.0  # [s] of a wait, on a machine that is busy and compiles
KEPT = (  # of the arm and the camera
    ("/joint_states", JointState, JOINT_STATE, 100), ("/tf_static", TFMessage, TF, DURABLE),
    ("/camera/fruits", Detection3DArray, DETECTIONS, 100),
)  # fmt: skip
CAMERA = ["--role", "ripe=target:stem", "--role", "unripe=pushable:stem"]
CAMERA += ["--detections", "/camera/fruits", "--ros-args", "-p", "use_sim_time:=true"]


@pytest.fixture(scope="module", autouse=True)
def ros() -> Iterator[None]:
    """ROS 2 on this machine alone, apart from other runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", str(os.getpid() % 100)))
        rclpy.init()
        yield
        rclpy.shutdown()


@pytest.fixture
def node() -> Iterator[Any]:
    made = rclpy.create_node("tests")
    yield made
    made.destroy_node()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts processes, and ends them with the test."""
    running = list[tuple[subprocess.Popen[str], Any]]()

    def begin(*call: str) -> subprocess.Popen[str]:
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        log = (tmp_path / f"{len(running)}.log").open("w")
        process = subprocess.Popen(
            [sys.executable, *call], stdout=log, stderr=log, text=True, cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": path},
        )  # fmt: skip
        running.append((process, log))
        return process

    yield begin
    for process, log in running:
        process.kill()
        process.wait()
        log.close()
    for log in sorted(tmp_path.glob("*.log")):
        print(log.name, log.read_text())


def until(node: Any, done: Callable[[], Any], longest: float = LONGEST, each: Any = None) -> None:
    """Let a node work until something is so; ``each``: that is called every 20 ms."""
    end = time.monotonic() + longest
    while not done():
        assert time.monotonic() < end, "it did not come"
        if each is not None:
            each()
        rclpy.spin_once(node, timeout_sec=0.02)


def real(item: Any, kind: Any) -> Any:
    """A message as an object of ROS's own class."""
    return deserialize_message(to_bytes(item), kind)


def state(node: Any, q: Any = SCENE.start, names: Any = NAMES) -> bytes:
    """Of an arm that stands."""
    return to_bytes(states(names, q, node.get_clock().now().nanoseconds, np.zeros(len(q))))


def joints(q: Any, names: Any = NAMES) -> Any:
    """A goal of ``moveit_msgs/Constraints``: a configuration, or some joints of one."""
    pairs = zip(names, map(float, q), strict=True)
    return Constraints(
        joint_constraints=[JointConstraint(joint_name=n, position=x) for n, x in pairs]
    )


def place(pose: Pose, link: str = "tool", frame: str = "fr3_link0", alone: bool = False) -> Any:
    """One of a position, and of an orientation unless it is ``alone``."""
    at = PositionConstraint(link_name=link)
    at.header.frame_id = frame
    where = real(pose_message(pose), PoseMessage)
    at.constraint_region.primitive_poses = [where]
    turn = OrientationConstraint(link_name=link, header=at.header, orientation=where.orientation)
    return Constraints(position_constraints=[at], orientation_constraints=[] if alone else [turn])


ROBOT, START = posed(SCENE)
THERE = np.array(START.q) + [0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
TOOL, FAR = tool_frame(ROBOT, THERE), Pose([3.0, 0.0, 0.0])
HERE = known_frames(ROBOT, q=START.q)
LEFT = [f"left_joint{k}" for k in range(1, 8)]


def requests() -> dict[str, tuple[dict[str, Any], str]]:
    """Of each kind: its fields, and what the answer begins with or says."""
    goals = {
        "a configuration": (joints(THERE), "success"),
        "some joints": (joints(THERE[:2], NAMES[:2]), "success"),
        "a position alone": (place(TOOL, alone=True), "success"),
        "a pose": (place(TOOL), "success"),
        "a pose of the flange": (place(HERE["flange"], "fr3_flange"), "success"),
        "a pose of the last link in its frame": (place(Pose(), *["fr3_link7"] * 2), "success"),
        "out of reach": (place(FAR), "GOAL_UNREACHABLE"),
        "beyond a limit": (joints([9.0], NAMES[:1]), "outside its limits"),
        "a frame that is none": (place(TOOL, frame="map"), "frame_id is 'map'"),
    }
    begins = {
        "elsewhere": (JointState(name=NAMES, position=THERE), "not executed: the plan begins 0.2"),
        "half an arm": (JointState(name=NAMES[:3], position=[0.0] * 3), "joint fr3_joint4, "),
    }
    return {
        "the target": ({}, "success"),
        "alternatives": ({"goal_constraints": [place(FAR), joints(THERE)]}, "success"),
        **{kind: ({"goal_constraints": [one]}, words) for kind, (one, words) in goals.items()},
        **{
            kind: ({"start_state": RobotState(joint_state=one)}, words)
            for kind, (one, words) in begins.items()
        },
    }


ACTION = "/arm/follow_joint_trajectory"


class Asker:
    """Whoever asks the planning service: with an arm, its gripper and another arm on one topic.

    ``quality``: of the joint states, which are of an arm that stands at the scene's start.
    """

    def __init__(self, node: Any, start: Any, scene: str, quality: Any = 10) -> None:
        self.node, self.said, self.shown = node, list[str](), list[Any]()
        self.states = node.create_publisher(JointState, "joint_states", quality)
        self.objects = node.create_publisher(CollisionObject, "collision_object", 10)
        self.scenes = node.create_publisher(PlanningScene, "planning_scene", 10)
        node.create_subscription(DisplayTrajectory, "display_planned_path", self.shown.append, 10)
        node.create_subscription(
            DiagnosticStatus, "/optipromp/status", lambda item: self.said.append(item.message), 99
        )
        self.client = node.create_client(GetMotionPlan, "/optipromp/plan")
        start("-m", "optipromp", "ros-node", scene, "--prefix", "fr3_", "--execute", ACTION)
        until(node, self.client.service_is_ready)
        every = self.states, self.objects, self.scenes
        until(node, lambda: min(each.get_subscription_count() for each in every) > 0)

    def speak(self) -> None:
        for names, q in ((NAMES, START.q), (LEFT, THERE), (["fr3_finger_joint1"], [0.04])):
            self.states.publish(state(self.node, q, names))

    def wait(self, each: Any = None) -> None:
        end = time.monotonic() + 1.0
        until(self.node, lambda: time.monotonic() > end, each=each)

    def ask(self, each: Any = None, **fields: Any) -> Any:
        made = GetMotionPlan.Request()
        made.motion_plan_request = MotionPlanRequest(group_name="arm", **fields)
        answer = self.client.call_async(made)
        until(self.node, answer.done, each=each)
        return answer.result().motion_plan_response


def test_the_planning_service_answers_each_kind_of_request(node: Any, start: Any) -> None:
    """A planning scene, an object and the arm in; plans out, which an action server executes."""
    executed = []

    def execute(goal: Any) -> Any:
        executed.append(goal.request.trajectory)
        goal.succeed()
        return FollowJointTrajectory.Result()

    server = ActionServer(node, FollowJointTrajectory, ACTION, execute)
    asker = Asker(node, start, "scenario-4", qos_profile_sensor_data)
    scene = real(planning_scene(SCENE, "fr3_"), PlanningScene)
    apart = scene.world.collision_objects.pop()  # comes by itself
    asker.scenes.publish(scene)
    asker.wait()
    asker.objects.publish(apart)
    assert "no joint states were heard" in asker.ask().error_code.message
    asker.wait(asker.speak)
    for kind, (fields, words) in requests().items():
        found = asker.ask(asker.speak, **fields)
        told = found.error_code.message
        assert told.startswith(words) or (words != "success" and words in told), (kind, told)
        assert (found.error_code.val == 1) == (words == "success"), (kind, told)
        until(node, lambda told=told: told in asker.said[-1:], each=asker.speak)
        if words != "success":
            assert not found.trajectory.joint_trajectory.points
            continue
        assert told.endswith(f"; {ACTION} executed it")
        motion = executed.pop()
        assert motion == found.trajectory.joint_trajectory
        assert (found.group_name, list(motion.joint_names)) == ("arm", NAMES)
        np.testing.assert_allclose(motion.points[0].positions, START.q, atol=1e-9)
        end_at = np.array(motion.points[-1].positions)
        if kind in ("a configuration", "some joints", "alternatives"):
            np.testing.assert_allclose(end_at, THERE, atol=1e-3)
        elif kind != "the target":
            where = HERE["tool"] if "pose of the" in kind else TOOL
            off = tool_frame(ROBOT, end_at).position - where.position
            assert np.linalg.norm(off) < 2e-3, kind
    assert f"{ACTION} accepted the plan" in asker.said
    assert not executed
    assert len(asker.shown[0].trajectory) == 1
    server.destroy()


def test_what_is_not_understood_is_told_once_each(node: Any, start: Any, tmp_path: Path) -> None:
    """An obstacle in an unknown frame, and a message that cannot be decoded."""
    asker, crate = Asker(node, start, "scenario-3"), CollisionObject(id="crate")
    crate.header.frame_id = "camera"
    for _ in range(3):
        asker.objects.publish(crate)
        asker.objects.publish(to_bytes(message("moveit_msgs/msg/CollisionObject"))[:40])
    asker.wait(asker.speak)
    told = asker.ask(asker.speak).error_code.message
    assert told.startswith("INVALID_SCENE: not understood: ")
    assert "collision object 'crate': header.frame_id is 'camera'" in told
    assert "a message of collision_object: 40 bytes are no moveit_msgs" in told
    log = (tmp_path / "0.log").read_text()
    assert log.count("collision object 'crate'") == log.count("40 bytes are no") == 1
    asker.scenes.publish(real(planning_scene(SCENE, "fr3_"), PlanningScene))  # all is told anew
    asker.wait(asker.speak)
    assert asker.ask(asker.speak).error_code.message.startswith("EXECUTION_FAILED: no controller")


@pytest.mark.parametrize(
    ("server", "words"),
    [
        ("rejects", "rejected the plan"),
        ("is silent", "gave no answer to the goal within 5.0 s: the arm may move"),
        ("aborts", "did not reach the end: status 6 (must be 4), error_code -4 'too far'"),
        ("fails", "status 4 (must be 4), error_code -4"),
        ("does not end", "gave no result within"),
    ],
)
def test_what_a_controller_does_with_a_plan_is_told(node, start, server, words):
    def execute(goal: Any) -> Any:
        if server == "does not end":
            time.sleep(20.0)
        goal.abort() if server == "aborts" else goal.succeed()
        return FollowJointTrajectory.Result(error_code=-4, error_string="too far")

    def accept(_: Any) -> Any:
        time.sleep(6.0 if server == "is silent" else 0.0)
        return GoalResponse.REJECT if server == "rejects" else GoalResponse.ACCEPT

    made = ActionServer(node, FollowJointTrajectory, ACTION, execute, goal_callback=accept)
    asker = Asker(node, start, "scenario-3")
    asker.wait(asker.speak)
    found = asker.ask(asker.speak, goal_constraints=[joints(THERE)])
    assert found.error_code.message.startswith("EXECUTION_FAILED"), found.error_code.message
    assert words in found.error_code.message
    assert not found.trajectory.joint_trajectory.points
    made.destroy()


def test_roles_and_topics_that_are_none_are_refused() -> None:
    for option, text, told in (
        ("role", "red", "--role is 'red'"), ("role", "red=static", "role of class 'red'"),
        ("pictures", "/a,/b", "must be the topics of colour, depth and camera_info"),
    ):  # fmt: skip
        call = ["ros-node", "scenario-4", "--loop", f"--{option}", text]
        result = invoke(*call)
        assert (result.exit_code, told in result.stderr) == (2, True)


def test_a_node_alone_names_what_it_waits_for(node: Any, start: Any, tmp_path: Path) -> None:
    log = tmp_path / "0.log"
    alone = start("-m", "optipromp", "ros-node", "scenario-3", *CAMERA[-3:])
    until(node, lambda: "nobody publishes /joint_states, /clock: " in log.read_text())
    alone.send_signal(signal.SIGINT)
    alone.wait(LONGEST)
    assert "Traceback" not in log.read_text()


@pytest.mark.parametrize("end", ["silence", "SIGTERM"])
def test_a_guard_never_falls_silent(node: Any, start: Any, end: str) -> None:
    """The arm follows what it was sent last; then its states stop, or the guard is ended."""
    q, sent = np.array(SCENE.start), []
    speaker = node.create_publisher(JointState, "joint_states", 10)
    policy = node.create_publisher(Float64MultiArray, "/policy", 10)
    node.create_subscription(
        Float64MultiArray, "/velocity", lambda item: sent.append(item.data[0]), 10
    )
    call = ["-m", "optipromp", "ros-node", "scenario-3", "--prefix", "fr3_", "--guard", "/policy"]
    guard = start(*call, "--execute", "/velocity")

    def move() -> None:
        policy.publish(Float64MultiArray(data=[-0.9] + [0.0] * 6))
        speaker.publish(state(node, [q[0] + 0.02 * sum(sent), *q[1:]]))

    until(node, lambda: sent and sent[-1] < -0.5, each=move)
    count = len(sent)
    if end == "SIGTERM":
        guard.send_signal(signal.SIGTERM)
        until(node, lambda: guard.poll() is not None, each=move)
    stop = time.monotonic() + 1.0
    until(node, lambda: time.monotonic() > stop)
    assert sent[-1] == pytest.approx(0.0, abs=1e-6)
    assert any(-0.5 < speed < -0.02 for speed in sent[count:]), sent[count:]


class Heard:
    """What the node in closed loop says and commands."""

    def __init__(self, node: Any) -> None:
        self.said: list[DiagnosticStatus] = []
        self.curves: list[JointTrajectory] = []
        node.create_subscription(DiagnosticStatus, "/optipromp/status", self.hear, 10)
        node.create_subscription(JointTrajectory, "/arm/joint_trajectory", self.curves.append, 10)

    def hear(self, item: DiagnosticStatus) -> None:
        if not self.said or self.said[-1].message != item.message:
            print(f"{time.time():.2f}", item.level[0], item.message, len(self.curves))
        self.said.append(item)

    def value(self, key: str) -> str:
        """Of the last status."""
        last = self.said[-1].values if self.said else []
        return next((one.value for one in last if one.key == key), "")


LOOP = ["--prefix", "fr3_", "--loop", "--execute", "/arm/joint_trajectory"]


@pytest.mark.parametrize("killed", [False, True])
def test_a_pick_between_processes(node: Any, start: Any, tmp_path: Path, killed: bool) -> None:
    """The arm and the camera are other nodes; states and looks come late and out of order.

    The curve that runs when a node is ``killed`` in travel ends at rest, at the camera point; the
    next node begins from there. What the nodes of arm and camera sent is a bag; its shadow has one
    pick, without harm.
    """
    heard, scene, kept, closed = Heard(node), str(tmp_path / "scene.yaml"), [], []

    def keep(topic: str, kind: str, data: bytes) -> None:
        kept.append(Recorded(topic, from_bytes(data, kind), time.time_ns()))
        if kind == JOINT_STATE and heard.value("gripper") == "close":
            closed.append(stamp_of(kept[-1]))

    for topic, kind, name, qos in KEPT:
        node.create_subscription(kind, topic, partial(keep, topic, name), qos, raw=True)
    save_scene(generate("cluster", 3), scene)
    plant = start(str(Path(__file__).parent / "plant.py"), scene)
    call = ["-m", "optipromp", "ros-node", scene, *LOOP, *CAMERA]
    loop, before = start(*call), 20
    if killed:
        until(node, lambda: heard.value("stage") == "travel" and len(heard.curves) > 0)
        loop.kill()
        loop.wait()
        loop, before = start(*call), len(heard.curves)
    until(node, lambda: loop.poll() is not None)
    assert loop.returncode == 0
    assert heard.value("stage") == "done", heard.said[-1].message
    assert len(heard.curves) > before
    plant.send_signal(signal.SIGTERM)
    plant.wait(60.0)
    assert "outcome True None" in (tmp_path / "0.log").read_text()
    write_bag(tmp_path / "shift.mcap", kept)
    begin = min(stamp_of(item) for item in kept if item.topic == "/joint_states")
    picks = [{"closed": (closed[0] - begin) / 1e9}]
    (tmp_path / "marks.json").write_text(json.dumps({"picks": picks}))
    call = ["shadow", str(tmp_path / "shift.mcap"), "--known", scene, "--prefix", "fr3_", "--json"]
    told = completed(*call, "--marks", str(tmp_path / "marks.json"), *CAMERA[:4])
    (pick,) = json.loads(told.stdout)["picks"]
    assert (pick["why"], pick["harmful"]) == ("", False)
    assert pick["theirs"]["probability"] < 0.1


def test_without_a_camera_nothing_is_commanded(node: Any, start: Any) -> None:
    heard = Heard(node)
    speaker = node.create_publisher(JointState, "joint_states", 10)
    start("-m", "optipromp", "ros-node", "scenario-3", *LOOP)
    until(node, lambda: "no look has come" in (heard.said or [DiagnosticStatus()])[-1].message,
          each=lambda: speaker.publish(state(node)))  # fmt: skip
    end = time.monotonic() + 5.0
    until(node, lambda: time.monotonic() > end, each=lambda: speaker.publish(state(node)))
    assert heard.curves == []
    assert heard.said[-1].level == DiagnosticStatus.WARN
    until(node, lambda: heard.said[-1].message == "joint states are old", 5.0)


def test_the_loop_sees_by_the_topics_of_a_camera(node: Any, start: Any) -> None:
    """Pictures of a camera at the base until three fruits in them are tracked."""
    shot, heard = shot_of(), Heard(node)
    speaker = node.create_publisher(JointState, "joint_states", 10)
    where = node.create_publisher(TFMessage, "/tf_static", DURABLE)
    topics = "/c/color/compressed", "/c/depth", "/c/camera_info"
    kinds = zip(topics, (CompressedImage, Image, CameraInfo), strict=True)
    senders = [node.create_publisher(kind, topic, 10) for topic, kind in kinds]
    where.publish(to_bytes(frames(0, ("fr3_link0", FRAME, shot.picture.camera.pose))))
    items = [
        compressed(shot.picture.rgb, 0, "png"),
        image(shot.picture.depth.astype(np.float32), "32FC1", 0), info(shot.picture.camera),
    ]  # fmt: skip
    start("-m", "optipromp", "ros-node", "scenario-4", *LOOP,
          "--pictures", ",".join(topics))  # fmt: skip
    sent = [0.0]

    def photograph() -> None:
        speaker.publish(state(node))
        if time.monotonic() < sent[0] + 0.1:
            return
        sent[0] = time.monotonic()
        now = time_message(node.get_clock().now().nanoseconds)
        for item, sender in zip(items, senders, strict=True):
            item.header = replace(item.header, stamp=now)
            sender.publish(to_bytes(item))

    until(node, lambda: int(heard.value("fruits") or 0) >= 3, each=photograph)
    assert {one.level[0] for one in heard.said} <= {0, 1}
