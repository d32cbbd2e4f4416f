"""Normalised radial basis functions over the phase."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp.checks import phase_array
from optipromp.core.values import Positive, Validated

MOST_BASES = 200  # the covariance of the weights of 7 joints then takes 16 MB


@dataclass(frozen=True)
class Basis(Validated, label="basis "):
    r"""Normalised Gaussian bases on the phase z in [0, 1].

    .. math:: \phi_i(z) = \frac{b_i(z)}{\sum_k b_k(z)}, \quad
              b_i(z) = \exp\Big(-\frac{h}{2}\Big(\frac{z - c_i}{\Delta}\Big)^2\Big)

    with width :math:`h`, centres :math:`c_i = (i - o)\Delta`, :math:`o` of them outside [0, 1]
    on each side, and :math:`\Delta = 1/(K - 2o - 1)`. The bases sum to one, so that constants are
    represented exactly. They are evaluated as a softmax, which is never 0/0.

    Args:
        count: number of bases K, at most 200; at least 2 must lie inside [0, 1].
        width: h > 0 [-]; a larger h makes narrower bases: at a neighbour's centre b is exp(-h/2).
        outside: bases o outside [0, 1] on each side.

    Raises:
        InvalidRequestError: a value outside its range.
    """

    count: Annotated[int, Le(MOST_BASES)] = 5
    width: Positive = 4.0
    outside: Annotated[int, Ge(0)] = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count < 2 * self.outside + 2:
            raise InvalidRequestError(
                f"basis count must be at least {2 * self.outside + 2} with {self.outside} outside "
                f"on each side, got {self.count}"
            )

    @property
    def spacing(self) -> float:
        """Distance Δ between centres, in phase."""
        return 1.0 / (self.count - 2 * self.outside - 1)

    @cached_property
    def centers(self) -> FloatArray:
        """Centres (K,), in phase."""
        return read_only((np.arange(self.count, dtype=np.float64) - self.outside) * self.spacing)

    def evaluate(self, phases: int | ArrayLike, order: int = 0) -> FloatArray:
        r"""Values Φ (T, K) of the bases, or a derivative with respect to the phase.

        :math:`\phi` is the softmax of :math:`\beta(c_i z - c_i^2/2)`, :math:`\beta = h/\Delta^2`.
        With :math:`d_i = \beta(c_i - \sum_k \phi_k c_k)`, :math:`v = \sum\phi d^2` and
        :math:`s = \sum\phi d^3` its derivatives are :math:`\phi' = \phi d`,
        :math:`\phi'' = \phi(d^2 - v)` and :math:`\phi''' = \phi(d^3 - 3vd - s)`.

        Args:
            phases: (T,) in [0, 1], or a count of evenly spaced ones, for which the result is cached
                and read-only.
            order: of the derivative, 0 to 3.

        Raises:
            InvalidRequestError: a phase outside [0, 1], or another order.
        """
        if isinstance(phases, (int, np.integer)) and not isinstance(phases, bool):
            return _at_even(self, int(phases), order)
        return self._at(phase_array(phases), order)

    def _at(self, z: FloatArray, order: int) -> FloatArray:
        c = self.centers
        beta = self.width / self.spacing**2
        values = (z[:, None] - 0.5 * c) * (beta * c)
        values -= values.max(axis=1, keepdims=True)
        np.exp(values, out=values)
        values /= values.sum(axis=1, keepdims=True)
        if order == 0:
            return values
        d: FloatArray = beta * (c - (values @ c)[:, None])
        if order == 1:
            return values * d
        v: FloatArray = (values * d**2).sum(axis=1, keepdims=True)
        if order == 2:
            return values * (d**2 - v)
        if order == 3:
            s: FloatArray = (values * d**3).sum(axis=1, keepdims=True)
            third: FloatArray = d**3 - 3.0 * v * d - s
            return values * third
        raise InvalidRequestError(f"derivative order must be 0, 1, 2 or 3, got {order}")


@lru_cache(maxsize=64)
def _at_even(basis: Basis, count: int, order: int) -> FloatArray:
    return read_only(basis._at(phase_array(count), order))
