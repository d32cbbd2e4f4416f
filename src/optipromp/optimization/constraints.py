"""The constraints as one-sided quadratic penalties, weighed by their priority.

Method §5 ranks what gives way where constraints conflict: joint limits and static clearance first,
then reaching the target, avoid objects, the drift offset, straightness. :class:`Priority` holds
that order as stiffnesses [per m² or rad²]: with a Gauss-Newton solver a stiff penalty costs no
conditioning, and two constraints that cannot both hold share the conflict in the ratio of theirs.

A penalty knows no value without its stiffness: what ``add`` of a constraint returns is multiplied
by ``scale`` already, unlike that of a functional. So a constraint belongs among those of a
:class:`~optipromp.optimization.problem.Problem`, not among its terms.
"""

from dataclasses import dataclass

import numpy as np

from optipromp.arrays import BoolArray, FloatArray
from optipromp.optimization import kernels
from optipromp.optimization.evaluation import LEVER, Evaluation
from optipromp.optimization.terms import Term


@dataclass(frozen=True)
class Priority:
    """Stiffness of each kind of constraint, highest first."""

    limits: float = 1e6
    touch: float = 1e6
    goal: float = 1e6
    clearance: float = 2e4
    avoid: float = 1e5
    step: float = 1e5
    tool_avoid: float = 1e3
    funnel: float = 1e4
    drift: float = 1e4
    berth: float = 3e2
    tool_step: float = 1e3
    follow: float = 1e4
    level: float = 1e3
    corridor: float = 1e4
    upright: float = 1e2


class ClearanceConstraint(Term):
    """Body spheres keep ``margin`` from static things, or B_d from avoid things and pushables."""

    def __init__(
        self, name: str, field: str, weight: float, margin: float, mask: BoolArray | None = None
    ) -> None:
        super().__init__(name, weight)
        self.field, self.margin, self.mask = field, margin, mask

    def add(self, e: Evaluation, scale: float) -> float:
        field = e.static if self.field == "static" else e.dynamic
        if scale == 0.0:
            return 0.0
        chosen = e.every if self.mask is None else self.mask
        return float(
            kernels.clearance_penalty(
                field.distance, field.normal, self.margin, chosen, scale, e.force, e.stiffness
            )
        )


class SelfConstraint(Term):
    """Links that are not neighbours keep ``margin`` apart."""

    def __init__(self, weight: float, margin: float) -> None:
        super().__init__("self", weight)
        self.margin = margin

    def add(self, e: Evaluation, scale: float) -> float:
        body = e.body
        return float(
            kernels.self_penalty(
                e.points, body.radius, body.groups, body.pairs, body.link_bound, self.margin, scale,
                e.force, e.stiffness,
            )
        )  # fmt: skip


class DriftConstraint(Term):
    """Constraints 1 and 2: past each pushable on its stem-free side by the gripper's radius.

    ``most`` (T, N) [m]: more than that is not asked of a knot; None: all is.
    """

    def __init__(
        self,
        weight: float,
        centers: FloatArray,
        directions: FloatArray,
        approach: FloatArray,
        windows: FloatArray,
        offset: FloatArray,
        first: int,
        slope: float = 4.0,
        most: FloatArray | None = None,
    ) -> None:
        super().__init__("drift", weight)
        self.centers, self.directions, self.approach = centers, directions, approach
        self.windows, self.offset, self.first, self.slope = windows, offset, first, slope
        self.most = np.empty((0, len(centers))) if most is None else most

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.drift_penalty(
                e.points, e.tool, self.centers, self.directions, self.approach, self.windows,
                self.offset, self.slope, self.most, self.first, scale, e.force, e.stiffness,
            )
        )  # fmt: skip


class FunnelConstraint(Term):
    """Straightness: no farther from the approach line than the pushables ask for, and at the target
    no farther than the mouth can be off and still take it in.

    The funnel has ``width`` down to ``below`` the goal [m] and opens with ``slope`` to ``widest``.
    """

    def __init__(
        self,
        weight: float,
        goal: FloatArray,
        approach: FloatArray,
        below: float,
        width: float,
        widest: float,
        first: int,
        slope: float = 4.0,
    ) -> None:
        super().__init__("funnel", weight)
        self.goal, self.approach, self.below = goal, approach, below
        self.width, self.widest, self.first, self.slope = width, widest, first, slope

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.funnel_penalty(
                e.points, e.tool, self.goal, self.approach, self.below, self.width, self.slope,
                self.widest, self.first, scale, e.force, e.stiffness,
            )
        )  # fmt: skip


