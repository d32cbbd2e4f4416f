r"""The functionals of OptI-ProMP: one class each, the mathematics in :mod:`.kernels`.

A term returns its value and adds its gradient, times its weight, to the arrays of an
:class:`~optipromp.optimization.evaluation.Evaluation`, in the space where it lives. To write one in
plain NumPy, subclass :class:`Term`; see ``docs/add-a-cost-term.md``.
"""

from abc import ABC, abstractmethod
from typing import Literal

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.optimization import kernels
from optipromp.optimization.evaluation import Evaluation

Reduction = Literal["max", "sum"]
PushForm = Literal["quadratic", "reciprocal"]


class Term(ABC):
    """A cost of a trajectory.

    Attributes:
        name: the key under which values are reported.
        weight: factor of the term in the objective; not negative.
    """

    name: str
    weight: float

    def __init__(self, name: str, weight: float) -> None:
        if not weight >= 0.0:
            raise InvalidRequestError(f"the weight of {name} is {weight}; it must not be negative")
        self.name = name
        self.weight = weight

    @abstractmethod
    def add(self, e: Evaluation, scale: float) -> float:
        """Return the value (without weight) and add ``scale`` times its gradient to ``e``."""


class ObstacleTerm(Term):
    r""":math:`F_s` or :math:`F_d` :math:`=\int \max_u c(x(\xi,u))\,\lVert dx/dt\rVert\,dt`."""

    def __init__(
        self, name: Literal["static", "avoid"], weight: float, epsilon: float, reduction: Reduction
    ) -> None:
        super().__init__(name, weight)
        if not epsilon > 0.0:
            raise InvalidRequestError(f"epsilon is {epsilon}; it must be positive [m]")
        if reduction not in ("max", "sum"):
            raise InvalidRequestError(f"reduction is {reduction!r}; use 'max' or 'sum'")
        self.epsilon = epsilon
        self.reduction: Reduction = reduction

    def add(self, e: Evaluation, scale: float) -> float:
        field = e.static if self.name == "static" else e.dynamic
        return float(
            kernels.obstacle_functional(
                e.points, field.distance, field.normal, self.epsilon, e.dt,
                self.reduction == "max", scale, e.force, e.stiffness,
            )
        )  # fmt: skip


class PushTerm(Term):
    r""":math:`F_p=\int_{t_1}^T\lVert fk(\xi_t)-X_g\rVert^2_{\mathcal F_g}dt`, or the authors'."""

    def __init__(
        self,
        weight: float,
        goal: FloatArray,
        frame: FloatArray,
        first: int,
        axis_weights: FloatArray,
        form: PushForm = "quadratic",
        softening: float = 1e-4,
    ) -> None:
        super().__init__("push", weight)
        if form not in ("quadratic", "reciprocal"):
            raise InvalidRequestError(f"push is {form!r}; use 'quadratic' or 'reciprocal'")
        self.goal, self.frame, self.first = goal, frame, first
        self.axis_weights, self.form, self.softening = axis_weights, form, softening

    def add(self, e: Evaluation, scale: float) -> float:
        if self.form == "reciprocal":
            return float(
                kernels.push_reciprocal(
                    e.points, e.tool, self.goal, self.frame[1], self.softening, self.first, scale,
                    e.force,
                )
            )  # fmt: skip
        return float(
            kernels.push_quadratic(
                e.points, e.tool, self.goal, self.frame, self.axis_weights, e.dt, self.first, scale,
                e.force, e.stiffness,
            )
        )  # fmt: skip


class VelocityTerm(Term):
    r""":math:`F_v=\int\dot\xi^\top\dot\xi\,dt`."""

    def __init__(self, weight: float) -> None:
        super().__init__("velocity", weight)

    def add(self, e: Evaluation, scale: float) -> float:
        return float(kernels.velocity_functional(e.q, e.dt, scale, e.joint_gradient, e.band))


class SmoothnessTerm(Term):
    r""":math:`\tfrac12\int\lVert\ddot\xi\rVert^2dt`: CHOMP's metric A as a term."""

    def __init__(self, weight: float) -> None:
        super().__init__("smoothness", weight)

    def add(self, e: Evaluation, scale: float) -> float:
        return float(kernels.smoothness(e.q, e.dt, scale, e.joint_gradient, e.band))
