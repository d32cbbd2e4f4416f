"""What an arm has to spare in configurations along a way: joint range, room, speed, height."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.laboratory.generate import bunches

# choices that weigh alike: to a joint limit [rad or m], between links [m], tool speed [m/rad]
MARGIN, ROOM, SPEED_RATIO = 0.3, 0.05, 0.2
LOW = bunches.BEFORE[1] + bunches.FRUIT_RADII[1]  # [m] from the target down to the lowest pushable
BESIDE = 0.1  # [m] from the tool's axis: pushables hang, and are pushed, within it: a choice
NECKS = 0.005  # [m] step of the length of a cup's neck: a choice
MISS = 1e-4  # [m] largest error of inverse kinematics on the way


def lowest(robot: Robot, q: FloatArray) -> FloatArray:
    """Heights (m,) of the tool point over any link beside the tool, in configurations (m, n) [m].

    These are the links before the last one, within :data:`BESIDE` of the tool axis. The height is
    along that axis.
    """
    points, axes = robot.tool_pose(q)
    off = (robot.sphere_centers(q) - points[:, None])[:, ~robot.spheres.distal]
    radius = robot.spheres.radius[~robot.spheres.distal]
    along = np.einsum("mbi,mi->mb", off, axes)
    aside = np.linalg.norm(off - along[:, :, None] * axes[:, None], axis=2)
    height = np.where(aside - radius < BESIDE, -along - radius, np.inf)
    return np.asarray(height.min(axis=1, initial=np.inf))


def spare(robot: Robot, q: FloatArray, low: float = LOW) -> FloatArray:
    """The least of four margins (m,) of each of the configurations (m, n).

    They are the distance to a joint limit over :data:`MARGIN`, the gap between links over ``ROOM``,
    the least singular value of the tool's Jacobian over ``SPEED_RATIO``, and :func:`lowest` over
    ``low`` [m].
    """
    margin = np.minimum(q - robot.lower, robot.upper - q).min(axis=1)
    jp, ja = robot.tool_jacobian(q)
    rates = np.linalg.svd(np.concatenate([jp, ik.AXIS_LENGTH * ja], axis=1), compute_uv=False)
    rate = rates[:, min(5, robot.n_joints) - 1]  # of a point and an axis
    room = robot.self_gaps(q).min(axis=1, initial=np.inf)
    margins = margin / MARGIN, room / ROOM, rate / SPEED_RATIO, lowest(robot, q) / low
    return np.asarray(np.min(margins, axis=0))
