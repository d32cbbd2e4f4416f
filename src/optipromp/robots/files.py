"""Robot files: a YAML file beside a URDF, and the robot that the two describe."""

from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from optipromp.arrays import FloatArray, frozen
from optipromp.errors import InvalidRobotError
from optipromp.robots.chain import Chain, serial_chain
from optipromp.robots.model import BodySpheres, Robot
from optipromp.robots.self_collision import with_self_pairs
from optipromp.robots.spheres import cover_capsule, cover_geometry
from optipromp.robots.urdf import LENGTH_LIMIT, UrdfModel, read_urdf

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-LENGTH_LIMIT, le=LENGTH_LIMIT, allow_inf_nan=False)]
Radius = Annotated[float, Field(gt=0.0, le=LENGTH_LIMIT, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class CapsuleEntry(BaseModel):
    """A capsule in a link's frame: the segment ``from``–``to`` thickened by ``radius`` [m]."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    start: Point = Field(alias="from")
    end: Point = Field(alias="to")
    radius: Radius


class RobotFile(BaseModel):
    """The keys of a robot file; lists of numbers are in the order of the chain's joints.

    A link that has an entry under ``spheres`` or ``capsules`` (an empty list counts) is covered by
    those; every other link is covered from its URDF geometry.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    format: Literal[1]
    name: str = Field(min_length=1)
    urdf: str = Field(min_length=1)
    flange: str | None = None
    scale: Positive = 1.0  # metres in one unit of length of the URDF
    velocity: list[Positive] | None = None  # overrides the URDF
    acceleration: list[Positive] | None = None
    jerk: list[Positive] | None = None
    home: list[Finite] | None = None
    bulge: Positive = 0.005  # [m] how far covers of capsules may reach beyond them
    spheres: dict[str, list[tuple[Coordinate, Coordinate, Coordinate, Radius]]] = {}
    capsules: dict[str, list[CapsuleEntry]] = {}
    allow_self: list[tuple[str, str]] = []


def robot_from_urdf(path: Path) -> Robot:
    """The robot of a bare URDF: flange at the deepest leaf, spheres from its geometry.

    Accelerations and jerks are unlimited; home is zero, or the limits nearest to it.
    Raises InvalidRobotError.
    """
    model = read_urdf(path)
    return _build(RobotFile(format=1, name=model.name, urdf=path.name), model, path)


def robot_from_file(path: Path) -> Robot:
    """The robot that the YAML robot file at ``path`` describes. Raises InvalidRobotError."""
    entry = read_robot_file(path)
    urdf = path.parent / entry.urdf
    return _build(entry, read_urdf(urdf, entry.scale), path)


def read_robot_file(path: Path) -> RobotFile:
    """Read and check a robot file; an unknown key is refused by name. Raises InvalidRobotError."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidRobotError(f"{path}: cannot be read: {error}") from error
    try:
        content = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, RecursionError) as error:
        raise InvalidRobotError(
            f"{path}: not valid YAML: {' '.join(str(error).split())}"
        ) from error
    if not isinstance(content, dict):
        raise InvalidRobotError(f"{path}: a robot file is a mapping of keys, starting 'format: 1'")
    try:
        return RobotFile.model_validate(content)
    except ValidationError as error:
        problems = "; ".join(_problem(e) for e in error.errors()[:5])
        raise InvalidRobotError(f"{path}: {problems}") from error


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for key in keys:
            if keys.count(key) > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key '{key}' is given twice", node.start_mark
                )
        return super().construct_mapping(node, deep)


def _problem(error: Any) -> str:
    where = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        known = CapsuleEntry if len(error["loc"]) > 1 else RobotFile
        names = ", ".join(f.alias or name for name, f in known.model_fields.items())
        return f"unknown key '{where}'; known: {names}"
    if error["type"] == "missing":
        return f"key '{where}' is missing"
    return f"{where}: {error['msg']}, got {error['input']!r}"


def _build(entry: RobotFile, model: UrdfModel, path: Path) -> Robot:
    chain = serial_chain(model, entry.flange)
    names = chain.joint_names
    n = len(names)
    unlimited = np.full(n, np.inf)
    home = _per_joint(
        path, "home", entry.home, names, np.clip(np.zeros(n), chain.lower, chain.upper)
    )
    outside = np.flatnonzero((home < chain.lower) | (home > chain.upper))
    if len(outside):
        i = int(outside[0])
        raise InvalidRobotError(
            f"{path}: home of joint '{names[i]}' is {home[i]:g}, outside its limits "
            f"[{chain.lower[i]:g}, {chain.upper[i]:g}]"
        )
    known = set(model.links)
    mentioned = [
        *entry.spheres,
        *entry.capsules,
        *(link for pair in entry.allow_self for link in pair),
    ]
    for link in mentioned:
        if link not in known:
            shown = ", ".join(list(model.links)[:20])
            raise InvalidRobotError(f"{path}: unknown link '{link}'; links: {shown}")
    robot = Robot(
        name=entry.name,
        joint_names=names,
        lower=chain.lower,
        upper=chain.upper,
        velocity=_per_joint(path, "velocity", entry.velocity, names, chain.velocity),
        acceleration=_per_joint(path, "acceleration", entry.acceleration, names, unlimited),
        jerk=_per_joint(path, "jerk", entry.jerk, names, unlimited),
        kinematics=chain.kinematics,
        spheres=_body_spheres(entry, model, chain),
        link_names=tuple(model.links),
        self_pairs=frozen(np.zeros((0, 2)), np.int64),
        flange_rotation=frozen(chain.flange.rotation),
        flange_translation=frozen(chain.flange.translation),
        tool_point=frozen(chain.flange.translation),
        tool_axis=frozen(chain.flange.rotation[:, 2]),
        gripper_radius=0.0,
        home=home,
        held_joints=chain.held_joints,
    )
    return with_self_pairs(robot, entry.allow_self)


def _per_joint(
    path: Path, key: str, given: list[float] | None, names: tuple[str, ...], default: FloatArray
) -> FloatArray:
    if given is not None and len(given) != len(names):
        raise InvalidRobotError(
            f"{path}: {key} has {len(given)} values; the chain has {len(names)} joints "
            f"({', '.join(names[:20])})"
        )
    return frozen(default if given is None else given)


def _body_spheres(entry: RobotFile, model: UrdfModel, chain: Chain) -> BodySpheres:
    segment, center, radius, link = [], [np.zeros((0, 3))], [np.zeros(0)], []
    for index, (name, place) in enumerate(chain.placements.items()):
        cover = _link_cover(entry, model, name)
        if not len(cover):
            continue
        if place.driver:
            raise InvalidRobotError(
                f"{model.path}: link '{name}' hangs on joint '{place.driver}', off the chain and "
                "driven by a joint of the chain; only a serial chain moves. Choose another flange, "
                f"or give '{name}' no spheres in a robot file (spheres: {{{name}: []}})"
            )
        center.append(cover[:, :3] @ place.rotation.T + place.translation)
        radius.append(cover[:, 3])
        segment += [place.segment] * len(cover)
        link += [index] * len(cover)
    if not segment and not entry.spheres and not entry.capsules:
        raise InvalidRobotError(
            f"{model.path}: no link has collision or visual geometry, so nothing could be kept off "
            "an obstacle; give spheres or capsules in a robot file"
        )
    carrier = np.array(segment, dtype=np.int64)
    return BodySpheres(
        segment=frozen(carrier, np.int64),
        center=frozen(np.concatenate(center)),
        radius=frozen(np.concatenate(radius)),
        link=frozen(link, np.int64),
        distal=frozen(carrier == len(chain.kinematics.kind) - 1, np.bool_),
    )


def _link_cover(entry: RobotFile, model: UrdfModel, link: str) -> FloatArray:
    if link not in entry.spheres and link not in entry.capsules:
        return cover_geometry(model, link)
    covers = [np.array(entry.spheres.get(link, []), dtype=float).reshape(-1, 4)]
    for capsule in entry.capsules.get(link, []):
        start, end = np.array(capsule.start), np.array(capsule.end)
        covers.append(cover_capsule(start, end, capsule.radius, entry.bulge))
    return np.concatenate(covers)
