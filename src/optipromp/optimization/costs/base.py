"""The contract of a cost."""

from abc import ABC, abstractmethod

from optipromp.errors import InvalidRequestError
from optipromp.optimization.evaluation import Evaluation


class Cost(ABC):
    """A cost of a trajectory: a quantity to minimise, or a penalty that is zero where it is kept.

    A subclass is a dataclass, or calls ``super().__init__(name, weight)``.

    Attributes:
        name: the key under which values are reported.
        weight: factor of the cost in the objective, for a constraint its stiffness; not negative.
    """

    name: str
    weight: float

    def __init__(self, name: str, weight: float) -> None:
        self.name, self.weight = name, weight
        self.__post_init__()

    def __post_init__(self) -> None:
        """Check the weight.

        Raises:
            InvalidRequestError: it is negative or not a number.
        """
        if not self.weight >= 0.0:
            raise InvalidRequestError(
                f"the weight of {self.name} is {self.weight}; it must not be negative"
            )

    @abstractmethod
    def add(self, e: Evaluation, scale: float) -> float:
        """Return the value, without weight, and add ``scale`` times its gradient to ``e``.

        The gradient is with respect to joints or to points, whichever the cost depends on. A known
        curvature is added too. ``scale`` is the weight; for a constraint, the weight times the
        stage of the penalty.
        """
