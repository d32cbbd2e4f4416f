"""The faces of shapes (see :mod:`optipromp.core.geometry.faces`), and triangles that shade well."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.geometry.shapes import Shape

_LARGEST_FACE = 0.04  # [m] larger flat faces are cut, so that a painter can sort them by depth
_CREASE = 0.77  # cosine of 40 degrees, a choice: a sharper edge is shaded as an edge
_DIGITS = 7  # decimals of a corner [m] by which corners are the same


def shape_faces(
    shape: Shape, position: FloatArray, rotation: FloatArray, cut: float = _LARGEST_FACE
) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world.

    ``shape``: the shape in its local frame. ``position``: (3,) [m]. ``rotation``: (3, 3), world
    from local. ``cut``: largest edge of a flat face [m], unless an edge takes too many faces.
    """
    return np.asarray(shape.surface(cut) @ np.asarray(rotation).T + np.asarray(position))


def triangles(faces: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (M, 3) of faces (F, 4, 3), or of triangles (M, 3, 3).

    Corners at one place are one vertex where the surface is smooth, so that a viewer that averages
    normals shades it smoothly; they are several vertices at an edge sharper than :data:`_CREASE`.
    Triangles of no area are left out.
    """
    corners = faces
    if faces.shape[1] == 4:
        corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    place = np.round(corners, _DIGITS) + 0.0
    normal = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
    area = np.linalg.norm(normal, axis=1)
    place, normal = place[area > 0.0], normal[area > 0.0]
    if not len(place):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    _, at = _alike(place.reshape(-1, 3))
    unit = np.repeat(normal / np.linalg.norm(normal, axis=1)[:, None], 3, axis=0)
    count = np.bincount(at)
    order = np.argsort(at, kind="stable")  # corners by place; each meets all others of its place
    one = np.repeat(order, count[at[order]])
    start = np.repeat((np.cumsum(count) - count)[at[order]], count[at[order]])
    step = np.arange(len(one)) - np.repeat(
        np.cumsum(count[at[order]]) - count[at[order]], count[at[order]]
    )
    other = order[start + step]
    alike = np.einsum("ci,ci->c", unit[one], unit[other]) > _CREASE
    mean = np.zeros_like(unit)
    np.add.at(mean, one[alike], np.repeat(normal, 3, axis=0)[other[alike]])
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    keys = np.column_stack([at, np.round(mean, 2)]) + 0.0
    first, index = _alike(keys)
    return place.reshape(-1, 3)[first], index.reshape(-1, 3).astype(np.int64)


def coarser(corners: FloatArray, cell: float) -> FloatArray:
    """Fewer triangles (M, 3, 3): all corners in a cell of a grid move to their mean."""
    points = corners.reshape(-1, 3)
    _, cells = _alike(np.floor(points / cell))
    count = np.bincount(cells)
    mean = np.stack([np.bincount(cells, column) for column in points.T], axis=1) / count[:, None]
    a, b, c = (index := cells.reshape(-1, 3)).T
    whole = index[(a != b) & (b != c) & (c != a)]
    first, _ = _alike(np.sort(whole, axis=1))
    return np.asarray(mean[whole[np.sort(first)]])


def _alike(rows: FloatArray | IntArray) -> tuple[IntArray, IntArray]:
    """The first of each kind of ``rows`` (k, d), and the kind of each (k,); a faster np.unique."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=np.bool_)
    new[1:] = (np.diff(rows[order], axis=0) != 0).any(axis=1)
    kind = np.empty(len(rows), dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


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
