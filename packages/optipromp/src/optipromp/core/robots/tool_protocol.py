"""The protocol of a tool, :class:`Tool`, with defaults by the tool's solids and mouth."""

import functools
from abc import abstractmethod
from collections.abc import Hashable, Iterable
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.compiled import called, inner
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

    def holds(self, begin: FloatArray, end: FloatArray) -> BoolArray:
        """Whether the tool holds bodies (R,) whose axes run from ``begin`` to ``end`` (R, 3), in
        tool axes from the tool point: from one end's ball to the other's; of a ball its centre.

        By default those of which a point of the axis is between ``front`` and ``tip``, and within
        the inner radius of a round mouth, or between the fingers and within :func:`finger_width`.
        """
        ends = self.front - self.reach, self.tip - self.reach
        room = self.mouth[0], *ends, finger_width(self), 1.0, 0.0, 0.0
        lines = np.hstack([begin, end - begin]).tolist()
        held = [meets(h, x, y, 0.0, dh, dx, dy, 0.0, *room) for x, y, h, dx, dy, dh in lines]
        return np.array(held, dtype=np.bool_)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre of a mass [kg] (3,) and inertia about it (3, 3) [kg m²], in the flange frame.

        By default that of the boxes about the solids, of one density.
        """
        return solids_inertia(self.solids(), mass)


@called
def meets(h, x, y, z, dh, dx, dy, dz, wide, low, high, within, ax, ay, az):
    """Whether a line meets the room of a mouth.

    The line begins at the height ``h`` along the tool axis, and at (x, y, z) from that axis, across
    it; ``dh`` and (dx, dy, dz) lead to its end. The room is between the heights ``low`` and
    ``high``, and nearer to the axis than ``wide``: of two fingers (``within`` above 0) along the
    opening, and at most ``within`` from the axis along (ax, ay, az), across it. All in metres.
    """
    a, b = _between(h, dh, low, high, 0.0, 1.0)
    if within > 0.0:
        w, dw = x * ax + y * ay + z * az, dx * ax + dy * ay + dz * az
        x, y, z = x - w * ax, y - w * ay, z - w * az
        dx, dy, dz = dx - dw * ax, dy - dw * ay, dz - dw * az
        a, b = _between(w, dw, -within, within, a, b)
    if a > b or wide <= 0.0:
        return False
    square = dx * dx + dy * dy + dz * dz
    t = -(x * dx + y * dy + z * dz) / square if square > 0.0 else a
    t = min(max(t, a), b)
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    return x * x + y * y + z * z < wide * wide


@inner
def _between(p, d, low, high, a, b):
    """The shares from ``a`` to ``b`` of a line for which p + share d is between ``low``, ``high``;
    (1, 0) where it nowhere is."""
    if d == 0.0:
        return (a, b) if low <= p <= high else (1.0, 0.0)
    one, other = (low - p) / d, (high - p) / d
    return max(a, min(one, other)), min(b, max(one, other))


def finger_width(tool: Tool) -> float:
    """Half the width of the narrowest finger solid, across the opening [m]; 0 for a round tool."""
    if not tool.fingers:
        return 0.0
    fingers = [solid.corners for solid in tool.solids() if solid.part == "finger"]
    wide = [float(np.abs((own - tool.point) @ tool.rotation[:, 0]).max()) for own in fingers]
    return min(wide, default=np.inf)


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
