"""Arms of equal reach with 3 to 7 joints, which docs/joints.md compares.

Every arm is made of one set of links: a column of 0.30 m, an upper arm of 0.42 m, a forearm of
0.33 m and a wrist of 0.105 m, so the flange reaches 0.855 m from the shoulder, as a Panda's. Names
tell the joints from the base on: y turns about the vertical, p pitches, r rolls about the link, s
slides along the vertical.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

COLUMN, UPPER, FORE, WRIST = 0.30, 0.42, 0.33, 0.105  # [m] of the links
RADIUS, LIMIT, SPEED = 0.045, 2.9, 2.2  # [m], [rad], [rad/s] of every link and joint
SLIDE = 0.40  # [m] of a joint that slides
FAMILY: Mapping[str, str] = {
    "3 yys": "yys", "4 yppp": "yppp", "5 ypprp": "ypprp", "6 ypprpr": "ypprpr",
    "6 yprprp": "yprprp", "7 yprprpr": "yprprpr",
}  # fmt: skip


def urdf(joints: str) -> str:
    """An arm of the family as URDF text.

    The letters are joints from the base on. Pitching joints stand at the shoulder, the elbow and
    the wrist; rolling ones lie in the link before the next pitch; of ``yys`` both turn about the
    vertical, and the hand hangs on a slide.
    """
    lengths = {0: UPPER, 1: FORE, 2: WRIST}
    parts, index, at, pitches = [_link("base", COLUMN, "0 0 1")], 0, f"0 0 {COLUMN}", 0
    parent = "base"
    if joints == "yys":
        ahead = (UPPER, FORE)
        for k, long in enumerate(ahead):
            parts += [_joint(k, "revolute", parent, at, "0 0 1"), _link(f"l{k}", long, "1 0 0")]
            parent, at = f"l{k}", f"{long} 0 0"
        parts += [_joint(2, "prismatic", parent, at, "0 0 1"), _link("l2", WRIST, "0 0 1")]
        return _robot([*parts, _flange("l2", f"0 0 {WRIST}")])
    for letter in joints:
        axis = {"y": "0 0 1", "p": "0 1 0", "r": "0 0 1"}[letter]
        name = f"l{index}"
        parts.append(_joint(index, "revolute", parent, at, axis))
        if letter == "p":
            parts.append(_link(name, lengths[pitches], "0 0 1"))
            at, pitches = f"0 0 {lengths[pitches]}", pitches + 1
        else:
            parts.append(_link(name, 0.0, "0 0 1"))
            at = "0 0 0"
        parent, index = name, index + 1
    return _robot([*parts, _flange(parent, at)])


def _robot(parts: Iterable[str]) -> str:
    return f'<robot name="family">{"".join(parts)}</robot>'


def _link(name: str, long: float, along: str) -> str:
    x, _, z = (float(value) for value in along.split())
    middle = f"{0.5 * long * x} 0 {0.5 * long * z}"
    turn = "0 1.5707963 0" if x else "0 0 0"
    mass = 1.0 + 4.0 * long
    body = ""
    if long > 0.05:
        size = f'<cylinder radius="{RADIUS}" length="{long}"/>'
        origin = f'<origin xyz="{middle}" rpy="{turn}"/>'
        body = f"<collision>{origin}<geometry>{size}</geometry></collision>"
    inertia = 'ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"'
    return (
        f'<link name="{name}"><inertial><origin xyz="{middle}"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial>{body}</link>"
    )


def _joint(index: int, kind: str, parent: str, at: str, axis: str) -> str:
    low, high = (-SLIDE, 0.0) if kind == "prismatic" else (-LIMIT, LIMIT)
    return (
        f'<joint name="j{index}" type="{kind}"><parent link="{parent}"/><child link="l{index}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" velocity="{SPEED}" effort="200"/></joint>'
    )


def _flange(parent: str, at: str) -> str:
    return (
        f'<link name="flange"/><joint name="f" type="fixed"><parent link="{parent}"/>'
        f'<child link="flange"/><origin xyz="{at}"/></joint>'
    )


def robot_file(name: str, folder: Path) -> Path:
    """The robot file of an arm of the family, written to ``folder``."""
    joints = FAMILY[name]
    file = folder / f"{joints}.yaml"
    (folder / f"{joints}.urdf").write_text(urdf(joints))
    acceleration = ", ".join(["10.0"] * len(joints))
    file.write_text(
        f"format: 1\nname: {joints}\nurdf: {joints}.urdf\nflange: flange\n"
        f"acceleration: [{acceleration}]\n"
    )
    return file
