"""The duration of a trajectory."""

from optipromp.arrays import FloatArray, lengths
from optipromp.planning.options import PlanOptions
from optipromp.planning.task import Task
from optipromp.pushing.parameters import PUSH
from optipromp.robots.model import Robot
from optipromp.trajectory import Trajectory, shortest_dt


def timed(
    robot: Robot, q: FloatArray, duration: float | None, slow: FloatArray | None, speed: float
) -> Trajectory:
    """Waypoints (T, n) as a trajectory of a given duration [s], or of the shortest possible one.

    The shortest duration keeps the limits of velocity and acceleration. Along the configurations
    ``slow`` (m, n), if given, it also keeps the tool below ``speed`` [m/s].
    """
    if duration is not None:
        return Trajectory(q, duration / (len(q) - 1), robot.joint_names)
    dt = shortest_dt(q, robot.velocity, robot.acceleration)
    if slow is not None:
        points, _ = robot.tool_pose(slow)
        dt = max(dt, float(lengths(points[1:] - points[:-1]).max(initial=0.0)) / speed)
    return Trajectory(q, dt, robot.joint_names)


def timed_past(task: Task, options: PlanOptions, q: FloatArray, first: int) -> Trajectory:
    """Waypoints (T, n) as a trajectory, slow from ``first`` on where there are neighbours."""
    slow = q[first:] if task.neighbours else None
    speed = options.approach_speed or PUSH.hanging.speed
    return timed(task.robot, q, options.duration, slow, speed)
