"""A tool made of convex meshes, with a tool point and a tool axis."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import MeshShape, is_convex
from optipromp.core.robots.meshes import pieces
from optipromp.core.robots.tool_geometry import Part, Solid, profile
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length

MESH_PLAY = 1e-4  # [m] that a piece may reach into the mouth, chosen: files have single precision
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class MeshTool(Tool):
    """A tool of the user's own shape: convex pieces in the flange frame. Metres.

    Every connected piece of the meshes must be convex; CoACD and V-HACD cut a mesh into convex
    parts. The tool counts as round: its roll is free, and it pushes with the volume that it sweeps
    as it rolls.

    Args:
        meshes: in the flange frame.
        tool_point: place of the centre of a fruit that the tool holds.
        tool_axis: out of the mouth.
        opening: inner diameter of a round mouth about the tool axis; None: the tool takes hold of
            nothing, and the models of the push treat it as solid.
        height: of the mouth, from its floor to the rim; with ``opening`` only.

    Raises:
        InvalidRequestError: no meshes, a piece that is not convex, an axis without direction, a
            mouth that does not fit the meshes; named with its value.
    """

    meshes: tuple[MeshShape, ...]
    tool_point: Vector
    tool_axis: Vector = (0.0, 0.0, 1.0)
    opening: float | None = None
    height: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", tuple(self.meshes))
        for field in ("tool_point", "tool_axis"):
            values = getattr(self, field)
            if np.shape(values) != (3,):
                raise InvalidRequestError(f"tool mesh: {field} is {values!r}; it must be x, y, z")
            for i, value in enumerate(values):
                check_length("mesh", f"{field}[{i}]", value, -LARGEST, LARGEST)
            object.__setattr__(self, field, tuple(values))
        if not math.hypot(*self.tool_axis) > 0.0:
            raise InvalidRequestError(
                f"tool mesh: tool_axis is {self.tool_axis}; it must have a direction"
            )
        _pieces(self.meshes)
        if (self.opening is None) != (self.height is None):
            raise InvalidRequestError(
                f"tool mesh: opening is {self.opening} and height is {self.height}; a mouth needs "
                "both [m], a tool that takes hold of nothing has neither"
            )
        if self.opening is not None and self.height is not None:
            self._check_mouth(self.opening, self.height)

    def _check_mouth(self, opening: float, height: float) -> None:
        low, high, inner, _ = self._profile.T
        check_length("mesh", "height", height, 0.0, float(high.max() - low.min()), open_below=True)
        check_length("mesh", "opening", opening, 0.0, 2.0 * self.mouth[1], open_below=True)
        within = (high > self.front - self.reach + MESH_PLAY) & (inner < opening / 2.0 - MESH_PLAY)
        if within.any():
            free = 2.0 * float(inner[high > self.front - self.reach + MESH_PLAY].min())
            raise InvalidRequestError(
                f"tool mesh: opening is {opening:g} and height is {height:g}, but "
                f"piece {int(np.argmax(within))} of {len(within)} is in that mouth; along the tool "
                f"axis there is room for an opening of {free:.4f} metres"
            )

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.array(self.tool_point, dtype=np.float64)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns."""
        return _axes(self.tool_axis)

    @property
    def tip(self) -> float:
        """Height of the foremost point of the meshes [m]."""
        return self.reach + self.depth

    @property
    def depth(self) -> float:
        """Distance of the foremost point of the meshes beyond the tool point [m]."""
        return float(self._profile[:, 1].max())

    @property
    def front(self) -> float:
        """Height of the mouth's floor; of the hindmost point where there is no mouth [m]."""
        if self.height is None:
            return self.reach + float(self._profile[:, 0].min())
        return self.tip - self.height

    @property
    def mouth(self) -> tuple[float, float]:
        """Half the opening, or 0, and the greatest radius of the pieces beyond ``front`` [m]."""
        _, high, _, outer = self._profile.T
        before = high > self.front - self.reach + MESH_PLAY
        return (self.opening or 0.0) / 2.0, float(outer[before].max())

    def solids(self) -> tuple[Solid, ...]:
        """The pieces."""
        part: Part = "palm" if self.opening is None else "mouth"
        return tuple(
            Solid(f"piece:{k}", piece, np.zeros(3), part=part)
            for k, piece in enumerate(_pieces(self.meshes))
        )

    @property
    def _profile(self) -> FloatArray:
        """(K, 4) [m] of the pieces: least and largest height over the tool point, and radius."""
        return _profiles(self.meshes, self.tool_point, self.tool_axis)


def _axes(axis: Vector) -> FloatArray:
    """Orthonormal right-handed axes (3, 3), as columns; the last is along ``axis``."""
    z = np.array(axis) / math.hypot(*axis)
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@functools.lru_cache(maxsize=32)
def _pieces(meshes: tuple[MeshShape, ...]) -> tuple[MeshShape, ...]:
    """The connected pieces of meshes, each convex."""
    if not meshes:
        raise InvalidRequestError("tool mesh: meshes is empty; there must be one at least")
    out = []
    for mesh in meshes:
        far = float(np.abs(mesh.vertices).max())
        if far > LARGEST:
            raise InvalidRequestError(
                f"tool mesh: {mesh.path or 'a mesh'} reaches {far:g} m from the flange (at most "
                f"{LARGEST:g}): millimetres? then give it the scale 0.001"
            )
        parts = pieces(mesh.vertices, mesh.faces)
        for k, faces in enumerate(parts):
            used, own = np.unique(faces, return_inverse=True)
            piece = MeshShape(mesh.vertices[used], own.reshape(-1, 3))
            if not is_convex(piece):
                raise InvalidRequestError(
                    f"tool mesh: {mesh.path or 'a mesh'}: piece {k} of {len(parts)} is not convex; "
                    "cut it into convex parts"
                )
            out.append(piece)
    return tuple(out)


@functools.lru_cache(maxsize=32)
def _profiles(meshes: tuple[MeshShape, ...], point: Vector, axis: Vector) -> FloatArray:
    turned = _axes(axis)
    return frozen([profile((piece.vertices - point) @ turned) for piece in _pieces(meshes)])
