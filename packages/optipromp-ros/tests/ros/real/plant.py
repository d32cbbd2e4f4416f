"""Two nodes of ROS 2 that play an arm and a camera: ``python plant.py SCENE``.

The simulation is behind them: the arm follows what comes on ``/arm/joint_trajectory``, closes its
tool when ``/optipromp/status`` says so, and says on ``/joint_states`` where it is; the camera sends
detections on ``/camera/fruits``, and where it is on ``/tf_static``. Of every two looks the later is
sent first, and every tenth joint state comes after the next. The time is that of ``/clock``, slower
than the wall's, so that a busy machine keeps up. At SIGTERM it prints the outcome.
"""

import signal
import sys
import time
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tests.ros.camera_messages import frames, states
from tests.ros.curves import Curves
from tests.ros.looks import array_of
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory
from vision_msgs.msg import Detection3DArray

from optipromp import load_scene
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.look import Look
from optipromp.core.trajectory import State
from optipromp_ros import from_bytes, to_bytes
from optipromp_sim.simulation import DETECTORS, Detector, Eye, Simulation
from optipromp_sim.simulation.rollouts import Pick, rollout

SLOW = 3.0  # wall time over that of the plant
BEGIN = 1_790_000_000.0  # [s] by the clock
PREFIX = "fr3_"


class Nodes:
    """The nodes of the arm and of the camera, as an agent of ``rollout``: what decides is another
    node."""

    def __init__(self, robot: Robot, start: State, eye: Eye) -> None:
        self.node, camera = rclpy.create_node("arm"), rclpy.create_node("camera")
        self.curves, self.asked, self.closed = Curves(robot.joint_names, start), list[int](), False
        self.node.create_subscription(
            JointTrajectory, "/arm/joint_trajectory", self.heard, 10, raw=True
        )
        self.node.create_subscription(DiagnosticStatus, "/optipromp/status", self.told, 10)
        self.sender = self.node.create_publisher(JointState, "joint_states", 10)
        self.seen = camera.create_publisher(Detection3DArray, "/camera/fruits", 10)
        self.clock = camera.create_publisher(Clock, "/clock", 1)
        durable = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.where = camera.create_publisher(TFMessage, "/tf_static", durable)
        at = tool_frame(robot, start.q).inverse() @ eye.detector.camera(start.q)
        self.where.publish(to_bytes(frames(0, ("tool", "camera", at))))
        self.late: bytes | None = None
        self.held, self.sent = list[Look](), 0

    def heard(self, data: bytes) -> None:
        self.curves.heard(from_bytes(data, "trajectory_msgs/msg/JointTrajectory"))

    def told(self, item: DiagnosticStatus) -> None:
        self.closed |= {one.key: one.value for one in item.values}.get("gripper") == "close"

    def say(self, state: State, now: int) -> None:
        """Publish a state; every tenth after the next."""
        names = [PREFIX + name for name in self.curves.joints]
        item = to_bytes(states(names, state.q, now, state.velocity))
        self.sent += 1
        if self.sent % 10 == 0:
            self.late = item
            return
        self.sender.publish(item)
        if self.late is not None:
            self.sender.publish(self.late)
            self.late = None

    def __call__(self, pick: Pick[Any]) -> list[State] | None:
        """The references of a cycle; see :class:`optipromp_sim.simulation.rollouts.Agent`."""
        now = BEGIN + pick.arena.time
        stamp = round(now * 1e9)
        self.clock.publish(Clock(clock=Time(sec=stamp // 10**9, nanosec=stamp % 10**9)))
        self.say(pick.state, stamp)
        self.held += pick.looks
        if len(self.held) > 1:
            for look in self.held[::-1]:
                self.seen.publish(to_bytes(array_of(look, round((BEGIN + look.time) * 1e9))))
            self.held = []
        begun = time.monotonic()
        while time.monotonic() < begun + SLOW * pick.ticks * pick.arena.tick:
            rclpy.spin_once(self.node, timeout_sec=0.01)
        target = pick.arena.scene.target
        if self.closed and pick.taken is None and target and target.id in pick.arena.held():
            pick.take()
        if self.asked:
            return None
        return [self.curves.at(now + k * pick.arena.tick) for k in range(pick.ticks)]


def main(path: str) -> None:
    scene = load_scene(path)
    robot, start = posed(scene)
    eye = Eye(Detector(scene, robot, DETECTORS["zero-mean"], 0))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    nodes = Nodes(robot, start, eye)
    signal.signal(signal.SIGTERM, lambda number, _: nodes.asked.append(number))
    outcome = rollout(nodes, Pick(Simulation(scene), eye))
    print("outcome", outcome.success, outcome.cause, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
