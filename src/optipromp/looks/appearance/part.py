"""One coloured surface of a robot or a scene."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.looks.appearance.faces import triangles

Colour = tuple[int, int, int]  # sRGB, 0 to 255


@dataclass(frozen=True, eq=False)
class Part:
    """A surface that moves as one.

    Attributes:
        name: unique among the parts of a robot, or of a scene; in files ``/`` separates a group.
        segment: of the robot, which carries the part; -1: the base, or the world.
        vertices: (v, 3) in the frame of that segment [m]; of a scene, in the robot's base frame.
        faces: (f, 3) rows of vertices, anticlockwise seen from outside.
        colour: sRGB, each 0 to 255.
        opacity: 0 to 1.
        owner: id of the scene's object; empty where the part is of none.
    """

    name: str
    segment: int
    vertices: FloatArray
    faces: IntArray
    colour: Colour
    opacity: float = 1.0
    owner: str = ""

    @classmethod
    def of(
        cls, name: str, faces: FloatArray, colour: str, *, segment: int = -1, opacity: float = 1.0,
        owner: str = "",
    ) -> Self:  # fmt: skip
        """A part of faces (F, 4, 3), or triangles (F, 3, 3), in a colour ``#rrggbb``."""
        vertices, rows = triangles(faces)
        return cls(
            name, segment, frozen(vertices), frozen(rows, np.int64), rgb(colour), opacity, owner
        )

    def placed(self, position: FloatArray, rotation: FloatArray) -> Self:
        """The same part, its frame at a position (3,) [m] with a rotation (3, 3)."""
        return replace(self, vertices=frozen(self.vertices @ rotation.T + position))


def rgb(colour: str) -> Colour:
    """The numbers of ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def hex_colour(colour: Iterable[int]) -> str:
    """``#rrggbb`` of the first three numbers."""
    return "#" + bytes(int(value) for value in colour)[:3].hex()
