"""The protocol of a tool, :class:`Tool`, with defaults by the tool's solids and mouth."""

import functools
from abc import abstractmethod
from collections.abc import Hashable, Iterable
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.tool_geometry import (
    Solid,
    cover_solids,
    hull,
    solids_inertia,
    swept_polygons,
)

LARGEST = 5.0  # [m] chosen: a larger dimension of a tool is a number in millimetres
Size = Annotated[float, Gt(0.0), Le(LARGEST), Unit("m")]
Distance = Annotated[float, Ge(0.0), Le(LARGEST), Unit("m")]
Coordinate = Annotated[float, Ge(-LARGEST), Le(LARGEST), Unit("m")]
Place = tuple[Coordinate, Coordinate, Coordinate]


@runtime_checkable
class Tool(Protocol):
    """A tool on the flange: the members that planners, judge, simulation and pictures use.

    An object of any class with these members can be mounted
    (:func:`optipromp.core.robots.tools.with_tool`); it must not change from then on. Lengths are
    metres. The classes of the library refuse a parameter out of its range by InvalidRequestError.

    A subclass defines ``solids``, ``point``, ``front``, ``tip`` and ``mouth``; the other members
    follow from them. By default the tool is round about the flange's z and swallows a fruit. With
    ``fingers`` true it closes on the fruit.

    The *tool axes* are x, y and z: z is the tool axis and points out of the mouth; fingers open
    along y. The *tool point* is the place of the centre of a fruit that the tool holds.
    """

    @property
    @abstractmethod
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame."""

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns; by default those of the flange."""
        return np.eye(3)

    @property
    def fingers(self) -> bool:
        """Whether the tool opens along y only, and y is kept level. False: a round tool."""
        return False

    @property
    def reach(self) -> float:
        """Height of the tool point over the flange's origin, along the tool axis."""
        return float(self.point @ self.rotation[:, 2])

    @property
    @abstractmethod
    def front(self) -> float:
        """Height at which the mouth begins: a cup's floor, a hand's palm."""

    @property
    @abstractmethod
    def tip(self) -> float:
        """Height of the rim, or of the finger tips."""

    @property
    def depth(self) -> float:
        """Distance of the rim or finger tips beyond the tool point: ``tip - reach``."""
        return self.tip - self.reach

    @property
    def gripper_radius(self) -> float:
        """R_gripper: distance of the tool axis from the centre of a fruit that the tool passes.

        By default the outer radius of a round mouth, or half the distance of the fingers.
        """
        return self.mouth[0] if self.fingers else self.mouth[1]

    @property
    @abstractmethod
    def mouth(self) -> tuple[float, float]:
        """Inner and outer radius of the mouth; of fingers, half the distance of their inner sides
        and of their backs. A tool of inner radius 0 holds nothing; the push models treat it as
        solid."""

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the solids, in the flange frame."""
        return _covered(self) if isinstance(self, Hashable) else cover_solids(self.solids())

    def outline(self) -> tuple[FloatArray, ...]:
        """The tool seen along its x: convex polygons (k, 2), k <= 8, counter-clockwise.

        Columns: along the tool axis and along y, from the tool point. The outline of a round tool,
        whose roll is free, is that of the volume that it sweeps as it rolls.
        """
        return outline_of(self, self.solids())

    @abstractmethod
    def solids(self) -> tuple[Solid, ...]:
        """The solids of the simulation and of pictures."""

    def holds(self, points: FloatArray) -> BoolArray:
        """Whether the tool holds objects at points (R, 3), in tool axes from the tool point.

        By default the points between ``front`` and ``tip`` that are within the inner radius of a
        round mouth, or between the fingers and within the width of the narrowest finger solid.
        """
        x, y, z = points.T
        ends = self.front - self.reach, self.tip - self.reach
        if not self.fingers:
            within = np.hypot(x, y) < self.mouth[0]
            return np.asarray(within & (z < ends[1]) & (z > ends[0]))
        fingers = [solid.corners for solid in self.solids() if solid.part == "finger"]
        wide = [np.abs((own - self.point) @ self.rotation[:, 0]).max() for own in fingers]
        across = (np.abs(y) < self.mouth[0]) & (np.abs(x) <= min(wide, default=np.inf))
        return np.asarray(across & (z > ends[0]) & (z <= ends[1]))

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre of a mass [kg] (3,) and inertia about it (3, 3) [kg m²], in the flange frame.

        By default that of the boxes about the solids, of one density.
        """
        return solids_inertia(self.solids(), mass)


def outline_of(
    tool: Tool, solids: Iterable[Solid], outline: Iterable[FloatArray] = ()
) -> tuple[FloatArray, ...]:
    """An ``outline``, then the polygons of ``solids`` as :meth:`Tool.outline` sees them."""
    found = {part.round(6).tobytes(): part for part in outline}
    for solid in solids:
        local = (solid.corners - tool.point) @ tool.rotation
        seen = local[:, [2, 1]].round(15)  # corners one behind the other are one
        parts = [hull(seen)] if tool.fingers else swept_polygons(local)
        found |= {part.round(6).tobytes(): part for part in parts}  # alike ones count once
    return tuple(found.values())


@functools.lru_cache(maxsize=32)
def _covered(tool: Tool) -> FloatArray:
    return frozen(cover_solids(tool.solids()))


MEMBERS = tuple(name for name in vars(Tool) if not name.startswith("_"))
AGREE = 1e-6  # [m] largest difference of two numbers of a tool that must agree: rounding


def check_tool(tool: Tool) -> None:
    """Refuse an object without the members of a tool, and a tool whose numbers disagree."""
    name = type(tool).__name__
    missing = [member for member in MEMBERS if not hasattr(tool, member)]
    if missing:
        raise InvalidRequestError(
            f"{name} is no tool: it lacks {', '.join(missing)}; see optipromp.core.robots.Tool"
        )
    turn, point = np.asarray(tool.rotation), np.asarray(tool.point)
    for member, array, shape in (("rotation", turn, (3, 3)), ("point", point, (3,))):
        if array.shape != shape or not np.isfinite(array).all():
            raise InvalidRequestError(
                f"tool {name}: {member} is {array.tolist()}; it must be {shape} finite numbers"
            )
    if np.abs(turn.T @ turn - np.eye(3)).max() > AGREE or np.linalg.det(turn) < 0.0:
        raise InvalidRequestError(
            f"tool {name}: rotation is {turn.tolist()}; its columns must be right-handed unit axes"
        )
    inner, outer = tool.mouth
    for member, value, wanted in (
        ("reach", tool.reach, float(point @ turn[:, 2])),
        ("depth", tool.depth, tool.tip - tool.reach),
        ("mouth[0]", inner, min(max(inner, 0.0), outer)),
        ("front", tool.front, min(tool.front, tool.tip)),
    ):
        if not abs(value - wanted) <= AGREE:
            raise InvalidRequestError(
                f"tool {name}: {member} is {value:g}; by its other numbers it must be {wanted:g}"
            )


def check_length(
    tool: str, field: str, value: object, low: float, high: float, open_below: bool = False,
    unit: str = "metres",
) -> None:  # fmt: skip
    """Refuse a value that is no number between ``low`` and ``high``, by default a length [m]."""
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else np.nan
    if number <= high and (low < number if open_below else low <= number):
        return
    bracket = "(" if open_below else "["
    raise InvalidRequestError(
        f"tool {tool}: {field} is {value!r}; it must be in {bracket}{low:g}, {high:g}] {unit}"
    )


def quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternion wxyz of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])
