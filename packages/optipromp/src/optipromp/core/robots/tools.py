"""Tools on the flange: the swallowing cup, the Franka hand, and the mounting of any tool."""

import functools
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry.shapes import Box, Cylinder, MeshShape, Shape, hull_faces
from optipromp.core.robots.cup_cover import NECK_RADIUS, cover_cup
from optipromp.core.robots.grippers import FingerGripper, MeshTool, Scissor, Suction
from optipromp.core.robots.model import BodySpheres, Robot, candidate_pairs, drop_always_touching
from optipromp.core.robots.mounted import Mounted, cover_load, loads_of, unmounted
from optipromp.core.robots.tool_geometry import Part, Solid, strip
from optipromp.core.robots.tool_protocol import (
    Distance,
    Size,
    Tool,
    check_length,
    check_tool,
    quaternion,
)
from optipromp.core.values import Validated

TOOL_LINK = "tool"
WALL = 0.002  # [m] chosen: thickness of a cup's floor, and of its wall by default
Corners = tuple[tuple[float, float, float], ...]
FINGERS = 0.0584  # [m] before the flange, where the fingers of the Franka hand begin
# The Franka hand: convex parts by their corners [mm], each its own mirror image in x. Half of the
# thickness along x, then y and z in the hand's axes: of the palm from the flange, of a finger from
# the inner side of its pad at FINGERS. The maker's visual meshes stand at most 2 mm out of them.
PALM: Corners = (
    (2, -78, -28), (1, -103, -16), (23, 77, -10), (16, -91, -4), (26, 85, -4), (32, 1, 0),
    (22, 94, 2), (18, -99, 31), (20, 99, 50), (16, 101, 55), (15, -102, 57), (18, -92, 63),
    (15, 93, 64), (13, -96, 66), (12, 96, 66),
)  # fmt: skip
FINGER: dict[str, Corners] = {
    "base": ((11, 2, 0), (11, 26, 0), (11, 25, 19), (9, 16, 36), (9, 7, 36)),
    "pad": ((8, 0, 36), (8, 15, 36), (8, 15, 53.9), (8, 0, 53.9)),
}
# y, z, radius [m] in the same axes: the fewest spheres that contain every point of the maker's
# meshes and reach at most 15 mm beyond them (docs/decisions.md). They contain the parts above.
PALM_SPHERES = (
    (-0.064, -0.004, 0.0312), (-0.08, 0.004, 0.0328), (-0.02, 0.008, 0.0423),
    (0.028, 0.012, 0.041), (0.068, 0.016, 0.039), (-0.016, 0.036, 0.0378),
    (-0.052, 0.04, 0.0369), (-0.076, 0.044, 0.0348), (0.024, 0.044, 0.035),
    (0.072, 0.044, 0.035),
)  # fmt: skip
FINGER_SPHERES = (0.012, 0.016, 0.025), (0.008, 0.036, 0.0212)
WALLS = 16  # flat pieces of a cup's wall, chosen


