"""The tree of a URDF, and the serial chain in it.

In the tree fingers, wheels, heads and sensors are told by names and branches. In the chain fixed
joints are merged, mimics resolved, branches held.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.arrays import rotation as turned
from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.description import rotation_of
from optipromp.core.robots.kernels import PRISMATIC, REVOLUTE, Kinematics
from optipromp.readers.urdf import UrdfJoint, UrdfMimic, UrdfModel


def _set(listed: str) -> frozenset[str]:
    return frozenset(listed.split())


# Words of names, lower case, whole: "left_gripper_finger2" has left, gripper, finger, 2.
FINGER = _set("finger fingers fingertip fingertips thumb knuckle jaw jaws claw pinky phalanx")
HAND = _set("gripper grippers hand hands robotiq")
TURN = _set("yaw pitch roll rotate rotation wrist")  # of a whole hand
PALM = FINGER | HAND | _set("palm vacuum suction tcp grasp grasping pinch")
WHEEL = _set("wheel wheels caster castor rotor propeller steer steering drivewhl whl")
HEAD = _set("head neck eye eyes camera laser lidar kinect antenna")
SENSOR = _set(
    "camera optical rgb rgbd depth color imu lidar laser led accelerometer gyro gyrometer sensor "
    "marker light inertial com fsr ir infra1 infra2"
)
LEG = _set("leg legs foot feet hip knee ankle calf thigh toe sole haa hfe kfe")
TORSO = _set("torso waist spine trunk lumbar chest lift body base")
FLANGE = _set("flange tool0 attachment")
CENTRE = _set("tcp tool tool0 ee eef effector grasp grasping center centre frame")
LEAST_ABOVE = 3  # joints, chosen: equal branches after as many joints are fingers, not limbs
MOST_BARS = 4  # joints, chosen: two bars beside the arm, or two such in series
ALONG = 0.999  # chosen: least cosine between axes of one direction
ACROSS = 0.1  # chosen: largest cosine between slides that count as perpendicular

_WORD = re.compile(r"[A-Z]?[a-z]+[0-9]*|[A-Z]+(?![a-z])|[0-9]+")


def words_of(name: str) -> frozenset[str]:
    """The words of a name, with and without digits; split at signs and changes of case."""
    found = [word.lower() for word in _WORD.findall(name)]
    return frozenset(found) | {word.rstrip("0123456789") for word in found}


@dataclass(frozen=True)
class Tree:
    """Paths and branches of a model."""

    model: UrdfModel

    @cached_property
    def above(self) -> dict[str, UrdfJoint]:
        """The joint that carries each link but the root."""
        return {joint.child: joint for joint in self.model.joints.values()}

    @cached_property
    def below(self) -> dict[str, list[UrdfJoint]]:
        """The joints on each link, in file order."""
        out: dict[str, list[UrdfJoint]] = {link: [] for link in self.model.links}
        for joint in self.model.joints.values():
            out[joint.parent].append(joint)
        return out

    def path(self, link: str, base: str | None = None) -> list[UrdfJoint]:
        """The joints from the root, or from the link ``base`` if it lies between, to ``link``."""
        out = []
        while link in self.above and link != base:
            out.append(self.above[link])
            link = self.above[link].parent
        return out[::-1]

    def rigid(self, link: str, stop: frozenset[str] = frozenset()) -> list[tuple[int, str]]:
        """Depth and name of ``link`` and of the links fixed to it; none of ``stop`` or beyond."""
        out = [(0, link)]
        for depth, name in out:  # grows while it is walked
            out += [
                (depth + 1, joint.child)
                for joint in self.below[name]
                if joint.kind == "fixed" and joint.child not in stop
            ]
        return out

    def is_hollow(self, link: str) -> bool:
        """Whether neither ``link`` nor a link fixed to it has geometry."""
        parts = [self.model.links[part] for _, part in self.rigid(link)]
        return not any(part.collisions or part.visuals for part in parts)

    def driving(self, path: Sequence[UrdfJoint]) -> int:
        """The number of joints at the beginning of ``path``, from the root, that are a driving
        base: two perpendicular slides of links without geometry, and a revolute joint, if any."""
        slides = path[:2]
        if len(path) < 2 or not all(
            joint.kind == "prismatic" and self.is_hollow(joint.child) for joint in slides
        ):
            return 0
        first, second = slides
        across = rotation_of(second.rpy) @ np.array(second.axis)
        if abs(float(across @ np.array(first.axis))) > ACROSS:
            return 0
        return 3 if [joint.kind for joint in path[2:3]] in (["revolute"], ["continuous"]) else 2

    def onward(self, link: str) -> list[UrdfJoint]:
        """The movable joints on the rigid body of ``link``, outward."""
        return [j for _, part in self.rigid(link) for j in self.below[part] if j.kind != "fixed"]

    def body(self, link: str) -> str:
        """The first link, from the root, of the rigid body that ``link`` belongs to."""
        while link in self.above and self.above[link].kind == "fixed":
            link = self.above[link].parent
        return link

    def subtree(self, joint: UrdfJoint) -> list[UrdfJoint]:
        """``joint`` and every movable joint beyond it."""
        out = [joint]
        for each in out:
            out += self.onward(each.child)
        return out

    def movable(self, link: str) -> list[UrdfJoint]:
        """The movable joints from the root to ``link``."""
        return [joint for joint in self.path(link) if joint.kind != "fixed"]

    @cached_property
    def outward(self) -> tuple[UrdfJoint, ...]:
        """Every joint, those nearer to the root first."""
        out = list(self.below[self.model.root])
        for joint in out:
            out += self.below[joint.child]
        return tuple(out)

    @cached_property
    def before(self) -> dict[str, int]:
        """The number of movable joints between the root and each link."""
        out = {self.model.root: 0}
        for joint in self.outward:
            out[joint.child] = out[joint.parent] + (joint.kind != "fixed")
        return out

    @cached_property
    def after(self) -> dict[str, int]:
        """The most movable joints on a path that starts at each link."""
        out = dict.fromkeys(self.model.links, 0)
        for joint in reversed(self.outward):
            out[joint.parent] = max(out[joint.parent], self.reach(joint, out))
        return out

    def reach(self, joint: UrdfJoint, after: dict[str, int] | None = None) -> int:
        """The most movable joints on a path that starts with ``joint``."""
        return (joint.kind != "fixed") + (self.after if after is None else after)[joint.child]

    @cached_property
    def followers(self) -> frozenset[str]:
        """Mimic joints that are not beyond the joint they follow, such as fingers and rods."""
        return frozenset(
            joint.name
            for joint in self.model.joints.values()
            if joint.mimic is not None
            and joint.mimic.joint not in {above.name for above in self.path(joint.parent)}
        )

    @cached_property
    def hands(self) -> frozenset[str]:
        """Joints of grippers and hands, by name, by mimic pair, or as equal short branches."""
        first = [joint for joint in self.model.joints.values() if self._starts_hand(joint)]
        return frozenset(each.name for joint in first for each in self.subtree(joint))

    def _starts_hand(self, joint: UrdfJoint) -> bool:
        if joint.kind == "fixed":
            return False
        own, link = words_of(joint.name), words_of(joint.child)
        if own & FINGER or ((link & FINGER or own & HAND) and not own & TURN):
            return True
        above = self.before[joint.parent]
        beside = self.onward(self.body(joint.parent))
        reach = self.reach(joint)
        if any(j.mimic is not None and j.mimic.joint == joint.name for j in beside):
            return joint.mimic is None and reach <= above
        same = len(beside) > 1 and all(self.reach(j) == reach for j in beside)
        return same and above >= LEAST_ABOVE and reach < above

    def is_linkage(self, joint: UrdfJoint, beside: UrdfJoint) -> bool:
        """Whether ``joint`` begins bars of a linkage that a joint of the arm drives.

        Such bars turn about axes along that of the arm's joint ``beside`` them on one body, and
        carry nothing that turns otherwise.
        """
        parts = [each for each in self.subtree(joint) if each.mimic is None]
        if not 1 < len(parts) <= MOST_BARS or any(each.kind != "revolute" for each in parts):
            return False
        if any((words_of(j.name) | words_of(j.child)) & (HEAD | LEG | PALM | WHEEL) for j in parts):
            return False
        axes = [self._direction(each) for each in (beside, *parts)]
        return min(abs(float(axes[0] @ axis)) for axis in axes) > ALONG

    def _direction(self, joint: UrdfJoint) -> FloatArray:
        """The axis (3,) of a joint in the frame of the root, with all joints at zero."""
        turn = np.eye(3)
        for each in self.path(joint.child):
            turn = turn @ rotation_of(each.rpy)
        return np.asarray(turn @ np.array(joint.axis))

    def named(self, vocabulary: frozenset[str]) -> frozenset[str]:
        """Movable joints whose name or child's name has a word of ``vocabulary``, and all joints
        beyond them."""
        return frozenset(
            each.name
            for joint in self.model.joints.values()
            if joint.kind != "fixed" and (words_of(joint.name) | words_of(joint.child)) & vocabulary
            for each in self.subtree(joint)
        )


_NONE: Mapping[str, float] = MappingProxyType({})


class Placement(NamedTuple):
    """The place of a link on its segment: x_segment = rotation @ x_link + translation.

    ``segment`` is -1 for the fixed base. ``driver`` names the off-chain joint, driven by a joint of
    the chain, that moves the link relative to its segment; empty for a link carried rigidly.
    """

    segment: int
    rotation: FloatArray
    translation: FloatArray
    driver: str = ""
    rigid: bool = True  # neither such a joint nor one of a branch, which is held, lies between


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
        if joint.fault or (joint := model.joints[drives[joint.name].joint]).fault:
            raise InvalidRobotError(joint.fault)
    names = tuple(dict.fromkeys(drives[joint.name].joint for joint in movable))
    index = {name: i for i, name in enumerate(names)}
    _check_held(model, held, drives, index)
    lower, upper, velocity = _limits(model, index, drives)
    segments, placements, still = _placed(tree, path, held, drives, index)
    kinematics = Kinematics(
        kind=frozen([PRISMATIC if j.kind == "prismatic" else REVOLUTE for j in movable], np.int64),
        rotation=frozen([rotation for rotation, _ in segments]),
        translation=frozen([translation for _, translation in segments]),
        axis=frozen([joint.axis for joint in movable]),
        dof=frozen([index[drives[joint.name].joint] for joint in movable], np.int64),
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
    drives: Mapping[str, UrdfMimic],
    index: Mapping[str, int],
) -> tuple[list[tuple[FloatArray, FloatArray]], dict[str, Placement], set[str]]:
    """The frame of each moving joint of ``path`` at zero, the placement of every link, and the
    names of the joints at rest."""
    joints, on_path = tree.model.joints, {joint.name for joint in path}
    whole = tree.path(path[-1].child)  # from the root
    placements = {tree.model.root: Placement(-1, np.eye(3), np.zeros(3))}
    segments: list[tuple[FloatArray, FloatArray]] = []
    still: set[str] = set()
    for joint in tree.outward:
        frame = placements[joint.parent]
        rotation = frame.rotation @ rotation_of(joint.rpy)
        translation = frame.rotation @ np.array(joint.xyz) + frame.translation
        segment, driver, rigid = frame.segment, frame.driver, frame.rigid
        if joint.kind != "fixed":
            drive, rigid = drives[joint.name], rigid and joint in whole
            if joint.name in on_path:
                segments.append((rotation, translation))
                segment, rotation, translation = len(segments) - 1, np.eye(3), np.zeros(3)
            elif drive.joint in index:
                driver = driver or joint.name
            else:
                still.add(joint.name)
                leader = joints[drive.joint]
                rest = held.get(drive.joint, min(max(0.0, leader.lower), leader.upper))
                value = drive.multiplier * rest + drive.offset
                if joint.kind == "prismatic":
                    translation = rotation @ (np.array(joint.axis) * value) + translation
                else:
                    rotation = rotation @ turned(joint.axis, value)
        placements[joint.child] = Placement(segment, rotation, translation, driver, rigid)
    return segments, placements, still


def _check_held(
    model: UrdfModel,
    held: Mapping[str, float],
    drives: Mapping[str, UrdfMimic],
    index: Mapping[str, int],
) -> None:
    """Refuse to hold a joint of the arm, a mimic joint, or a joint outside its limits."""
    free = [
        name
        for name, joint in model.joints.items()
        if joint.kind != "fixed" and drives[name].joint == name and name not in index
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


def _drives(model: UrdfModel) -> dict[str, UrdfMimic]:
    """Each movable joint as a function of a joint that mimics none."""
    drives: dict[str, UrdfMimic] = {}
    for joint in model.joints.values():
        trail = []
        current = joint
        while current.mimic is not None and current.name not in drives:
            trail.append((current.name, current.mimic))
            current = model.joints[current.mimic.joint]
        drive = drives.setdefault(current.name, UrdfMimic(current.name, 1.0, 0.0))
        for name, mimic in reversed(trail):
            m, o = mimic.multiplier, mimic.offset
            drive = UrdfMimic(drive.joint, m * drive.multiplier, m * drive.offset + o)
            drives[name] = drive
    return drives


def _limits(
    model: UrdfModel, index: Mapping[str, int], drives: Mapping[str, UrdfMimic]
) -> tuple[list[float], list[float], list[float]]:
    """Position limits and velocity limits of the independent joints, by which every joint that they
    drive stays within its limits."""
    lower = [model.joints[name].lower for name in index]
    upper = [model.joints[name].upper for name in index]
    velocity = [model.joints[name].velocity for name in index]
    for joint in model.joints.values():
        drive = drives[joint.name]
        if joint.mimic is None or drive.joint not in index:
            continue
        i, m, o = index[drive.joint], drive.multiplier, drive.offset
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
                f"leader '{drive.joint}' keeps"
            )
    return lower, upper, velocity
