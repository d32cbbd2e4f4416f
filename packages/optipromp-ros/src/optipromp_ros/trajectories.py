"""Trajectories and joint states as messages of ROS and back.

``trajectory_msgs/JointTrajectory``, ``moveit_msgs/RobotTrajectory`` and
``moveit_msgs/DisplayTrajectory``. Between two points a controller of ros2_control follows the same
quintic polynomial as :class:`optipromp.Trajectory`.
"""

import os
from collections.abc import Sequence

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.robots.measured import Measured
from optipromp.core.trajectory import CURVE, State, Trajectory, Unwind, curve
from optipromp_ros.types import Message, message, read_bag

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
TRAJECTORIES = (  # Types of messages that hold trajectories, the plainest first
    JOINT_TRAJECTORY,
    "moveit_msgs/msg/RobotTrajectory",
    "moveit_msgs/msg/DisplayTrajectory",
)

NANO = 10**9  # [ns] in a second


def joint_trajectory(
    trajectory: Trajectory, rate: float | None = None, prefix: str = ""
) -> Message:
    """A ``trajectory_msgs/JointTrajectory``: a point with all derivatives for each row.

    Its time stamp is zero: a controller starts the trajectory on arrival.

    Args:
        trajectory: any.
        rate: of the points [Hz]; None: the rows as they are.
        prefix: of joint names in ROS (``fr3_``).

    Raises:
        InvalidRequestError: a rate that is not positive.
    """
    rows = trajectory if rate is None else trajectory.resample(rate)
    points = []
    for k, time in enumerate(rows.times):
        fields = {what: getattr(rows, what)[k] for what in CURVE[1:]}
        after = time_message(round(time * NANO), "Duration")
        name = "trajectory_msgs/msg/JointTrajectoryPoint"
        points.append(message(name, time_from_start=after, **fields))
    names = [prefix + name for name in rows.joint_names]
    return message(JOINT_TRAJECTORY, joint_names=names, points=points)


def stretch_trajectory(
    stretch: Stretch, origin: int = 0, rate: float | None = None, prefix: str = ""
) -> Message:
    """A ``trajectory_msgs/JointTrajectory`` that takes over while another runs.

    Its time stamp is the time at which the stretch begins, from which its points count. ``origin``:
    time 0 of the stretch's clock by the clock of ROS [ns]. ``rate`` and ``prefix`` are as for
    :func:`joint_trajectory`.
    """
    item = joint_trajectory(stretch.curve, rate, prefix)
    begins = origin + round(stretch.begins * NANO)
    item.header = message("std_msgs/msg/Header", stamp=time_message(begins))
    return item


def time_message(stamp: int, kind: str = "Time") -> Message:
    """A ``builtin_interfaces/Time`` or ``Duration`` of nanoseconds."""
    whole, part = divmod(stamp, NANO)
    return message(f"builtin_interfaces/msg/{kind}", sec=whole, nanosec=part)


def nanoseconds(stamp: Message) -> int:
    """A ``builtin_interfaces/Time`` in nanoseconds."""
    return int(stamp.sec) * NANO + int(stamp.nanosec)


def robot_trajectory(
    trajectory: Trajectory, rate: float | None = None, prefix: str = ""
) -> Message:
    """A ``moveit_msgs/RobotTrajectory``; arguments as for :func:`joint_trajectory`."""
    inner = joint_trajectory(trajectory, rate, prefix)
    return message("moveit_msgs/msg/RobotTrajectory", joint_trajectory=inner)


def display_trajectory(
    trajectories: Sequence[Trajectory], model: str, rate: float | None = None, prefix: str = ""
) -> Message:
    """A ``moveit_msgs/DisplayTrajectory``, as RViz draws it.

    ``rate`` and ``prefix`` are as for :func:`joint_trajectory`.

    Args:
        trajectories: one after another, at least one.
        model: name of the robot's model.
    """
    if not trajectories:
        raise InvalidRequestError("no trajectories to display: must be one at least")
    first = trajectories[0]
    return message(
        "moveit_msgs/msg/DisplayTrajectory",
        model_id=model,
        trajectory=[robot_trajectory(one, rate, prefix) for one in trajectories],
        trajectory_start=robot_state(first.at(0.0), first.joint_names, prefix),
    )


