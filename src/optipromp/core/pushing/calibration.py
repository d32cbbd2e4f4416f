"""Probability of an unclean pick for a predicted harm, and the largest harm of a promise."""

from dataclasses import dataclass

import numpy as np

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class Calibration(Checked):
    """Tables of predicted harm against simulated runs; interpolated, constant beyond the ends."""

    harm: tuple[float, ...] = parameter((), "1", "choice", "ascending abscissae of ``failed``")
    failed: tuple[float, ...] = parameter(
        (), "1", "measured", "share of runs that are not clean: a logistic curve, docs/studies.md"
    )
    risk: tuple[float, ...] = parameter(
        (0.01, 0.02, 0.03, 0.05, 0.1), "1", "choice", "shares of broken promises, ascending"
    )
    threshold: tuple[float, ...] = parameter(
        (), "1", "measured", "largest harm of a success, for the share ``risk`` of broken promises"
    )

    def probability(self, harm: float) -> float:
        """The probability that a pick of this predicted harm is not clean."""
        return float(np.interp(harm, self.harm, self.failed))

    def allowed(self, risk: float) -> float:
        """The largest harm of a success, for a share of promises that may be broken."""
        return float(np.interp(risk, self.risk, self.threshold))


KNOWN = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.002, 0.011, 0.025, 0.052, 0.084, 0.144, 0.208, 0.438, 0.598),
    threshold=(0.05, 0.2, 0.5, 0.9, 2.0),
)
"""Fruits on stems with exactly known positions."""
DETECTED = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.006, 0.022, 0.042, 0.074, 0.106, 0.160, 0.212, 0.386, 0.510),
    threshold=(0.05, 0.3, 0.65, 1.1, 2.0),
)
"""Fruits on stems with detected positions, which have errors."""
PACKS = Calibration(
    harm=(0.0, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0, 60.0),
    failed=(0.016, 0.035, 0.053, 0.090, 0.159, 0.262, 0.425, 0.609),
    threshold=(1.6, 2.5, 8.0, 12.0, 30.0),
)
"""Packs, whose harm is the cost of :mod:`optipromp.core.pushing.packs.trials`."""
