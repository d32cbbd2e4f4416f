"""Candidate paths of a hand among packs.

A candidate path is a polyline in the plane of the board, in (u, v): along z_g and y_g from the
target [m].
"""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.pushing.candidates import Candidates, Round, Schedule
from optipromp.core.pushing.packs.plane import Plane
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.scenes.scene import Scene

STANDING = PUSH.standing


class PathsBetween(Candidates):
    """Paths between packs on a board, from the entry of the ``board`` to the target."""

    schedule = Schedule(
        rounds=(Round(150, 1), *[Round(75, 1)] * 4, *[Round(25, 4)] * 3), runs=3, kept=20,
        screened=3, states=1 + STANDING.samples, fresh=0.0, lenient=1.12,
    )  # fmt: skip

    def __init__(self, scene: Scene, board: Plane) -> None:
        assert scene.target is not None
        self._target, self._board = scene.target.position, board
        self._upright = scene.frame[[2, 1, 0]]  # (u, v) and up
        self.entry = float(self._target @ scene.frame[2]) + board.entry
        self._low = np.array([board.entry, -STANDING.sideways, -np.inf])
        self._high = np.array([0.0, STANDING.sideways, np.inf])

    def path(self, x: FloatArray) -> ToolPath:
        """From the entry at v = x[0] through the corners (u, v) in x[1:] to the target."""
        entry, drop = self._board.entry, self._board.drop
        between = len(x) // 2
        corners = np.zeros((between + (3 if drop else 2), 3))
        corners[: between + 2, 2] = drop  # low over the board, and up at the end
        corners[0, 0], corners[0, 1] = entry, x[0]
        corners[1 : between + 1, :2] = x[1:].reshape(-1, 2)
        corners = np.minimum(np.maximum(corners, self._low), self._high)
        return through(self._target + corners @ self._upright, STANDING.speed)

    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """0: the harm includes walls and length."""
        return 0.0

    def first(self) -> FloatArray:
        """No candidate."""
        return np.zeros((0, 1))

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """About the straight line from the entry."""
        corners = STANDING.first_corners if run == 0 else STANDING.corners
        shares = np.linspace(1.0, 0.0, corners + 2)[1:-1]
        line = np.ravel([[share * self._board.entry, 0.0] for share in shares])
        return np.append(0.0, line), np.append(
            STANDING.spread_aside, np.tile([STANDING.spread_along, STANDING.spread_aside], corners)
        )
