"""Tools with two straight fingers or blades on a body; they stay open."""

import functools
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optipromp.arrays import BoolArray, FloatArray, frozen
from optipromp.errors import InvalidRequestError
from optipromp.geometry.shapes import Box
from optipromp.robots.tool_geometry import cover_solids, solids_inertia
from optipromp.robots.tool_protocol import LARGEST, Part, Solid, check_length

Size = tuple[float, float, float]


class TwoFingers(ABC):
    """The base class of grippers: two boxes, the fingers, on a box, the body.

    The body stands on the flange and is centred there. Fingers stand side by side on the body.
    """

    fingers: ClassVar[bool] = True
    opening: float  # [m]
    depth: float  # [m]
    turn: float  # [rad] about flange z

    @property
    @abstractmethod
    def _finger(self) -> Size:
        """Size of a finger across the opening, along it, and along the tool axis [m]."""

    @property
    @abstractmethod
    def _body(self) -> Size:
        """Size of the body, likewise [m]."""

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.array([0.0, 0.0, self.reach])

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns; it opens along y."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def reach(self) -> float:
        """Height of the tool point over the flange [m]."""
        return self.tip - self.depth

    @property
    def front(self) -> float:
        """Height of the front of the body over the flange [m]."""
        return self._body[2]

    @property
    def tip(self) -> float:
        """Height of the finger tips over the flange [m]."""
        return self._body[2] + self._finger[2]

    @property
    def gripper_radius(self) -> float:
        """Half the opening between the fingers [m]."""
        return self.mouth[0]

    @property
    def mouth(self) -> tuple[float, float]:
        """Half the opening between the fingers, and half the distance of their backs [m]."""
        half = 0.5 * self.opening
        return half, half + self._finger[1]

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) over body and fingers, in the flange frame [m]."""
        return _covered(self)

    def outline(self) -> tuple[FloatArray, ...]:
        """Body and fingers seen along the tool's x: three rectangles; see :class:`Tool`."""
        flange, front, tip = -self.reach, self.front - self.reach, self.tip - self.reach
        (inner, outer), wide = self.mouth, 0.5 * self._body[1]
        sides = (
            (flange, front, -wide, wide), (front, tip, inner, outer), (front, tip, -outer, -inner),
        )  # fmt: skip
        return tuple(np.array([[a, c], [b, c], [b, d], [a, d]]) for a, b, c, d in sides)

    def solids(self) -> tuple[Solid, ...]:
        """The body and two fingers."""
        half = 0.5 * self.turn
        turned = math.cos(half), 0.0, 0.0, math.sin(half)
        aside = 0.5 * (self.mouth[0] + self.mouth[1])
        boxes: tuple[tuple[str, Size, float, float, Part], ...] = (
            ("palm", self._body, 0.0, 0.5 * self._body[2], "palm"),
            ("left finger", self._finger, aside, 0.5 * (self.front + self.tip), "finger"),
            ("right finger", self._finger, -aside, 0.5 * (self.front + self.tip), "finger"),
        )
        return tuple(
            Solid(name, Box(size), self.rotation @ [0.0, y, z], turned, part)
            for name, size, y, z, part in boxes
        )

    def holds(self, points: FloatArray) -> BoolArray:
        """Between the fingers and within their width, from body to tips; points (R, 3)."""
        ends = self.front - self.reach, self.tip - self.reach
        return between(points, self.mouth[0], 0.5 * self._finger[0], ends)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Of body and fingers, of one density."""
        return solids_inertia(self.solids(), mass)


@dataclass(frozen=True)
class FingerGripper(TwoFingers):
    """A gripper with two parallel fingers, open. Metres.

    Body and fingers are boxes. *Length* is along the tool axis, *width* of the palm and
    *thickness* of a finger along the opening, *thickness* of the palm and *width* of a finger
    across both. The gripper takes hold of objects whose centre is between the fingers, within
    their width. The tool point is ``depth`` behind the finger tips.

    Args:
        opening: between the open fingers.
        finger_length: of a finger.
        finger_width: of a finger, across the opening.
        finger_thickness: of a finger, along the opening.
        palm_length: of the body, from the flange.
        palm_width: of the body, along the opening.
        palm_thickness: of the body, across the opening.
        depth: how far the finger tips are beyond the tool point.
        turn: of the gripper about flange z; at 0 it opens along flange y [rad].

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    opening: float
    finger_length: float = 0.05
    finger_width: float = 0.02
    finger_thickness: float = 0.01
    palm_length: float = 0.08
    palm_width: float = 0.10
    palm_thickness: float = 0.05
    depth: float = 0.01
    turn: float = 0.0

    def __post_init__(self) -> None:
        lengths = ("palm_length", "palm_width", "palm_thickness")
        _check(self, "finger_gripper", "finger", lengths)

    @property
    def _finger(self) -> Size:
        return self.finger_width, self.finger_thickness, self.finger_length

    @property
    def _body(self) -> Size:
        return self.palm_thickness, self.palm_width, self.palm_length


