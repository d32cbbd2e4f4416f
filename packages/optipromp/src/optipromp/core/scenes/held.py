"""What a scene's tool holds (``attached``), and the pairs that may touch (``may_touch``)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le, Unit

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError, suggest
from optipromp.core.geometry.shapes import MeshShape, PointCloudShape, Shape, is_convex, parted
from optipromp.core.robots.mounted import Load
from optipromp.core.robots.tool_geometry import Solid
from optipromp.core.scenes.pose import LARGEST_PADDING, Array, Direction, Framed, Point, Turn
from optipromp.core.scenes.rotations import IDENTITY
from optipromp.core.values import Name, Validated

TOOL = "tool"  # name of the tool in ``may_touch``
RETREAT = 0.1
"""Default distance of a retreat [m], chosen: about the length of a tool's path among fruits."""
Pair = tuple[str, str]


@dataclass(frozen=True, eq=False)
class Attached(Validated, error=InvalidSceneError):
    """A shape that moves with the tool: a fruit in the cup, a punnet, a payload.

    Args:
        id: its name, unlike those of the objects.
        shape: convex, or a mesh whose connected pieces are convex.
        position: (3,) of the shape's origin in the tool axes, from the tool point [m].
        orientation: of the shape's frame in the tool axes: quaternion (4,) ``w, x, y, z``.
        mass: [kg]; None: it weighs nothing.

    Raises:
        InvalidSceneError: a value that is not finite or of the wrong shape, a mass that is not
            positive, or a shape that is not convex or has no end.
    """

    id: Name
    shape: Shape
    position: Annotated[FloatArray, Array(3)] = field(default_factory=lambda: np.zeros(3))
    orientation: Turn = field(default_factory=lambda: IDENTITY)
    mass: Annotated[float | None, Gt(0.0), Unit("kg")] = None

    def __post_init__(self) -> None:
        where = f"attached {self.id!r}"
        super().__post_init__(f"{where}: ")
        if not math.isfinite(self.shape.measure.bound) or isinstance(self.shape, PointCloudShape):
            raise InvalidSceneError(
                f"{where}: shape is a {type(self.shape).__name__}: must be convex and have an end"
            )
        for k, piece in enumerate(self._pieces):
            if isinstance(piece, MeshShape) and not is_convex(piece):
                raise InvalidSceneError(
                    f"{where}: piece {k} of {len(self._pieces)} of its mesh is not convex: "
                    "must be cut into convex parts"
                )

    @cached_property
    def _pieces(self) -> Sequence[Shape]:
        """The convex pieces of the shape."""
        return parted(self.shape) if isinstance(self.shape, MeshShape) else [self.shape]

    @cached_property
    def load(self) -> Load:
        """The load of the tool, see :class:`optipromp.core.robots.mounted.Mounted`."""
        w, x, y, z = self.orientation.tolist()
        solids = (
            Solid(str(k), shape, self.position, (w, x, y, z), "load")
            for k, shape in enumerate(self._pieces)
        )
        return Load(self.id, tuple(solids), self.mass or 0.0)


@dataclass(frozen=True, eq=False)
class Place(Framed, label="place."):
    """Where the tool brings the target after the pick, in the base frame.

    Args:
        position: (3,) of the tool point at the end [m].
        axis: (3,) of the tool axis there; of any length above 0.
        retreat: distance of the tool's retreat from the place of the pick [m].
    """

    position: Point
    axis: Direction
    retreat: Annotated[float, Gt(0.0), Le(LARGEST_PADDING), Unit("m")] = RETREAT


def check_held(
    attached: Sequence[Attached], may_touch: Sequence[Pair], ids: Collection[str]
) -> None:
    """Refuse shapes whose id is taken, and pairs of one name."""
    taken = {*ids, TOOL}
    for index, item in enumerate(attached):
        if item.id in taken:
            raise InvalidSceneError(
                f"attached[{index}].id {item.id!r} is taken: must be unlike every other id"
            )
        taken.add(item.id)
    for index, pair in enumerate(may_touch):
        if pair[0] == pair[1]:
            raise InvalidSceneError(
                f"may_touch[{index}] is {list(pair)}: must be two different names of objects, "
                f"links, attached shapes, or {TOOL!r}"
            )


def check_names(pairs: Iterable[Pair], objects: Collection[str], links: Collection[str]) -> None:
    """Refuse pairs of names that are neither objects nor links, or of two objects.

    ``links``: names of all links, of attached shapes, and of the tool.
    """
    for index, pair in enumerate(pairs):
        for name in pair:
            if name not in objects and name not in links:
                raise InvalidSceneError(
                    f"may_touch[{index}] names {name!r}, which is no object, link or attached "
                    f"shape: {suggest(name, [*objects, *links])}"
                )
        if not any(name in links for name in pair):
            raise InvalidSceneError(
                f"may_touch[{index}] is {list(pair)}, two objects: one must be a link, an attached "
                f"shape, or {TOOL!r}"
            )


def pairs_among(pairs: Iterable[Pair], gone: Collection[str]) -> tuple[Pair, ...]:
    """The pairs that name none of the objects that are ``gone``."""
    return tuple(pair for pair in pairs if not gone or not {*pair} & {*gone})
