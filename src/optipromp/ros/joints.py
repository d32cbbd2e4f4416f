"""The joints of a robot in messages, by name."""

from collections.abc import Sequence

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.trajectory import State
from optipromp.core.trajectory_files import columns
from optipromp.ros.types import Message, message

AT_REST = 0.01
"""[rad/s or m/s] A slower joint is at rest: encoders are noisy. A choice; the arm's controller
smooths a step of this size."""


def joint_positions(state: Message, joints: Sequence[str], what: str) -> FloatArray:
    """Positions (n,) of ``joints`` in a ``sensor_msgs/JointState`` [rad or m]."""
    if len(state.position) and not len(state.name):
        raise InvalidRequestError(f"{what}: name is empty: must name the joint of each position")
    if len(state.position) != len(state.name):
        raise InvalidRequestError(
            f"{what}: {len(state.position)} positions for {len(state.name)} names: must be as many"
        )
    q = np.asarray(state.position, dtype=np.float64)[columns(state.name, joints, what)]
    if not np.isfinite(q).all():
        bad = int(np.argmin(np.isfinite(q)))
        raise InvalidRequestError(f"{what}: {joints[bad]} is {q[bad]}: must be finite")
    return q


def joint_motion(state: Message, joints: Sequence[str], what: str) -> State:
    """Positions and velocities of ``joints`` in a ``sensor_msgs/JointState``.

    Where all velocities are below :data:`AT_REST`, or the message has none, the joints are at rest.
    """
    q = joint_positions(state, joints, what)
    if len(state.velocity) not in (0, len(state.name)):
        raise InvalidRequestError(
            f"{what}: {len(state.velocity)} velocities for {len(state.name)} names: must be as "
            "many, or none"
        )
    if not len(state.velocity):
        return State(q)
    velocity = np.asarray(state.velocity, dtype=np.float64)[columns(state.name, joints, what)]
    return State(q) if np.abs(velocity).max() < AT_REST else State(q, velocity)


def robot_state(state: State, joints: Sequence[str], prefix: str = "", frame: str = "") -> Message:
    """A ``moveit_msgs/RobotState`` of n joints; ``prefix`` goes before each name."""
    inner = message(
        "sensor_msgs/msg/JointState",
        header=message("std_msgs/msg/Header", frame_id=frame),
        name=[prefix + joint for joint in joints],
        position=state.q,
        velocity=state.velocity,
    )
    return message("moveit_msgs/msg/RobotState", joint_state=inner)
