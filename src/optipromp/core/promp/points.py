"""Points in joint space and in task space that condition a ProMP."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp.checks import finite_array, phase_array
from optipromp.core.promp.gaussian import check_covariance


@dataclass(frozen=True, eq=False)
class JointPoint:
    """The joint positions at a phase: y(z) ~ N(value, covariance).

    Args:
        phase: z in [0, 1].
        value: (n,) joint positions [rad or m], or their derivative with respect to the phase.
        covariance: (n, n), one variance for all joints, or None: exact.
        derivative: 0 for positions; 1 or 2 for derivatives with respect to the phase (velocity
            times duration; acceleration times duration squared).

    Raises:
        InvalidRequestError: a phase outside [0, 1], a value that is not finite, a covariance that
            is not positive semi-definite.
    """

    phase: float
    value: FloatArray
    covariance: FloatArray | float | None = None
    derivative: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "phase", _phase(self.phase))
        value = read_only(finite_array(self.value, "joint point value", 1))
        object.__setattr__(self, "value", value)
        covariance = _covariance(self.covariance, value.size, "joint point covariance")
        object.__setattr__(self, "covariance", covariance)
        if self.derivative not in (0, 1, 2):
            raise InvalidRequestError(f"derivative must be 0, 1 or 2, got {self.derivative}")

    @property
    def exact(self) -> bool:
        """Whether the point is exact."""
        return self.covariance is None or not np.any(self.covariance)


@dataclass(frozen=True, eq=False)
class TaskPoint:
    """The tool point at a phase, x(z) ~ N(position, covariance), and optionally the tool axis.

    Args:
        phase: z in [0, 1].
        position: (3,) of the tool point in the world [m].
        axis: (3,) direction of the tool axis, of any length but 0; None: free.
        covariance: of the position [m²]: (3, 3), one variance, or None: exact. The covariance of a
            detected object goes here.
        axis_covariance: variance of the angle between the tool axis and ``axis`` [rad²] in each of
            the two directions of tilt, or None: exact.

    Raises:
        InvalidRequestError: a phase outside [0, 1], a value that is not finite, an axis of length
            0, a covariance that is not positive semi-definite.
    """

    phase: float
    position: FloatArray
    axis: FloatArray | None = None
    covariance: FloatArray | float | None = None
    axis_covariance: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "phase", _phase(self.phase))
        position = finite_array(self.position, "task point position", 1)
        if position.shape != (3,):
            raise InvalidRequestError(f"task point position: expected 3 numbers, got {position}")
        object.__setattr__(self, "position", read_only(position))
        covariance = _covariance(self.covariance, 3, "task point covariance")
        object.__setattr__(self, "covariance", covariance)
        if self.axis is not None:
            axis = finite_array(self.axis, "task point axis", 1)
            length = float(np.linalg.norm(axis))
            if axis.shape != (3,) or not length > 1e-9:
                raise InvalidRequestError(
                    f"task point axis: expected 3 numbers, not all 0, got {axis.tolist()}"
                )
            object.__setattr__(self, "axis", read_only(axis / length))
        if self.axis_covariance is not None:
            variance = finite_array(self.axis_covariance, "axis_covariance", 0)
            if variance < 0.0:
                raise InvalidRequestError(f"axis_covariance must be at least 0, got {variance}")
            object.__setattr__(self, "axis_covariance", float(variance))

    @property
    def exact(self) -> bool:
        """Whether the position is exact."""
        return self.covariance is None or not np.any(self.covariance)


Point = JointPoint | TaskPoint


def _phase(phase: float) -> float:
    if isinstance(phase, float) and 0.0 <= phase <= 1.0:
        return float(phase)
    array = phase_array(phase if np.ndim(phase) else float(phase))
    if array.size != 1:
        raise InvalidRequestError(f"phase: expected one number, got {phase}")
    return min(max(float(array[0]), 0.0), 1.0)


def _covariance(
    covariance: FloatArray | float | None, size: int, name: str
) -> FloatArray | float | None:
    if covariance is None or (type(covariance) is float and 0.0 <= covariance < math.inf):
        return covariance
    if np.ndim(covariance) == 0:
        variance = float(finite_array(covariance, name, 0))
        if variance < 0.0:
            raise InvalidRequestError(f"{name}: a variance must be at least 0, got {variance}")
        return variance
    return read_only(check_covariance(covariance, size, name))
