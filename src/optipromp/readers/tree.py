"""The tree of a URDF; fingers, wheels, heads and sensors by names and branches."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optipromp.core.robots.description import rotation_of
from optipromp.readers.urdf import UrdfJoint, UrdfModel


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

    def is_bare(self, link: str) -> bool:
        """Whether ``link`` and the links fixed to it have no geometry and carry no moving joint."""
        return not self.onward(link) and self._is_hollow(link)

    def _is_hollow(self, link: str) -> bool:
        """Whether neither ``link`` nor a link fixed to it has geometry."""
        parts = [self.model.links[part] for _, part in self.rigid(link)]
        return not any(part.collisions or part.visuals for part in parts)

    def driving(self, path: Sequence[UrdfJoint]) -> int:
        """The number of joints at the beginning of ``path``, from the root, that are a driving
        base: two perpendicular slides of links without geometry, and a revolute joint, if any."""
        slides = path[:2]
        if len(path) < 2 or not all(
            joint.kind == "prismatic" and self._is_hollow(joint.child) for joint in slides
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

    def named(self, vocabulary: frozenset[str]) -> frozenset[str]:
        """Movable joints whose name or child's name has a word of ``vocabulary``, and all joints
        beyond them."""
        return frozenset(
            each.name
            for joint in self.model.joints.values()
            if joint.kind != "fixed" and (words_of(joint.name) | words_of(joint.child)) & vocabulary
            for each in self.subtree(joint)
        )
