"""The serial chain of a tree of links: fixed joints merged, mimics resolved, branches held."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.arrays import rotation as turned
from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.description import rotation_of
from optipromp.core.robots.kernels import PRISMATIC, REVOLUTE, Kinematics
from optipromp.readers.tree import Tree
from optipromp.readers.urdf import UrdfJoint, UrdfModel

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Placement:
    """The place of a link on its segment: x_segment = rotation @ x_link + translation.

    ``segment`` is -1 for the fixed base. ``driver`` names the off-chain joint, driven by a joint of
    the chain, that moves the link relative to its segment; empty for a link carried rigidly.
    """

    segment: int
    rotation: FloatArray
    translation: FloatArray
    driver: str = ""


@dataclass(frozen=True)
class Chain:
    """The chain from the root to the flange link, n independent joints and S segments."""

    joint_names: tuple[str, ...]
    lower: FloatArray  # (n,) limits of every joint that the independent one drives, intersected
    upper: FloatArray
    velocity: FloatArray
    effort: FloatArray  # (S,) [N m or N] of each segment's joint, infinite where the file has none
    kinematics: Kinematics
    flange: Placement
    held_joints: tuple[str, ...]  # off the chain, at rest
    placements: Mapping[str, Placement]  # every link of the file, in file order


@dataclass(frozen=True)
class _Drive:
    """The value of a joint: multiplier * value of ``leader`` + offset [rad or m]."""

    leader: str
    multiplier: float
    offset: float


def serial_chain(
    model: UrdfModel, tip: str, base: str | None = None, held: Mapping[str, float] = _NONE
) -> Chain:
    """The chain of ``model`` from link ``base`` (default: the root) to link ``tip``, the flange.

    Movable joints off the chain stand at their value in ``held`` [rad or m], else at zero or the
    limit nearest to zero. Frames are relative to the root, whatever the base.
    """
    tree = Tree(model)
    base = model.root if base is None else base
    path = tree.path(tip, base)
    movable = [joint for joint in path if joint.kind != "fixed"]
    if not movable:
        start = f"root '{base}'" if base == model.root else f"base link '{base}'"
        raise InvalidRobotError(
            f"{model.path}: no movable joint between the {start} and the flange '{tip}'"
        )
    drives = _drives(model)
    for joint in movable:
        if joint.fault or (joint := model.joints[drives[joint.name].leader]).fault:
            raise InvalidRobotError(joint.fault)
    names = tuple(dict.fromkeys(drives[joint.name].leader for joint in movable))
    index = {name: i for i, name in enumerate(names)}
    _check_held(model, held, drives, index)
    lower, upper, velocity = _limits(model, index, drives)
    segments, placements, still = _placed(tree, path, held, drives, index)
    kinematics = Kinematics(
        kind=frozen([PRISMATIC if j.kind == "prismatic" else REVOLUTE for j in movable], np.int64),
        rotation=frozen([rotation for rotation, _ in segments]),
        translation=frozen([translation for _, translation in segments]),
        axis=frozen([joint.axis for joint in movable]),
        dof=frozen([index[drives[joint.name].leader] for joint in movable], np.int64),
        multiplier=frozen([drives[joint.name].multiplier for joint in movable]),
        offset=frozen([drives[joint.name].offset for joint in movable]),
    )
    return Chain(
        joint_names=names,
        lower=frozen(lower),
        upper=frozen(upper),
        velocity=frozen(velocity),
        effort=frozen([joint.effort for joint in movable]),
        kinematics=kinematics,
        flange=placements[tip],
        held_joints=tuple(name for name in model.joints if name in still),
        placements=MappingProxyType({name: placements[name] for name in model.links}),
    )


def _placed(
    tree: Tree,
    path: Sequence[UrdfJoint],
    held: Mapping[str, float],
    drives: Mapping[str, _Drive],
    index: Mapping[str, int],
) -> tuple[list[tuple[FloatArray, FloatArray]], dict[str, Placement], set[str]]:
    """The frame of each moving joint of ``path`` at zero, the placement of every link, and the
    names of the joints at rest."""
    joints, on_path = tree.model.joints, {joint.name for joint in path}
    placements = {tree.model.root: Placement(-1, np.eye(3), np.zeros(3))}
    segments: list[tuple[FloatArray, FloatArray]] = []
    still: set[str] = set()
    for joint in tree.outward:
        frame = placements[joint.parent]
        rotation = frame.rotation @ rotation_of(joint.rpy)
        translation = frame.rotation @ np.array(joint.xyz) + frame.translation
        driver = frame.driver
        segment = frame.segment
        if joint.kind != "fixed":
            drive = drives[joint.name]
            if joint.name in on_path:
                segments.append((rotation, translation))
                segment, rotation, translation = len(segments) - 1, np.eye(3), np.zeros(3)
            elif drive.leader in index:
                driver = driver or joint.name
            else:
                still.add(joint.name)
                leader = joints[drive.leader]
                rest = held.get(drive.leader, min(max(0.0, leader.lower), leader.upper))
                value = drive.multiplier * rest + drive.offset
                if joint.kind == "prismatic":
                    translation = rotation @ (np.array(joint.axis) * value) + translation
                else:
                    rotation = rotation @ turned(joint.axis, value)
        placements[joint.child] = Placement(segment, rotation, translation, driver)
    return segments, placements, still


def _check_held(
    model: UrdfModel,
    held: Mapping[str, float],
    drives: Mapping[str, _Drive],
    index: Mapping[str, int],
) -> None:
    """Refuse to hold a joint of the arm, a mimic joint, or a joint outside its limits."""
    free = [
        name
        for name, joint in model.joints.items()
        if joint.kind != "fixed" and drives[name].leader == name and name not in index
    ]
    for name, value in held.items():
        where = f"{model.path}: hold gives joint '{name}' {value:g}"
        if name not in free:
            raise InvalidRobotError(
                f"{where}; it holds joints that move by themselves and are not of the arm: "
                f"{', '.join(free) or 'none'}"
            )
        joint = model.joints[name]
        if not joint.lower <= value <= joint.upper:
            raise InvalidRobotError(
                f"{where}, outside its limits [{joint.lower:g}, {joint.upper:g}]"
            )


def _drives(model: UrdfModel) -> dict[str, _Drive]:
    """Each movable joint as a function of a joint that mimics none."""
    drives: dict[str, _Drive] = {}
    for joint in model.joints.values():
        trail = []
        current = joint
        while current.mimic is not None and current.name not in drives:
            trail.append(current)
            current = model.joints[current.mimic.joint]
        drive = drives.setdefault(current.name, _Drive(current.name, 1.0, 0.0))
        for follower in reversed(trail):
            if follower.mimic is not None:
                m, o = follower.mimic.multiplier, follower.mimic.offset
                drive = _Drive(drive.leader, m * drive.multiplier, m * drive.offset + o)
                drives[follower.name] = drive
    return drives


def _limits(
    model: UrdfModel, index: Mapping[str, int], drives: Mapping[str, _Drive]
) -> tuple[list[float], list[float], list[float]]:
    """Position limits and velocity limits of the independent joints, by which every joint that they
    drive stays within its limits."""
    lower = [model.joints[name].lower for name in index]
    upper = [model.joints[name].upper for name in index]
    velocity = [model.joints[name].velocity for name in index]
    for joint in model.joints.values():
        drive = drives[joint.name]
        if joint.mimic is None or drive.leader not in index:
            continue
        i, m, o = index[drive.leader], drive.multiplier, drive.offset
        where = f"{model.path}: mimic joint '{joint.name}'"
        if m == 0.0:
            if not joint.lower <= o <= joint.upper:
                raise InvalidRobotError(
                    f"{where} stands at {o:g}, outside its limits "
                    f"[{joint.lower:g}, {joint.upper:g}]"
                )
            continue
        ends = sorted(((joint.lower - o) / m, (joint.upper - o) / m))
        lower[i], upper[i] = max(lower[i], ends[0]), min(upper[i], ends[1])
        velocity[i] = min(velocity[i], joint.velocity / abs(m))
        if lower[i] > upper[i]:
            raise InvalidRobotError(
                f"{where} has limits [{joint.lower:g}, {joint.upper:g}] that no position of its "
                f"leader '{drive.leader}' keeps"
            )
    return lower, upper, velocity
