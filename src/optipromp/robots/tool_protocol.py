"""The protocol of a tool, :class:`Tool`, and the solids that a tool is made of."""

import math
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from optipromp.arrays import BoolArray, FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.geometry.shapes import Box, Cylinder, MeshShape

Part = Literal["mouth", "neck", "palm", "finger"]
LARGEST = 5.0  # [m] a tool dimension beyond it is taken for millimetres


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex solid of a tool, in the flange frame.

    Attributes:
        name: unique within the tool.
        shape: a box, a cylinder along its z, or a convex mesh.
        position: (3,) of the shape's own frame [m].
        orientation: of the shape's own frame, a unit quaternion w, x, y, z.
        part: kind of part, which gives its colour in pictures.
    """

    name: str
    shape: Box | Cylinder | MeshShape
    position: FloatArray
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    part: Part = "palm"

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the flange frame from the shape's own."""
        from scipy.spatial.transform import Rotation

        w, x, y, z = self.orientation
        return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())


@runtime_checkable
class Tool(Protocol):
    """A tool on the flange: the members that planners, judge, simulation and pictures use.

    An object of any class with these members can be mounted
    (:func:`optipromp.robots.tools.with_tool`); it must not change from then on. Lengths are metres.

    The *tool axes* are x, y and z: z is the tool axis and points out of the mouth; fingers open
    along y. The *tool point* is the place of the centre of a fruit that the tool holds.
    """

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame."""

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns."""

    @property
    def fingers(self) -> bool:
        """Whether it opens along y alone; then y is kept level. False: a round tool."""

    @property
    def reach(self) -> float:
        """Height of the tool point over the flange's origin, along the tool axis."""

    @property
    def front(self) -> float:
        """Height at which the mouth begins: a cup's floor, a hand's palm."""

    @property
    def tip(self) -> float:
        """Height of the rim, or of the finger tips."""

    @property
    def depth(self) -> float:
        """How far rim or finger tips are beyond the tool point: ``tip - reach``."""

    @property
    def gripper_radius(self) -> float:
        """R_gripper: distance of the tool axis from the centre of a fruit that it passes."""

    @property
    def mouth(self) -> tuple[float, float]:
        """Inner and outer radius of the mouth, or half the distance of fingers and of their backs.

        An inner radius of 0: the tool takes hold of nothing. The push models treat it as solid.
        """

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) that cover the solids, in the flange frame."""

    def outline(self) -> tuple[FloatArray, ...]:
        """The tool seen along its x: convex polygons (k, 2), k <= 8, counter-clockwise.

        Columns: along the tool axis and along y, from the tool point. A round tool, whose
        roll is free, gives the outline of the volume that it sweeps as it rolls.
        """

    def solids(self) -> tuple[Solid, ...]:
        """Solids that collide in the simulation and that pictures show."""

    def holds(self, points: FloatArray) -> BoolArray:
        """Whether the tool holds objects at points (R, 3), in tool axes from the tool point."""

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre of a mass [kg] (3,) and inertia about it (3, 3) [kg m²], in the flange frame."""


MEMBERS = tuple(name for name in vars(Tool) if not name.startswith("_"))
AGREE = 1e-6  # [m] largest difference of two numbers of a tool that must agree: rounding


def check_tool(tool: Tool) -> None:
    """Refuse an object without the members of a tool, and a tool whose numbers disagree.

    Raises:
        InvalidRequestError: naming the members, their values and what would be right.
    """
    name = type(tool).__name__
    missing = [member for member in MEMBERS if not hasattr(tool, member)]
    if missing:
        raise InvalidRequestError(
            f"{name} is no tool: it lacks {', '.join(missing)}; see optipromp.robots.Tool"
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
    tool: str, field: str, value: object, low: float, high: float, open_below: bool = False
) -> None:
    """Refuse a length that is no number between ``low`` and ``high`` [m].

    Raises:
        InvalidRequestError: naming the tool, the field, the value and the range.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if (
        number
        and math.isfinite(value)  # type: ignore[arg-type]
        and low <= value <= high  # type: ignore[operator]
        and not (open_below and value <= low)  # type: ignore[operator]
    ):
        return
    bracket = "(" if open_below else "["
    raise InvalidRequestError(
        f"tool {tool}: {field} is {value!r}; it must be in {bracket}{low:g}, {high:g}] metres"
    )


def quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternion wxyz of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])