class CorridorConstraint(Term):
    """Constraint 3: the tool stays within a tolerance of a reference along each of ``axes``.

    Between the walls its curvature is ``within`` of theirs, though no force is there: a solver that
    knew nothing of the walls before it met them would step far through them.
    """

    def __init__(
        self,
        weight: float,
        reference: FloatArray,
        axes: FloatArray,
        tolerance: float,
        first: int,
        within: float = 0.0,
    ) -> None:
        super().__init__("corridor", weight)
        self.within = within
        self.reference, self.axes, self.tolerance, self.first = reference, axes, tolerance, first

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.corridor_penalty(
                e.points, e.tool, self.reference, self.axes, self.tolerance, self.within,
                self.first, scale, e.force, e.stiffness,
            )
        )  # fmt: skip


class UprightConstraint(Term):
    """The tool axis stays within an angle [rad] of the approach, from knot ``first`` on."""

    def __init__(self, weight: float, axis: FloatArray, tolerance: float, first: int) -> None:
        super().__init__("upright", weight)
        self.axis, self.tolerance, self.first = axis, tolerance, first

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.axis_penalty(
                e.points, e.tool, LEVER, self.axis, self.tolerance, self.first, scale, e.force,
                e.stiffness,
            )
        )  # fmt: skip


class GoalConstraint(Term):
    """At T the tool point is at the goal and the tool axis along the goal's axis (None: free)."""

    def __init__(self, weight: float, position: FloatArray, axis: FloatArray | None) -> None:
        super().__init__("goal", weight)
        self.position = position
        self.axis = np.zeros(3) if axis is None else axis
        self.lever = 0.0 if axis is None else 0.1

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.goal_penalty(
                e.points, e.tool, self.position, self.axis, LEVER, scale, scale * self.lever**2,
                e.force, e.stiffness,
            )
        )  # fmt: skip


class LimitConstraint(Term):
    """Constraint 4, positions: every knot within the joint limits, less a margin."""

    def __init__(self, weight: float, lower: FloatArray, upper: FloatArray) -> None:
        super().__init__("limits", weight)
        self.lower, self.upper = lower, upper

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.limit_penalty(e.q, self.lower, self.upper, scale, e.joint_gradient, e.band)
        )


class StepConstraint(Term):
    """No joint moves more than ``largest`` (n,) between knots [rad or m]."""

    def __init__(self, weight: float, largest: FloatArray) -> None:
        super().__init__("step", weight)
        self.largest = largest

    def add(self, e: Evaluation, scale: float) -> float:
        return float(kernels.step_penalty(e.q, self.largest, scale, e.joint_gradient, e.band))


class ToolStepConstraint(Term):
    """The tool point moves at most ``largest`` [m] between knots from ``first`` on.

    Drift and funnel are asked for at the knots: a tool that dwells and then leaps would keep them
    there and break them between.
    """

    def __init__(self, weight: float, largest: float, first: int) -> None:
        super().__init__("tool step", weight)
        self.largest, self.first = largest, first

    def add(self, e: Evaluation, scale: float) -> float:
        return float(
            kernels.tool_step_penalty(
                e.points, e.tool, self.largest, self.first, scale, e.force, e.stiffness
            )
        )


class LevelConstraint(Term):
    """Two body spheres of the tool stay level with one another, from knot ``first`` on.

    ``pair`` are their indices in the order of the evaluation's points, ``normal`` (3,) is a unit
    vector: what rolls a hand so that its fingers stand side by side.
    """

    def __init__(
        self, weight: float, pair: tuple[int, int], normal: FloatArray, first: int
    ) -> None:
        super().__init__("level", weight)
        self.pair, self.normal, self.first = pair, normal, first

    def add(self, e: Evaluation, scale: float) -> float:
        (a, b), n = self.pair, self.normal
        off = (e.points[self.first :, a] - e.points[self.first :, b]) @ n
        pull = scale * off[:, None] * n
        e.force[self.first :, a] += pull
        e.force[self.first :, b] -= pull
        # each as if the other stood twice as stiff against it: no less than the pair's curvature
        outer = np.array([n[0] ** 2, n[1] ** 2, n[2] ** 2, n[0] * n[1], n[0] * n[2], n[1] * n[2]])
        e.stiffness[self.first :, [a, b]] += 2.0 * scale * outer
        return float(0.5 * scale * (off @ off))
