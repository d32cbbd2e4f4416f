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
from collections import deque
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tests.ros.camera_messages import frames
from tests.ros.looks import array_of
from tf2_msgs.msg import TFMessage
from trajectory_msgs.msg import JointTrajectory
from vision_msgs.msg import Detection3DArray

from optipromp import load_scene
from optipromp.core.planning.task import posed
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.look import Look
from optipromp.core.trajectory import State
from optipromp_ros import from_bytes, read_trajectories, to_bytes
from optipromp_ros.trajectories import nanoseconds
from optipromp_sim.simulation import DETECTORS, Detector, Eye, Simulation
from optipromp_sim.simulation.detector import Truth

CYCLE = 0.02  # [s] between two joint states
SLOW = 3.0  # wall time over that of the plant
BEGIN = 1_790_000_000.0  # [s] by the clock
PREFIX = "fr3_"


def stamp(now: float) -> Any:
    """A time [s] as a message."""
    return Time(sec=int(now), nanosec=round(now % 1.0 * 1e9) % 10**9)


class Arm:
    """The node of the arm: the curve that runs, and those that take over later."""

    def __init__(self, joints: tuple[str, ...], start: State) -> None:
        self.node = rclpy.create_node("arm")
        self.joints, self.state = joints, start
        self.sender = self.node.create_publisher(JointState, "joint_states", 10)
        self.node.create_subscription(
            JointTrajectory, "/arm/joint_trajectory", self.heard, 10, raw=True
        )
        self.node.create_subscription(DiagnosticStatus, "/optipromp/status", self.told, 10)
        self.closed = False
        self.runs: tuple[Any, float] | None = None
        self.coming: deque[tuple[Any, float]] = deque()
        self.late: JointState | None = None
        self.sent = 0

    def heard(self, data: bytes) -> None:
        item = from_bytes(data, "trajectory_msgs/msg/JointTrajectory")
        (motion,) = read_trajectories(item, self.joints)
        self.coming.append((motion, nanoseconds(item.header.stamp) / 1e9))

    def told(self, item: DiagnosticStatus) -> None:
        self.closed |= {one.key: one.value for one in item.values}.get("gripper") == "close"

    def reference(self, now: float) -> State:
        while self.coming and self.coming[0][1] <= now:
            self.runs = self.coming.popleft()
        return self.state if self.runs is None else self.runs[0].at(now - self.runs[1])

    def say(self, state: State, now: float) -> None:
        """Publish a state as most drivers do, without efforts; every tenth after the next."""
        item = JointState(name=[PREFIX + name for name in self.joints])
        item.header.stamp = stamp(now)
        item.position, item.velocity = state.q.tolist(), state.velocity.tolist()
        self.sent += 1
        if self.sent % 10 == 0:
            self.late = item
            return
        self.sender.publish(item)
        if self.late is not None:
            self.sender.publish(self.late)
            self.late = None


def main(path: str) -> None:
    scene = load_scene(path)
    robot, start = posed(scene)
    simulation = Simulation(scene)
    eye = Eye(Detector(scene, robot, DETECTORS["zero-mean"], 0))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    arm, camera = Arm(robot.joint_names, start), rclpy.create_node("camera")
    seen = camera.create_publisher(Detection3DArray, "/camera/fruits", 10)
    durable = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    where = camera.create_publisher(TFMessage, "/tf_static", durable)
    at = tool_frame(robot, start.q).inverse() @ eye.detector.camera(start.q)
    where.publish(to_bytes(frames(0, ("tool", "camera", at))))
    clock = camera.create_publisher(Clock, "/clock", 1)
    held: list[Look] = []
    asked = list[int]()
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    while not asked:
        begun = time.monotonic()
        while time.monotonic() < begun + SLOW * CYCLE:
            rclpy.spin_once(arm.node, timeout_sec=0.01)
        for _ in range(round(CYCLE / simulation.tick)):
            simulation.step(arm.reference(BEGIN + simulation.time))
        if arm.closed:
            simulation.close()
        now, state, f = BEGIN + simulation.time, simulation.state(), simulation.fruits()
        clock.publish(Clock(clock=stamp(now)))
        arm.say(state, now)
        eye.see(now, state.q, Truth(f.ids, f.positions, f.rotations, f.stem_ends))
        held += eye.delivered(now)
        if len(held) > 1:
            for look in held[::-1]:
                seen.publish(to_bytes(array_of(look, round(look.time * 1e9))))
            held = []
    outcome = simulation.outcome()
    print("outcome", outcome.success, outcome.cause, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
