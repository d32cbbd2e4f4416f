"""What collides in the simulation lies inside of the spheres that judge and planners know.

Every kind of tool, every shape that a tool may hold, and the arms themselves: else a clearance that
the judge reports is not there in the simulation.
"""

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from tests.robots.builders import BAR, TOOLS
from tests.robots.covers import directions

from optipromp.core.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    MeshShape,
    Shape,
    Sphere,
)
from optipromp.core.robots import (
    Cup,
    FrankaHand,
    Mounted,
    Robot,
    Solid,
    Tool,
    load_robot,
    robot_names,
    with_tool,
)
from optipromp.core.robots.mounted import Load, unmounted
from optipromp.core.robots.tools import TOOLS as KINDS
from optipromp.core.scenes import JointGoal, Scene
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.world import World, build

TOLERANCE = 1e-6  # [m] rounding: MuJoCo has the corners of meshes in single precision
FLAT = 0.02  # [-] of a cup's radius: its round wall is covered, the corners of flat walls are not
STEP = 0.0015  # [m] between the points of a surface that are looked at
HELD: dict[str, Shape] = {
    "ball": Sphere(0.03), "box": Box((0.04, 0.06, 0.05)), "can": Cylinder(0.03, 0.08),
    "capsule": Capsule(0.02, 0.05), "pear": Ellipsoid((0.03, 0.03, 0.05)),
    "cone": Cone(0.03, 0.01, 0.06), "bar": MeshShape(*BAR),
}  # fmt: skip
turned = (np.cos(0.4), np.sin(0.4), 0.0, 0.0)


def holding(name: str) -> Tool:
    solid = Solid(name, HELD[name], np.array([0.01, 0.0, 0.04]), turned)
    return Mounted(FrankaHand(), loads=(Load(name, (solid,), 0.1),))


CASES: dict[str, Tool] = {
    **TOOLS,
    "wide cup": Cup(0.05), "tapered cup": Cup(0.03, taper=45), "steep cup": Cup(0.05, taper=65),
    "mounted tapered cup": Mounted(Cup(0.04, taper=20), (0.0, 0.0, 0.05), (0.8, 0.0, 0.6, 0.0)),
    "short cup": Cup(0.035, height=0.03, length=0.0, opening=0.06),
    "narrow hand": FrankaHand(gripper_radius=0.02),
    "mounted": Mounted(FrankaHand(), (0.01, -0.02, 0.03), (0.8, 0.0, 0.6, 0.0)),
    **{f"holding a {name}": holding(name) for name in HELD},
}  # fmt: skip


def test_every_kind_of_tool_is_looked_at() -> None:
    assert {type(tool) for tool in TOOLS.values()} >= {*KINDS.values()}
    assert {*KINDS} <= {*TOOLS}


def world_of(robot: Robot) -> World:
    """A world of a robot alone; all that collides in it is the robot's, but for the floor."""
    return build(Scene("alone", robot.name, (), goal=JointGoal(robot.home)), robot)


def surface(model, geom: int) -> np.ndarray:
    """Points (m, 3) of the surface of a geom, in its frame [m]; the corners are among them."""
    kinds, kind, size = engine().mjtGeom, model.geom_type[geom], model.geom_size[geom]
    ball = directions(4000)
    if kind == kinds.mjGEOM_SPHERE:
        return size[0] * ball
    if kind == kinds.mjGEOM_ELLIPSOID:
        return size * ball
    if kind == kinds.mjGEOM_CAPSULE:
        return size[0] * ball + np.sign(ball[:, 2:]) * [0.0, 0.0, size[1]]
    if kind == kinds.mjGEOM_CYLINDER:  # the rims are farthest out of any cover of convex bodies
        turn = np.linspace(0.0, 2.0 * np.pi, 240)
        radii, heights = size[0] * np.linspace(0.0, 1.0, 12), np.linspace(-1.0, 1.0, 60) * size[1]
        round_ = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(240)])
        rings = [(size[0], h) for h in heights] + [(r, h) for r in radii for h in heights[[0, -1]]]
        return np.concatenate([r * round_ + [0.0, 0.0, h] for r, h in rings])
    if kind == kinds.mjGEOM_BOX:
        corners = size * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    else:
        assert kind == kinds.mjGEOM_MESH
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = np.array(model.mesh_vert[first : first + count], dtype=np.float64)
    points = [corners]
    for a, b, c in corners[ConvexHull(corners).simplices]:
        n = int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a)) / STEP))
        i, j = np.meshgrid(*[np.arange(n + 1) / n] * 2)
        i, j = i[i + j <= 1.0], j[i + j <= 1.0]
        points.append(a + i[:, None] * (b - a) + j[:, None] * (c - a))
    return np.concatenate(points)


def beyond(robot: Robot) -> dict[str, float]:
    """How far each colliding geom of a robot stands out of the spheres of its links [m]."""
    world = world_of(robot)
    model, data = world.model, world.data(robot.home)
    engine().mj_forward(model, data)
    centers, radius = robot.sphere_centers(robot.home), np.array(robot.spheres.radius)
    held = robot.spheres.link >= robot.n_own_links
    out = {}
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if not collides or model.geom_type[geom] == engine().mjtGeom.mjGEOM_PLANE:
            continue
        at, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
        points = at + surface(model, geom) @ turn.T
        mine = held if not name.startswith("body:") else ~held
        away = np.full(len(points), np.inf)
        for center, r in zip(centers[mine], radius[mine], strict=True):
            np.minimum(away, np.linalg.norm(points - center, axis=1) - r, out=away)
        out[name] = float(away.max())
    return out


@pytest.mark.parametrize("name", CASES)
def test_the_solids_of_a_tool_lie_inside_of_its_spheres(name: str) -> None:
    tool = CASES[name]
    found = beyond(with_tool(load_robot("panda"), tool))
    solids = {geom: out for geom, out in found.items() if not geom.startswith("body:")}
    assert len(solids) >= len(tool.solids())
    walls = FLAT * tool.gripper_radius if isinstance(unmounted(tool), Cup) else 0.0
    for geom, out in solids.items():
        assert out <= (walls if geom.startswith("tool:wall") else TOLERANCE), geom


@pytest.mark.parametrize("name", robot_names())
def test_the_links_of_an_arm_lie_inside_of_their_spheres(name: str) -> None:
    robot = load_robot(name)
    found = beyond(robot)
    assert len(found) == len(robot.spheres.radius)
    assert max(found.values()) <= TOLERANCE


def test_a_shape_that_stands_out_is_seen() -> None:
    """The palm as the box about it, as the simulation had it: 24 mm out at a rear corner.

    Beside link 7, whose spheres the arm has too, it was 16 mm.
    """
    box = Solid("palm", Box((0.0632, 0.204, 0.0918)), np.array([0.0, 0.0, 0.02]))

    class Boxed(FrankaHand):
        def solids(self) -> tuple[Solid, ...]:
            w = (np.cos(np.pi / 8.0), 0.0, 0.0, -np.sin(np.pi / 8.0))
            return (Solid(box.name, box.shape, box.position, w),)

    found = beyond(with_tool(load_robot("panda"), Boxed()))
    assert found["tool:palm"] == pytest.approx(0.0235, abs=1e-3)
