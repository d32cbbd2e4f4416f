"""URDFs of arms, grippers and bodies, made of joints."""

import re

from tests.robots.links import BALL, joint

SHORT = {"origin": '<origin xyz="0 0 0.2"/>'}


def robot(*joints: str, name: str = "r") -> str:
    """A URDF of these joints; every link they name has a ball."""
    links = dict.fromkeys(re.findall(r'link="([^"]+)"', "".join(joints)))
    held = "".join(f'<link name="{link}">{BALL}</link>' for link in links)
    return f'<robot name="{name}">{held}{"".join(joints)}</robot>'


def fixed(parent: str, child: str) -> str:
    return joint(f"{parent}-{child}", parent, child, kind="fixed", axis="", limit="", **SHORT)


def series(prefix: str, base: str, count: int) -> list[str]:
    """Joints <prefix>1 to <prefix>n, of links <prefix>link1 to <prefix>linkn, from ``base``."""
    links = [base, *(f"{prefix}link{i + 1}" for i in range(count))]
    return [joint(f"{prefix}{i + 1}", links[i], links[i + 1], **SHORT) for i in range(count)]


def slide(name: str, parent: str, child: str, mimic: str = "") -> str:
    more = f'<mimic joint="{mimic}"/>' if mimic else ""
    limit = '<limit lower="0" upper="0.04"/>'
    return joint(name, parent, child, kind="prismatic", limit=limit, more=more, **SHORT)


ARM = series("a", "base", 6)
GRIPPER = [slide("left_drive", "palm", "pad1"), slide("right_drive", "palm", "pad2", "left_drive")]
CAMERA = [fixed("alink6", "camera_link"), fixed("camera_link", "camera_color_optical_frame")]
TORSO = [slide("lift", "foot", "column")]
WHEELS = [
    joint(f"{side}_wheel", "chassis", f"{side}_wheel_link", kind="continuous", limit="")
    for side in ("left", "right")
]
TWO = [*TORSO, *series("left", "column", 6), *series("right", "column", 6)]