def read_trajectories(
    item: Message, joints: Sequence[str] | None = None, unwind: Unwind | None = None
) -> tuple[Trajectory, ...]:
    """The trajectories of a JointTrajectory, a RobotTrajectory (one) or a DisplayTrajectory.

    Points without accelerations get those of the cubics through positions and velocities (the mean
    of both sides). Points with positions alone get the derivatives of
    :meth:`optipromp.Trajectory.through`, at rest at both ends. Time begins at the first point.

    Args:
        item: the message.
        joints: of the robot, in its order; other joints of the message are left out, a common
            prefix is ignored. None: all joints of the message.
        unwind: as for :func:`optipromp.core.trajectory.curve`.

    Raises:
        InvalidRequestError: a wrong value; the message names point, field and valid values.
    """
    match item.__msgtype__.rpartition("/")[2]:
        case "JointTrajectory":
            return (_read(item, joints, unwind),)
        case "RobotTrajectory":
            if item.multi_dof_joint_trajectory.points:
                names = ", ".join(item.multi_dof_joint_trajectory.joint_names)
                raise InvalidRequestError(
                    f"multi_dof_joint_trajectory moves {names}: must be empty; joints have one "
                    "degree of freedom"
                )
            return (_read(item.joint_trajectory, joints, unwind),)
        case "DisplayTrajectory":
            parts = (read_trajectories(part, joints, unwind) for part in item.trajectory)
            return tuple(one for part in parts for one in part)
    raise InvalidRequestError(
        f"a {item.__msgtype__} is no trajectory: must be a JointTrajectory, RobotTrajectory or "
        "DisplayTrajectory"
    )


def read_trajectory(
    path: str | os.PathLike[str], joints: Sequence[str] | None = None, *, topic: str | None = None,
    unwind: Unwind | None = None,
) -> Trajectory:  # fmt: skip
    """The trajectory of a bag.

    The bag's JointTrajectory messages are read; where it has none, its RobotTrajectory, else its
    DisplayTrajectory messages.

    Args:
        path: as for :func:`optipromp_ros.read_bag`.
        joints: as for :func:`read_trajectories`.
        topic: to read; None: all.
        unwind: as for :func:`optipromp.core.trajectory.curve`.

    Raises:
        InvalidRequestError: no bag; no trajectory, or several; as :func:`read_trajectories`.
    """
    topics = None if topic is None else (topic,)
    items = list(read_bag(path, topics=topics, types=TRAJECTORIES))
    for name in TRAJECTORIES:
        chosen = [item for item in items if item.message.__msgtype__ == name]
        found = [one for item in chosen for one in read_trajectories(item.message, joints, unwind)]
        if len(found) == 1:
            return found[0]
        if found:
            there = ", ".join(sorted({item.topic for item in chosen}))
            raise InvalidRequestError(
                f"{path} has {len(found)} trajectories of type {name} on {there}: must have one "
                "(of a pick, its folder is judged with all legs)"
            )
    raise InvalidRequestError(
        f"{path} has no trajectory: must have a message of type {' or '.join(TRAJECTORIES)}"
    )


def _read(item: Message, joints: Sequence[str] | None, unwind: Unwind | None) -> Trajectory:
    what, points = "joint trajectory", item.points
    names = tuple(item.joint_names if joints is None else joints)
    if len(points) < 2:
        raise InvalidRequestError(f"{what} has {len(points)} points: must have 2 at least")
    stamps = [point.time_from_start for point in points]
    times = np.array([stamp.sec + stamp.nanosec / NANO for stamp in stamps], dtype=np.float64)
    counts = {what: {len(getattr(point, what)) for point in points} for what in CURVE[1:]}
    wanted = len(item.joint_names)
    if not wanted:
        raise InvalidRequestError(f"{what}: joint_names is empty: must name each joint")
    for field, sizes in counts.items():
        if sizes != {wanted} and (sizes != {0} or field == "positions"):
            k = next(k for k, p in enumerate(points) if len(getattr(p, field)) != wanted)
            size = len(getattr(points[k], field))
            raise InvalidRequestError(
                f"{what}: points[{k}].{field} has {size} values: must have {wanted}"
                + ("" if field == "positions" else ", or none in any point")
            )
    rows = [
        np.array([getattr(point, field) for point in points]) if counts[field] != {0} else None
        for field in CURVE[1:]
    ]
    if rows[1] is None and rows[2] is not None:
        raise InvalidRequestError(f"{what} has accelerations and no velocities: must have both")
    return curve(times, rows, item.joint_names, names, unwind)


def hear(arm: Measured, item: Message, time: float) -> bool:
    """Tell a reader of an arm's state a ``sensor_msgs/JointState`` of a ``time`` [s].

    Returns whether it told all velocities: one of NaN, as ``joint_state_broadcaster`` sends where a
    driver measures none, counts as 0, as where a message has none.
    """
    speeds = np.asarray(item.velocity)
    arm.heard(time, item.name, item.position, np.where(np.isnan(speeds), 0.0, speeds))
    return len(speeds) > 0 and not np.isnan(speeds[arm.mine(item.name)]).any()


def joint_motion(state: Message, joints: Sequence[str], what: str, prefix: str = "") -> State:
    """Positions and velocities of ``joints`` in a ``sensor_msgs/JointState``.

    Where all velocities are below :data:`optipromp.core.robots.measured.AT_REST`, or the message
    has none, the joints are at rest. ``prefix``: see :class:`optipromp.core.robots.Measured`.

    Raises:
        InvalidRequestError: a joint is missing, or a wrong value; begins with ``what``.
    """
    arm = Measured(joints, prefix=prefix, what=what)
    arm.heard(0.0, state.name, state.position, state.velocity)
    arm.series()  # tells what is missing
    assert arm.newest is not None
    return arm.newest[1]


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
