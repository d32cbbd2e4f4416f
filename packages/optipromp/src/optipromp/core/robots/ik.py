r"""Inverse kinematics for a tool point and a tool axis; rotation about the axis stays free.

A whole orientation is given by two axes of the tool's frame, which count alike. Many starts run at
once. Each is a damped Gauss-Newton descent on

.. math:: \tfrac12\lVert p^\* - p(q)\rVert^2 + \tfrac12\ell^2\lVert a^\* - a(q)\rVert^2
          + \tfrac12 w\lVert (q - q_c)/(q_{max}-q_{min})\rVert^2

clipped to the joint limits. The last term pulls to the middle of the limits, or to the start of the
search. It fades out over the iterations, so that the solution is exact.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.compiled import called, kernel
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.kernels import chain_frames, tool_rows
from optipromp.core.robots.model import Robot

AXIS_LENGTH = 0.3  # [m] chosen: ℓ, lever that weighs an axis error against a position error
POSITION_SOLVED = 1e-6  # [m] chosen: largest position error of a solution
WIDE = 0.3  # [rad or m] chosen: margin from limits that counts as much as the clearance ROOMY
ROOMY = 0.05  # [m] chosen
DESCENT = 24  # iterations of a descent from anywhere, chosen
TRACKING = 30  # iterations of a descent from a known configuration, chosen
AXIS_SOLVED = 1e-6  # [rad] chosen: largest axis error of a solution


@dataclass(frozen=True, eq=False)
class Solutions:
    """Distinct solutions of one inverse-kinematics problem, best first.

    Attributes:
        joints: (m, n) configurations [rad or m].
        margin: (m,) smallest distance to a joint limit [rad or m].
        clearance: (m,) values of the clearance function [m]; infinite without one.
    """

    joints: FloatArray
    margin: FloatArray
    clearance: FloatArray

    def __len__(self) -> int:
        return len(self.joints)


@called
def cholesky_solve(a, b):
    """Solve ``a x = b`` in place, ``a`` (n, n) symmetric positive definite; x in ``b``."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                a[i, i] = np.sqrt(max(s, 1e-14))
            else:
                a[i, j] = s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= a[k, i] * b[k]
        b[i] = s / a[i, i]


@kernel
def apart_from_earlier(q, turning, distinct):
    """Whether each row of ``q`` (m, n) is kept: it differs from every earlier kept row in a joint
    by more than ``distinct`` [rad or m]. Full turns of ``turning`` joints (n,) do not count."""
    kept = np.zeros(q.shape[0], dtype=np.bool_)
    for i in range(q.shape[0]):
        kept[i] = True
        for k in range(i):
            if not kept[k]:
                continue
            largest = 0.0
            for j in range(q.shape[1]):
                apart = abs(q[k, j] - q[i, j])
                if turning[j]:
                    apart = min(apart, 2.0 * np.pi - apart)
                largest = max(largest, apart)
            if not largest > distinct:
                kept[i] = False
                break
    return kept


@kernel
def _descend(
    kin, tool_point, tool_axes, positions, directions, axis_weight, lower, upper, center, weight,
    iterations, chained, q, position_error, axis_error,
):  # fmt: skip
    """Run every start in ``q`` (M, n) to its pose, in place; errors (M,) [m, rad].

    The pose is ``positions`` (M, 3) of the tool point, and ``directions`` (M, A, 3) of the
    ``tool_axes`` (A, 3). The axis error is that of all A axes, as the root of a sum of squares.
    If ``chained``, each row but the first starts from the solution of the row before it.
    """
    n_starts, n = q.shape
    n_segments = kin.kind.shape[0]
    origins, axes = np.empty((n_segments, 3)), np.empty((n_segments, 3))
    rotations = np.empty((n_segments, 3, 3))
    n_axes = tool_axes.shape[0]
    jp, ja = np.empty((3, n)), np.empty((n_axes, 3, n))
    point, direction = np.empty(3), np.empty((n_axes, 3))
    hessian, step, scale = np.empty((n, n)), np.empty(n), np.empty(n)
    for j in range(n):
        span = upper[j] - lower[j]
        scale[j] = 1.0 / (span * span) if np.isfinite(span) else 0.02
    for m in range(n_starts):
        damping, position, axis = 1e-3, positions[m], directions[m]
        if chained and m > 0:
            for j in range(n):
                q[m, j] = q[m - 1, j]
        for iteration in range(iterations + 1):
            chain_frames(kin, q[m], origins, rotations, axes)
            r = rotations[n_segments - 1]
            ep, ea = 0.0, 0.0
            for i in range(3):
                point[i] = origins[n_segments - 1, i]
                for k in range(3):
                    point[i] += r[i, k] * tool_point[k]
                ep += (position[i] - point[i]) ** 2
                for a in range(n_axes):
                    direction[a, i] = 0.0
                    for k in range(3):
                        direction[a, i] += r[i, k] * tool_axes[a, k]
                    ea += (axis[a, i] - direction[a, i]) ** 2
            position_error[m] = np.sqrt(ep)
            axis_error[m] = 2.0 * np.arcsin(min(1.0, 0.5 * np.sqrt(ea))) if axis_weight > 0 else 0.0
            pull = weight[m] * max(0.0, 1.0 - iteration / (0.7 * iterations)) ** 2
            if iteration == iterations or (
                pull == 0.0 and position_error[m] < 1e-9 and axis_error[m] < 1e-8
            ):
                break
            for a in range(n_axes):
                tool_rows(kin, origins, axes, point, direction[a], jp, ja[a])
            residual = ep + axis_weight * ea
            for i in range(n):
                g = 0.0
                for k in range(3):
                    g += jp[k, i] * (position[k] - point[k])
                    for a in range(n_axes):
                        g += axis_weight * ja[a, k, i] * (axis[a, k] - direction[a, k])
                g += pull * scale[i] * (center[m, i] - q[m, i])
                step[i] = g
                for j in range(i + 1):
                    h = 0.0
                    for k in range(3):
                        both = jp[k, i] * jp[k, j]
                        for a in range(n_axes):
                            both += axis_weight * ja[a, k, i] * ja[a, k, j]
                        h += both
                    hessian[i, j] = h
                hessian[i, i] += pull * scale[i] + damping * min(1.0, residual) + 1e-9
            for i in range(n):  # a joint held at its limit takes no part in this step
                if (q[m, i] <= lower[i] and step[i] < 0) or (q[m, i] >= upper[i] and step[i] > 0):
                    for j in range(i):
                        hessian[i, j] = 0.0
                    for j in range(i + 1, n):
                        hessian[j, i] = 0.0
                    hessian[i, i] = 1.0
                    step[i] = 0.0
            cholesky_solve(hessian, step)
            largest = 0.0
            for i in range(n):
                largest = max(largest, abs(step[i]))
            shrink = min(1.0, 0.5 / largest) if largest > 0 else 1.0
            for i in range(n):
                q[m, i] = min(upper[i], max(lower[i], q[m, i] + shrink * step[i]))


