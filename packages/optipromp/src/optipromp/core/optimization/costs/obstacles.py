"""Costs of the body: the obstacle functionals F_s and F_d, clearance, self-collision."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.compiled import called, inner
from optipromp.core.errors import InvalidRequestError
from optipromp.core.optimization.evaluation import Cost, Evaluation
from optipromp.core.optimization.kernels import add_along

Reduction = Literal["max", "sum"]


@dataclass(frozen=True, eq=False)
class ObstacleCost(Cost):
    r""":math:`F_s` or :math:`F_d` :math:`=\int \max_u c(x(\xi,u))\,\lVert dx/dt\rVert\,dt`.

    ``static`` is :math:`F_s`, over all body spheres and static objects. ``avoid`` is :math:`F_d`,
    over B_d and the objects to avoid and to push. ``tool avoid`` is no part of :math:`F_d`: it is
    the same integral over the last link and the tool, and the objects to avoid.

    ``epsilon`` is the safety distance of c [m]. ``reduction`` is over the body points u: ``max``
    (the paper) or ``sum`` (CHOMP).

    Raises:
        InvalidRequestError: an epsilon that is not positive, or another reduction.
    """

    name: Literal["static", "avoid", "tool avoid"]
    weight: float
    epsilon: float
    reduction: Reduction

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.epsilon > 0.0:
            raise InvalidRequestError(f"epsilon is {self.epsilon}; it must be positive [m]")
        if self.reduction not in ("max", "sum"):
            raise InvalidRequestError(f"reduction is {self.reduction!r}; use 'max' or 'sum'")

    def add(self, e: Evaluation, scale: float) -> float:
        field, chosen = {
            "static": (e.static, e.every),
            "avoid": (e.dynamic, e.proximal),
            "tool avoid": (e.dynamic, e.distal),
        }[self.name]
        return e.at_points(
            obstacle_functional, scale, field.distance, field.normal, chosen, self.epsilon, e.dt,
            self.reduction == "max",
        )  # fmt: skip


@called
def chomp_cost(d, epsilon):
    """The CHOMP cost c(D) of a distance ``d`` and its derivative; ``epsilon``: safety distance."""
    if d >= epsilon:
        return 0.0, 0.0
    if d >= 0.0:
        return (d - epsilon) ** 2 / (2.0 * epsilon), (d - epsilon) / epsilon
    return 0.5 * epsilon - d, -1.0


@inner
def velocity(points, before, after, b, span):
    """Velocity of a point between two waypoints, and the speed."""
    x = (points[after, b, 0] - points[before, b, 0]) / span
    y = (points[after, b, 1] - points[before, b, 1]) / span
    z = (points[after, b, 2] - points[before, b, 2]) / span
    return x, y, z, math.sqrt(x * x + y * y + z * z)


@inner
def any_below(distance, limit):
    """Whether any distance (B,) is below a limit; without a branch, in a tenth of the time."""
    count = 0
    for b in range(distance.shape[0]):
        count += distance[b] < limit
    return count > 0


@called
def obstacle_functional(
    points, _tool, distance, normal, chosen, epsilon, dt, use_max, scale, force, stiffness
):
    r"""F = ∫ max_u c(x_u) ‖dx_u/dt‖ dt (or the sum) over the ``chosen`` (B,) u, by trapezoids.

    The gradient is that of the discrete sum. It agrees with finite differences at any T, and tends
    to the functional gradient as T grows.
    """
    n_waypoints, total = distance.shape[0], 0.0
    for t in range(n_waypoints):
        if not any_below(distance[t], epsilon):
            continue
        w = dt * (0.5 if t == 0 or t == n_waypoints - 1 else 1.0)
        before, after = max(t - 1, 0), min(t + 1, n_waypoints - 1)
        span = (after - before) * dt
        best, worst = 0.0, -1
        if use_max:
            for b in range(distance.shape[1]):
                if not chosen[b]:
                    continue
                rate = chomp_cost(distance[t, b], epsilon)[0]
                if rate > 0.0:
                    rate *= velocity(points, before, after, b, span)[3]
                if rate > best:
                    best, worst = rate, b
        for b in range(distance.shape[1]):
            if distance[t, b] >= epsilon or not chosen[b] or (use_max and b != worst):
                continue
            c, slope = chomp_cost(distance[t, b], epsilon)
            vx, vy, vz, speed = velocity(points, before, after, b, span)
            total += w * c * speed
            k, n = scale * w * speed, normal[t, b]
            add_along(force[t, b], stiffness[t, b], k * slope, k / epsilon, n[0], n[1], n[2])
            if speed > 1e-12:  # below, the velocity has no direction
                drag = scale * w * c / (span * speed)
                for i, v in enumerate((vx, vy, vz)):
                    force[after, b, i] += drag * v
                    force[before, b, i] -= drag * v
    return total


@dataclass(frozen=True, eq=False)
class ClearanceCost(Cost):
    """Body spheres keep ``margin`` [m] from static objects, or from objects to avoid and to push.

    ``mask`` (B,) chooses the spheres; None: all.
    """

    name: str
    field: Literal["static", "dynamic"]
    weight: float
    margin: float
    mask: BoolArray | None = None

    def add(self, e: Evaluation, scale: float) -> float:
        field = e.static if self.field == "static" else e.dynamic
        chosen = e.every if self.mask is None else self.mask
        return e.at_points(
            clearance_penalty, scale, field.distance, field.normal, self.margin, chosen
        )


@called
def clearance_penalty(_points, _tool, distance, normal, margin, chosen, scale, force, stiffness):
    """½ Σ max(0, margin − D)² over the ``chosen`` (B,) spheres."""
    total = 0.0
    for t in range(distance.shape[0]):
        if not any_below(distance[t], margin):
            continue
        for b in range(distance.shape[1]):
            short = margin - distance[t, b]
            if short > 0.0 and chosen[b]:
                total += 0.5 * short * short
                n = normal[t, b]
                add_along(force[t, b], stiffness[t, b], -scale * short, scale, n[0], n[1], n[2])
    return total


@dataclass(frozen=True, eq=False)
class SelfCost(Cost):
    """Links that are not neighbours keep ``margin`` [m] apart."""

    weight: float
    margin: float
    name = "self"

    def add(self, e: Evaluation, scale: float) -> float:
        return float(self_overlap(e, self.margin, scale).sum())


def self_overlap(e: Evaluation, margin: float, scale: float = 0.0) -> FloatArray:
    """½ Σ max(0, margin − D)² of each waypoint (T,), over pairs of spheres that must keep apart.

    Adds ``scale`` times the gradient to ``e``.
    """
    body, out = e.body, np.zeros(len(e.q))
    self_penalty(
        e.points, body.radius, body.groups, body.pairs, body.slack, body.link_bound, margin, scale,
        e.force, e.stiffness, out,
    )  # fmt: skip
    return out


@called
def self_penalty(
    points, radius, groups, pairs, slack, link_bound, margin, scale, force, stiffness, out
):
    """:func:`self_overlap`; adds to ``out`` (T,).

    A row of ``groups`` (G, 4) has two links and the range of their ``pairs`` (P, 2): links whose
    bounding spheres are apart cost a single test. ``slack`` (P,) is ``Robot.self_slack``.
    """
    n_spheres = radius.shape[0]
    for t in range(points.shape[0]):
        for g in range(groups.shape[0]):
            first, second = groups[g, 0], groups[g, 1]
            c, d = points[t, n_spheres + 2 + first], points[t, n_spheres + 2 + second]
            far = link_bound[first] + link_bound[second] + margin
            if (c[0] - d[0]) ** 2 + (c[1] - d[1]) ** 2 + (c[2] - d[2]) ** 2 >= far * far:
                continue
            last, skip, a = -1, False, c
            for p in range(groups[g, 2], groups[g, 3]):
                i, j = pairs[p, 0], pairs[p, 1]
                if i != last:  # pairs are sorted: one test for all partners of a sphere
                    last, a = i, points[t, i]
                    far = radius[i] + link_bound[second] + margin
                    skip = (a[0] - d[0]) ** 2 + (a[1] - d[1]) ** 2 + (a[2] - d[2]) ** 2 >= far * far
                if skip:
                    continue
                x, y, z = a[0] - points[t, j, 0], a[1] - points[t, j, 1], a[2] - points[t, j, 2]
                keep = radius[i] + radius[j] + margin - slack[p]
                squared = x * x + y * y + z * z
                if keep <= 0.0 or squared >= keep * keep:
                    continue
                apart = math.sqrt(squared)
                short = keep - apart
                out[t] += 0.5 * short * short
                if apart < 1e-9:
                    continue
                x, y, z = x / apart, y / apart, z / apart
                # twice the stiffness on each sphere bounds the curvature of the pair
                add_along(force[t, i], stiffness[t, i], -scale * short, 2.0 * scale, x, y, z)
                add_along(force[t, j], stiffness[t, j], scale * short, 2.0 * scale, x, y, z)
