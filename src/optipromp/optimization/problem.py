"""The optimisation problem: terms and constraints over the free knots of a trajectory."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray, frozen
from optipromp.geometry.obstacles import Obstacles
from optipromp.optimization import kernels
from optipromp.optimization.evaluation import BodyPoints, Evaluation
from optipromp.optimization.terms import Term
from optipromp.robots.model import Robot

ANCHOR = 1e3  # how much of ∫‖δ‖² dt the metric adds to ∫‖δ̈‖² dt, so that slow bends cost too


@dataclass(frozen=True)
class Surroundings:
    """Obstacles by role, ready for the kernels.

    Attributes:
        static: what every body sphere keeps away from.
        dynamic: avoid objects first, then pushables; those from index ``shared`` on concern only
            B_d (all links but the last one and the tool).
        shared: number of avoid objects.
    """

    static: Obstacles
    dynamic: Obstacles
    shared: int


@dataclass(frozen=True, eq=False)
class Value:
    """Objective at one trajectory.

    Attributes:
        merit: what is minimised, ``cost + scale·penalty``.
        terms: each term without its weight.
        cost: the weighted sum of the terms.
        penalty: the weighted sum of the constraints, at full stiffness.
    """

    merit: float
    terms: dict[str, float]
    cost: float = 0.0
    penalty: float = 0.0


class Problem:
    """Minimise Σ weight·term + penalty_scale·Σ weight·constraint over the free knots.

    The first knot is fixed (the start); the last one too where ``end_fixed``. Time is normalised:
    the trajectory takes one unit of it, so that weights mean the same at any speed.
    """

    def __init__(
        self,
        robot: Robot,
        surroundings: Surroundings,
        terms: Sequence[Term],
        constraints: Sequence[Term],
        n_knots: int,
        *,
        cutoff: float,
        end_fixed: bool = False,
        body: BodyPoints | None = None,
        evaluation: Evaluation | None = None,
    ) -> None:
        self.robot, self.surroundings, self.n_knots = robot, surroundings, n_knots
        self.terms, self.constraints = tuple(terms), tuple(constraints)
        self.cutoff = cutoff
        self.first = 1
        self.last = n_knots - 2 if end_fixed else n_knots - 1
        self.dt = 1.0 / (n_knots - 1)
        body = body or BodyPoints(robot)
        self.evaluation = evaluation or Evaluation(robot, body, n_knots, self.dt)
        n = robot.n_joints
        self.matrix = np.zeros((2 * n + 1, (self.last - self.first + 1) * n))
        self.metric = _metric(n_knots, n, self.last)

    def evaluate(self, q: FloatArray, penalty_scale: float = 1.0) -> Value:
        """Value at ``q`` (T, n); gradient and curvature stay in ``self.evaluation``."""
        e = self.evaluation
        e.move_to(q)
        s = self.surroundings
        e.static.measure(e, s.static, len(s.static.kind), self.cutoff)
        e.dynamic.measure(e, s.dynamic, s.shared, self.cutoff)
        cost, values = 0.0, {}
        for term in self.terms:
            value = term.add(e, term.weight)
            values[term.name] = value
            cost += term.weight * value
        stiff = 0.0
        for constraint in self.constraints:
            stiff += constraint.add(e, penalty_scale * constraint.weight)
        return Value(cost + stiff, values, cost, stiff / penalty_scale if stiff else 0.0)

    def gradient(self) -> FloatArray:
        """Gradient (T, n) at the last evaluation; zero at the fixed knots."""
        gradient = self.evaluation.gradient()
        gradient[: self.first] = 0.0
        gradient[self.last + 1 :] = 0.0
        return gradient

    def curvature(self) -> FloatArray:
        """Gauss-Newton matrix of the free knots, in LAPACK's lower banded form ((2n+1), N)."""
        e = self.evaluation
        kernels.add_stiffness(
            self.robot.kinematics, e.body.segment[: e.tool + 2], e.points, e.stiffness, e.origins,
            e.axes, e.band, self.first, self.matrix,
        )  # fmt: skip
        return self.matrix


@functools.lru_cache(maxsize=32)
def _metric(n_knots: int, n: int, last: int) -> FloatArray:
    """The covariant metric A of knots 1 … ``last``, banded like :meth:`Problem.curvature`."""
    dt = 1.0 / (n_knots - 1)
    band = np.zeros((n_knots, 3, n))
    kernels.smoothness(np.zeros((n_knots, n)), dt, 1.0, np.zeros((n_knots, n)), band)
    metric = np.zeros((2 * n + 1, last * n))
    free = band[1 : last + 1]
    metric[0] = free[:, 0].ravel() + ANCHOR * dt
    metric[n, : -n or None] = free[:-1, 1].ravel()
    metric[2 * n, : -2 * n or None] = free[:-2, 2].ravel()
    return frozen(metric)
