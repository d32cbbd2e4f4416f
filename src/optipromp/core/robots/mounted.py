"""A tool on a flange at a pose of its own, in place of upright at the flange's origin."""

import math
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.robots.tool_geometry import Solid
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length, quaternion

_NO_SHAPE = Sphere(1.0)  # of a solid that only turns
ROUNDED = 1e-3  # [1] chosen: largest error of a quaternion's length, as in scene files


@dataclass(frozen=True)
class Mounted(Tool):
    """A tool of any class, placed in the flange frame. Metres.

    Args:
        tool: whose frame is placed.
        position: of that frame's origin, x, y, z.
        orientation: of that frame, a unit quaternion w, x, y, z.

    Raises:
        InvalidRequestError: a position that is not three lengths, or a quaternion that is not of
            length 1; named with its value.
    """

    tool: Tool
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

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

    @property
    def turn(self) -> FloatArray:
        """(3, 3) from the tool's frame to the flange frame."""
        return Solid("", _NO_SHAPE, np.zeros(3), self.orientation).rotation

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
        return self.reach + self.tool.depth

    @property
    def gripper_radius(self) -> float:
        """Of the tool [m]."""
        return self.tool.gripper_radius

    @property
    def mouth(self) -> tuple[float, float]:
        """Of the tool [m]."""
        return self.tool.mouth

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the solids, in the flange frame [m]."""
        own = self.tool.spheres()
        return np.column_stack([own[:, :3] @ self.turn.T + self.position, own[:, 3]])

    def outline(self) -> tuple[FloatArray, ...]:
        """Of the tool: in its axes, from the tool point."""
        return self.tool.outline()

    def solids(self) -> tuple[Solid, ...]:
        """Those of the tool, placed."""
        out = []
        for solid in self.tool.solids():
            w, x, y, z = quaternion(self.turn @ solid.rotation).tolist()
            at = self.turn @ solid.position + self.position
            out.append(replace(solid, position=at, orientation=(w, x, y, z)))
        return tuple(out)

    def holds(self, points: FloatArray) -> BoolArray:
        """Whether the tool holds objects at points (R, 3), in tool axes from the tool point."""
        return self.tool.holds(points)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre of a mass [kg] (3,) and inertia about it (3, 3) [kg m²], in the flange frame."""
        center, own = self.tool.inertia(mass)
        return self.turn @ center + self.position, self.turn @ own @ self.turn.T


def unmounted(tool: Tool | None) -> Tool | None:
    """The tool itself, without its mount."""
    return tool.tool if isinstance(tool, Mounted) else tool
