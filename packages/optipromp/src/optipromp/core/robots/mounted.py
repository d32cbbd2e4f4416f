"""A tool as it is mounted and what it holds: its pose on the flange, its loads, a full mouth."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import SPHERE, Sphere
from optipromp.core.robots.tool_geometry import Solid, cover_solids, solids_inertia
from optipromp.core.robots.tool_protocol import Place, Tool, check_tool, outline_of, quaternion
from optipromp.core.values import Validated

UPRIGHT = (1.0, 0.0, 0.0, 0.0)  # the quaternion of no turn
_NO_SHAPE = Sphere(1.0)  # of a solid that only turns
_LATER: Any = None
ROUNDED = 1e-3  # [1] chosen: largest error of a quaternion's length, as in scene files


@dataclass(frozen=True, eq=False)
class Load:
    """A thing that a tool holds, rigidly."""

    id: str  # name of its link
    solids: tuple[Solid, ...]  # convex, in the tool axes from the tool point
    mass: float = 0.0  # [kg]; 0: a thing without weight


@dataclass(frozen=True)
class Mounted(Validated, Tool, label="tool: mount."):
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
    position: Place = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = UPRIGHT
    loads: tuple[Load, ...] = ()
    full: bool = False
    # set with the pose, in the place of the protocol's properties; ``turn`` (3, 3) is from the
    # tool's frame to the flange frame
    turn = point = rotation = fingers = front = tip = depth = gripper_radius = mouth = _LATER

    def __post_init__(self) -> None:
        super().__post_init__()
        length = math.hypot(*self.orientation)
        if not abs(length - 1.0) <= ROUNDED:
            raise InvalidRequestError(
                f"tool: mount.orientation is {list(self.orientation)}, of length {length:.4g}; "
                "must be a unit quaternion w, x, y, z"
            )
        unit = tuple(value / length for value in self.orientation)
        object.__setattr__(self, "orientation", unit)
        check_tool(tool := self.tool)
        turn = Solid("", _NO_SHAPE, np.zeros(3), self.orientation).rotation
        point, axes = (
            np.asarray(turn @ tool.point + self.position),
            np.asarray(turn @ tool.rotation),
        )
        tip, depth, reach = tool.tip, tool.depth, float(point @ axes[:, 2])
        if self._moved:
            tip = reach + depth
            depth = tip - reach
        values = {
            "turn": turn,
            "point": point,
            "rotation": axes,
            "fingers": tool.fingers,
            "front": tool.front + float(np.array(self.position) @ axes[:, 2]),
            "tip": tip,
            "depth": depth,
            "gripper_radius": tool.gripper_radius,
            "mouth": (0.0, tool.mouth[1]) if self.full else tool.mouth,
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, tool: Tool) -> "Mounted":
        """The tool itself if it is one with a mount; else the tool upright on the flange."""
        return tool if isinstance(tool, Mounted) else cls(tool)

    @property
    def _moved(self) -> bool:
        """Whether the mount is not the flange itself, where all numbers stay as they are."""
        return any(self.position) or self.orientation != UPRIGHT

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the tool without its loads, in the flange frame [m]."""
        own = self.tool.spheres()
        return np.column_stack([own[:, :3] @ self.turn.T + self.position, own[:, 3]])

    def outline(self) -> tuple[FloatArray, ...]:
        """The outline of the tool and of its loads, from the tool point; see :class:`Tool`."""
        held = [solid for load in self.placed for solid in load.solids]
        return outline_of(self, held, self.tool.outline())

    def solids(self) -> tuple[Solid, ...]:
        """The solids of the tool, then those of the loads, in the flange frame."""
        own, at = self.tool.solids(), np.array(self.position)
        if self._moved:
            own = tuple(_placed(solid, self.turn, at) for solid in own)
        return (*own, *(solid for load in self.placed for solid in load.solids))

    def holds(self, begin: FloatArray, end: FloatArray) -> BoolArray:
        return self.tool.holds(begin, end)

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
