"""A tool made of convex meshes, with a tool point and a tool axis."""

import functools
import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import MeshShape, is_convex, parted
from optipromp.core.robots.tool_geometry import Part, Solid, profile
from optipromp.core.robots.tool_protocol import LARGEST, Tool, check_length

MESH_PLAY = 1e-4  # [m] that a piece may reach into the mouth, chosen: files have single precision
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class MeshTool(Tool):
    """A tool of the user's own shape: convex pieces in the flange frame. Metres.

    Every connected piece of the meshes must be convex; CoACD and V-HACD cut a mesh into convex
    parts. Without fingers the tool counts as round: its roll is free, and it pushes with the volume
    that it sweeps as it rolls. With fingers it opens along the line between their middles, across
    the tool axis, and takes hold of what is between them, as
    :class:`optipromp.core.robots.grippers.FingerGripper` does.

    Args:
        meshes: in the flange frame.
        tool_point: place of the centre of a fruit that the tool holds.
        tool_axis: out of the mouth.
        opening: inner diameter of a round mouth about the tool axis, or distance of the fingers;
            None: that of the finger meshes, or, without fingers, the tool takes hold of nothing,
            and the models of the push treat it as solid.
        height: of a round mouth, from its floor to the rim; with ``opening`` only.
        finger_meshes: two or more, on both sides of the tool axis; ``meshes`` are then the body.

    Raises:
        InvalidRequestError: no meshes, a piece that is not convex, an axis without direction, a
            mouth that does not fit the meshes; named with its value.
    """

    meshes: tuple[MeshShape, ...]
    tool_point: Vector
    tool_axis: Vector = (0.0, 0.0, 1.0)
    opening: float | None = None
    height: float | None = None
    finger_meshes: tuple[MeshShape, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", tuple(self.meshes))
        object.__setattr__(self, "finger_meshes", tuple(self.finger_meshes))
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
        _pieces(self._all)
        if self.finger_meshes:
            self._check_fingers()
            return
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
    def _all(self) -> tuple[MeshShape, ...]:
        return self.meshes + self.finger_meshes

    def _check_fingers(self) -> None:
        if self.height is not None:
            raise InvalidRequestError(
                f"tool mesh: height is {self.height}; it is of a round mouth, and this tool has "
                "fingers"
            )
        middles = [
            _sides(mesh, self.tool_point, self.rotation).mean() for mesh in self.finger_meshes
        ]
        free = self._between
        if not (min(middles) < 0.0 < max(middles) and free > 0.0):
            raise InvalidRequestError(
                "tool mesh: fingers are at "
                f"{', '.join(f'{1e3 * middle:.0f}' for middle in middles)} mm from the tool axis, "
                f"{1e3 * free:.1f} mm apart; there must be some on either side of it"
            )
        if self.opening is not None:
            check_length("mesh", "opening", self.opening, 0.0, free + MESH_PLAY, open_below=True)

    @property
    def fingers(self) -> bool:
        """Whether the tool has fingers."""
        return bool(self.finger_meshes)

    @property
    def _between(self) -> float:
        """Twice the least distance of a finger from the plane midway between the fingers [m]."""
        sides = [_sides(mesh, self.tool_point, self.rotation) for mesh in self.finger_meshes]
        inner = [side.min() if side.mean() > 0.0 else -side.max() for side in sides]
        return 2.0 * float(min(inner))

    @property
    def point(self) -> FloatArray:
        """(3,) the tool point in the flange frame [m]."""
        return np.array(self.tool_point, dtype=np.float64)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) the tool axes in the flange frame, as columns."""
        return _axes(self.tool_axis, self.finger_meshes)

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
        if self.fingers:
            return self.reach + self._palm
        if self.height is None:
            return self.reach + float(self._profile[:, 0].min())
        return self.tip - self.height

    @property
    def mouth(self) -> tuple[float, float]:
        """Half the opening, or 0, and the greatest radius of the pieces beyond ``front`` [m]."""
        if self.fingers:
            sides = [_sides(mesh, self.tool_point, self.rotation) for mesh in self.finger_meshes]
            half = 0.5 * (self._between if self.opening is None else self.opening)
            return half, float(max(np.abs(side).max() for side in sides))
        _, high, _, outer = self._profile.T
        before = high > self.front - self.reach + MESH_PLAY
        return (self.opening or 0.0) / 2.0, float(outer[before].max())

    def solids(self) -> tuple[Solid, ...]:
        """The pieces."""
        if self.fingers:
            groups: tuple[tuple[Part, tuple[MeshShape, ...]], ...] = (
                ("palm", self.meshes), ("finger", self.finger_meshes),
            )  # fmt: skip
            return tuple(
                Solid(f"{part}:{k}", piece, np.zeros(3), part=part)
                for part, meshes in groups
                if meshes
                for k, piece in enumerate(_pieces(meshes))
            )
        part: Part = "palm" if self.opening is None else "mouth"
        return tuple(
            Solid(f"piece:{k}", piece, np.zeros(3), part=part)
            for k, piece in enumerate(_pieces(self.meshes))
        )

    @property
    def _profile(self) -> FloatArray:
        """(K, 4) [m] of the pieces: least and largest height over the tool point, and radius."""
        return _profiles(self._all, self.tool_point, self.tool_axis)

    @property
    def _palm(self) -> float:
        """Height over the tool point of the body's front, or of a finger's hindmost end [m]."""
        heights = [
            (mesh.vertices - self.point) @ self.rotation[:, 2]
            for mesh in self.meshes or self.finger_meshes
        ]
        if self.meshes:
            return float(max(each.max() for each in heights))
        return float(min(each.min() for each in heights))


def _sides(mesh: MeshShape, point: Vector, axes: FloatArray) -> FloatArray:
    """Distances (N,) of a mesh's corners from the tool point, along the opening [m]."""
    return np.asarray((mesh.vertices - point) @ axes[:, 1])


