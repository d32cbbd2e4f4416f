"""Whether a Franka Research 3 (FR3) would abort a motion: the manufacturer's published conditions.

Positions, accelerations, jerks and torques are those of Franka Robotics' "Control Interface
Specification and Robot Limits"; the fall of the velocity towards a position limit is that of
``franka/rate_limiting.h`` (libfranka 0.10 to 0.13), whose ends lie 6 mrad beyond the limits. Masses
are those of the FR3's published URDF, with the Franka Hand. The manufacturer publishes no limit of
the power beyond which ``power_limit_violation`` aborts a motion; the largest power is told.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.judging import Violation
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Trajectory

LOWER = np.array([-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159])  # [rad]
UPPER = np.array([2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159])  # [rad]
VELOCITY = np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])  # [rad/s] away from the ends
ENDS = np.array([  # [rad] where the velocity that is allowed comes to 0
    [-2.7501, -1.7918, -2.9065, -3.0481, -2.8101, 0.54092, -3.0196],
    [2.7501, 1.7918, 2.9065, -0.1458, 2.8101, 4.5205, 3.0196],
])  # fmt: skip
OFFSET = np.array([0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35])  # [rad/s] of that fall
DECELERATION = np.array([6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0])  # [rad/s^2] of that fall
ACCELERATION = 10.0  # [rad/s^2]
JERK = 5000.0  # [rad/s^3]
TORQUE = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # [N m]
TORQUE_RATE = 1000.0  # [N m/s]

# of links 1 to 7 and the hand: mass [kg], centre [m], inertia xx yy zz xy xz yz about it [kg m^2]
BODIES = np.array([
    [2.92747, 0.0, -0.01813, -0.03860, 0.02393, 0.02248, 0.00635, 0.00001, -0.00011, -0.00200],
    [2.93554, 0.00318, -0.07432, 0.00881, 0.04194, 0.02515, 0.06170, 0.00020, 0.00408, -0.00423],
    [2.24490, 0.04070, -0.00482, -0.02897, 0.02410, 0.01974, 0.01904, 0.00240, -0.00286, -0.00210],
    [2.61560, -0.04591, 0.06305, -0.00852, 0.03453, 0.02888, 0.04125, 0.01323, 0.01015, -0.00098],
    [2.32712, -0.00160, 0.02925, -0.09730, 0.05161, 0.04788, 0.01642, -0.00572, -0.00357, 0.01067],
    [1.81704, 0.05971, -0.04103, -0.01017, 0.00541, 0.01406, 0.01608, 0.00619, 0.00142, -0.00131],
    [0.62714, 0.00452, 0.00863, -0.01616, 0.00021, 0.00018, 0.00006, -0.00002, 0.00005, 0.00009],
    [0.73, -0.01, 0.0, 0.137, 0.001, 0.0025, 0.0017, 0.0, 0.0, 0.0],
])  # fmt: skip
CARRIES = np.array([0, 1, 2, 3, 4, 5, 6, 6])  # joint whose link carries the body
TENSORS = BODIES[:, [4, 7, 8, 7, 5, 9, 8, 9, 6]].reshape(-1, 3, 3)
GRAVITY = 9.81  # [m/s^2]
LENGTH = math.hypot(0.316 + 0.384, 0.088)  # [m] from joint 1 to joint 7, stretched

PERIOD = 0.001  # [s] of the arm's cycle
MOST = 60_000  # instants of a longer curve, chosen: a minute at each cycle
TIE = 1e-6  # share of a limit by which rounding may exceed it, chosen


class Foreseen(NamedTuple):
    """The conditions that a motion breaks, each of libfranka's name, the largest of each joint."""

    violations: tuple[Violation, ...]
    shares: dict[str, float]  # largest use of each limit that is not 0
    power: float  # largest mechanical power of the joints together [W]


