"""Tools with two fingers or blades, which stay open; a suction cup; tools of one's own meshes."""

import functools
import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le, Unit

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, Cylinder, MeshShape, is_convex, parted
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.tool_geometry import Part, Solid, profile
from optipromp.core.robots.tool_protocol import LARGEST, Distance, Place, Size, Tool, check_length
from optipromp.core.values import Validated

Vector = tuple[float, float, float]
WIDEST = 0.12  # [m] chosen: opening of a scissor


class TwoFingers(Validated, Tool):
    """The base class of grippers: two boxes, the fingers, side by side on a box, the body.

    The body stands centred on the flange.
    """

    fingers = True
    names: tuple[str, str, str]  # of the kind, and of a finger and the body in the parameters
    opening: float  # [m]
    depth: float  # [m]
    turn: float  # [rad] about flange z

    def __post_init__(self) -> None:
        super().__post_init__()
        kind = self.names[0]
        check_length(kind, "opening", self.opening, 0.0, self._body[1], open_below=True)
        check_length(kind, "depth", self.depth, 0.0, self._finger[2])

    def _size(self, part: str, *sides: str) -> Vector:
        x, y, z = (getattr(self, f"{part}_{side}") for side in sides)
        return x, y, z

    @property
    def _finger(self) -> Vector:
        """Size of a finger across the opening, along it, and along the tool axis [m]."""
        return self._size(self.names[1], "width", "thickness", "length")

    @property
    def _body(self) -> Vector:
        """Size of the body, likewise [m]."""
        return self._size(self.names[2], "thickness", "width", "length")

    @property
    def point(self) -> FloatArray:
        return np.array([0.0, 0.0, self.tip - self.depth])

    @property
    def rotation(self) -> FloatArray:
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
        half = 0.5 * self.turn
        turned = math.cos(half), 0.0, 0.0, math.sin(half)
        aside = 0.5 * (self.mouth[0] + self.mouth[1])
        boxes: tuple[tuple[str, Vector, float, float, Part], ...] = (
            ("palm", self._body, 0.0, 0.5 * self._body[2], "palm"),
            ("left finger", self._finger, aside, 0.5 * (self.front + self.tip), "finger"),
            ("right finger", self._finger, -aside, 0.5 * (self.front + self.tip), "finger"),
        )
        return tuple(
            Solid(name, Box(size), self.rotation @ [0.0, y, z], turned, part)
            for name, size, y, z, part in boxes
        )