@dataclass(frozen=True)
class Cup(Validated, Tool, label="tool cup: "):
    """A swallowing gripper: an open cylinder on a slender neck, its axis along flange z. Metres.

    The neck (radius 0.01) of ``length`` joins the flange and the cup's base. The wall of outer
    ``radius`` and ``height`` joins the base and the rim. ``opening`` is the inner diameter, by
    default 2 ``radius``: a thin wall. The tool point, where the centre of a swallowed fruit rests,
    is ``depth`` below the rim. The tool axis points out of the mouth. ``taper`` is the slope of a
    cone under the base, from its edge down to the neck [degrees]; 0: the underside is flat.
    """

    radius: Size
    height: Size = 0.05
    length: Distance = 0.10
    depth: float = 0.02
    opening: float | None = None
    taper: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_length("cup", "depth", self.depth, 0.0, self.height)
        if self.opening is not None:
            check_length("cup", "opening", self.opening, 0.0, 2.0 * self.radius, open_below=True)
        wide = max(self.radius - NECK_RADIUS, 0.0)
        most = min(round(math.degrees(math.atan2(self.length, wide)), 2), 89.99)
        unit = f"degrees, so that the cone ends on the neck of {self.length:g} metres"
        check_length("cup", "taper", self.taper, 0.0, most, unit=unit)

    @property
    def cone(self) -> float:
        """Height of the cone under the base [m]; 0: none."""
        high = (self.radius - NECK_RADIUS) * math.tan(math.radians(self.taper))
        return min(max(high, 0.0), self.length)

    @property
    def point(self) -> FloatArray:
        return np.array([0.0, 0.0, self.length + self.height - self.depth])

    def spheres(self) -> FloatArray:
        inner = self.radius if self.opening is None else self.opening / 2.0
        return cover_cup(self.radius, inner, self.height, self.length, self.cone)

    @property
    def front(self) -> float:
        """Height of the cup's base over the flange [m]."""
        return self.length

    @property
    def tip(self) -> float:
        """Height of the rim over the flange [m]."""
        return self.length + self.height

    @property
    def mouth(self) -> tuple[float, float]:
        if self.opening is None:
            return max(self.radius - WALL, 0.5 * self.radius), self.radius
        return min(self.opening / 2.0, self.radius - 1e-4), self.radius

    def outline(self) -> tuple[FloatArray, ...]:
        """The cup cut along its axis: neck, base, walls and cone; see :meth:`Tool.outline`."""
        (inner, outer), rim, flange = self.mouth, self.depth, -self.reach
        base = rim - self.height
        neck = (flange, base, -NECK_RADIUS, NECK_RADIUS)
        floor = (base, base + WALL, -outer, outer)
        walls = (base, rim, inner, outer), (base, rim, -outer, -inner)
        sides = [neck, floor, *walls] if self.length > 0.0 else [floor, *walls]
        cone = strip(base - self.cone, base, -outer, outer)
        cone[[0, 3], 1] = -NECK_RADIUS, NECK_RADIUS
        return (*(strip(*side) for side in sides), *([cone] if self.cone else []))

    def solids(self) -> tuple[Solid, ...]:
        """Neck, floor, cone and a ring of flat walls."""
        (inner, outer), floor = self.mouth, min(WALL, self.height / 4.0)
        wide = 2.0 * (self.radius * np.tan(np.pi / WALLS))
        wall = outer - inner
        middle, aside = self.length + 0.5 * self.height, inner + wall / 2.0
        out = []
        if self.length > 0.0:
            neck = Cylinder(min(NECK_RADIUS, self.radius), self.length)
            out.append(Solid("neck", neck, np.array([0.0, 0.0, self.length / 2.0]), part="neck"))
        at = np.array([0.0, 0.0, self.length + floor / 2.0])
        out.append(Solid("floor", Cylinder(self.radius, floor), at, part="mouth"))
        if self.cone:
            turn = np.linspace(0.0, 2.0 * np.pi, 3 * WALLS, endpoint=False)
            edge = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))])
            down = NECK_RADIUS * edge - [0.0, 0.0, self.cone]
            corners = np.concatenate([self.radius * edge, down])
            cone, base = MeshShape(corners, hull_faces(corners)), np.array([0.0, 0.0, self.length])
            out.append(Solid("cone", cone, base, part="mouth"))
        for k in range(WALLS):
            angle = 2.0 * np.pi * k / WALLS
            at = np.array([aside * np.cos(angle), aside * np.sin(angle), middle])
            turned = float(np.cos(angle / 2.0)), 0.0, 0.0, float(np.sin(angle / 2.0))
            out.append(Solid(f"wall:{k}", Box((wall, wide, self.height)), at, turned, "mouth"))
        return tuple(out)

    def inertia(self, mass: float) -> tuple[FloatArray, FloatArray]:
        """Centre (3,) [m] and inertia (3, 3) [kg m²] of a tube of the whole ``mass`` [kg]."""
        across = 0.5 * self.radius**2 + self.height**2 / 12.0
        middle = np.array([0.0, 0.0, self.length + 0.5 * self.height])
        return middle, mass * np.diag([across, across, self.radius**2])


