"""What is in a picture: regions with a class. The door of every finder."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from optipromp.core.arrays import BoolArray, IntArray
from optipromp.perception.pictures import DepthPicture

Class = Literal["ripe", "unripe", "stem"]
MOST_REGIONS = 256  # of a picture: a choice; pictures of rows have up to 201
MOST_MASKS = 120_000_000  # [pixel] of all regions, a byte each, which bounds memory: a choice


@dataclass(frozen=True, eq=False)
class Region:
    """The pixels of one thing.

    Attributes:
        kind: ``ripe`` or ``unripe`` of one fruit; ``stem`` of all stems together.
        pixels: (height, width) whether a pixel shows it.
        score: 0 to 1, how sure the finder is.
    """

    kind: Class
    pixels: BoolArray
    score: float

    @cached_property
    def box(self) -> tuple[slice, slice]:
        """The rows and columns of its pixels."""
        return box_of(self.pixels, 0)


def box_of(mask: BoolArray, margin: int) -> tuple[slice, slice]:
    """The rows and columns of a mask, with a margin [pixel]."""
    out = []
    for axis, size in enumerate(mask.shape):
        there = np.flatnonzero(mask.any(axis=1 - axis))
        low, high = (there[0], there[-1] + 1) if len(there) else (0, 1)
        out.append(slice(max(int(low) - margin, 0), min(int(high) + margin, size)))
    return out[0], out[1]


@dataclass(frozen=True, eq=False)
class Found:
    """All that was found in one picture, the surest first.

    Attributes:
        regions: fruits and stems.
        left_out: how many places of fruits the finder left out, because there are too many.
    """

    regions: tuple[Region, ...]
    left_out: int = 0

    @property
    def fruits(self) -> tuple[Region, ...]:
        """The fruits, ripe and unripe."""
        return tuple(region for region in self.regions if region.kind != "stem")

    @property
    def stems(self) -> tuple[Region, ...]:
        """The regions of stems."""
        return tuple(region for region in self.regions if region.kind == "stem")


def largest(sizes: IntArray, pixels: int) -> IntArray:
    """The rows, in order, of the largest of sizes (K,): :data:`MOST_REGIONS`, or as many as
    :data:`MOST_MASKS` holds in a picture of some pixels."""
    most = min(MOST_REGIONS, MOST_MASKS // pixels)
    return np.sort(np.argsort(-sizes, kind="stable")[:most])


class Finder(Protocol):
    """Finds fruits and stems: by geometry, by a network, or by a detector of your own."""

    def find(self, picture: DepthPicture) -> Found:
        """The regions of a picture."""
        ...
