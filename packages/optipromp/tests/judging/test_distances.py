"""The judge's kinematics and distances against other libraries, and by hand."""

from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
import pytest
from tests.judging.builders import TURN, UP, box_mesh, obj, to

from optipromp.core import judging
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    PointCloudShape,
    Sphere,
    shapes,
)
from optipromp.core.geometry.obstacles import measures
from optipromp.core.judging import clearance
from optipromp.core.judging.distances import measured
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool
from optipromp.core.scenes import JointGoal

SHAPES = {
    "sphere": Sphere(0.15),
    "box": Box((0.3, 0.1, 0.5)),
    "cylinder": Cylinder(0.1, 0.4),
    "capsule": Capsule(0.08, 0.3),
    "half-space": HalfSpace(),
}


def samples(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.lower, robot.upper, (count, robot.n_joints))


def coals(shape: Any) -> Any:
    coal = pytest.importorskip("coal")
    match shape:
        case Sphere():
            return coal.Sphere(shape.radius)
        case Box():
            return coal.Box(*shape.size)
        case Cylinder():
            return coal.Cylinder(shape.radius, shape.length)
        case Capsule():
            return coal.Capsule(shape.radius, shape.length)
    return coal.Halfspace(UP, 0.0)


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_kinematics_are_pinocchios(name: str) -> None:
    pin = pytest.importorskip("pinocchio")
    robot = with_tool(load_robot(name), Cup(0.05))
    with resources.as_file(
        resources.files("optipromp.core.robots") / "data" / f"{name}.urdf"
    ) as path:
        model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = samples(robot, 300)
    _, _, points, axes = judging.swept(to(JointGoal(q[0])), robot, q)
    centers = judging.centers(robot, q)
    assert centers.shape == (300, len(robot.spheres.radius), 3)

    def flange(link: str) -> Any:
        return data.oMf[model.getFrameId("flange" if link == "tool" else link)]

    links = [robot.link_names[i] for i in robot.spheres.link]
    pin.framesForwardKinematics(model, data, q[0].copy())
    local = [flange(k).actInv(c) for k, c in zip(links, centers[0], strict=True)]
    for t in range(len(q)):
        pin.framesForwardKinematics(model, data, q[t].copy())
        pose = flange("tool")
        along = pose.rotation[:, 2]
        np.testing.assert_allclose(axes[t], along, atol=1e-12)
        np.testing.assert_allclose(points[t], pose.translation + 0.13 * along, atol=1e-12)
        expected = [flange(k).act(x) for k, x in zip(links, local, strict=True)]
        np.testing.assert_allclose(centers[t], expected, atol=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_clearances_are_coals(name: str, panda: Robot) -> None:
    """The nearest sphere to each role's object, over a few configurations, sphere by sphere."""
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(2)
    shape = coals(SHAPES[name])
    balls = [coal.Sphere(float(r)) for r in panda.spheres.radius]
    distal = np.asarray(panda.spheres.distal)
    for q in samples(panda, 6, seed=3):
        at = rng.uniform(-0.9, 0.9, 3) + [0.0, 0.0, 0.4]
        if name == "half-space":
            at[2] = -0.8
        centers = panda.sphere_centers(q)
        pose = coal.Transform3s(TURN, at)
        d = np.array([
            coal.distance(
                b, coal.Transform3s(np.eye(3), c), shape, pose, coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            for b, c in zip(balls, centers, strict=True)
        ])  # fmt: skip
        clear = d.min() > 1e-3  # coal's penetration depths are another measure
        for role, key, chosen in (
            ("static", "clearance_static", np.ones_like(distal)),
            ("avoid", "clearance_avoid", ~distal),
            ("avoid", "clearance_avoid_tool", distal),
            ("pushable", "clearance_pushable", ~distal),
        ):
            if role == "pushable" and name == "half-space":
                continue  # no such object
            scene = to(JointGoal(q), obj(role, SHAPES[name], at, TURN))
            found, contacts = judging.clearances(scene, panda, q[None])
            value = found[key]
            nearest = d[chosen].min()
            if nearest > 1e-3:
                assert value == pytest.approx(nearest, abs=2e-6)
            else:
                assert value < 1e-3
            if clear:
                assert not [c for c in contacts if c.other == "object"]


@pytest.mark.parametrize("cuts", [0, 4])  # of 12 and of 3,072 triangles
@pytest.mark.parametrize("role", ["static", "avoid", "pushable"])
def test_a_mesh_of_a_box_is_the_box(role, cuts, panda, monkeypatch):
    monkeypatch.setattr(clearance, "CONFIGURATIONS", 2)  # of a long motion not all are in memory
    size = (0.3, 0.1, 0.5)
    for seed, at in enumerate(([0.4, 0.1, 0.5], [0.3, -0.4, 0.2], [0.9, 0.3, 0.8])):
        q = samples(panda, 3, seed=seed)
        shapes = Box(size), box_mesh(size, cuts)
        scenes = [to(JointGoal(q[0]), obj(role, shape, at, TURN)) for shape in shapes]
        (box, touch), (mesh, touched) = (judging.clearances(s, panda, q) for s in scenes)
        for key in box.keys() - {"M_c"}:
            assert mesh[key] == pytest.approx(box[key], abs=1e-9), key
        assert [(c.link, round(c.depth, 9)) for c in touched] == [
            (c.link, round(c.depth, 9)) for c in touch
        ]


def test_a_point_cloud_is_its_points(panda: Robot) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.2, 0.2, (40, 3))
    q = samples(panda, 2)
    at = np.array([0.5, 0.1, 0.6])
    cloud = to(JointGoal(q[0]), obj("static", PointCloudShape(points, 0.02), at, TURN))
    balls = [obj("static", Sphere(0.02), at + TURN @ p, name=str(i)) for i, p in enumerate(points)]
    one, _ = judging.clearances(cloud, panda, q)
    many, _ = judging.clearances(to(JointGoal(q[0]), *balls), panda, q)
    assert one["clearance_static"] == pytest.approx(many["clearance_static"], abs=1e-12)
    # the core of a ball is its centre, that of a cloud its surface
    assert one["M_c"] == pytest.approx((many["M_c"] or 0.0) - 0.02, abs=1e-12)


def test_m_c_is_the_distance_to_the_core(gantry: Robot) -> None:
    """By hand: the ball of y is the lowest object, 0.5 under the joints."""
    q = np.zeros((1, 3))
    low = np.array([0.0, 0.0, -0.5])
    rows = [
        (Sphere(0.1), low - [0.0, 0.0, 0.3], np.eye(3), 0.3),
        # the long axis of a bar, here y: beside it, and beyond its end
        (Box((0.1, 0.8, 0.2)), low - [0.0, 0.2, 0.4], np.eye(3), 0.4),
        (Box((0.1, 0.8, 0.2)), low - [0.0, 0.7, 0.4], np.eye(3), 0.5),
        (Capsule(0.05, 0.6), low - [0.3, 0.0, 0.7], np.eye(3), 0.5),
        (Cylinder(0.05, 0.6), low - [0.3, 0.0, 0.7], np.eye(3), 0.5),
        (HalfSpace(), low - [0.0, 0.0, 0.25], np.eye(3), 0.25),
    ]
    for shape, at, turn, expected in rows:
        for role in ("static", "avoid"):
            found, _ = judging.clearances(
                to(JointGoal(q[0]), obj(role, shape, at, turn)), gantry, q
            )
            assert found["M_c"] == pytest.approx(expected), (shape, role)
    pushed, _ = judging.clearances(
        to(JointGoal(q[0]), obj("pushable", Sphere(0.1), low)), gantry, q
    )
    assert pushed["M_c"] is None


def test_m_c_of_a_mesh_is_not_hidden_by_a_nearer_surface(gantry: Robot) -> None:
    """The big ball is nearer to its object's surface, the small one's centre nearer to the mesh."""
    q = np.zeros((1, 3))
    low = np.array([0.0, 0.0, -0.5])  # of radius 0.02
    top = gantry.sphere_centers(q[0])[np.asarray(gantry.spheres.distal)].max(axis=0)[2]
    ball_ = obj("static", Sphere(0.3), low - [0.0, 0.0, 0.325], name="ball")  # 5 mm off
    mesh = obj("static", box_mesh((0.2, 0.2, 0.2)), [0.0, 0.0, top + 0.13], name="mesh")
    found, _ = judging.clearances(to(JointGoal(q[0]), ball_, mesh), gantry, q)
    alone, _ = judging.clearances(to(JointGoal(q[0]), mesh), gantry, q)
    assert found["clearance_static"] == pytest.approx(0.005)
    assert found["M_c"] == alone["M_c"] == pytest.approx(0.03, abs=1e-6)


@pytest.mark.parametrize("most", [0.0, 0.04])
def test_self_clearance_is_that_of_the_pairs(panda: Robot, most: float) -> None:
    """Less what they may overlap: a slack of up to ``most`` [m] for each."""
    q = samples(panda, 20, seed=5)
    centers, radius = panda.sphere_centers(q), np.asarray(panda.spheres.radius)
    a, b = panda.self_pairs.T
    slack = np.random.default_rng(1).uniform(0.0, most, len(a))
    expected = np.linalg.norm(centers[:, a] - centers[:, b], axis=2) - radius[a] - radius[b] + slack
    panda = replace(panda, self_slack=slack)
    np.testing.assert_allclose(panda.self_gaps(q), expected, atol=1e-12)
    found, _ = judging.clearances(to(JointGoal(q[0])), panda, q)
    assert found["clearance_self"] == pytest.approx(expected.min(), abs=1e-12)


def test_the_judge_reads_shapes_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a shape tells the planner of its size, wrong or right, does not reach the judge.

    Many shapes, which are read class by class, measure what each of them does.
    """
    of = [shapes.Sphere(0.03), shapes.Box((0.1, 0.2, 0.3)), shapes.Cylinder(0.02, 0.1),
          shapes.Capsule(0.02, 0.1), shapes.Ellipsoid((0.02, 0.03, 0.04)),
          shapes.Cone(0.03, 0.01, 0.05), shapes.HalfSpace()]  # fmt: skip
    found, told = measured(of), measures(of)
    for mine, other in zip(found, told, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-15)
    for read in (measured, measures):
        for one, many in zip(read(of), read(5 * of), strict=True):
            np.testing.assert_array_equal(many, np.concatenate(5 * [one]))
    monkeypatch.setattr(shapes.Primitive, "measure", shapes.Sphere(1e-3).measure)
    of = [*map(replace, of)]  # not read before
    assert (measures(of)[0] == measures(of)[0][0]).all()
    for mine, again in zip(found, measured(of), strict=True):
        np.testing.assert_array_equal(again, mine)
