"""The roll of a tool about its axis, by which its fingers are level."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.robots.model import Robot

ROLLS = 12  # values of a joint that only rolls the tool, chosen: 30 degrees apart


def level(robot: Robot, q: FloatArray, normal: FloatArray, *, path: bool = False) -> FloatArray:
    r"""Configurations with the hand rolled so that it opens across ``normal``.

    The last joint of many arms turns the tool about its own axis a and moves neither its point nor
    its axis. Turned by φ, the direction h in which the hand opens becomes
    :math:`\cos φ\,h + \sin φ\,a×h`; it is at right angles to the normal n at

    .. math:: φ = \operatorname{atan2}(-h·n,\ (a×h)·n) + kπ.

    ``robot``: the arm and its tool. ``q``: (m, n) configurations [rad or m]. ``normal``: (3,) unit;
    x_g of a target frame keeps the fingers side by side on the level. ``path``: whether the rows of
    ``q`` are consecutive points of a path; their rolls are then continuous, as far as the joint's
    limits allow.

    Returns: (m, n) configurations with the roll within the limits that is nearest to that of ``q``.
    A copy of ``q`` if the tool has no fingers or the last joint does more than roll it.
    """
    out = np.array(q, dtype=np.float64).reshape(-1, robot.n_joints)
    tool, kin = robot.tool, robot.kinematics
    if tool is None or not tool.fingers or not len(out) or not rolls(robot):
        return out
    _, turns = robot.segment_frames(out)
    hand = turns[:, -1] @ robot.flange_rotation @ tool.rotation
    opens, axis = hand[:, :, 1], hand[:, :, 2]
    turn = np.arctan2(-opens @ normal, np.cross(axis, opens) @ normal)
    joint = int(kin.dof[-1])
    share = float(kin.multiplier[-1] * (kin.axis[-1] @ robot.tool_axis))
    period = np.pi / abs(share)
    wanted = out[:, joint] + turn / share
    low, high = robot.lower[joint], robot.upper[joint]
    nearest = wanted - period * np.round((wanted - out[:, joint]) / period)
    if path:
        nearest = np.unwrap(nearest, period=period)
        for shift in (0.0, period, -period):
            moved = nearest + shift
            if low <= moved.min() and moved.max() <= high:
                out[:, joint] = moved
                return out
    over, under = nearest > high, nearest < low
    nearest[over] -= period * np.ceil((nearest[over] - high) / period)
    nearest[under] += period * np.ceil((low - nearest[under]) / period)
    fits = (low <= nearest) & (nearest <= high)
    out[fits, joint] = nearest[fits]
    return out


def rolls(robot: Robot) -> bool:
    """Whether the last joint turns the tool about its axis and does nothing else."""
    kin = robot.kinematics
    along = abs(float(kin.axis[-1] @ robot.tool_axis))
    aside = np.cross(kin.axis[-1], robot.tool_point)
    alone = int((kin.dof == kin.dof[-1]).sum()) == 1
    return bool(alone and kin.kind[-1] != 1 and along > 1.0 - 1e-9 and np.linalg.norm(aside) < 1e-9)


def rolled(robot: Robot, goals: FloatArray) -> FloatArray:
    """Configurations ``goals`` (m, n), then copies with the tool rolled about its axis.

    Each joint that only rolls the tool takes :data:`ROLLS` values within a turn and its limits.
    """
    jp, ja = robot.tool_jacobian(goals)
    idle = np.flatnonzero(np.abs(jp).max(axis=(0, 1)) + np.abs(ja).max(axis=(0, 1)) < 1e-9)
    if not len(idle):
        return goals
    out = np.repeat(goals, ROLLS, axis=0)
    for joint in idle:
        low, high = max(robot.lower[joint], -np.pi), min(robot.upper[joint], np.pi)
        out[:, joint] = np.tile(np.linspace(low, high, ROLLS), len(goals))
    return np.vstack([goals, out])
