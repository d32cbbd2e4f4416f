"""A tool that holds something: a fruit in the cup, a punnet, a payload."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.geometry.shapes import SPHERE
from optipromp.core.robots.tool_geometry import Solid, cover_solids, seen, solids_inertia, swept
from optipromp.core.robots.tool_protocol import Tool, quaternion


@dataclass(frozen=True, eq=False)
class Load:
    """A thing that a tool holds, rigidly.

    Attributes:
        id: name of its link.
        solids: convex, in the tool axes from the tool point.
        mass: [kg]; 0: a thing without weight.
    """

    id: str
    solids: tuple[Solid, ...]
    mass: float = 0.0


@dataclass(frozen=True, eq=False)
class Laden(Tool):
    """``tool`` with ``loads`` in it or on it. Mouth, point and axes are those of the tool.

    The robot has a further link for each load (:func:`optipromp.core.robots.tools.with_tool`).
    Solids and outline contain the loads; spheres and inertia do not.
    """

    tool: Tool
    loads: tuple[Load, ...]

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return self.tool.point

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns."""
        return self.tool.rotation

    @property
    def fingers(self) -> bool:
        """Whether the tool opens along y only."""
        return self.tool.fingers

    @property
    def reach(self) -> float:
        """Height of the tool point [m]."""
        return self.tool.reach

    @property
    def front(self) -> float:
        """Height at which the mouth begins [m]."""
        return self.tool.front

    @property
    def tip(self) -> float:
        """Height of the rim, or of the finger tips [m]."""
        return self.tool.tip

    @property
    def depth(self) -> float:
        """Distance of the rim beyond the tool point [m]."""
        return self.tool.depth

    @property
    def gripper_radius(self) -> float:
        """R_gripper [m]."""
        return self.tool.gripper_radius

    @property
    def mouth(self) -> tuple[float, float]:
        """Inner and outer radius of the mouth [m]."""
        return self.tool.mouth

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the tool without its loads, in the flange frame [m]."""
        return self.tool.spheres()

    def outline(self) -> tuple[FloatArray, ...]:
        """The outline of the tool and of its loads; see :meth:`Tool.outline`."""
        found = {part.round(6).tobytes(): part for part in self.tool.outline()}
        for load in self.placed:
            for solid in load.solids:
                local = (solid.corners - self.point) @ self.rotation
                parts = seen(local) if self.fingers else swept(local)
                found |= {part.round(6).tobytes(): part for part in parts}
        return tuple(found.values())

    def solids(self) -> tuple[Solid, ...]:
        """The solids of the tool, then those of the loads, in the flange frame."""
        return (*self.tool.solids(), *(solid for load in self.placed for solid in load.solids))

    def holds(self, points: FloatArray) -> BoolArray:
        """Whether the tool holds objects at points (R, 3); see :meth:`Tool.holds`."""
        return self.tool.holds(points)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre (3,) [m] and inertia (3, 3) [kg m²] of the tool without its loads."""
        return self.tool.inertia(mass)

    @cached_property
    def placed(self) -> tuple[Load, ...]:
        """The loads with their solids in the flange frame."""
        return tuple(
            Load(load.id, tuple(self._placed(load.id, one) for one in load.solids), load.mass)
            for load in self.loads
        )

    def _placed(self, id_: str, solid: Solid) -> Solid:
        at, turned = self.point + self.rotation @ solid.position, self.rotation @ solid.rotation
        w, x, y, z = quaternion(turned).tolist()
        return Solid(f"{id_}:{solid.name}", solid.shape, at, (w, x, y, z), "load")


def loads_of(tool: Tool | None) -> tuple[Load, ...]:
    """The loads of a tool, in the flange frame; none for a tool that holds nothing."""
    return tool.placed if isinstance(tool, Laden) else ()


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
