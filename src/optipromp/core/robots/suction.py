"""A suction cup on a stem: it takes hold of what its lip touches."""

from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Cylinder
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.tool_geometry import Solid
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length


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