def _axes(axis: Vector, fingers: tuple[MeshShape, ...] = ()) -> FloatArray:
    """Orthonormal right-handed axes (3, 3), as columns; the last is along ``axis``.

    With fingers the second is along the line from the first to the last, across ``axis``.
    """
    z = np.array(axis) / math.hypot(*axis)
    if fingers:
        y = fingers[-1].vertices.mean(axis=0) - fingers[0].vertices.mean(axis=0)
        y = y - (y @ z) * z
        if not np.linalg.norm(y) > MESH_PLAY:
            raise InvalidRequestError(
                "tool mesh: the first and the last of fingers are not side by side across the "
                "tool axis; they must be"
            )
        y /= np.linalg.norm(y)
        return np.column_stack([np.cross(y, z), y, z])
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@functools.lru_cache(maxsize=32)
def _pieces(meshes: tuple[MeshShape, ...]) -> tuple[MeshShape, ...]:
    """The connected pieces of meshes, each convex."""
    if not meshes:
        raise InvalidRequestError("tool mesh: meshes is empty; there must be one at least")
    out: list[MeshShape] = []
    for mesh in meshes:
        far = float(np.abs(mesh.vertices).max())
        if far > LARGEST:
            raise InvalidRequestError(
                f"tool mesh: {mesh.path or 'a mesh'} reaches {far:g} m from the flange (at most "
                f"{LARGEST:g}): millimetres? then give it the scale 0.001"
            )
        parts = parted(mesh)
        for k, piece in enumerate(parts):
            if not is_convex(piece):
                raise InvalidRequestError(
                    f"tool mesh: {mesh.path or 'a mesh'}: piece {k} of {len(parts)} is not convex; "
                    "cut it into convex parts"
                )
        out += parts
    return tuple(out)


@functools.lru_cache(maxsize=32)
def _profiles(meshes: tuple[MeshShape, ...], point: Vector, axis: Vector) -> FloatArray:
    turned = _axes(axis)
    return frozen([profile((piece.vertices - point) @ turned) for piece in _pieces(meshes)])
