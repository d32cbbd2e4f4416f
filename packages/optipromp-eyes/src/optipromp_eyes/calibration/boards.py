"""Boards of calibration in pictures: chessboards, ChArUco boards and AprilTags, by OpenCV."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, suggest
from optipromp_eyes.needed import opencv

Pattern = Literal["chessboard", "charuco", "apriltag"]
FEWEST = 4  # points of a board that tell its pose; a tag has four
WINDOW = 5  # [pixel] half size of the window that refines a corner of a tag: a choice


@dataclass(frozen=True)
class Board:
    """A flat board; x goes along a row, y down the columns, z into the board.

    A chessboard begins at the corner whose outermost square is white.

    Attributes:
        pattern: what is printed on it.
        columns, rows: of inner corners (chessboard), squares (charuco) or tags (apriltag).
        side: of a square [m]; of an apriltag's black border.
        marker: of a charuco board the side of its markers [m]; of several apriltags the gap between
            two of them.
        dictionary: of the markers, as in OpenCV without ``DICT_``.

    Raises:
        InvalidRequestError: a board that cannot be, or that looks the same turned by a half.
    """

    pattern: Pattern
    columns: int
    rows: int
    side: float
    marker: float = 0.0
    dictionary: str = "5X5_100"

    def __post_init__(self) -> None:
        if self.pattern not in get_args(Pattern):
            raise InvalidRequestError(f"board {self.pattern!r}: {suggest(self.pattern, _PATTERNS)}")
        least = {"chessboard": 3, "charuco": 3, "apriltag": 1}[self.pattern]
        if min(self.columns, self.rows) < least:
            raise InvalidRequestError(
                f"size is {self.columns}x{self.rows}; a {self.pattern} has {least} each way at "
                "least"
            )
        if not 0.0 < self.side < math.inf:
            raise InvalidRequestError(f"side is {self.side:g}; must be above 0 [m]")
        if self.pattern == "chessboard" and (self.columns - self.rows) % 2 == 0:
            raise InvalidRequestError(
                f"a chessboard of {self.columns}x{self.rows} inner corners looks the same turned "
                "by a half: take one with an even and an odd count, or a ChArUco board"
            )
        if self.pattern == "charuco" and not 0.0 < self.marker < self.side:
            raise InvalidRequestError(
                f"marker is {self.marker:g}; the markers of a charuco board are smaller than its "
                f"squares of {self.side:g} m"
            )
        if self.pattern == "apriltag" and self.columns * self.rows > 1 and self.marker <= 0.0:
            raise InvalidRequestError("of several tags, state the gap between two as marker [m]")

    @cached_property
    def drawn(self) -> Any:
        """The board of OpenCV; it draws itself by ``generateImage``."""
        aruco, size = opencv().aruco, (self.columns, self.rows)
        names = [name[5:] for name in dir(aruco) if name.startswith("DICT_")]
        if self.dictionary not in names:
            raise InvalidRequestError(
                f"dictionary {self.dictionary!r}: {suggest(self.dictionary, names)}"
            )
        markers = aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{self.dictionary}"))
        if self.pattern == "charuco":
            return aruco.CharucoBoard(size, self.side, self.marker, markers)
        gap = self.marker if self.columns * self.rows > 1 else self.side
        return aruco.GridBoard(size, self.side, gap, markers)

    def find(self, picture: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray] | None:
        """Points of the board in a picture; None: fewer than four are found.

        Args:
            picture: (height, width, 3) or, in grey, (height, width).

        Returns:
            Places (N, 3) on the board [m], and columns and rows (N, 2) [pixel].
        """
        cv = opencv()
        grey = picture if picture.ndim == 2 else cv.cvtColor(picture, cv.COLOR_RGB2GRAY)
        if self.pattern == "chessboard":
            flags = cv.CALIB_CB_ACCURACY | cv.CALIB_CB_NORMALIZE_IMAGE
            found, pixels = cv.findChessboardCornersSB(grey, (self.columns, self.rows), flags)
            if not found:
                return None
            across, down = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
            flat = np.column_stack([across.ravel(), down.ravel(), np.zeros(across.size)])
            return np.asarray(self.side * flat), _flat(pixels, 2)
        corners, ids = self._charuco(grey) if self.pattern == "charuco" else self._tags(grey)
        if ids is None or not len(ids):
            return None
        places, pixels = self.drawn.matchImagePoints(corners, ids)
        if places is None or len(places) < FEWEST:
            return None
        return _flat(places, 3), _flat(pixels, 2)

    def _charuco(self, grey: NDArray[np.uint8]) -> tuple[Any, Any]:
        """Corners and ids; a board as OpenCV drew it before 4.6 is tried too."""
        corners = ids = None
        for legacy in (False, True):
            self.drawn.setLegacyPattern(legacy)
            corners, ids, *_ = opencv().aruco.CharucoDetector(self.drawn).detectBoard(grey)
            if ids is not None and len(ids) >= FEWEST:
                break
        return corners, ids

    def _tags(self, grey: NDArray[np.uint8]) -> tuple[Any, Any]:
        aruco = opencv().aruco
        given = aruco.DetectorParameters()
        given.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        given.cornerRefinementWinSize = WINDOW
        finder = aruco.ArucoDetector(self.drawn.getDictionary(), given)
        corners, ids, _ = finder.detectMarkers(grey)
        return corners, ids


_PATTERNS = get_args(Pattern)


def _flat(values: Any, columns: int) -> FloatArray:
    return np.asarray(values, dtype=np.float64).reshape(-1, columns)
