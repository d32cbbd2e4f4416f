"""Resolved robot files: a robot in one file, without its description and meshes.

The file is an NPZ archive of the arrays of :data:`ARRAYS`, exact to the bit, and of a text
``robot``: a JSON object with the keys of :class:`_Header`. Lengths are metres, angles radians;
frames as in :class:`optipromp.core.robots.model.Robot`. Paths of meshes serve pictures only.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter

from optipromp.core.arrays import frozen, lengths
from optipromp.core.errors import InvalidRequestError, InvalidRobotError, is_name, printable
from optipromp.core.files import members, npz, read_npz, reading, write_atomically
from optipromp.core.robots.description import Arm, LeftOut, LinkGeometry, LinkShape, meshes_found
from optipromp.core.robots.kernels import Kinematics
from optipromp.core.robots.model import BodySpheres, Dynamics, Robot

SUFFIX = ".robot"
MOST_JOINTS = 200  # moving, of an arm, chosen: frames at 20,000 configurations take 0.4 GB
MOST_SPHERES = 2_000  # chosen: their pairs take 0.5 GB and 40 s
LARGEST = 1e6  # [m, kg or kg m²] chosen: far above every number of an arm

_ROUNDED = 1e-6  # chosen: largest error of a rotation or of the length of an axis

ARRAYS: dict[str, tuple[type, str]] = {
    **dict.fromkeys(("lower", "upper", "velocity", "acceleration", "jerk", "home"), (float, "n")),
    "kinematics kind": (int, "S"),
    "kinematics rotation": (float, "S33"),
    "kinematics translation": (float, "S3"),
    "kinematics axis": (float, "S3"),
    "kinematics dof": (int, "S"),
    "kinematics multiplier": (float, "S"),
    "kinematics offset": (float, "S"),
    "spheres segment": (int, "B"),
    "spheres center": (float, "B3"),
    "spheres radius": (float, "B"),
    "spheres link": (int, "B"),
    "spheres distal": (bool, "B"),
    "self_pairs": (int, "P2"),
    "self_slack": (float, "P"),
    "flange_rotation": (float, "33"),
    "flange_translation": (float, "3"),
    "geometry segment": (int, "G"),
    "geometry rotation": (float, "G33"),
    "geometry translation": (float, "G3"),
    "dynamics effort": (float, "S"),
    "dynamics mass": (float, "S"),
    "dynamics center": (float, "S3"),
    "dynamics inertia": (float, "S33"),
}
"""Type and shape of each array: n joints, S segments, B spheres, P pairs, G links with geometry.

