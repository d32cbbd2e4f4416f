"""An FR3 in MuJoCo behind the arm's own network protocol (franky-sim), with the arm's reflexes.

``python server.py HOST PACE Q1 ... Q7`` serves an arm that stands at Q [rad] until it is ended;
:func:`serving` does so in a process.
franky-sim knows no errors; this server compares each millisecond with the published conditions, and
aborts the motion as an arm would, by name:

- ``controller_torque_discontinuity``: a commanded torque changes by more than 1000 N m/s;
- ``tau_J_range_violation``: a commanded torque is beyond 87 N m (joints 1 to 4) or 12 N m;
- ``joint_position_limits_violation``: a measured position is beyond its limit;
- ``joint_velocity_violation``: a measured velocity is beyond the limit at that position;
- ``self_collision_avoidance_violation``: two bodies of the arm touch;
- ``cartesian_reflex``: the arm touches something else, here the floor.

Time of the arm stands still while an answer to its state is outstanding, for 50 ms at most: a busy
machine loses no packet. Under torque control by a client that says so (``paced.py``) it also stands
still where no reference came for AHEAD ms of it, 0.1 s after the begin: what a test measures does
not depend on how long the machine lets the client's thread wait. Else, at rest and under torque
control, it runs slower than the world's, by PACE. The arm's own controller, which holds it between
motions, is softer than franky-sim's: at 200 N m s/rad the wrist chatters at 0.05 to 0.08 rad/s for
ever after a motion.
"""

import os
import select
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    BaseCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.mujoco_simulator import MujocoSimulator

HOLD = {
    "kp": (3000.0, 3000.0, 2000.0, 2000.0, 500.0, 500.0, 500.0),  # [N m/rad]
    "kv": (150.0, 150.0, 100.0, 100.0, 20.0, 20.0, 20.0),  # [N m s/rad]
}
STANDS = (0.3, -0.2, 0.1, -1.9, 0.1, 1.7, 0.6)  # [rad] at the begin: away from limits and floor

# [rad, rad/s, rad/s, rad/s^2] of franka/rate_limiting.h, libfranka 0.10 to 0.13: where the velocity
# reaches 0, its largest, the offset and the deceleration of its fall towards the limit.
LOWER = np.array([-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196])
UPPER = np.array([2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196])
FASTEST = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
OFFSET = np.array([0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35])
DECELERATION = np.array([6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0])
STRONGEST = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # [N m]
TORQUE_STEP = 1.0 + 1e-6  # [N m] in 1 ms, and rounding

NUMBERS = {  # of libfranka's errors
    "joint_position_limits_violation": 0,
    "self_collision_avoidance_violation": 2,
    "joint_velocity_violation": 3,
    "cartesian_reflex": 7,
    "controller_torque_discontinuity": 32,
    "tau_J_range_violation": 34,
}
COUNT = 41
LONGEST_WAIT = 0.05  # [s]
BEATS = 1400  # UDP port: a reference was commanded (1), the stream of references ended (0)
AHEAD = 2  # [ms] of the arm's time that pass after a reference: their period at 500 Hz
FIRST = 100  # [ms] the same until the first reference
HELD = 0.8  # [s] longest wait for it in each ms: libfranka gives a silent arm up after 1 s
PACE = float(os.environ.get("FRANKA_PACE", "2"))  # of the tests, as a choice


class Recovery(AutomaticErrorRecoveryCommand):
    def handle(self, server):
        server.reflex = None
        super().handle(server)


