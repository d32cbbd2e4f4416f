"""Tools with two straight fingers or blades on a body, which stay open; a suction cup."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.tool_geometry import Part, Solid
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length

Size = tuple[float, float, float]


class TwoFingers(Tool):
    """The base class of grippers: two boxes, the fingers, side by side on a box, the body.

    The body stands centred on the flange.
    """

    fingers = True
    names: tuple[str, str, str]  # of the kind, and of a finger and the body in the parameters
    opening: float  # [m]
    depth: float  # [m]
    turn: float  # [rad] about flange z

    def __post_init__(self) -> None:
        kind, finger, body = self.names
        for part in (finger, body):
            for side in ("length", "width", "thickness"):
                given = getattr(self, f"{part}_{side}")
                check_length(kind, f"{part}_{side}", given, 0.0, LARGEST, open_below=True)
        check_length(kind, "opening", self.opening, 0.0, self._body[1], open_below=True)
        check_length(kind, "depth", self.depth, 0.0, self._finger[2])
        turn: object = self.turn
        if isinstance(turn, bool) or not (isinstance(turn, int | float) and math.isfinite(turn)):
            raise InvalidRequestError(f"tool {kind}: turn is {turn!r}; it must be a number [rad]")

    def _size(self, part: str, *sides: str) -> Size:
        x, y, z = (getattr(self, f"{part}_{side}") for side in sides)
        return x, y, z

    @property
    def _finger(self) -> Size:
        """Size of a finger across the opening, along it, and along the tool axis [m]."""
        return self._size(self.names[1], "width", "thickness", "length")

    @property
    def _body(self) -> Size:
        """Size of the body, likewise [m]."""
        return self._size(self.names[2], "thickness", "width", "length")

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.array([0.0, 0.0, self.tip - self.depth])

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns; it opens along y."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def front(self) -> float:
        """Height of the front of the body over the flange [m]."""
        return self._body[2]

    @property
    def tip(self) -> float:
        """Height of the finger tips over the flange [m]."""
        return self._body[2] + self._finger[2]

    @property
    def mouth(self) -> tuple[float, float]:
        """Half the opening between the fingers, and half the distance of their backs [m]."""
        half = 0.5 * self.opening
        return half, half + self._finger[1]

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
        depth: distance of the finger tips beyond the tool point.
        turn: of the gripper about flange z; at 0 it opens along flange y [rad].

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    names = "finger_gripper", "finger", "palm"
    opening: float
    finger_length: float = 0.05
    finger_width: float = 0.02
    finger_thickness: float = 0.01
    palm_length: float = 0.08
    palm_width: float = 0.10
    palm_thickness: float = 0.05
    depth: float = 0.01
    turn: float = 0.0


@dataclass(frozen=True)
class Scissor(TwoFingers):
    """A scissor of two thin open blades on a body. Metres.

    Blades and body are boxes, named and measured as the fingers and the palm of
    :class:`FingerGripper`. The scissor takes hold of objects whose centre is between the blades,
    within their width. At a target that hangs the tool point ends on the stem, ``cut`` from the
    fruit, where the blades close.

    Args:
        opening: between the open blades.
        blade_length: of a blade.
        blade_width: of a blade, across the opening.
        blade_thickness: of a blade, along the opening.
        body_length: of the body, from the flange.
        body_width: of the body, along the opening.
        body_thickness: of the body, across the opening.
        depth: distance of the blade tips beyond the tool point.
        turn: of the scissor about flange z; at 0 it opens along flange y [rad].
        cut: distance of the place of the cut from the fruit. Above ``depth`` and half of the
            body's thickness, so that the closing blades and the body miss the fruit.

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    names = "scissor", "blade", "body"
    opening: float
    blade_length: float = 0.05
    blade_width: float = 0.012
    blade_thickness: float = 0.002
    body_length: float = 0.10
    body_width: float = 0.06
    body_thickness: float = 0.03
    depth: float = 0.015
    turn: float = 0.0
    cut: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        check_length("scissor", "cut", self.cut, 0.0, LARGEST, open_below=True)


@dataclass(frozen=True)
class Suction(Tool):
    """A suction cup: a lip at the end of a stem along flange z. Metres.

    It takes hold of an object that its lip touches, within ``radius`` of the tool axis and with a
    force that is at most ``angle`` off that axis. The push models treat it as solid.

    Args:
        radius: of the lip.
        length: from the flange to the lip.
        height: of the cup, the wide part behind the lip.
        angle: largest angle between the tool axis and the touched surface's normal [degrees].
        fruit: distance from the lip to the tool point, where the centre of a touched fruit is. In a
            scene file without ``fruit``: the target's radius less :data:`PRESS`.

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    radius: float
    length: float = 0.10
    height: float = 0.015
    angle: float = 30.0
    fruit: float = 0.015

    def __post_init__(self) -> None:
        check_length("suction", "radius", self.radius, 0.0, LARGEST, open_below=True)
        check_length("suction", "length", self.length, 0.0, LARGEST, open_below=True)
        check_length("suction", "height", self.height, 0.0, self.length, open_below=True)
        check_length("suction", "fruit", self.fruit, 0.0, LARGEST)
        check_length("suction", "angle [degrees]", self.angle, 0.0, 90.0, open_below=True)

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.array([0.0, 0.0, self.length + self.fruit])

    @property
    def front(self) -> float:
        """Height of the cup's back over the flange [m]."""
        return self.length - self.height

    @property
    def tip(self) -> float:
        """Height of the lip over the flange [m]."""
        return self.length

    @property
    def mouth(self) -> tuple[float, float]:
        """0, as the cup swallows nothing, and the radius of the lip [m]."""
        return 0.0, self.radius

    def solids(self) -> tuple[Solid, ...]:
        """The stem and the cup."""
        cup = Cylinder(self.radius, self.height)
        out = [
            Solid("cup", cup, np.array([0.0, 0.0, self.length - 0.5 * self.height]), part="mouth")
        ]
        if self.front > 0.0:
            stem = Cylinder(min(NECK_RADIUS, self.radius), self.front)
            out.append(Solid("stem", stem, np.array([0.0, 0.0, 0.5 * self.front]), part="neck"))
        return tuple(out)


PRESS = 0.002  # [m] chosen: by which the lip would enter a fruit that did not yield
