"""What is in a picture: regions with a class. The door of every finder."""

from dataclasses import dataclass
from typing import Literal, Protocol

from optipromp.core.arrays import BoolArray
from optipromp.perception.pictures import DepthPicture

Class = Literal["ripe", "unripe", "stem"]


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


@dataclass(frozen=True, eq=False)
class Found:
    """All that was found in one picture, the surest first."""

    regions: tuple[Region, ...]

    @property
    def fruits(self) -> tuple[Region, ...]:
        """The fruits, ripe and unripe."""
        return tuple(region for region in self.regions if region.kind != "stem")

    @property
    def stems(self) -> tuple[Region, ...]:
        """The regions of stems."""
        return tuple(region for region in self.regions if region.kind == "stem")


class Finder(Protocol):
    """Finds fruits and stems: by geometry, by a network, or by a detector of your own."""

    def find(self, picture: DepthPicture) -> Found:
        """The regions of a picture."""
        ...