@dataclass(frozen=True)
class FingerGripper(TwoFingers, label="tool finger_gripper: "):
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
    """

    names = "finger_gripper", "finger", "palm"
    opening: float
    finger_length: Size = 0.05
    finger_width: Size = 0.02
    finger_thickness: Size = 0.01
    palm_length: Size = 0.08
    palm_width: Size = 0.10
    palm_thickness: Size = 0.05
    depth: float = 0.01
    turn: Annotated[float, Unit("rad")] = 0.0


@dataclass(frozen=True)
class Scissor(TwoFingers, label="tool scissor: "):
    """A scissor of two thin open blades on a body, which cuts a stem and holds its end. Metres.

    Blades and body are boxes, named and measured as the fingers and the palm of
    :class:`FingerGripper`; the body is at least as wide as the open blades. At a target that hangs
    the tool point ends on the stem, ``cut`` from the fruit, where the blades close. The fruit then
    hangs from them.

    Args:
        opening: between the open blades, 0.12 at most.
        depth: distance of the blade tips beyond the tool point.
        turn: of the scissor about flange z; at 0 it opens along flange y [rad].
        cut: distance of the place of the cut from the fruit. Above ``depth`` and half of the
            body's thickness, so that the closing blades and the body miss the fruit.
    """

    names = "scissor", "blade", "body"
    opening: Annotated[float, Le(WIDEST), Unit("m")]
    blade_length: Size = 0.05
    blade_width: Size = 0.012
    blade_thickness: Size = 0.002
    body_length: Size = 0.10
    body_width: Size = 0.06
    body_thickness: Size = 0.03
    depth: float = 0.015
    turn: Annotated[float, Unit("rad")] = 0.0
    cut: Size = 0.02

    @property
    def _body(self) -> Vector:
        x, y, z = super()._body
        return x, max(y, self.opening + 2.0 * self.blade_thickness), z


@dataclass(frozen=True)
class Suction(Validated, Tool, label="tool suction: "):
    """A suction cup: a lip at the end of a stem along flange z. Metres.

    It takes hold of an object that its lip touches, within ``radius`` of the tool axis and with a
    force that is at most ``angle`` off that axis. The push models treat it as solid. The cup is a
    bellows: it yields along the axis by its whole height at most, as a spring.

    Args:
        radius: of the lip.
        length: from the flange to the lip.
        height: of the cup, the wide part behind the lip.
        angle: largest angle between the tool axis and the touched surface's normal [degrees].
        fruit: distance from the lip to the tool point, where the centre of a touched fruit is. In a
            scene file without ``fruit``: as far as the target reaches against the approach, less
            :data:`PRESS`, or less where the cup would press harder than the target bears.
        stiffness: of the cup along the axis [N/m]. A guess: bellows of 20 to 40 mm give a
            millimetre for 0.5 to 2 N.
    """

    radius: Size
    length: Size = 0.10
    height: float = 0.015
    angle: Annotated[float, Gt(0.0), Le(90.0), Unit("degrees")] = 30.0
    fruit: Distance = 0.015
    stiffness: Annotated[float, Gt(0.0), Le(1e6), Unit("N/m")] = 1000.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_length("suction", "height", self.height, 0.0, self.length, open_below=True)

    @property
    def point(self) -> FloatArray:
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
        cup = Cylinder(self.radius, self.height)
        out = [
            Solid("cup", cup, np.array([0.0, 0.0, self.length - 0.5 * self.height]), part="mouth")
        ]
        if self.front > 0.0:
            stem = Cylinder(min(NECK_RADIUS, self.radius), self.front)
            out.append(Solid("stem", stem, np.array([0.0, 0.0, 0.5 * self.front]), part="neck"))
        return tuple(out)


PRESS = 0.002  # [m] chosen: by which a lip goes on after its touch, so that it surely touches

MESH_PLAY = 1e-4  # [m] that a piece may reach into the mouth, chosen: files have single precision


@dataclass(frozen=True)
class MeshTool(Validated, Tool, label="tool mesh: "):
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
    tool_point: Place
    tool_axis: Place = (0.0, 0.0, 1.0)
    opening: float | None = None
    height: float | None = None
    finger_meshes: tuple[MeshShape, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
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
        middles, free = [side.mean() for side in self._sides], self._between
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
        return bool(self.finger_meshes)

    @property
    def _sides(self) -> list[FloatArray]:
        """Distances (N,) of each finger's corners from the tool point, along the opening [m]."""
        across = self.rotation[:, 1]
        return [(mesh.vertices - self.tool_point) @ across for mesh in self.finger_meshes]

    @property
    def _between(self) -> float:
        """Twice the least distance of a finger from the plane midway between the fingers [m]."""
        inner = [side.min() if side.mean() > 0.0 else -side.max() for side in self._sides]
        return 2.0 * float(min(inner))

    @property
    def point(self) -> FloatArray:
        return np.array(self.tool_point, dtype=np.float64)

    @property
    def rotation(self) -> FloatArray:
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
            half = 0.5 * (self._between if self.opening is None else self.opening)
            return half, float(max(np.abs(side).max() for side in self._sides))
        _, high, _, outer = self._profile.T
        before = high > self.front - self.reach + MESH_PLAY
        return (self.opening or 0.0) / 2.0, float(outer[before].max())

    def solids(self) -> tuple[Solid, ...]:
        body: Part = "palm" if self.fingers or self.opening is None else "mouth"
        groups: list[tuple[str, Part, tuple[MeshShape, ...]]] = [
            ("palm" if self.fingers else "piece", body, self.meshes),
            ("finger", "finger", self.finger_meshes),
        ]
        return tuple(
            Solid(f"{name}:{k}", piece, np.zeros(3), part=part)
            for name, part, meshes in groups
            if meshes
            for k, piece in enumerate(_pieces(meshes))
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