The arrays of the dynamics may be missing, all of them together.
"""
_MAY_BE_INFINITE = "lower", "upper", "velocity", "acceleration", "jerk", "dynamics effort"


@dataclass(frozen=True)
class _Drawn:
    """A link; ``urdf``: the file beside which relative meshes lie."""

    link: str
    urdf: str
    shapes: tuple[LinkShape, ...]
    looks: tuple[LinkShape, ...]
    rigid: bool = True


@dataclass(frozen=True)
class _Header:
    """The JSON object of a resolved robot file."""

    format: Literal["optipromp robot"]
    version: Literal[1]
    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    held_joints: tuple[str, ...]
    excess: dict[str, float]
    left_out: tuple[LeftOut, ...]
    geometry: tuple[_Drawn, ...]
    arm: Arm
    told: tuple[str, ...] = ()


_SHARED = tuple(item.name for item in fields(_Header)[2:] if item.name != "geometry")
"""Fields that a robot has by the same names."""


def save_robot(robot: Robot, path: str | Path) -> None:
    """Write a robot as a resolved file, which :func:`optipromp.core.robots.load_robot` reads.

    Reading needs no URDF, mesh or further package, and gives the same robot to the bit.

    Args:
        robot: without a tool, which a scene names.
        path: of the file to write; its name must end in ``.robot``.

    Raises:
        InvalidRequestError: the robot carries a tool, the path ends otherwise, or the file cannot
            be written.
    """
    path = Path(path)
    if robot.tool is not None:
        raise InvalidRequestError(f"{robot.name} carries a tool: save without_tool(robot)")
    if path.suffix.lower() != SUFFIX:
        raise InvalidRequestError(f"{path}: the name of a resolved robot must end in {SUFFIX}")
    write_atomically(path, resolved(robot, path.parent))


def resolved(robot: Robot, folder: Path) -> bytes:
    """The content of a resolved robot file in ``folder``."""
    geometry = tuple(
        _Drawn(link.link, _from(folder, link.urdf), link.shapes, link.looks, link.rigid)
        for link in robot.geometry
    )
    shared = {name: getattr(robot, name) for name in _SHARED}
    header = _Header("optipromp robot", 1, geometry=geometry, **shared)
    drawn = {
        "segment": np.array([link.segment for link in robot.geometry], dtype=np.int64),
        "rotation": np.array([link.rotation for link in robot.geometry]).reshape(-1, 3, 3),
        "translation": np.array([link.translation for link in robot.geometry]).reshape(-1, 3),
    }
    groups = {
        "kinematics": robot.kinematics._asdict(),
        "spheres": robot.spheres._asdict(),
        "geometry": drawn,
        "dynamics": {} if robot.dynamics is None else robot.dynamics._asdict(),
    }
    arrays = {key: getattr(robot, key) for key in ARRAYS if " " not in key}
    for group, own in groups.items():
        arrays |= {f"{group} {key}": value for key, value in own.items()}
    return npz({"robot": json.dumps(asdict(header)), **arrays})


def _from(folder: Path, urdf: Path) -> str:
    """The path of a description: relative to ``folder`` if it lies in it, else absolute."""
    there, here = urdf.absolute(), folder.absolute()
    return str(there.relative_to(here) if there.is_relative_to(here) else there)


def read_resolved(path: Path, check: Callable[[Path], Path] = Path) -> Robot:
    """The robot of a resolved file.

    ``check``: called with each mesh file that the robot names and that exists.
    """
    data = read_npz(path, InvalidRobotError)
    with reading(path, "no resolved robot file", InvalidRobotError):
        header = TypeAdapter(_Header).validate_json(str(data.pop("robot")))
        sizes = {"n": len(header.joint_names), "G": len(header.geometry)}
        still = not any(key.startswith("dynamics ") for key in data)
        table = {k: of for k, of in ARRAYS.items() if not (still and k.startswith("dynamics "))}
        arrays = members(data, table, sizes)
        _check(header, arrays)

    def group(name: str) -> dict[str, Any]:
        keys = [key for key in arrays if key.startswith(f"{name} ")]
        return {key.removeprefix(f"{name} "): arrays.pop(key) for key in keys}

    drawn, dynamics = group("geometry"), group("dynamics")
    places = zip(*drawn.values(), header.geometry, strict=True)
    geometry = tuple(
        LinkGeometry(
            link.link, int(segment), turn, at, link.shapes, path.parent / link.urdf, link.looks,
            link.rigid,
        )
        for segment, turn, at, link in places
    )  # fmt: skip
    for link in geometry:
        for file in meshes_found(link.urdf, link.link, (*link.shapes, *link.looks)):
            check(file)
    return Robot(
        **{name: getattr(header, name) for name in _SHARED},
        kinematics=Kinematics(**group("kinematics")),
        spheres=BodySpheres(**group("spheres")),
        **arrays,
        tool_point=arrays["flange_translation"],
        tool_axis=frozen(arrays["flange_rotation"][:, 2]),
        gripper_radius=0.0,
        geometry=geometry,
        dynamics=Dynamics(**dynamics) if dynamics else None,
    )


def _check(header: _Header, arrays: dict[str, Any]) -> None:
    """Refuse indices out of range, which kernels would follow unchecked, and contradicting limits.

    Raises ValueError.
    """
    for key, array in arrays.items():
        most = np.inf if key in _MAY_BE_INFINITE else LARGEST
        if array.dtype == float and not (np.abs(array) <= most).all():
            raise ValueError(f"'{key}' holds a number that is not finite, or too large")
    n, segments = len(header.joint_names), len(arrays["kinematics kind"])
    spheres, links = len(arrays["spheres radius"]), len(header.link_names)
    if not 0 < n <= segments <= MOST_JOINTS or spheres > MOST_SPHERES:
        raise ValueError(
            f"it has {n} joints, {segments} segments and {spheres} spheres: must have at least one "
            f"joint, at most {MOST_JOINTS} segments and {MOST_SPHERES} spheres"
        )
    for key, first, end in (
        ("kinematics kind", 0, 2),
        ("kinematics dof", 0, n),
        ("spheres segment", -1, segments),
        ("geometry segment", -1, segments),
        ("spheres link", 0, links),
        ("self_pairs", 0, spheres),
    ):
        if not ((arrays[key] >= first) & (arrays[key] < end)).all():
            raise ValueError(f"'{key}' must lie in {first} to {end - 1}")
    for names in (header.joint_names, header.link_names):
        if len(set(names)) < len(names) or not all(map(is_name, names)):
            raise ValueError("names of joints and of links must differ, without control characters")
    if any(
        printable(text) != text
        for text in _texts((header.name, header.left_out, header.arm, header.told))
    ):
        raise ValueError("a text in it holds control characters")
    turns = np.concatenate([arrays["kinematics rotation"], arrays["flange_rotation"][None]])
    if not np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3), rtol=0.0, atol=_ROUNDED):
        raise ValueError("'kinematics rotation' and 'flange_rotation' must hold rotations")
    if not np.allclose(lengths(arrays["kinematics axis"]), 1.0, rtol=0.0, atol=_ROUNDED):
        raise ValueError("'kinematics axis' must hold vectors of length 1")
    home, lower, upper = arrays["home"], arrays["lower"], arrays["upper"]
    if not ((lower <= home) & (home <= upper)).all():
        raise ValueError("'home' must lie within 'lower' and 'upper'")
    for key in ("velocity", "acceleration", "jerk", "spheres radius"):
        if not (arrays[key] > 0.0).all():
            raise ValueError(f"'{key}' must be positive")


def _texts(value: Any) -> Iterator[str]:
    """All texts in a value."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Arm):
        yield from _texts(vars(value))
    elif isinstance(value, Mapping):
        yield from _texts(tuple(value.items()))
    elif isinstance(value, tuple):
        for each in value:
            yield from _texts(each)
