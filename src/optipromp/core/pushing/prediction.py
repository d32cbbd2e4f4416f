"""The prediction of a push."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Prediction:
    """The prediction for the push of a trajectory.

    Attributes:
        harm: mean over the states of the scene; see :class:`PushModel`.
        threshold: largest harm of a success.
        object: id of the object that is harmed most in the worst state; empty without harm.
        cause: the harm of that object, in words.
        forces: largest force on each pushed object, by id, in the perceived state [N].
        probability: that the pick is not clean, see
            :class:`optipromp.core.pushing.calibration.Calibration`.
    """

    harm: float
    threshold: float
    object: str
    cause: str
    forces: Mapping[str, float] = field(default_factory=dict)
    probability: float = math.nan

    @property
    def harmful(self) -> bool:
        """Whether the harm is above the threshold."""
        return self.harm > self.threshold

    def __str__(self) -> str:
        told = f"harm {self.harm:.2f} of at most {self.threshold:.2g}"
        if not math.isnan(self.probability):
            told += f"; not clean with probability {100.0 * self.probability:.0f} %"
        what = f"{self.object} {self.cause}" if self.object else self.cause
        return f"harm is predicted: {what} ({told})" if self.harmful else f"predicted {told}"

    def pushes(self, passage: Mapping[str, tuple[float, float] | None]) -> str:
        """Force on and passage of each pushed object, in words; empty for no pushed object.

        ``passage`` has the offsets of the tool along x_g and y_g from each passed object [m].
        """
        told = []
        for name, force in self.forces.items():
            way = passage.get(name)
            at = "" if way is None else " ({:+d}, {:+d}) mm".format(*(round(1e3 * x) for x in way))
            told.append(f"{name} {force:.1f} N{at}")
        return f"pushed, and passed at (x_g, y_g): {', '.join(told)}" if told else ""
