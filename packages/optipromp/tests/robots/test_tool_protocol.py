"""Every kind of tool, and one of the user's own, keeps what the protocol says."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.refusals import assert_refused
from tests.robots.builders import (
    BAR,
    FLOOR,
    INNER,
    OUTER,
    RIM,
    TOOLS,
    Spoon,
    cup_parts,
    joined,
    prism,
    probe,
    square,
)
from tests.robots.covers import worst_gap

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, Cylinder, MeshShape
from optipromp.core.robots import (
    FingerGripper,
    MeshTool,
    Scissor,
    Solid,
    Tool,
    load_robot,
    with_tool,
    without_tool,
)
from optipromp.core.robots.ik import rolls
from optipromp.core.robots.tool_geometry import MOST
from optipromp.core.robots.tools import TOOLS as KINDS
from optipromp.core.robots.tools import Cup, FrankaHand, make_tool

# [m] that the spheres reach beyond the solids of these tools; tests/robots/test_tools.py says how
# tight a cup's spheres are
EXCESS = {
    "franka_hand": 0.0165, "finger_gripper": 0.009, "scissor": 0.0072, "suction": 0.0062,
    "mesh": 0.0078, "probe": 0.0046, "spoon": 0.0038,
}  # fmt: skip
ALL = pytest.mark.parametrize("name", TOOLS)


def points_of(solid: Solid, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, 3) inside and on a solid, in the flange frame."""
    match solid.shape:
        case Box(size):
            local = rng.uniform(-0.5, 0.5, (count, 3)) * size
            face = rng.integers(3, size=count // 2)
            rows = np.arange(count // 2)
            local[rows, face] = 0.5 * np.sign(local[rows, face]) * np.array(size)[face]
        case Cylinder(radius, length):
            turn, r = rng.uniform(0.0, 2.0 * np.pi, count), radius * np.sqrt(rng.random(count))
            r[: count // 2] = radius
            z = rng.uniform(-0.5, 0.5, count) * length
            local = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        case MeshShape(vertices=vertices):
            share = rng.dirichlet(np.full(len(vertices), 0.3), count)
            local = share @ vertices
    return solid.position + local @ solid.rotation.T


def distance(points: np.ndarray, solids: tuple[Solid, ...]) -> np.ndarray:
    """A lower bound of the distance of points from a tool: beyond a face of each solid."""
    least = np.full(len(points), np.inf)
    for solid in solids:
        local = (points - solid.position) @ solid.rotation
        match solid.shape:
            case Box(size):
                beyond = np.maximum(np.abs(local) - 0.5 * np.array(size), 0.0)
                away = np.linalg.norm(beyond, axis=1)
            case Cylinder(radius, length):
                aside = np.maximum(np.hypot(local[:, 0], local[:, 1]) - radius, 0.0)
                away = np.hypot(aside, np.maximum(np.abs(local[:, 2]) - 0.5 * length, 0.0))
            case MeshShape(vertices=vertices):
                faces = ConvexHull(vertices).equations
                away = np.maximum((local @ faces[:, :3].T + faces[:, 3]).max(axis=1), 0.0)
        least = np.minimum(least, away)
    return least


def at(tool: Tool, points: object) -> np.ndarray:
    """Whether the tool holds balls at points (R, 3)."""
    return tool.holds(np.array(points), np.array(points))


def in_tool_axes(tool: Tool, points: np.ndarray) -> np.ndarray:
    return (points - tool.point) @ tool.rotation


@ALL
def test_it_is_a_tool_of_numbers_that_agree(name: str) -> None:
    tool = TOOLS[name]
    assert isinstance(tool, Tool)
    assert hash(tool) == hash(dataclasses.replace(tool))
    np.testing.assert_allclose(tool.rotation.T @ tool.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(tool.rotation) == pytest.approx(1.0)
    assert tool.point @ tool.rotation[:, 2] == pytest.approx(tool.reach)
    assert tool.depth == pytest.approx(tool.tip - tool.reach)
    assert tool.front < tool.tip
    inner, outer = tool.mouth
    assert 0.0 <= inner < outer
    names = [solid.name for solid in tool.solids()]
    assert len(set(names)) == len(names)


@ALL
def test_the_spheres_hold_the_solids_and_little_more(name: str) -> None:
    tool, rng = TOOLS[name], np.random.default_rng(0)
    cover, solids = tool.spheres(), tool.solids()
    assert len(cover) <= MOST
    if name == "cup":  # its round wall is covered, the flat walls of the simulation stand about it
        solids = tuple(s for s in solids if not s.name.startswith("wall"))
    for solid in solids:
        points = points_of(solid, 4000, rng)
        assert worst_gap(points, cover) <= 1e-9, solid.name
    if name == "cup":
        assert len(cover) <= 40
        return
    ways = rng.normal(size=(400, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shell = (cover[:, None, :3] + cover[:, None, 3:] * ways).reshape(-1, 3)
    if name == "mesh":  # inside the mouth there is room for spheres
        local = in_tool_axes(tool, shell)
        within = (np.hypot(local[:, 0], local[:, 1]) < tool.mouth[1]) & (local[:, 2] < tool.depth)
        shell = shell[~within]
    assert 0.95 * EXCESS[name] < distance(shell, solids).max() <= EXCESS[name]


@ALL
def test_the_outline_holds_the_solids_in_front(name: str) -> None:
    """Seen along x, and of a round tool at any roll; what is behind the palm is the arm's."""
    tool, rng = TOOLS[name], np.random.default_rng(1)
    for polygon in tool.outline():
        assert 3 <= len(polygon) <= 8
        side = np.roll(polygon, -1, axis=0) - polygon
        after = np.roll(side, -1, axis=0)
        assert (side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0] > -1e-12).all()
    for solid in tool.solids():
        x, y, u = in_tool_axes(tool, points_of(solid, 1500, rng)).T
        v = y if tool.fingers else np.hypot(x, y) * rng.choice([-1.0, 1.0], len(x))
        if name == "cup":
            if solid.name.startswith("wall"):  # between flat walls there are corners
                v *= math.cos(math.pi / 16)
            if solid.name == "floor":
                v *= 0.999
        beyond = np.full(len(u), np.inf)
        for polygon in tool.outline():
            side = np.roll(polygon, -1, axis=0) - polygon
            normal = np.column_stack([side[:, 1], -side[:, 0]])
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            off = np.column_stack([u, v]) @ normal.T - np.sum(polygon * normal, axis=1)
            beyond = np.minimum(beyond, off.max(axis=1))
        assert beyond.max() < 2e-3, solid.name


@ALL
def test_what_is_held_is_at_the_tool_point_and_not_in_a_solid(name: str) -> None:
    tool, rng = TOOLS[name], np.random.default_rng(2)
    takes = tool.mouth[0] > 0.0
    assert at(tool, [[0.0, 0.0, 0.0]]).tolist() == [takes]
    around = rng.uniform(-0.15, 0.15, (20000, 3))
    held = around[at(tool, around)]
    assert bool(len(held)) is takes
    if takes:
        assert np.hypot(held[:, 0], held[:, 1]).max() <= math.hypot(tool.mouth[0], 0.02)
        assert held[:, 2].max() <= tool.depth + 1e-12
        flange = tool.point + held @ tool.rotation.T
        free = distance(flange, tool.solids())
        if name not in ("cup", "spoon"):  # a cup's floor has a thickness, a spoon is full
            assert (free > -1e-12).all()
            assert np.median(free) > 1e-3


@ALL
def test_its_inertia_is_that_of_a_body(name: str) -> None:
    middle, inertia = TOOLS[name].inertia(0.5)
    moments = np.linalg.eigvalsh(inertia)
    np.testing.assert_allclose(inertia, inertia.T, atol=1e-18)
    assert moments.min() > 0.0
    assert moments.max() <= moments.min() + np.sort(moments)[1] + 1e-12  # triangle inequality
    assert 0.0 <= middle[2] <= TOOLS[name].tip
    np.testing.assert_allclose(TOOLS[name].inertia(1.0)[1], 2.0 * inertia)


def test_the_inertia_of_one_box_is_the_textbooks() -> None:
    middle, inertia = probe().inertia(2.0)
    np.testing.assert_allclose(middle, [0.0, 0.0, 0.05], atol=1e-12)
    across = 2.0 / 12.0 * (0.024**2 + 0.10**2)
    along = 2.0 / 12.0 * 2.0 * 0.024**2
    np.testing.assert_allclose(inertia, np.diag([across, across, along]), atol=1e-15)


@ALL
@pytest.mark.parametrize("robot", ["panda", "scara"])
def test_mounted_on_a_robot(name: str, robot: str) -> None:
    tool, bare = TOOLS[name], load_robot(robot)
    mounted = with_tool(bare, tool)
    flange, _ = bare.tool_pose(bare.home)
    turned = bare.segment_frames(bare.home)[1][-1] @ bare.flange_rotation
    point, axis = mounted.tool_pose(mounted.home)
    np.testing.assert_allclose(point, flange + turned @ tool.point, atol=1e-12)
    np.testing.assert_allclose(axis, turned @ tool.rotation[:, 2], atol=1e-12)
    assert mounted.gripper_radius == tool.gripper_radius
    on_tool = mounted.spheres.link == mounted.link_names.index("tool")
    assert mounted.spheres.distal[on_tool].all()
    local = (mounted.sphere_centers(mounted.home)[on_tool] - flange) @ turned
    np.testing.assert_allclose(local, tool.spheres()[:, :3], atol=1e-12)
    pairs = mounted.spheres.segment[mounted.self_pairs]
    assert (np.abs(pairs[:, 0] - pairs[:, 1]) >= 2).all()
    again = without_tool(mounted)
    np.testing.assert_array_equal(again.tool_point, bare.tool_point)
    np.testing.assert_array_equal(again.tool_axis, bare.tool_axis)


def test_a_gripper_is_as_large_as_it_says() -> None:
    tool = FingerGripper(
        0.06, finger_length=0.05, finger_width=0.02, finger_thickness=0.01, palm_length=0.08,
        palm_width=0.10, palm_thickness=0.05, depth=0.01,
    )  # fmt: skip
    assert (tool.front, tool.mouth, tool.gripper_radius) == (0.08, (0.03, 0.04), 0.03)
    assert (tool.tip, tool.reach) == (pytest.approx(0.13), pytest.approx(0.12))
    palm, left, right = tool.solids()
    assert palm.shape == Box((0.05, 0.10, 0.08))
    assert left.shape == right.shape == Box((0.02, 0.01, 0.05))
    np.testing.assert_allclose(left.position, [0.0, 0.035, 0.105])
    np.testing.assert_allclose(right.position, [0.0, -0.035, 0.105])
    inside = [[0, 0, 0], [0.01, 0.029, 0.0], [-0.01, -0.029, 0.0099], [0, 0, -0.039]]
    outside = [[0.0101, 0, 0], [0, 0.031, 0], [0, 0, 0.0101], [0, 0, -0.041]]
    assert at(tool, inside).all()
    assert not at(tool, outside).any()


def test_a_turned_gripper_is_turned_as_a_whole() -> None:
    straight, turned = FingerGripper(0.06), FingerGripper(0.06, turn=math.pi / 2.0)
    np.testing.assert_allclose(turned.rotation[:, 1], [-1.0, 0.0, 0.0], atol=1e-12)
    for one, other in zip(straight.solids(), turned.solids(), strict=True):
        np.testing.assert_allclose(turned.rotation @ one.position, other.position, atol=1e-12)
        np.testing.assert_allclose(turned.rotation, other.rotation, atol=1e-12)
    for one, other in zip(straight.outline(), turned.outline(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_blades_of_a_scissor_are_thin_and_hold_a_fruit_between_them() -> None:
    tool = Scissor(0.05)
    _, left, _ = tool.solids()
    assert left.shape == Box((0.012, 0.002, 0.05))
    assert tool.mouth == (0.025, pytest.approx(0.027))
    assert at(tool, [[0.0, 0.02, 0.0], [0.006, 0.0, 0.014]]).all()
    assert not at(tool, [[0.007, 0.0, 0.0], [0.0, 0.026, 0.0]]).any()


def test_a_mesh_is_as_it_is_stated() -> None:
    tool = TOOLS["mesh"]
    assert isinstance(tool, MeshTool)
    assert len(tool.solids()) == len(cup_parts())
    assert (tool.reach, tool.tip) == (pytest.approx(0.12), pytest.approx(RIM))
    assert tool.front == pytest.approx(FLOOR)
    assert tool.mouth == (INNER, pytest.approx(OUTER))
    assert at(tool, [[0.021, 0.0, 0.0], [0.0, 0.0, -0.019]]).all()
    assert not at(tool, [[0.023, 0.0, 0.0], [0.0, 0.0, -0.021], [0, 0, 0.021]]).any()
    # the walls are alike as the tool rolls: neck, floor, and a wall on either side
    assert len(tool.outline()) == 4


def test_a_mesh_that_takes_hold_of_nothing_is_solid() -> None:
    tool = probe()
    half_diagonal = 0.012 * math.sqrt(2.0)
    assert tool.mouth == (0.0, pytest.approx(half_diagonal))
    assert tool.depth == pytest.approx(-0.018)
    (outline,) = tool.outline()
    assert sorted({*outline[:, 0].round(9)}) == [-0.118, -0.018]
    assert np.abs(outline[:, 1]).max() == pytest.approx(half_diagonal)


def test_a_tool_may_point_aside() -> None:
    bar = MeshShape(*prism(square(0.01), 0.0, 0.10))
    tool = MeshTool((bar,), (0.0, 0.02, 0.10), tool_axis=(0.0, 2.0, 2.0))
    robot = with_tool(load_robot("panda"), tool)
    np.testing.assert_allclose(tool.rotation[:, 2], [0.0, math.sqrt(0.5), math.sqrt(0.5)])
    assert not rolls(robot)
    corner = np.array([0.0, 0.01, 0.10])
    assert tool.depth == pytest.approx((corner - tool.point) @ tool.rotation[:, 2])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: FingerGripper(0.0), ["tool finger_gripper: opening is 0.0", "(0, 0.1] metres"]),
        (lambda: FingerGripper(0.05, depth=0.06), ["depth is 0.06", "[0, 0.05]"]),
        (lambda: FingerGripper(0.05, turn=math.inf), ["turn is inf", "[rad]"]),
        (lambda: Scissor(0.05, blade_thickness=0), ["tool scissor: blade_thickness is 0"]),
        (lambda: MeshTool((), (0, 0, 0.1)), ["meshes is empty"]),
        (lambda: MeshTool((MeshShape(*BAR),), (0, 0)), ["tool_point has 2 entries", "must have 3"]),
        (
            lambda: MeshTool((MeshShape(*BAR),), (0, 0, 0.1), tool_axis=(0, 0, 0)),
            ["tool_axis is (0.0, 0.0, 0.0)", "direction"],
        ),
        (
            lambda: MeshTool((MeshShape(1000.0 * BAR[0], BAR[1]),), (0, 0, 0.1)),
            ["reaches 100 m", "scale 0.001"],
        ),
        (lambda: MeshTool((MeshShape(*BAR),), (0, 0, 0.1), opening=0.02), ["height is None"]),
        (
            lambda: MeshTool((MeshShape(*BAR),), (0, 0, 0.1), opening=0.02, height=0.02),
            ["opening is 0.02", "piece 0 of 1", "an opening of 0.0000 metres"],
        ),
        (lambda: make_tool("scissor", {"openning": 0.05}), ["tool scissor", "openning"]),
    ],
)
def test_refused(make: object, words: list[str]) -> None:
    assert_refused(InvalidRequestError, words, make)


def test_a_piece_that_is_not_convex_is_refused() -> None:
    wedge = np.array([[0.0, 0.0], [0.05, 0.0], [0.01, 0.01], [0.0, 0.05]])  # a dart
    with pytest.raises(InvalidRequestError, match=r"piece 1 of 2 is not convex"):
        MeshTool((MeshShape(*joined([BAR, prism(wedge + 0.1, 0.0, 0.1)])),), (0.0, 0.0, 0.1))


def test_what_lacks_a_member_is_no_tool() -> None:
    class Half:
        reach, fingers = 0.1, False

    with pytest.raises(InvalidRequestError) as caught:
        with_tool(load_robot("panda"), Half())  # type: ignore[arg-type]
    assert "Half is no tool" in caught.value.message
    assert "rotation" in caught.value.message
    assert "reach" not in caught.value.message.partition("lacks")[2]


@pytest.mark.parametrize(
    ("member", "value", "words"),
    [
        ("rotation", np.diag([1.0, 1.0, -1.0]), "right-handed"),
        ("rotation", np.eye(2), "(3, 3) finite numbers"),
        ("point", np.array([0.0, np.nan, 0.1]), "(3,) finite numbers"),
        ("reach", 0.11, "reach is 0.11; by its other numbers it must be 0.1"),
        ("depth", -0.02, "depth is -0.02; by its other numbers it must be 0.02"),
        ("mouth", (0.03, 0.02), "mouth[0] is 0.03; by its other numbers it must be 0.02"),
    ],
)
def test_a_tool_that_contradicts_itself_is_refused(member: str, value: object, words: str) -> None:
    tool = type("Odd", (Spoon,), {member: value})()
    assert_refused(InvalidRequestError, ["tool Odd: ", words], with_tool, load_robot("panda"), tool)


def test_the_kinds_are_those_of_the_library() -> None:
    assert {type(TOOLS[kind]) for kind in KINDS} == set(KINDS.values())
    assert not isinstance(Spoon(), tuple(KINDS.values()))


def test_a_tool_is_of_its_own_class_alone() -> None:
    """A class that derives from the protocol is none itself: others are not of it by their form."""
    assert not isinstance(Cup(0.03), FrankaHand | Scissor)
