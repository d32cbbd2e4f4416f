"""The motion of an object of a scene: its position as a function of time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.values import array

FOR_EVER = 600.0  # [s] a choice: for so long an object with a velocity moves
FASTEST = 10.0  # [m/s] chosen: a larger speed is a number in millimetres


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """A curve of straight pieces. Before and after it, the object stands at the curve's ends.

    Time 0 is the begin of a plan's trajectory. The object does not turn.

    Args:
        times: (k,) increasing [s], k >= 2.
        positions: (k, 3) of the object at these times, in the base frame [m].

    Raises:
        InvalidSceneError: times that do not increase, arrays that do not fit, or a speed above
            :data:`FASTEST`.
    """

    times: FloatArray
    positions: FloatArray

    def __post_init__(self) -> None:
        times, positions = np.asarray(self.times, dtype=np.float64), np.asarray(self.positions)
        if times.ndim != 1 or len(times) < 2 or positions.shape != (len(times), 3):
            raise InvalidSceneError(
                f"motion has times {times.shape} and positions {positions.shape}: must be (k,) "
                "and (k, 3), k >= 2"
            )
        times = array("motion.times", times, len(times))
        if (np.diff(times) <= 0.0).any():
            raise InvalidSceneError(f"motion.times are {times.tolist()}: must increase")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "positions", array("motion.positions", positions, len(times), 3))
        if self.fastest > FASTEST:
            raise InvalidSceneError(
                f"motion reaches {self.fastest:.3g} m/s: must be at most {FASTEST:g} [m/s]; "
                "millimetres? then write scale: 0.001 at the top"
            )

    @classmethod
    def steady(cls, position: FloatArray, velocity: FloatArray) -> Self:
        """From ``position`` (3,) [m] at time 0 with a ``velocity`` (3,) [m/s], for 600 s."""
        begin, by = array("position", position, 3), array("velocity", velocity, 3)
        return cls(np.array([0.0, FOR_EVER]), np.array([begin, begin + FOR_EVER * by]))

    def at(self, times: FloatArray) -> FloatArray:
        """Positions (M, 3) at ``times`` (M,) [m]."""
        return np.stack([np.interp(times, self.times, one) for one in self.positions.T], axis=-1)

    @property
    def fastest(self) -> float:
        """The largest speed [m/s]."""
        gone = lengths(np.diff(self.positions, axis=0))
        return float((gone / np.diff(self.times)).max())

    def later(self, time: float) -> ObjectMotion:
        """The same motion for one to whom ``time`` [s] is time 0."""
        return replace(self, times=self.times - time)

    def shifted(self, by: FloatArray) -> ObjectMotion:
        """The same motion, displaced ``by`` (3,) [m]."""
        return replace(self, positions=self.positions + by)

    def transformed(self, pose: Pose) -> ObjectMotion:
        """The same motion in another frame, in which its present frame has the ``pose``."""
        return replace(self, positions=frozen([pose @ place for place in self.positions]))
