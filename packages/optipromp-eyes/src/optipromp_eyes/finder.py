"""What is in a picture: regions with a class. The door of every finder."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import BoolArray, IntArray, read_only
from optipromp_eyes.needed import opencv
from optipromp_eyes.pictures import DepthPicture

Class = Literal["ripe", "unripe", "stem", "leaf"]
MOST_REGIONS = 256  # of a picture: a choice; pictures of rows have up to 201
RIGHT = 0.96  # share of fruits whose ripeness finders tell right: of 1,500 rendered ones
SUREST = 0.99  # probability of ripeness that one picture can tell: a choice
MOST_FITS = 160  # regions that are fitted, which bounds time and memory: a choice


class Region:
    """The pixels of one thing. Kept are those of its box alone.

    Attributes:
        kind: ``ripe`` or ``unripe`` of one fruit; ``stem``, ``leaf`` of all stems, leaves together.
        score: 0 to 1, how sure the finder is.
        ripe: probability that a fruit is ripe.
        shape: height and width of the picture.
        box: the rows and columns of its pixels.
        part: (h, w) of the box, whether a pixel shows it.

    Args:
        kind: see above, as of ``score``.
        pixels: (height, width) whether a pixel shows it; with a ``box``, those of the box.
        box: rows and columns of ``pixels`` in a picture of ``shape``; None: the whole picture.
        shape: height and width of the picture; with a box.
        ripe: None: :data:`RIGHT` for what is told to be ripe, else the rest.
    """

    def __init__(
        self, kind: Class, pixels: BoolArray, score: float,
        box: tuple[slice, slice] | None = None, shape: tuple[int, int] | None = None,
        ripe: float | None = None,
    ) -> None:  # fmt: skip
        rows, columns = inner = box_of(pixels, 0)
        self.kind, self.score, self.shape = kind, score, shape or pixels.shape
        usual = RIGHT if kind == "ripe" else 1.0 - RIGHT
        self.ripe = usual if ripe is None else min(max(ripe, 1.0 - SUREST), SUREST)
        self.part = read_only(np.array(pixels[inner], dtype=bool))
        top, left = (0, 0) if box is None else (box[0].start, box[1].start)
        self.box = (
            slice(rows.start + top, rows.stop + top),
            slice(columns.start + left, columns.stop + left),
        )

    def with_ripe(self, ripe: float) -> "Region":
        """The same pixels with another probability of ripeness."""
        return Region(self.kind, self.part, self.score, self.box, self.shape, ripe)

    @property
    def pixels(self) -> BoolArray:
        """(height, width) whether a pixel shows it: a new array at each call."""
        return Region.mask([self], self.shape)

    @staticmethod
    def mask(regions: "Iterable[Region]", shape: tuple[int, ...]) -> BoolArray:
        """(height, width) whether a pixel of a picture of ``shape`` shows one of some regions."""
        out = np.zeros(shape, dtype=bool)
        for region in regions:
            out[region.box] |= region.part
        return out

    def grown(self, margin: int) -> tuple[tuple[slice, slice], BoolArray]:
        """Its box with a margin [pixel] as far as the picture goes, and its pixels in that."""
        rows, columns = (
            slice(max(b.start - margin, 0), min(b.stop + margin, size))
            for b, size in zip(self.box, self.shape, strict=True)
        )
        out = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=bool)
        top, left = self.box[0].start - rows.start, self.box[1].start - columns.start
        out[top : top + self.part.shape[0], left : left + self.part.shape[1]] = self.part
        return (rows, columns), out


def box_of(mask: BoolArray, margin: int) -> tuple[slice, slice]:
    """The rows and columns of a mask, with a margin [pixel]."""
    out = []
    for axis, size in enumerate(mask.shape):
        there = np.flatnonzero(mask.any(axis=1 - axis))
        low, high = (there[0], there[-1] + 1) if len(there) else (0, 1)
        out.append(slice(max(int(low) - margin, 0), min(int(high) + margin, size)))
    return out[0], out[1]


def most_about(values: NDArray[Any], side: int) -> NDArray[Any]:
    """The largest of values (h, w) in a square of an odd ``side`` about each."""
    number: Any = {"f": values.dtype, "b": np.uint8}.get(values.dtype.kind, np.float32)  # to 2^24
    wide = opencv().dilate(values.astype(number, copy=False), np.ones((side, side), np.uint8))
    return np.asarray(wide).astype(values.dtype, copy=False)


@dataclass(frozen=True, eq=False)
class Found:
    """All that was found in one picture, the surest first.

    Attributes:
        regions: fruits, stems and leaves.
        left_out: how many places of fruits the finder left out, because there are too many.
    """

    regions: tuple[Region, ...]
    left_out: int = 0

    @property
    def fruits(self) -> tuple[Region, ...]:
        """The fruits, ripe and unripe."""
        return tuple(region for region in self.regions if region.kind in ("ripe", "unripe"))

    @property
    def stems(self) -> tuple[Region, ...]:
        """The regions of stems."""
        return tuple(region for region in self.regions if region.kind == "stem")


def largest(sizes: IntArray, most: int = MOST_REGIONS) -> IntArray:
    """The rows, in order, of the largest of sizes (K,), at most as many as told."""
    return np.sort(np.argsort(-sizes, kind="stable")[:most])


class Finder(Protocol):
    """Finds fruits and stems: by geometry, by a network, or by a detector of your own."""

    def find(self, picture: DepthPicture) -> Found:
        """The regions of a picture."""
        ...
