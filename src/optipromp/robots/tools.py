"""Tools on the flange: a swallowing cup and the Franka hand; each is a few covering spheres."""

import math
from dataclasses import dataclass, replace

import numpy as np

from optipromp.arrays import BoolArray, FloatArray, IntArray, frozen
from optipromp.errors import InvalidRequestError
from optipromp.robots.cup_cover import cover_cup
from optipromp.robots.model import BodySpheres, Robot
from optipromp.robots.self_collision import candidate_pairs, drop_always_touching
from optipromp.robots.spheres import cover_capsule

TOOL_LINK = "tool"
LARGEST = 5.0  # [m] a tool dimension beyond it is taken for millimetres


@dataclass(frozen=True)
class Cup:
    """A swallowing gripper: an open cylinder on a slender neck, its axis along flange z. Metres.

    The neck (radius 0.01) runs ``length`` from the flange to the cup's base; the wall of outer
    ``radius`` rises ``height`` from there to the rim; ``opening`` is the inner diameter (default:
    2 ``radius``, a thin wall). A swallowed fruit's centre rests ``depth`` below the rim: that is
    the tool point, and the tool axis points out of the mouth.

    Raises:
        InvalidRequestError: a parameter out of its range, named with its value.
    """

    radius: float
    height: float = 0.05
    length: float = 0.10
    depth: float = 0.02
    opening: float | None = None

    def __post_init__(self) -> None:
        _check("cup", "radius", self.radius, 0.0, LARGEST, open_below=True)
        _check("cup", "height", self.height, 0.0, LARGEST, open_below=True)
        _check("cup", "length", self.length, 0.0, LARGEST)
        _check("cup", "depth", self.depth, 0.0, self.height)
        if self.opening is not None:
            _check("cup", "opening", self.opening, 0.0, 2.0 * self.radius, open_below=True)

    @property
    def reach(self) -> float:
        """Height of the tool point above the flange [m]."""
        return self.length + self.height - self.depth

    @property
    def gripper_radius(self) -> float:
        """Outer radius of the cup: how far the tool axis passes from a fruit's centre [m]."""
        return self.radius

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) over neck, base, wall and rim, in the flange frame [m]."""
        inner = self.radius if self.opening is None else self.opening / 2.0
        return cover_cup(self.radius, inner, self.height, self.length)


@dataclass(frozen=True)
class FrankaHand:
    """The Franka hand with its fingers: two capsules along its y, 0.1 m between sphere centres.

    Radius 0.04 at flange z 0.04 (the hand) and 0.02 at 0.10 (the fingers). The hand is mounted
    turned by -45 degrees about flange z, as Franka mounts it. The tool point lies between the
    finger tips, 0.1034 beyond the flange.
    """

    reach: float = 0.1034
    gripper_radius: float = 0.04  # half of the 0.08 m between the open fingers

    def __post_init__(self) -> None:
        _check("franka_hand", "reach", self.reach, 0.0, LARGEST, open_below=True)
        _check("franka_hand", "gripper_radius", self.gripper_radius, 0.0, LARGEST, open_below=True)

    def spheres(self) -> FloatArray:
        """Spheres (k, 4) over both capsules, in the flange frame [m]."""
        c = math.sqrt(0.5)
        half = 0.05 * np.array([c, c, 0.0])  # the hand's y, turned by -45 degrees about z
        covers = []
        for height, radius in ((0.04, 0.04), (0.10, 0.02)):
            middle = np.array([0.0, 0.0, height])
            covers.append(cover_capsule(middle - half, middle + half, radius, bulge=0.006))
        return np.concatenate(covers)


Tool = Cup | FrankaHand


def with_tool(robot: Robot, tool: Tool) -> Robot:
    """``robot`` with ``tool`` on its flange, in place of any tool it carries.

    The tool is a new last link, "tool": distal, at rest relative to the last link and a neighbour
    of the one before; the spheres of other links are kept from it.

    Raises:
        InvalidRequestError: the robot has a link of its own named "tool".
    """
    bare = without_tool(robot)
    if TOOL_LINK in bare.link_names:
        raise InvalidRequestError(
            f"robot '{robot.name}' has a link named '{TOOL_LINK}'; rename it to mount a tool"
        )
    cover = tool.spheres()
    rotation, translation = bare.flange_rotation, bare.flange_translation
    body, k = bare.spheres, len(cover)
    spheres = BodySpheres(
        segment=frozen([*body.segment, *[bare.n_segments - 1] * k], np.int64),
        center=frozen(np.concatenate([body.center, cover[:, :3] @ rotation.T + translation])),
        radius=frozen(np.concatenate([body.radius, cover[:, 3]])),
        link=frozen([*body.link, *[len(bare.link_names)] * k], np.int64),
        distal=frozen([*body.distal, *[True] * k], np.bool_),
    )
    robot = replace(
        bare,
        spheres=spheres,
        link_names=(*bare.link_names, TOOL_LINK),
        tool_point=frozen(translation + tool.reach * rotation[:, 2]),
        gripper_radius=float(tool.gripper_radius),
        tool=tool,
    )
    pairs = candidate_pairs(robot)
    pairs = pairs[pairs[:, 1] >= len(body.radius)]  # the arm's own are known
    pairs = drop_always_touching(robot, pairs)
    return replace(robot, self_pairs=frozen(np.concatenate([bare.self_pairs, pairs]), np.int64))


def without_tool(robot: Robot) -> Robot:
    """``robot`` with a bare flange: the tool point is the flange's origin."""
    if robot.tool is None:
        return robot
    keep: BoolArray = robot.spheres.link != len(robot.link_names) - 1
    pairs: IntArray = robot.self_pairs[keep[robot.self_pairs].all(axis=1)]
    spheres = BodySpheres(*(frozen(values[keep], values.dtype) for values in robot.spheres))
    return replace(
        robot,
        spheres=spheres,  # the tool's come last, so the other indices stay
        link_names=robot.link_names[:-1],
        self_pairs=frozen(pairs, np.int64),
        tool_point=robot.flange_translation,
        gripper_radius=0.0,
        tool=None,
    )


def _check(
    tool: str, field: str, value: float, low: float, high: float, open_below: bool = False
) -> None:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if (
        number
        and math.isfinite(value)
        and low <= value <= high
        and not (open_below and value <= low)
    ):
        return
    bracket = "(" if open_below else "["
    raise InvalidRequestError(
        f"tool {tool}: {field} is {value!r}; it must be in {bracket}{low:g}, {high:g}] metres"
    )