def foreseen(robot: Robot, curve: Trajectory, up: FloatArray) -> Foreseen:
    """The conditions of an FR3 that a curve breaks, at each millisecond.

    ``up``: (3,) the upward vertical in the frame of the base.

    Raises:
        InvalidRequestError: the arm is no Franka, by its number of joints or its length.
    """
    origins, _ = robot.segment_frames(np.zeros(robot.n_joints))
    length = float(np.linalg.norm(origins[-1] - origins[0]))
    if robot.n_joints != len(LOWER) or abs(length - LENGTH) > 1e-3:
        raise InvalidRequestError(
            f"{robot.name} has {robot.n_joints} joints, the last {length:.3f} m from the first; "
            f"the controller franka moves {len(LOWER)} joints, {LENGTH:.3f} m"
        )
    count = min(math.ceil(curve.duration / PERIOD), MOST) + 1
    times = np.linspace(0.0, curve.duration, max(count, 3))
    q, velocity, acceleration = curve.sample(times)
    slowest, fastest = (
        way * np.clip(np.sqrt(2.0 * DECELERATION * np.maximum(room, 0.0)) - OFFSET, 0.0, VELOCITY)
        for way, room in ((-1.0, q - ENDS[0]), (1.0, ENDS[1] - q))
    )
    needed = torques(robot, times, q, velocity, up)
    jerk, torque_rate = (np.diff(of, axis=0) / times[1] for of in (acceleration, needed))
    conditions = {
        "position": ("joint_position_limits_violation", "rad", q, LOWER, UPPER),
        "velocity": ("joint_velocity_violation", "rad/s", velocity, slowest, fastest),
        "acceleration": (
            "joint_motion_generator_velocity_discontinuity", "rad/s^2",
            acceleration, -ACCELERATION, ACCELERATION,
        ),
        "jerk": (
            "joint_motion_generator_acceleration_discontinuity", "rad/s^3", jerk, -JERK, JERK,
        ),
        "torque": ("tau_J_range_violation", "N m", needed, -TORQUE, TORQUE),
        "torque rate": (
            "controller_torque_discontinuity", "N m/s", torque_rate, -TORQUE_RATE, TORQUE_RATE,
        ),
    }  # fmt: skip
    broken, shares = [], dict[str, float]()
    for what, (kind, unit, values, lower, upper) in conditions.items():
        limits = np.where(values < 0.0, lower, upper)
        used = np.divide(values, limits, out=np.zeros_like(values), where=limits != 0.0)
        shares[what] = float(used.max())
        over = np.maximum(lower - values, values - upper)
        for joint in np.flatnonzero((over > TIE * np.abs(limits)).any(axis=0)):
            row, name = int(np.argmax(over[:, joint])), robot.joint_names[joint]
            least, most = (np.broadcast_to(of, q.shape)[row, joint] for of in (lower, upper))
            told = (
                f"the {what} of {name} is {values[row, joint]:.5g} {unit} at {times[row]:.3f} s "
                f"and {q[row, joint]:.5g} rad; an FR3 allows {least:.5g} to {most:.5g} {unit}"
            )
            amount = float(over[row, joint])
            broken.append(Violation(kind, told, name, float(times[row]), amount, unit))
    del shares["position"]  # its limits do not lie about 0
    return Foreseen(tuple(broken), shares, float((needed * velocity).sum(axis=1).max()))


def torques(
    robot: Robot, times: FloatArray, q: FloatArray, velocity: FloatArray, up: FloatArray
) -> FloatArray:
    """Torques (T, 7) [N m] of an FR3 with its hand along a motion at equal steps of time.

    They balance what gravity and inertia ask of the bodies beyond each joint; forces and moments
    are the slopes of the momenta, by differences between neighbouring instants.
    """
    origins, rotations = robot.segment_frames(q)
    axes = rotations[..., 2]
    turned = rotations[:, CARRIES]
    centres = origins[:, CARRIES] + np.einsum("tbij,bj->tbi", turned, BODIES[:, 1:4])
    speeds = np.cumsum(axes * velocity[..., None], axis=1)[:, CARRIES]
    spins = np.einsum("tbji,tbj->tbi", turned, speeds)  # in the frame of the body
    momenta = np.einsum("tbij,bjk,tbk->tbi", turned, TENSORS, spins)
    step = times[1] - times[0]
    pulls = np.gradient(np.gradient(centres, step, axis=0), step, axis=0) + GRAVITY * up
    forces = BODIES[:, :1] * pulls
    moments = np.cross(centres, forces) + np.gradient(momenta, step, axis=0)
    beyond = [np.cumsum(each[:, ::-1], axis=1)[:, :0:-1] for each in (forces, moments)]
    return np.asarray(np.einsum("tji,tji->tj", axes, beyond[1] - np.cross(origins, beyond[0])))
