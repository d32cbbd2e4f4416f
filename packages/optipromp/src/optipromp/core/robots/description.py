"""Parts of a robot's description beside its kinematics: the arm, shapes and their meshes."""

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import is_file

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class LinkShape:
    """One collision or visual shape, placed in its link's frame.

    ``size`` [m]: sphere (radius,), cylinder and capsule (radius, length), box (x, y, z) full
    sizes; of a mesh the scale (x, y, z). ``xyz`` [m] and ``rpy`` [rad] place the shape. ``mesh``
    is the file name in the description, empty for a primitive.
    """

    kind: Literal["sphere", "cylinder", "capsule", "box", "mesh"]
    size: tuple[float, ...]
    xyz: Vector
    rpy: Vector
    mesh: str = ""


class LinkGeometry(NamedTuple):
    """A link, and its geometry, on a segment: x_segment = rotation @ x_link + translation."""

    link: str
    segment: int  # -1 for the fixed base
    rotation: FloatArray  # (3, 3)
    translation: FloatArray  # (3,) [m]
    shapes: tuple[LinkShape, ...]
    urdf: Path
    looks: tuple[LinkShape, ...] = ()  # its visual geometry
    rigid: bool = True  # no joint lies between that is held here, and may stand elsewhere


class LeftOut(NamedTuple):
    """Two links whose collision is not checked, and why."""

    link: str
    other: str
    why: str


@dataclass(frozen=True)
class Arm:
    """An arm of a robot: its joints lie between the links ``base`` and ``tip``, its flange.

    ``tool``: links beyond the flange that the last body carries. ``why``: the reason of the choice,
    in words. ``others``: descriptions of the other arms to choose from. ``groups``: the joints of
    each SRDF group that is a chain.
    """

    base: str
    tip: str
    joints: tuple[str, ...]
    tool: tuple[str, ...]
    why: str
    others: tuple[str, ...] = ()
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def __str__(self) -> str:
        shown = f"{self.joints[0]} to {self.joints[-1]}" if self.joints else "none"
        return f"tip '{self.tip}', base '{self.base}' ({len(self.joints)} joints: {shown})"


NOT_TOLD = Arm("", "", (), (), "not told")
"""The arm of a robot that was not read from a description."""


def rotation_of(rpy: Vector) -> FloatArray:
    """The (3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll) of URDF angles [rad]."""
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, rpy), map(math.sin, rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def mesh_name(urdf: Path, link: str, shape: LinkShape) -> str:
    """The name of a mesh in messages."""
    return f"{urdf}: link '{link}' mesh '{shape.mesh}'"


def mesh_file(urdf: Path, link: str, shape: LinkShape) -> Path:
    """The file of a mesh, whose name is relative to the URDF's folder or to a package's folder.

    Raises InvalidRobotError, naming the link and the file, if there is none.
    """
    folder, name = urdf.resolve().parent, shape.mesh
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        candidates = [up / package / rest for up in (folder, *folder.parents)]
        candidates += [up / rest for up in (folder, *folder.parents) if up.name == package]
    else:
        candidates = [folder / name.removeprefix("file://")]
    for candidate in candidates:
        if is_file(candidate):
            return candidate
    where = mesh_name(urdf, link, shape)
    raise InvalidRobotError(f"{where}: no such file, looked for {candidates[0]}")


def meshes_found(urdf: Path, link: str, shapes: Iterable[LinkShape]) -> list[Path]:
    """The files of a link's meshes that can be found; missing ones are skipped."""
    found = []
    for shape in shapes:
        if shape.kind == "mesh":
            with suppress(InvalidRobotError):
                found.append(mesh_file(urdf, link, shape))
    return found
