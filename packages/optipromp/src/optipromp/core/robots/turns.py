"""Angles that are whole turns apart: which joints may turn, and one difference of their positions.

An encoder reports a joint within one turn, from 0 to 2π or within half a turn of zero. Where a
whole turn changes nothing, the position and the same a turn farther are one place of the arm.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.robots.kernels import PRISMATIC, Kinematics

TURN = 2.0 * np.pi  # [rad]
WRAP = 0.5  # [rad] a step between two rows that is this near a whole turn is no motion: a choice
BEYOND_LIMITS = 0.05
"""[rad or m] beyond a joint's limits that is accepted of what was measured: an arm that is led by
hand leans into its stops."""


class Turns(NamedTuple):
    """The joints of which a whole turn changes nothing, and the limits within which they turn."""

    may: BoolArray  # (n,) and the joint's limits have room for a turn
    lower: FloatArray  # (n,) [rad or m]
    upper: FloatArray  # (n,)

    @classmethod
    def of(cls, kin: Kinematics, lower: FloatArray, upper: FloatArray) -> "Turns":
        """Of a robot: its mimic joints follow one that may turn in whole turns."""
        may = upper - lower >= TURN
        may[kin.dof[(kin.kind == PRISMATIC) | (kin.multiplier != np.round(kin.multiplier))]] = False
        return cls(frozen(may, np.bool_), lower, upper)

    def of_joints(self, columns: Sequence[int]) -> "Turns":
        """Of some of the joints, by their columns."""
        mine = list(columns)
        return Turns(self.may[mine], self.lower[mine], self.upper[mine])

    @property
    def endless(self) -> BoolArray:
        """(n,) whether the joint may turn, and has no limits."""
        return frozen(self.may & np.isinf(self.lower) & np.isinf(self.upper), np.bool_)

    def onto(self, q: FloatArray, near: FloatArray) -> FloatArray:
        """``q`` (..., n), each joint on the turn nearest to ``near`` (..., n), if that is allowed.

        A joint whose nearest turn is beyond its limits stays where it is.
        """
        there = q - TURN * np.round((q - near) / TURN)
        inside = (there >= self.lower - BEYOND_LIMITS) & (there <= self.upper + BEYOND_LIMITS)
        return np.where(self.may & inside, there, q)

    def apart(self, q: FloatArray, other: FloatArray) -> FloatArray:
        """How far ``q`` (..., n) is from ``other`` (..., n), without whole turns [rad or m]."""
        return np.asarray(self.onto(q, other) - other)

    def missed(self, q: FloatArray, goal: FloatArray) -> FloatArray:
        """How far ``q`` (n,) is from what was asked for [rad or m].

        A turn of a joint with limits counts: it is a way to go, and unwinds a cable.
        """
        return np.where(self.endless, self.apart(q, goal), q - goal)

    def unwound(self, q: FloatArray, most: float = np.pi) -> FloatArray:
        """Rows (T, n) that follow one another, without steps of whole turns.

        ``most``: a step that is so near a whole turn is one [rad].
        """
        out, steps = np.array(q, dtype=np.float64), np.diff(q, axis=0)
        turns = np.round(steps / TURN)
        wraps = self.may & (turns != 0.0) & (np.abs(steps - TURN * turns) <= most)
        for row in (np.flatnonzero(wraps.any(axis=1)) + 1).tolist():
            there = np.where(wraps[row - 1], self.onto(out[row], out[row - 1]), out[row])
            out[row:] += TURN * np.round((there - out[row]) / TURN)
        return out

    def as_motion(self, q: FloatArray) -> FloatArray:
        """As :meth:`unwound`, of rows that may be far from one another: steps near whole turns."""
        return self.unwound(q, WRAP)


def unwrapped(positions: FloatArray) -> FloatArray:
    """Positions (T, n) of joints that nothing is known of, without the steps of whole turns.

    Only of joints that are reported within one turn: larger values are no angles of an encoder.
    """
    ranges = np.ptp(positions, axis=0)
    most = np.full(ranges.shape, np.inf)
    return Turns(ranges < TURN + BEYOND_LIMITS, -most, most).as_motion(positions)
