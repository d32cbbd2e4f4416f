"""Costs of the tool point and its axis: goal, upright, level, corridor.

Arrays along the trajectory begin at its first waypoint; a cost applies from waypoint ``first`` on.
The tip is the point on the tool axis at :data:`LEVER` from the tool point.
"""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import called
from optipromp.core.optimization.evaluation import LEVER, Cost, Evaluation
from optipromp.core.optimization.kernels import add_along


@dataclass(frozen=True, eq=False)
class GoalCost(Cost):
    """At the end the tool point is at ``position`` (3,), the tool axis along ``axis``.

    ``axis`` (3,) is a unit vector; None: free.
    """

    weight: float
    position: FloatArray
    axis: FloatArray | None
    name = "goal"

    def add(self, e: Evaluation, scale: float) -> float:
        axis = np.zeros(3) if self.axis is None else self.axis
        turned = self.axis is not None
        return e.at_points(goal_penalty, scale, self.position, LEVER * axis, turned)


@called
def goal_penalty(points, tool, position, to_tip, turned, scale, force, stiffness):
    """½ ‖fk − position‖² at the end; with ``turned`` also ½ ‖tip − fk − to_tip‖²."""
    t, total = points.shape[0] - 1, 0.0
    for i in range(3):
        off = points[t, tool, i] - position[i]
        total += 0.5 * off * off
        force[t, tool, i] += scale * off
        stiffness[t, tool, i] += scale
        if turned:
            lean = points[t, tool + 1, i] - points[t, tool, i] - to_tip[i]
            total += 0.5 * lean * lean
            force[t, tool + 1, i] += scale * lean
            force[t, tool, i] -= scale * lean
            stiffness[t, tool + 1, i] += scale
    return total


@dataclass(frozen=True, eq=False)
class UprightCost(Cost):
    """The tool axis is within ``tolerance`` [rad] of ``axis``, from waypoint ``first`` on.

    ``axis`` is (1, 3) for all waypoints, or (T, 3).
    """

    weight: float
    axis: FloatArray
    tolerance: float
    first: int
    name = "upright"

    def add(self, e: Evaluation, scale: float) -> float:
        return e.at_points(axis_penalty, scale, LEVER, self.axis, self.tolerance, self.first)


@called
def axis_penalty(points, tool, lever, axis, tolerance, first, scale, force, stiffness):
    """½ Σ max(0, ‖a − axis‖ − tolerance)²; a is the tool axis. Both axes are unit vectors."""
    total = 0.0
    for t in range(first, points.shape[0]):
        k = min(t, axis.shape[0] - 1)
        x = (points[t, tool + 1, 0] - points[t, tool, 0]) / lever - axis[k, 0]
        y = (points[t, tool + 1, 1] - points[t, tool, 1]) / lever - axis[k, 1]
        z = (points[t, tool + 1, 2] - points[t, tool, 2]) / lever - axis[k, 2]
        off = math.sqrt(x * x + y * y + z * z)
        over = off - tolerance
        if over <= 0.0 or off < 1e-12:
            continue
        total += 0.5 * over * over
        x, y, z, push = x / off, y / off, z / off, scale * over / lever
        add_along(force[t, tool + 1], stiffness[t, tool + 1], push, scale / lever**2, x, y, z)
        add_along(force[t, tool], stiffness[t, tool], -push, 0.0, x, y, z)
    return total


@dataclass(frozen=True, eq=False)
class LevelCost(Cost):
    """Two body spheres of the tool stay level with one another: ½ Σ (normal·(x_a − x_b))².

    ``pair`` has the indices a and b of the spheres among the evaluation's points; ``normal`` (3,)
    is a unit vector. The cost rolls a hand so that its fingers stand side by side.
    """

    weight: float
    pair: tuple[int, int]
    normal: FloatArray
    first: int
    name = "level"

    def add(self, e: Evaluation, scale: float) -> float:
        (a, b), n = self.pair, self.normal
        off = (e.points[self.first :, a] - e.points[self.first :, b]) @ n
        pull = scale * off[:, None] * n
        e.force[self.first :, a] += pull
        e.force[self.first :, b] -= pull
        # twice the stiffness on each sphere bounds the curvature of the pair
        outer = np.array([n[0] ** 2, n[1] ** 2, n[2] ** 2, n[0] * n[1], n[0] * n[2], n[1] * n[2]])
        e.stiffness[self.first :, [a, b]] += 2.0 * scale * outer
        return 0.5 * float(off @ off)


@dataclass(frozen=True, eq=False)
class CorridorCost(Cost):
    """Constraint 3: the tool stays within ``tolerance`` of ``reference`` (T, 3) along ``axes``.

    Inside the corridor there is no force, but a curvature of ``within`` times that of the walls.
    Without this curvature, a solver would step far through the walls.
    """

    weight: float
    reference: FloatArray
    axes: FloatArray
    tolerance: float
    first: int
    within: float = 0.0
    name = "corridor"

    def add(self, e: Evaluation, scale: float) -> float:
        return e.at_points(
            corridor_penalty, scale, self.reference, self.axes, self.tolerance, self.within,
            self.first,
        )  # fmt: skip


@called
def corridor_penalty(
    points, tool, reference, axes, tolerance, within, first, scale, force, stiffness
):
    """½ Σ max(0, |axis·(fk − reference)| − tolerance)² along each of ``axes`` (m, 3)."""
    total = 0.0
    for t in range(first, points.shape[0]):
        for a in range(axes.shape[0]):
            off = 0.0
            for i in range(3):
                off += axes[a, i] * (points[t, tool, i] - reference[t, i])
            over, k = abs(off) - tolerance, scale
            if over <= 0.0:
                over, k = 0.0, within * scale
            total += 0.5 * over * over
            push = math.copysign(scale * over, off)
            x, y, z = axes[a, 0], axes[a, 1], axes[a, 2]
            add_along(force[t, tool], stiffness[t, tool], push, k, x, y, z)
    return total