@dataclass(frozen=True)
class FrankaHand(Validated, Tool, label="tool franka_hand: "):
    """The Franka hand, open. It is mounted turned by -45 degrees about flange z, as Franka does.

    The tool point lies between the finger tips, 0.1034 beyond the flange. Palm and fingers are
    convex parts, which simulation and push models use. The body spheres contain all of them and
    every point of the maker's collision meshes; they reach at most 15 mm beyond the meshes and
    17 mm beyond the parts.
    """

    fingers = True
    reach: Size = 0.1034
    gripper_radius: Size = 0.04  # half of the 0.08 m between the open fingers

    def spheres(self) -> FloatArray:
        left = np.array(FINGER_SPHERES) + [self.gripper_radius, FINGERS, 0.0]
        y, z, radius = np.concatenate([PALM_SPHERES, left, left * [-1.0, 1.0, 1.0]]).T
        return np.column_stack([np.outer(y, self.rotation[:2, 1]), z, radius])

    @property
    def point(self) -> FloatArray:
        return np.array([0.0, 0.0, self.reach])

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) columns: the hand's x (its thin side), y (along which it opens) and z axes."""
        c = math.sqrt(0.5)
        return np.array([[c, c, 0.0], [-c, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def mouth(self) -> tuple[float, float]:
        """Half the opening between the fingers, and half the distance of their backs [m]."""
        half = self.gripper_radius
        return half, half + 1e-3 * max(y for _, y, _ in FINGER["base"])

    @property
    def front(self) -> float:
        """Height of the palm's front over the flange [m]."""
        return 1e-3 * max(z for *_, z in PALM)

    @property
    def tip(self) -> float:
        """Height of the finger tips over the flange [m]."""
        return FINGERS + 1e-3 * max(z for *_, z in FINGER["pad"])

    def solids(self) -> tuple[Solid, ...]:
        """The palm, and base and pad of either finger."""
        return _hand(self)


@functools.lru_cache(maxsize=8)
def _hand(hand: FrankaHand) -> tuple[Solid, ...]:
    w, x, y, z = quaternion(hand.rotation).tolist()
    parts: list[tuple[str, Part, Corners, FloatArray, float]] = [
        ("palm", "palm", PALM, np.zeros(3), 1.0)
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        at = np.array([0.0, sign * hand.gripper_radius, FINGERS])
        parts += [(f"{side} {name}", "finger", rows, at, sign) for name, rows in FINGER.items()]
    out = []
    shape: Shape
    for name, part, rows, at, sign in parts:
        half = 1e-3 * np.array(rows) * [1.0, sign, 1.0]
        corners = np.concatenate([half, half * [-1.0, 1.0, 1.0]]) + at
        middle, shape = np.zeros(3), MeshShape(corners, hull_faces(corners))
        if len(rows) == 4:  # an upright box, which meets a can in two points, a mesh in one
            middle, shape = 0.5 * (corners.min(0) + corners.max(0)), Box(tuple(np.ptp(corners, 0)))
        out.append(Solid(f"hand:{name}", shape, hand.rotation @ middle, (w, x, y, z), part))
    return tuple(out)


def cone_of(tool: Tool) -> float:
    """Height of the cone under the base of a cup, as it is mounted [m]; 0 of other tools."""
    own = unmounted(tool)
    return own.cone if isinstance(own, Cup) else 0.0


TOOLS: dict[str, type[Tool]] = {
    "cup": Cup,
    "franka_hand": FrankaHand,
    "finger_gripper": FingerGripper,
    "scissor": Scissor,
    "suction": Suction,
    "mesh": MeshTool,
}
"""Classes of tools by their kind in scene files."""


def make_tool(kind: str, parameters: Mapping[str, Any]) -> Tool:
    """A tool of one of the :data:`TOOLS` from its parameters.

    The parameter ``mount``, of every kind, is a position and an orientation in the flange frame
    (:class:`optipromp.core.robots.mounted.Mounted`).
    """
    if kind not in TOOLS:
        raise InvalidSceneError(f"tool.kind is {kind!r}; valid are {', '.join(TOOLS)}")
    own = dict(parameters)
    mount = own.pop("mount", None)
    try:
        tool = TOOLS[kind](**own)
        return tool if mount is None else Mounted(tool, *mount)
    except TypeError as error:  # a parameter that the kind does not have, or lacks
        raise InvalidRequestError(f"tool {kind}: {error}") from None


def with_tool(robot: Robot, tool: Tool) -> Robot:
    """``robot`` with ``tool`` on its flange, in place of any tool it carries.

    The tool is a new last link, "tool": distal and fixed to the last link. Each load of a
    :class:`optipromp.core.robots.mounted.Mounted` tool is such a link before it. Their spheres stay
    off the links of all segments but the last two.

    Args:
        robot: with or without a tool.
        tool: one of :data:`TOOLS`, or of any class with the members of :class:`Tool`.

    Raises:
        InvalidRequestError: the robot has a link of its own named "tool", or named as a load;
            ``tool`` lacks members, or its numbers contradict one another.
    """
    check_tool(tool)
    bare = without_tool(robot)
    if TOOL_LINK in bare.link_names:
        raise InvalidRequestError(
            f"robot '{robot.name}' has a link named '{TOOL_LINK}'; rename it to mount a tool"
        )
    loads = loads_of(tool)
    for load in loads:
        if load.id in bare.link_names:
            raise InvalidRequestError(
                f"attached {load.id!r} is the name of a link of {robot.name}; give it another id"
            )
    covers = [*map(cover_load, loads), tool.spheres()]
    cover, links = np.concatenate(covers), len(bare.link_names)
    rotation, translation = bare.flange_rotation, bare.flange_translation
    body, k = bare.spheres, len(cover)
    _check_free(bare, tool)
    spheres = BodySpheres(
        segment=frozen([*body.segment, *[bare.n_segments - 1] * k], np.int64),
        center=frozen(np.concatenate([body.center, cover[:, :3] @ rotation.T + translation])),
        radius=frozen(np.concatenate([body.radius, cover[:, 3]])),
        link=frozen(
            [*body.link, *np.repeat(links + np.arange(len(covers)), [*map(len, covers)])], np.int64
        ),
        distal=frozen([*body.distal, *[True] * k], np.bool_),
    )
    robot = replace(
        bare,
        spheres=spheres,
        link_names=(*bare.link_names, *(load.id for load in loads), TOOL_LINK),
        tool_point=frozen(translation + rotation @ tool.point),
        tool_axis=frozen(rotation @ tool.rotation[:, 2]),
        gripper_radius=float(tool.gripper_radius),
        tool=tool,
        tool_links=len(covers),
    )
    pairs = candidate_pairs(robot)
    pairs = pairs[pairs[:, 1] >= len(body.radius)]  # those of the arm are known
    pairs = drop_always_touching(robot, pairs)
    return replace(
        robot,
        self_pairs=frozen(np.concatenate([bare.self_pairs, pairs]), np.int64),
        self_slack=frozen(np.append(bare.self_slack, np.zeros(len(pairs)))),
    )


def _check_free(bare: Robot, tool: Tool) -> None:
    """Warn if a link that the last link carries, such as a finger, stands beside a tool's mouth."""
    spheres = bare.spheres
    last = spheres.link[spheres.distal].min(initial=len(bare.link_names))
    riding = spheres.distal & (spheres.link > last)
    along = (spheres.center - bare.flange_translation) @ bare.flange_rotation @ tool.rotation[:, 2]
    before = np.where(riding, along - tool.front, -np.inf)  # of the spheres' middles
    if before.max(initial=0.0) > 0.0:
        link = bare.link_names[spheres.link[before.argmax()]]
        warnings.warn(
            f"link '{link}' stands beside the mouth of the tool, or before it: give the tool a "
            "longer neck, or the robot a flange (tip) before that link",
            stacklevel=3,
        )


def without_tool(robot: Robot) -> Robot:
    """``robot`` with a bare flange: the tool point is the flange's origin."""
    if robot.tool is None:
        return robot
    keep: BoolArray = robot.spheres.link < robot.n_own_links
    own = np.all(keep[robot.self_pairs], axis=1)
    spheres = BodySpheres(*(frozen(values[keep], values.dtype) for values in robot.spheres))
    return replace(
        robot,
        spheres=spheres,  # the tool's come last, so the other indices stay
        link_names=robot.link_names[: robot.n_own_links],
        self_pairs=frozen(robot.self_pairs[own], np.int64),
        self_slack=frozen(robot.self_slack[own]),
        tool_point=robot.flange_translation,
        tool_axis=frozen(robot.flange_rotation[:, 2]),
        gripper_radius=0.0,
        tool=None,
        tool_links=0,
    )
