"""A tool as it is mounted and what it holds: its pose on the flange, its loads, a full mouth."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import SPHERE, Sphere
from optipromp.core.robots.tool_geometry import (
    Solid,
    cover_solids,
    seen_polygon,
    solids_inertia,
    swept_polygons,
)
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length, quaternion

UPRIGHT = (1.0, 0.0, 0.0, 0.0)  # the quaternion of no turn
_NO_SHAPE = Sphere(1.0)  # of a solid that only turns
ROUNDED = 1e-3  # [1] chosen: largest error of a quaternion's length, as in scene files


@dataclass(frozen=True, eq=False)
class Load:
    """A thing that a tool holds, rigidly."""

    id: str  # name of its link
    solids: tuple[Solid, ...]  # convex, in the tool axes from the tool point
    mass: float = 0.0  # [kg]; 0: a thing without weight


@dataclass(frozen=True)
class Mounted(Tool):
    """A tool of any class, placed in the flange frame, with what it holds. Metres.

    The robot has a further link for each load (:func:`optipromp.core.robots.tools.with_tool`).
    Solids and outline contain the loads; spheres and inertia do not.

    Args:
        tool: whose frame is placed.
        position: of that frame's origin, x, y, z.
        orientation: of that frame, a unit quaternion w, x, y, z.
        loads: things in the tool or on it. Mouth, point and axes are those of the tool.
        full: whether the mouth is full, so that the tool takes hold of nothing more.

    Raises:
        InvalidRequestError: a position that is not three lengths, or a quaternion that is not of
            length 1; named with its value.
    """

    tool: Tool
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = UPRIGHT
    loads: tuple[Load, ...] = ()
    full: bool = False

    def __post_init__(self) -> None:
        for name, count in (("position", 3), ("orientation", 4)):
            values = getattr(self, name)
            if np.shape(values) != (count,):
                wanted = "x, y, z" if count == 3 else "w, x, y, z"
                raise InvalidRequestError(f"tool: mount.{name} is {values!r}; must be {wanted}")
            for i, value in enumerate(values):
                check_length("mount", f"{name}[{i}]", value, -LARGEST, LARGEST)
            object.__setattr__(self, name, tuple(float(value) for value in values))
        length = math.hypot(*self.orientation)
        if not abs(length - 1.0) <= ROUNDED:
            raise InvalidRequestError(
                f"tool: mount.orientation is {list(self.orientation)}, of length {length:.4g}; "
                "must be a unit quaternion w, x, y, z"
            )
        unit = tuple(value / length for value in self.orientation)
        object.__setattr__(self, "orientation", unit)

    @classmethod
    def of(cls, tool: Tool) -> "Mounted":
        """The tool itself if it is one with a mount; else the tool upright on the flange."""
        return tool if isinstance(tool, Mounted) else cls(tool)

    @cached_property
    def turn(self) -> FloatArray:
        """(3, 3) from the tool's frame to the flange frame."""
        return Solid("", _NO_SHAPE, np.zeros(3), self.orientation).rotation

    @property
    def _moved(self) -> bool:
        """Whether the mount is not the flange itself, where all numbers stay as they are."""
        return any(self.position) or self.orientation != UPRIGHT

    @property
    def _rise(self) -> float:
        """Height of the tool's frame over the flange's origin, along the tool axis [m]."""
        return float(np.array(self.position) @ self.rotation[:, 2])

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.asarray(self.turn @ self.tool.point + self.position)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns."""
        return np.asarray(self.turn @ self.tool.rotation)

    @property
    def fingers(self) -> bool:
        """Of the tool."""
        return self.tool.fingers

    @property
    def front(self) -> float:
        """Height at which the mouth begins [m]."""
        return self.tool.front + self._rise

    @property
    def tip(self) -> float:
        """Height of the rim, or of the finger tips [m]."""
        return self.reach + self.tool.depth if self._moved else self.tool.tip

    @property
    def depth(self) -> float:
        """Distance of the rim or finger tips beyond the tool point [m]."""
        return super().depth if self._moved else self.tool.depth

    @property
    def gripper_radius(self) -> float:
        """Of the tool [m]."""
        return self.tool.gripper_radius

    @property
    def mouth(self) -> tuple[float, float]:
        """Of the tool [m]; of a full mouth the inner radius is 0."""
        return (0.0, self.tool.mouth[1]) if self.full else self.tool.mouth

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the tool without its loads, in the flange frame [m]."""
        own = self.tool.spheres()
        return np.column_stack([own[:, :3] @ self.turn.T + self.position, own[:, 3]])

    def outline(self) -> tuple[FloatArray, ...]:
        """The outline of the tool and of its loads, from the tool point; see :class:`Tool`."""
        outline = {part.round(6).tobytes(): part for part in self.tool.outline()}
        for load in self.placed:
            for solid in load.solids:
                local = (solid.corners - self.point) @ self.rotation
                parts = seen_polygon(local) if self.fingers else swept_polygons(local)
                outline |= {part.round(6).tobytes(): part for part in parts}
        return tuple(outline.values())

    def solids(self) -> tuple[Solid, ...]:
        """The solids of the tool, then those of the loads, in the flange frame."""
        return (*self.own_solids, *(solid for load in self.placed for solid in load.solids))

    @property
    def own_solids(self) -> tuple[Solid, ...]:
        """The solids of the tool without its loads, in the flange frame."""
        own = self.tool.solids()
        if not self._moved:
            return own
        return tuple(_placed(solid, self.turn, np.array(self.position)) for solid in own)

    def holds(self, points: FloatArray) -> BoolArray:
        """Whether the tool holds objects at points (R, 3), in tool axes from the tool point."""
        return self.tool.holds(points)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre (3,) [m] and inertia about it (3, 3) [kg m²] of the tool without its loads."""
        center, own = self.tool.inertia(mass)
        return self.turn @ center + self.position, self.turn @ own @ self.turn.T

    @cached_property
    def placed(self) -> tuple[Load, ...]:
        """The loads with their solids in the flange frame."""
        out = []
        for load in self.loads:
            own = (_placed(solid, self.rotation, self.point) for solid in load.solids)
            named = (replace(one, name=f"{load.id}:{one.name}", part="load") for one in own)
            out.append(replace(load, solids=tuple(named)))
        return tuple(out)


def _placed(solid: Solid, turn: FloatArray, at: FloatArray) -> Solid:
    """A solid whose frame is turned by ``turn`` (3, 3) and then moved by ``at`` (3,) [m]."""
    w, x, y, z = quaternion(turn @ solid.rotation).tolist()
    return replace(solid, position=turn @ solid.position + at, orientation=(w, x, y, z))


def unmounted(tool: Tool | None) -> Tool | None:
    """The tool itself, without its mount and its loads."""
    return tool.tool if isinstance(tool, Mounted) else tool


def loads_of(tool: Tool | None) -> tuple[Load, ...]:
    """The loads of a tool, in the flange frame; none for a tool that holds nothing."""
    return tool.placed if isinstance(tool, Mounted) else ()


def without_loads(tool: Tool) -> Tool:
    """The tool as it is mounted, holding nothing."""
    if not isinstance(tool, Mounted):
        return tool
    return replace(tool, loads=()) if tool._moved else tool.tool


def cover_load(load: Load) -> FloatArray:
    """Spheres (k, 4) that cover a load, in the frame of its solids [m]: a ball is one sphere."""
    balls = [solid for solid in load.solids if solid.shape.measure.kind == SPHERE]
    rest = [solid for solid in load.solids if solid.shape.measure.kind != SPHERE]
    covers = [np.array([[*ball.position, ball.shape.measure.bound]]) for ball in balls]
    if rest:
        covers.append(cover_solids(rest))
    return frozen(np.concatenate(covers))


def weight_of(tool: Tool | None) -> tuple[float, FloatArray]:
    """Mass [kg] and centre of mass (3,) [m] of the loads of a tool, in the flange frame."""
    heavy = [load for load in loads_of(tool) if load.mass > 0.0]
    mass = sum(load.mass for load in heavy)
    if not mass:
        return 0.0, np.zeros(3)
    moments = [load.mass * solids_inertia(load.solids, load.mass)[0] for load in heavy]
    return mass, np.asarray(np.sum(moments, axis=0) / mass)