class Arm(FrankaRobotServer):
    """The server of one arm, with reflexes."""

    def __init__(self, simulator, host):
        self.reflex, self.torque = None, None
        super().__init__(simulator.robots[0], [host])
        self.simulator, self.left, self.paced = simulator, 0, False
        self.beats = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.beats.bind((host, BEATS))
        commands = self._FrankaServer__command_class_map
        commands[RobotCommand.kAutomaticErrorRecovery] = Recovery

    def _reset_state(self):
        super()._reset_state()
        self.reflex, self.torque = None, None

    def start_motion(self, *of):
        if self.reflex is not None:
            raise ValueError(f"recover from {self.reflex} first")
        super().start_motion(*of)
        self.torque = np.zeros(7)
        self.left = FIRST

    def wait(self):
        """Let the arm's time stand still while a reference is awaited."""
        self.left -= 1
        due = HELD if self.led and self.paced and self.left < 0 else 0.0
        while select.select([self.beats], [], [], due)[0]:
            beat, due = self.beats.recv(1), 0.0
            self.paced = beat != b"0"
            if beat == b"1":
                self.left = AHEAD

    @property
    def led(self):
        """Whether a client commands torques."""
        return self._FrankaRobotServer__control_mode.value == "torque"

    def _process_udp_commands(self):
        if self.current_motion_id and self.udp_connected:
            socket = self._FrankaServer__udp_receiver.sock
            select.select([socket], [], [], LONGEST_WAIT)
        super()._process_udp_commands()

    def check(self):
        """Abort a motion that an arm would abort."""
        if self.current_motion_id and (reflex := self._reflex()):
            print("reflex", reflex, flush=True)
            self.reflex = reflex
            number = self.current_motion_id
            self.stop_motion(send_preemption_signal=False)
            self.reset_current_motion_id()
            BaseCommand.send_response(
                self._tcp_socket, RobotCommand.kMove, number, MoveStatus.kReflexAborted
            )

    def _reflex(self):
        inner = self.robot.inner_state
        q, velocity = np.array(inner.q), np.array(inner.dq)
        fall = [
            np.clip(np.sqrt(2.0 * DECELERATION * np.maximum(room, 0.0)) - OFFSET, 0.0, FASTEST)
            for room in (q - LOWER, UPPER - q)
        ]
        if (q < LOWER).any() or (q > UPPER).any():
            return "joint_position_limits_violation"
        if (velocity < -fall[0]).any() or (velocity > fall[1]).any():
            return "joint_velocity_violation"
        command = self._FrankaRobotServer__current_control_command
        if self.led:
            torque = np.array(command.tau_J_d)
            step, self.torque = torque - self.torque, torque
            if (np.abs(step) > TORQUE_STEP).any():
                return "controller_torque_discontinuity"
            if (np.abs(torque) > STRONGEST).any():
                return "tau_J_range_violation"
        model, data = self.simulator.model, self.simulator.data
        for contact in data.contact[: data.ncon]:
            bodies = [model.geom_bodyid[geom] for geom in contact.geom]
            names = [model.body(body).name for body in bodies]
            if contact.dist < 0.0 and not all("finger" in name for name in names):
                both = all(name.startswith("robot0_") for name in names)
                return "self_collision_avoidance_violation" if both else "cartesian_reflex"
        return None

    @property
    def robot_state(self):
        state = super().robot_state
        if self.reflex is None:
            return state
        errors = tuple(k == NUMBERS[self.reflex] for k in range(COUNT))
        return state.replace(robot_mode=RobotMode.kReflex, errors=errors, reflex_reason=errors)


@contextmanager
def serving(host, stands=STANDS):
    """A server in a process of its own; yields the list of reflexes, which grows."""
    command = [sys.executable, __file__, host, *(str(value) for value in (PACE, *stands))]
    reflexes = []

    def read():
        for line in process.stdout:
            reflexes.append(line.split()[1])

    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            if process.stdout.readline() != "ready\n":
                raise RuntimeError(f"the server of {host} did not start")
            threading.Thread(target=read, daemon=True).start()
            yield reflexes
        finally:
            process.kill()


def serve(host, pace, stands):
    simulator = MujocoSimulator()
    simulator.add_robot(initial_q=stands, **HOLD)
    simulator.init()
    arm = Arm(simulator, host)
    arm.init()
    simulator.start()
    print("ready", flush=True)
    while True:
        began = time.perf_counter()
        arm.wait()
        arm.process_commands()
        simulator.step()
        arm.check()
        arm.send_state()
        least = 0.001 * pace if arm.led or not arm.current_motion_id else 0.0
        time.sleep(max(0.0, least - (time.perf_counter() - began)))


if __name__ == "__main__":
    serve(sys.argv[1], float(sys.argv[2]), [float(value) for value in sys.argv[3:]])