@dataclass(frozen=True)
class Scissor(TwoFingers):
    """A scissor of two thin open blades on a body. Metres.

    Blades and body are boxes, named and measured as the fingers and the palm of
    :class:`FingerGripper`. The scissor takes hold of objects whose centre is between the blades,
    within their width. To cut a stem, give the scene a goal on the stem in place of a target. The
    simulation then reports the harm of the motion, not whether the stem is cut.

    Args:
        opening: between the open blades.
        blade_length: of a blade.
        blade_width: of a blade, across the opening.
        blade_thickness: of a blade, along the opening.
        body_length: of the body, from the flange.
        body_width: of the body, along the opening.
        body_thickness: of the body, across the opening.
        depth: how far the blade tips are beyond the tool point.
        turn: of the scissor about flange z; at 0 it opens along flange y [rad].

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    opening: float
    blade_length: float = 0.05
    blade_width: float = 0.012
    blade_thickness: float = 0.002
    body_length: float = 0.10
    body_width: float = 0.06
    body_thickness: float = 0.03
    depth: float = 0.015
    turn: float = 0.0

    def __post_init__(self) -> None:
        lengths = ("body_length", "body_width", "body_thickness")
        _check(self, "scissor", "blade", lengths)

    @property
    def _finger(self) -> Size:
        return self.blade_width, self.blade_thickness, self.blade_length

    @property
    def _body(self) -> Size:
        return self.body_thickness, self.body_width, self.body_length


def between(
    points: FloatArray, half: float, half_width: float, ends: tuple[float, float]
) -> BoolArray:
    """Whether points (R, 3) in tool axes are between two fingers: across, in width, along them."""
    x, y, z = points.T
    across = (np.abs(y) < half) & (np.abs(x) <= half_width)
    return np.asarray(across & (z > ends[0]) & (z <= ends[1]))


@functools.lru_cache(maxsize=32)
def _covered(tool: TwoFingers) -> FloatArray:
    return frozen(cover_solids(tool.solids()))


def _check(tool: TwoFingers, kind: str, finger: str, body: tuple[str, ...]) -> None:
    """Refuse sizes that make no gripper; the fingers stand on the body."""
    for field in (*(f"{finger}_{part}" for part in ("length", "width", "thickness")), *body):
        check_length(kind, field, getattr(tool, field), 0.0, LARGEST, open_below=True)
    check_length(kind, "opening", tool.opening, 0.0, tool._body[1], open_below=True)
    check_length(kind, "depth", tool.depth, 0.0, tool._finger[2])
    turn: object = tool.turn
    if isinstance(turn, bool) or not (isinstance(turn, int | float) and math.isfinite(turn)):
        raise InvalidRequestError(f"tool {kind}: turn is {turn!r}; it must be a number [rad]")