def each(
    robot: Robot, positions: FloatArray, axes: FloatArray, near: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The configuration nearest to each row of ``near`` (m, n) with the tool at that row's pose.

    ``positions``: (m, 3) world [m]. ``axes``: (m, 3) unit, or (m, 2, 3); see :func:`solve`.
    ``near``: (m, n) configurations the descents start from.

    Returns: Configurations (m, n) and errors (m,); see :func:`track`.
    """
    return _tracked(robot, positions, axes, np.array(near), False)


def _tracked(
    robot: Robot, positions: FloatArray, axes: FloatArray | None, q: FloatArray, chained: bool
) -> tuple[FloatArray, FloatArray]:
    """Descents from ``q`` (m, n), in place, without a pull: damped steps are short."""
    position_error, axis_error = np.empty(len(q)), np.empty(len(q))
    directions = np.zeros((len(q), 3)) if axes is None else np.array(axes, dtype=np.float64)
    directions = directions if directions.ndim == 3 else directions[:, None]
    weight = 0.0 if axes is None else AXIS_LENGTH**2
    _descend(
        robot.kinematics, robot.tool_point, _tool_axes(robot, directions.shape[1]),
        np.array(positions, dtype=np.float64), directions, weight, robot.lower.copy(),
        robot.upper.copy(), q, np.zeros(len(q)), TRACKING, chained, q, position_error, axis_error,
    )  # fmt: skip
    return q, position_error + AXIS_LENGTH * axis_error


def _tool_axes(robot: Robot, count: int) -> FloatArray:
    """The first ``count`` (A, 3) of tool axis and y of the tool's frame, in the last segment's."""
    return np.array([robot.tool_axis, robot.tool_rotation[:, 1]])[:count]


def solve(
    robot: Robot, position: FloatArray, axis: FloatArray | None, *, starts: int = 48, seed: int = 0,
    near: FloatArray | None = None, clearance: Callable[[FloatArray], FloatArray] | None = None,
    distinct: float = 0.25, rest: FloatArray | None = None,
) -> Solutions:  # fmt: skip
    """Find distinct configurations with the tool point at ``position`` and its axis along ``axis``.

    Args:
        robot: the arm and its tool.
        position: (3,) world [m].
        axis: (3,) of the tool axis, world; None leaves the axis free. Or (2, 3): of the tool axis
            and of y of the tool's frame, which determine a whole orientation.
        starts: random starts, besides the home configuration and ``near``.
        seed: of the random starts.
        near: (m, n) further starts, whose solutions stay close to them.
        clearance: maps (m, n) configurations to (m,) clearances [m], used to rank.
        distinct: largest joint difference [rad or m] up to which two solutions count as equal. Full
            turns of a continuous joint do not count; the turn nearest to ``rest`` is returned.
        rest: (n,) values of joints that move neither the tool point nor the axis; None: the home
            configuration. Solutions that differ only in such joints count as equal.

    Returns:
        The solutions, ranked by the smaller of margin / :data:`WIDE` and clearance / :data:`ROOMY`.
        Empty when there is none.

    Raises:
        InvalidRequestError: a position or axis that is not three finite numbers, or a zero axis.
    """
    target = np.array(position, dtype=np.float64)
    direction = np.array([0.0, 0.0, 1.0]) if axis is None else np.array(axis, dtype=np.float64)
    whole = direction.shape == (2, 3)
    for name, value in (("position", target), ("axis", direction)):
        if (value.shape != (3,) and not (whole and name == "axis")) or not np.isfinite(value).all():
            raise InvalidRequestError(f"the goal {name} must be three finite numbers, got {value}")
    directions = direction.reshape(-1, 3)
    length = np.array([[float(np.linalg.norm(one))] for one in directions])
    if length.min() < 1e-9:
        raise InvalidRequestError("the goal axis has no length")
    n = robot.n_joints
    lower, upper = robot.lower.copy(), robot.upper.copy()
    finite = np.isfinite(lower) & np.isfinite(upper)
    low, high = np.where(finite, lower, -np.pi), np.where(finite, upper, np.pi)
    q = np.vstack([robot.home[None], low + (high - low) * uniform(seed, (starts, n))])
    center = np.tile(0.5 * (low + high), (len(q), 1))
    center[1::2] = q[1::2]
    weight = np.full(len(q), 0.3)
    if near is not None:
        further = np.atleast_2d(robot.check_configuration(near))
        q, center = np.vstack([further, q]), np.vstack([further, center])
        weight = np.concatenate([np.full(len(further), 0.05), weight])
    q = np.ascontiguousarray(np.clip(q, low, high))
    position_error, axis_error = np.empty(len(q)), np.empty(len(q))
    _descend(
        robot.kinematics, robot.tool_point, _tool_axes(robot, len(directions)),
        np.full((len(q), 3), target), np.tile(directions / length, (len(q), 1, 1)),
        AXIS_LENGTH**2 if axis is not None else 0.0, lower, upper, center, weight, DESCENT,
        False, q, position_error, axis_error,
    )  # fmt: skip
    good = (position_error < POSITION_SOLVED) & (axis_error < AXIS_SOLVED)
    rested = robot.home if rest is None else rest
    endless = robot.turns.endless
    q = q[good] if whole else _at_rest(robot, q[good], rested, axis is not None)
    q[:, endless] -= 2.0 * np.pi * np.round((q - rested)[:, endless] / (2.0 * np.pi))
    margin = np.min(np.minimum(q - robot.lower, robot.upper - q), axis=1, initial=np.inf)
    room = np.full(len(q), np.inf) if clearance is None or not len(q) else clearance(q)
    order = np.argsort(-np.minimum(margin / WIDE, room / ROOMY), kind="stable")
    kept = order[apart_from_earlier(q[order], endless, distinct)]
    return Solutions(q[kept], margin[kept], room[kept])


@functools.lru_cache(maxsize=32)
def uniform(seed: int, shape: tuple[int, ...]) -> FloatArray:
    """Samples of the uniform distribution from 0 to 1, the same for a seed."""
    return frozen(np.random.default_rng(seed).random(shape))


def _at_rest(robot: Robot, q: FloatArray, rest: FloatArray, with_axis: bool) -> FloatArray:
    """``q`` with joints that do not affect the task (a roll about the tool axis) at ``rest``."""
    if not len(q):
        return q
    jp, ja = robot.tool_jacobian(q)
    effect = np.abs(jp).max(axis=1) + (np.abs(ja).max(axis=1) if with_axis else 0.0)
    return np.where(effect < 1e-9, rest, q)


def track(
    robot: Robot, positions: FloatArray, axes: FloatArray | None, begin: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Follow task points in their order from a known configuration, on its branch.

    ``positions``: (m, 3) world [m], in the order they are followed. ``axes``: (m, 3) unit, or (m,
    2, 3); see :func:`solve`. None leaves the axis free. ``begin``: (n,) configuration the first
    solution starts from.

    Returns: Configurations (m, n) and errors (m,) [m]: position error plus :data:`AXIS_LENGTH`
    times the axis error. An error above 1e-6 is a miss.
    """
    q = np.empty((len(positions), robot.n_joints))
    q[:1] = begin
    return _tracked(robot, positions, axes, q, True)


ROLLS = 12  # values of a joint that only rolls the tool, chosen: 30 degrees apart


def level(robot: Robot, q: FloatArray, normal: FloatArray, *, path: bool = False) -> FloatArray:
    r"""Configurations with the hand rolled so that it opens across ``normal``.

    The last joint of many arms turns the tool about its own axis a and moves neither its point nor
    its axis. Turned by φ, the direction h in which the hand opens becomes
    :math:`\cos φ\,h + \sin φ\,a×h`; it is at right angles to the normal n at

    .. math:: φ = \operatorname{atan2}(-h·n,\ (a×h)·n) + kπ.

    ``normal``: (3,) unit; x_g of a target frame keeps the fingers side by side on the level.
    ``path``: whether the rows of ``q`` are consecutive points of a path; their rolls are then
    continuous, as far as the joint's limits allow.

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
