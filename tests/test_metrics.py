"""The judge: its kinematics and distances against other libraries, and everything it must catch."""

import json
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optipromp import metrics
from optipromp.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Sphere,
)
from optipromp.robots.library import load_robot
from optipromp.robots.model import Robot
from optipromp.robots.tools import Cup, with_tool
from optipromp.scenes import Approach, JointGoal, PoseGoal, Scene, SceneObject, Stem
from optipromp.trajectory import Trajectory

UP = np.array([0.0, 0.0, 1.0])
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


@pytest.fixture(scope="module")
def panda() -> Robot:
    return with_tool(load_robot("panda"), Cup(0.05))


@pytest.fixture(scope="module")
def scara() -> Robot:
    return with_tool(load_robot("scara"), Cup(0.03))


def joint(name: str, kind: str, parent: str, child: str, axis: str, limit: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/>{limit}</joint>'
    )


def ball(name: str, radius: float, at: str = "0 0 0") -> str:
    return (
        f'<link name="{name}"><collision><origin xyz="{at}"/><geometry>'
        f'<sphere radius="{radius}"/></geometry></collision></link>'
    )


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Three prismatic joints along x, y, z: the tool is where the joints say, 0.13 above them.

    The carriage of y is a ball of radius 0.02, proximal; that of z one of 0.01, distal.
    """
    limit = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
    text = (
        '<robot name="gantry"><link name="base"/>'
        + '<link name="x"/>' + ball("y", 0.02, "0 0 -0.5") + ball("z", 0.01)
        + joint("jx", "prismatic", "base", "x", "1 0 0", limit)
        + joint("jy", "prismatic", "x", "y", "0 1 0", limit)
        + joint("jz", "prismatic", "y", "z", "0 0 1", limit)
        + "</robot>"
    )  # fmt: skip
    path: Path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(text, encoding="utf-8")
    return with_tool(load_robot(str(path)), Cup(0.05))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """One continuous joint about z with a ball of radius 0.02, half a metre out."""
    text = (
        '<robot name="wheel"><link name="base"/>' + ball("rim", 0.02, "0.5 0 0")
        + joint("turn", "continuous", "base", "rim", "0 0 1", "") + "</robot>"
    )  # fmt: skip
    path: Path = tmp_path_factory.mktemp("wheel") / "wheel.urdf"
    path.write_text(text, encoding="utf-8")
    return load_robot(str(path))


def samples(robot: Robot, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(robot.lower, robot.upper, (count, robot.n_joints))


def thing(role: Any, shape: Any, at: Any, turn: Any = None, name: str = "thing") -> SceneObject:
    return SceneObject(
        name, role, shape, np.asarray(at, float), np.eye(3) if turn is None else turn
    )


def to(goal: Any, *objects: SceneObject) -> Scene:
    return Scene("s", "robot", objects, goal=goal)


def moving(robot: Robot, q: Any, dt: float = 1.0) -> Trajectory:
    return Trajectory(np.asarray(q, float), dt, robot.joint_names)


# --- kinematics ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_kinematics_are_pinocchios(name: str) -> None:
    pin = pytest.importorskip("pinocchio")
    robot = with_tool(load_robot(name), Cup(0.05))
    with resources.as_file(resources.files("optipromp.robots") / "data" / f"{name}.urdf") as path:
        model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    q = samples(robot, 300)
    points, axes = metrics.tool(robot, q)
    centers = metrics.centers(robot, q)
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


def test_centers_are_in_the_robots_own_order(panda: Robot, scara: Robot, gantry: Robot) -> None:
    """Against the planner's kernels, which share no code with the judge's."""
    for robot in (panda, scara, gantry):
        q = samples(robot, 20, seed=1)
        np.testing.assert_allclose(metrics.centers(robot, q), robot.sphere_centers(q), atol=1e-12)


# --- distances -------------------------------------------------------------------------------

SHAPES = {
    "sphere": Sphere(0.15),
    "box": Box((0.3, 0.1, 0.5)),
    "cylinder": Cylinder(0.1, 0.4),
    "capsule": Capsule(0.08, 0.3),
    "half-space": HalfSpace(),
}


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


@pytest.mark.parametrize("name", SHAPES)
def test_clearances_are_coals(name: str, panda: Robot) -> None:
    """The nearest sphere to each role's thing, over a few configurations, sphere by sphere."""
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
                continue  # no such thing
            scene = to(JointGoal(q), thing(role, SHAPES[name], at, TURN))
            found, contacts = metrics.clearances(scene, panda, q[None])
            value = found[key]
            assert value is not None
            nearest = d[chosen].min()
            if nearest > 1e-3:
                assert value == pytest.approx(nearest, abs=2e-6)
            else:
                assert value < 1e-3
            if clear:
                assert not [c for c in contacts if c.other == "thing"]


def box_mesh(size: tuple[float, float, float]) -> MeshShape:
    half = 0.5 * np.array(size)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    return MeshShape(corners, np.array(faces))


@pytest.mark.parametrize("role", ["static", "avoid", "pushable"])
def test_a_mesh_of_a_box_is_the_box(role: str, panda: Robot) -> None:
    size = (0.3, 0.1, 0.5)
    for seed, at in enumerate(([0.4, 0.1, 0.5], [0.3, -0.4, 0.2], [0.9, 0.3, 0.8])):
        q = samples(panda, 3, seed=seed)
        scenes = [
            to(JointGoal(q[0]), thing(role, shape, at, TURN))
            for shape in (Box(size), box_mesh(size))
        ]
        (box, touch), (mesh, touched) = (metrics.clearances(s, panda, q) for s in scenes)
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
    cloud = to(JointGoal(q[0]), thing("static", PointCloudShape(points, 0.02), at, TURN))
    balls = [
        thing("static", Sphere(0.02), at + TURN @ p, name=str(i)) for i, p in enumerate(points)
    ]
    one, _ = metrics.clearances(cloud, panda, q)
    many, _ = metrics.clearances(to(JointGoal(q[0]), *balls), panda, q)
    assert one["clearance_static"] == pytest.approx(many["clearance_static"], abs=1e-12)
    # the core of a ball is its centre, that of a cloud its surface
    assert one["M_c"] == pytest.approx((many["M_c"] or 0.0) - 0.02, abs=1e-12)


def test_m_c_is_the_distance_to_the_core(gantry: Robot) -> None:
    """By hand: the ball of y is the lowest thing, 0.5 under the joints."""
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
            found, _ = metrics.clearances(
                to(JointGoal(q[0]), thing(role, shape, at, turn)), gantry, q
            )
            assert found["M_c"] == pytest.approx(expected), (shape, role)
    pushed, _ = metrics.clearances(
        to(JointGoal(q[0]), thing("pushable", Sphere(0.1), low)), gantry, q
    )
    assert pushed["M_c"] is None


def test_m_c_of_a_mesh_is_not_hidden_by_a_nearer_surface(gantry: Robot) -> None:
    """The big ball is nearer to its thing's surface, the small one's centre nearer to the mesh."""
    q = np.zeros((1, 3))
    low = np.array([0.0, 0.0, -0.5])  # of radius 0.02
    top = gantry.sphere_centers(q[0])[np.asarray(gantry.spheres.distal)].max(axis=0)[2]
    ball_ = thing("static", Sphere(0.3), low - [0.0, 0.0, 0.325], name="ball")  # 5 mm off
    mesh = thing("static", box_mesh((0.2, 0.2, 0.2)), [0.0, 0.0, top + 0.13], name="mesh")
    found, _ = metrics.clearances(to(JointGoal(q[0]), ball_, mesh), gantry, q)
    alone, _ = metrics.clearances(to(JointGoal(q[0]), mesh), gantry, q)
    assert found["clearance_static"] == pytest.approx(0.005)
    assert found["M_c"] == alone["M_c"] == pytest.approx(0.03, abs=1e-6)


def test_nothing_there_is_none(gantry: Robot) -> None:
    found, contacts = metrics.clearances(to(JointGoal(np.zeros(3))), gantry, np.zeros((1, 3)))
    assert not contacts
    assert {key for key, value in found.items() if value is not None} <= {"clearance_self"}


def test_self_clearance_is_that_of_the_pairs(panda: Robot) -> None:
    q = samples(panda, 20, seed=5)
    centers, radius = panda.sphere_centers(q), np.asarray(panda.spheres.radius)
    a, b = panda.self_pairs.T
    expected = np.linalg.norm(centers[:, a] - centers[:, b], axis=2) - radius[a] - radius[b]
    found, _ = metrics.clearances(to(JointGoal(q[0])), panda, q)
    assert found["clearance_self"] == pytest.approx(expected.min(), abs=1e-12)


# --- between the knots -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "gantry", "wheel"])
@pytest.mark.parametrize("size", [0.02, 0.5, 3.0])
def test_no_sphere_moves_over_half_its_radius_between_checks(
    name: str, size: float, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    q = size * np.random.default_rng(1).uniform(-1.0, 1.0, (4, robot.n_joints)).cumsum(axis=0)
    fine, complete = metrics.fine_positions(robot, q)
    assert complete
    moved = np.linalg.norm(np.diff(robot.sphere_centers(fine), axis=0), axis=2)
    assert (moved <= 0.5 * np.asarray(robot.spheres.radius)).all()
    at = [int(np.argmin(np.abs(fine - k).max(axis=1))) for k in q]
    np.testing.assert_allclose(fine[at], q, atol=1e-12)  # the knots themselves are checked
    assert at == sorted(at)


def test_a_thin_wall_between_two_knots_is_met(gantry: Robot) -> None:
    """A sheet of paper across the path; at the knots the arm is 0.3 m from it."""
    q = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [1.2, 0.0, 0.0]])
    for at in (0.3, 0.9):
        wall = thing("static", Box((1e-4, 2.0, 3.0)), [at, 0.0, 0.0], name="wall")
        scene = to(JointGoal(q[-1]), wall)
        _, at_knots = metrics.clearances(scene, gantry, q)
        assert not at_knots
        judgement = metrics.judge(scene, gantry, moving(gantry, q))
        assert {c.other for c in judgement.contacts} == {"wall"}
        assert any("wall" in v for v in judgement.violations)
        assert judgement.metrics.clearance_static is not None
        assert judgement.metrics.clearance_static < -0.009
    beside = thing("static", Box((1e-4, 2.0, 3.0)), [1.3, 0.0, 0.0])
    assert not metrics.judge(to(JointGoal(q[-1]), beside), gantry, moving(gantry, q)).violations


@pytest.mark.parametrize("step", [0.5, np.pi, 2.0 * np.pi, 7.0])
def test_a_wall_inside_a_large_turn_is_met(wheel: Robot, step: float) -> None:
    """After a whole turn the ball is back where it was: its chord is nothing, its path is not."""
    q = np.array([[0.0], [step], [2.0 * step]])
    middle = 0.5 * step
    at = 0.5 * np.array([np.cos(middle), np.sin(middle), 0.0])
    wall = thing("static", Sphere(0.004), at, name="pin")
    _, at_knots = metrics.clearances(to(JointGoal(q[-1]), wall), wheel, q)
    assert not at_knots
    judgement = metrics.judge(to(JointGoal(q[-1]), wall), wheel, moving(wheel, q, 9.0))
    assert {c.other for c in judgement.contacts} == {"pin"}
    assert judgement.metrics.clearance_static == pytest.approx(-0.024, abs=0.006)


def test_what_cannot_be_checked_finely_enough_is_no_success(
    gantry: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    q = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 5)
    scene = to(JointGoal(q[-1]))
    assert not metrics.judge(scene, gantry, moving(gantry, q)).violations
    monkeypatch.setattr(metrics, "MOST_CHECKS", 50)
    (violation,) = metrics.judge(scene, gantry, moving(gantry, q)).violations
    assert "too far to be checked" in violation
    fine, complete = metrics.fine_positions(gantry, q)
    assert len(fine) <= 50 + len(q)
    assert not complete


# --- what is a violation ---------------------------------------------------------------------


def reach(gantry: Robot, end: Any = (0.4, 0.0, 0.0), knots: int = 9) -> Trajectory:
    return moving(gantry, np.linspace(np.zeros(3), end, knots))


def violations(scene: Scene, robot: Robot, trajectory: Trajectory, **more: Any) -> str:
    return "; ".join(metrics.judge(scene, robot, trajectory, **more).violations)


def test_a_good_trajectory_has_none_and_is_measured(gantry: Robot) -> None:
    trajectory = moving(gantry, np.linspace([0, 0, 0], [0.4, 0.3, 0.0], 5), dt=0.5)
    judgement = metrics.judge(
        to(JointGoal(np.array([0.4, 0.3, 0.0]))), gantry, trajectory, np.zeros(3)
    )
    assert judgement.violations == judgement.contacts == ()
    m = judgement.metrics
    assert (m.goal_error, m.goal_axis_error) == (pytest.approx(0.0, abs=1e-12), None)
    assert m.duration == 2.0
    assert m.limit_violation == 0.0
    assert m.max_step == pytest.approx(0.1)
    assert m.path_length == pytest.approx(0.5)
    assert m.velocity_ratio == pytest.approx(0.2)
    assert m.acceleration_ratio == 0.0  # this robot has no such limit
    ends = np.sqrt(2 * ((0.1 / 0.25) ** 2 + (0.075 / 0.25) ** 2) / 5)
    assert m.smoothness == pytest.approx(ends)


def test_limits(gantry: Robot) -> None:
    q = np.linspace([0, 0, 0], [0, 2.0, 0], 9)
    scene = to(JointGoal(q[-1]))
    assert violations(scene, gantry, moving(gantry, q)) == ""
    q[4, 1] = 2.0 + 1e-9
    q[5, 2] = -2.25
    judgement = metrics.judge(scene, gantry, moving(gantry, q, dt=99.0))
    assert judgement.metrics.limit_violation == pytest.approx(0.25)
    assert "jz leaves its limits by 0.25" in "; ".join(judgement.violations)
    q[5, 2] = 0.0
    assert "jy leaves its limits" in violations(scene, gantry, moving(gantry, q, dt=99.0))


def test_velocity_and_acceleration(gantry: Robot) -> None:
    scene = to(JointGoal(np.array([0.4, 0.0, 0.0])))
    q = reach(gantry).positions
    assert violations(scene, gantry, moving(gantry, q, dt=0.05)) == ""
    fast = metrics.judge(scene, gantry, moving(gantry, q, dt=0.04))
    assert fast.metrics.velocity_ratio == pytest.approx(1.25)
    assert fast.violations == ("velocity reaches 1.250 of its limit",)
    limited = replace(gantry, acceleration=np.full(3, 20.0))
    assert violations(scene, limited, moving(gantry, q, dt=0.05)) == ""
    tight = replace(gantry, acceleration=np.full(3, 16.0))
    found = metrics.judge(scene, tight, moving(gantry, q, dt=0.05))
    assert found.metrics.acceleration_ratio == pytest.approx(1.25)
    assert found.violations == ("acceleration reaches 1.250 of its limit",)


def test_start(gantry: Robot) -> None:
    scene, trajectory = to(JointGoal(np.array([0.4, 0.0, 0.0]))), reach(gantry)
    assert violations(scene, gantry, trajectory, start=np.zeros(3)) == ""
    assert violations(scene, gantry, trajectory, start=None) == ""
    late = violations(scene, gantry, trajectory, start=np.array([2e-6, 0.0, 0.0]))
    assert "does not begin at the start" in late


def test_goal_in_joints(gantry: Robot) -> None:
    for off, fine in ((0.9e-3, True), (1.1e-3, False)):
        scene = to(JointGoal(np.array([0.4, off, 0.0])))
        judgement = metrics.judge(scene, gantry, reach(gantry))
        assert judgement.metrics.goal_error == pytest.approx(off)
        assert (judgement.violations == ()) == fine


def test_goal_of_the_tool(gantry: Robot) -> None:
    tip = np.array([0.4, 0.0, 0.13])  # the cup holds a fruit 0.13 above the flange
    for off, fine in ((0.9e-3, True), (1.1e-3, False)):
        for goal in (
            to(PoseGoal(tip + [0.0, 0.0, off], UP)),
            to(None, thing("target", Sphere(0.015), tip + [0.0, off, 0.0])),
        ):
            judgement = metrics.judge(goal, gantry, reach(gantry))
            assert judgement.metrics.goal_error == pytest.approx(off)
            assert judgement.metrics.goal_axis_error == pytest.approx(0.0, abs=1e-9)
            assert (judgement.violations == ()) == fine


@pytest.mark.parametrize(("degrees", "fine"), [(1.9, True), (2.1, False), (180.0, False)])
def test_axis(degrees: float, fine: bool, gantry: Robot) -> None:
    angle = np.deg2rad(degrees)
    axis = np.array([np.sin(angle), 0.0, np.cos(angle)])
    judgement = metrics.judge(to(PoseGoal(np.array([0.4, 0, 0.13]), axis)), gantry, reach(gantry))
    assert judgement.metrics.goal_axis_error == pytest.approx(angle, abs=1e-9)
    assert (judgement.violations == ()) == fine
    assert ("axis" in "; ".join(judgement.violations)) != fine


def test_self_collision(panda: Robot) -> None:
    """At the paper's start the cup is folded into the forearm."""
    folded = np.array([0.0, 0.0, 0.0, -0.1, 0.0, 0.0, 0.8])
    judgement = metrics.judge(to(JointGoal(folded)), panda, moving(panda, [folded] * 3))
    (contact,) = judgement.contacts
    assert {contact.link, contact.other} != {""}
    assert "tool" in (contact.link, contact.other) or contact.role == "the robot itself"
    assert contact.depth > 0.01
    assert judgement.metrics.clearance_self == pytest.approx(-contact.depth)
    home = panda.home
    assert not metrics.judge(to(JointGoal(home)), panda, moving(panda, [home] * 3)).contacts


@pytest.mark.parametrize(
    ("role", "by_arm", "by_tool"),
    [("static", True, True), ("avoid", True, False), ("pushable", True, False)],
)
def test_who_may_touch_what(role: str, by_arm: bool, by_tool: bool, gantry: Robot) -> None:
    """B_d keeps off everything; the last link and the tool may brush what hangs."""
    end = np.array([0.4, 0.0, 0.0])
    on_arm = thing(role, Sphere(0.05), [0.2, 0.0, -0.5])
    on_tool = thing(role, Sphere(0.05), [0.2, 0.0, 0.1])
    for obstacle, fault in ((on_arm, by_arm), (on_tool, by_tool)):
        judgement = metrics.judge(to(JointGoal(end), obstacle), gantry, reach(gantry))
        assert bool(judgement.contacts) == fault
        assert bool(judgement.violations) == fault
    m = metrics.judge(to(JointGoal(end), on_arm), gantry, reach(gantry)).metrics
    key = {
        "static": "clearance_static",
        "avoid": "clearance_avoid",
        "pushable": "clearance_pushable",
    }
    assert getattr(m, key[role]) == pytest.approx(-0.07, abs=0.01)
    (contact,) = metrics.judge(to(JointGoal(end), on_arm), gantry, reach(gantry)).contacts
    assert (contact.link, contact.other, contact.role) == ("y", "thing", role)
    assert str(contact).startswith(f"y enters thing ({role}) by ")
    if role == "avoid":
        brushed = metrics.judge(to(JointGoal(end), on_tool), gantry, reach(gantry)).metrics
        assert brushed.clearance_avoid_tool is not None
        assert brushed.clearance_avoid_tool < 0.0 < (brushed.clearance_avoid or 0.0)


def test_every_contact_is_named(gantry: Robot) -> None:
    things = [
        thing("static", Sphere(0.03), [0.1 * i, 0.0, -0.5], name=f"s{i}") for i in range(1, 4)
    ]
    judgement = metrics.judge(to(JointGoal(np.array([0.4, 0, 0])), *things), gantry, reach(gantry))
    assert [c.other for c in judgement.contacts] == ["s1", "s2", "s3"]


def along_x(gantry: Robot, *stops: float) -> Trajectory:
    """The gantry along x, at rest in y and z."""
    x = np.interp(np.linspace(0.0, 1.0, 161), np.linspace(0.0, 1.0, len(stops)), stops)
    return moving(gantry, np.column_stack([x, np.zeros((161, 2))]), 0.1)


STANDING = Box((0.04, 0.04, 0.9))  # from the ball of y, 0.5 below, up to the tool


def test_a_link_may_pass_where_the_tool_has_pushed_a_thing_away(gantry: Robot) -> None:
    """The cup (radius 50 mm) meets the box before the ball of y (20 mm) does, and goes deeper."""
    stands = thing("pushable", STANDING, [0.3, 0.0, -0.2])
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), stands)
    judgement = metrics.judge(scene, gantry, along_x(gantry, 0.0, 0.27))
    assert not judgement.violations
    assert not judgement.contacts
    (note,) = judgement.notes
    assert note.startswith("y passes where thing stood")
    # where it stood is what is measured
    assert judgement.metrics.clearance_pushable == pytest.approx(-0.01, abs=1e-3)


@pytest.mark.parametrize("role", ["static", "avoid"])
def test_only_what_may_be_pushed_is_pushed_away(role: str, gantry: Robot) -> None:
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), thing(role, STANDING, [0.3, 0.0, -0.2]))
    judgement = metrics.judge(scene, gantry, along_x(gantry, 0.0, 0.27))
    assert judgement.violations
    assert not judgement.notes


def test_what_hangs_swings_back(gantry: Robot) -> None:
    stem = Stem(np.array([[0.3, 0.0, 0.25], [0.3, 0.0, 0.45]]))
    hung = replace(thing("pushable", STANDING, [0.3, 0.0, -0.2]), stem=stem)
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), hung)
    (contact,) = metrics.judge(scene, gantry, along_x(gantry, 0.0, 0.27)).contacts
    assert (contact.link, contact.other) == ("y", "thing")


def test_a_link_where_the_tool_never_comes_pushes(gantry: Robot) -> None:
    low = thing("pushable", Box((0.04, 0.04, 0.2)), [0.3, 0.0, -0.5])  # the tool never comes there
    scene = to(JointGoal(np.array([0.27, 0.0, 0.0])), low)
    (contact,) = metrics.judge(scene, gantry, along_x(gantry, 0.0, 0.27)).contacts
    assert contact.link == "y"


def test_no_deeper_than_the_tool_was(gantry: Robot) -> None:
    """The tool brushes the thing's top by 5 mm; the link then goes in by more."""
    tall = thing("pushable", Box((0.3, 0.02, 0.5)), [0.3, 0.0, -0.255])  # its top at -5 mm
    q = np.zeros((161, 3))
    q[:, 0] = np.interp(np.linspace(0.0, 1.0, 161), [0.0, 0.5, 1.0], [0.0, 0.0, 0.4])
    scene = to(JointGoal(q[-1]), tall)
    (contact,) = metrics.judge(scene, gantry, moving(gantry, q, 0.1)).contacts
    assert contact.link == "y"
    assert contact.depth > 0.02


def test_the_tool_must_have_been_there_before(gantry: Robot) -> None:
    """From the other end: the link comes to the thing's place first, the tool only later."""
    low = thing("pushable", Box((0.04, 0.04, 0.2)), [0.3, 0.0, -0.5])
    q = np.vstack([
        np.column_stack([np.linspace(0.0, 0.27, 80), np.zeros((80, 2))]),
        np.column_stack([np.full(80, 0.27), np.zeros(80), np.linspace(0.0, -0.63, 80)]),
    ])  # fmt: skip
    scene = to(JointGoal(q[-1]), low)
    contacts = metrics.judge(scene, gantry, moving(gantry, q, 0.1)).contacts
    assert ("y", "thing") in {(contact.link, contact.other) for contact in contacts}


# --- passing pushables -----------------------------------------------------------------------

FRUIT = np.array([0.0, 0.0, 0.6])
TARGET = np.array([0.0, 0.0, 0.75])


def passing(
    gantry: Robot, stem: Any, aside: Callable[[np.ndarray], Any], fruit: Any = FRUIT
) -> metrics.Judgement:
    """The tool goes up past a fruit with lateral offsets ``aside(height over the fruit)``."""
    height = np.linspace(0.2, 0.75, 56)
    path = np.zeros((56, 3))
    path[:, 2] = height
    path[:, :2] += np.asarray([aside(h) for h in height - fruit[2]])
    path[-1] = TARGET
    hung = None if stem is None else Stem(np.array([fruit, fruit + np.asarray(stem)]))
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject("n", "pushable", Sphere(0.015), np.asarray(fruit), stem=hung),
    )
    # the ball of the y carriage hangs 0.5 under the fruit's height, out of the way
    return metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_m_p_is_the_offset_where_the_tool_passes(side: float, gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert judgement.metrics.M_p["n"] == pytest.approx(side * 0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    wrong = side > 0.0  # the stem leans to +y: the tool must pass at -y
    assert (judgement.violations == ("the tool passes n on the side of its stem",)) == wrong
    mirrored = passing(gantry, (0.0, -0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert mirrored.metrics.stem_projection["n"] == pytest.approx(-0.05)
    assert bool(mirrored.violations) != wrong


def test_the_offset_counts_at_the_fruit_not_elsewhere(gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, -0.06 if abs(h) < 0.02 else 0.06))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)
    assert judgement.violations == ()


def test_a_stem_that_leans_along_x_has_a_side_too(gantry: Robot) -> None:
    """The paper's figure, along y_g, says nothing here; the stem still must not be met."""
    for x in (-0.06, 0.06):
        judgement = passing(gantry, (0.05, 0.0, 0.2), lambda h, x=x: (x, 0.0))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(0.0, abs=1e-12)
        assert judgement.metrics.stem_projection["n"] == pytest.approx(0.0, abs=1e-12)
        assert bool(judgement.violations) == (x > 0.0)


@pytest.mark.parametrize("stem", [None, (0.0, 0.0, 0.2), (0.0, 0.002, 0.2)])
def test_without_a_lean_either_side_will_do(stem: Any, gantry: Robot) -> None:
    for y in (-0.06, 0.06):
        judgement = passing(gantry, stem, lambda h, y=y: (0.0, y))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(y)
        assert judgement.violations == ()
    assert (judgement.metrics.stem_projection["n"] is None) == (stem is None)


def test_the_last_passage_counts(gantry: Robot) -> None:
    """Up on the wrong side, down, and up again on the right one."""
    height = np.concatenate([np.linspace(0.5, 0.7, 20), np.linspace(0.7, 0.5, 20)])
    height = np.concatenate([height, np.linspace(0.5, 0.75, 25)])
    path = np.zeros((65, 3))
    path[:, 2] = height
    path[:20, 1], path[20:40, 1], path[40:, 1] = 0.06, 0.06, -0.06
    path[-1] = TARGET
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject(
            "n", "pushable", Sphere(0.015), FRUIT, stem=Stem(np.array([FRUIT, [0, 0.05, 0.8]]))
        ),
    )
    judgement = metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)


def test_a_fruit_that_is_not_passed_has_no_m_p(gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.06), np.array([0, 0, 0.9]))
    assert judgement.metrics.M_p["n"] is None
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.violations == ()


def test_a_fruit_far_from_the_path_and_the_line_has_no_side(gantry: Robot) -> None:
    away = np.array([0.0, -0.4, 0.6])
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.0), away)
    assert judgement.metrics.M_p["n"] == pytest.approx(0.4)  # reported,
    assert judgement.violations == ()  # but nothing is pushed


def test_passing_holds_in_any_frame(gantry: Robot) -> None:
    """Sideways approach: along x, drifting along z."""
    target, fruit = np.array([0.75, 0.0, 0.1]), np.array([0.6, 0.0, 0.1])
    path = np.zeros((56, 3))
    path[:, 0], path[:, 2] = np.linspace(0.2, 0.75, 56), 0.1 - 0.06
    path[-1] = target
    scene = Scene(
        "s", "robot",
        (
            thing("target", Sphere(0.015), target, name="ripe"),
            SceneObject(
                "n", "pushable", Sphere(0.015), fruit,
                stem=Stem(np.array([fruit, fruit + [0.0, 0.1, 0.05]])),
            ),
        ),
        approach=Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    )  # fmt: skip
    judgement = metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.metrics.goal_axis_error == pytest.approx(np.pi / 2)


def test_to_dict_is_plain_and_complete(gantry: Robot) -> None:
    document = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, -0.06)).metrics.to_dict()
    assert json.loads(json.dumps(document)) == document
    assert set(document) >= {
        "M_c", "M_p", "stem_projection", "clearance_static", "clearance_avoid",
        "clearance_avoid_tool", "clearance_self", "goal_error", "goal_axis_error",
        "limit_violation", "max_step", "path_length", "smoothness", "duration",
        "velocity_ratio", "acceleration_ratio",
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_what_is_skipped_on_the_way_is_what_cannot_matter(
    seed: int, panda: Robot, scara: Robot
) -> None:
    """The sweep over a motion finds what a look at each of its configurations finds."""
    rng = np.random.default_rng(seed)
    robot = (panda, scara)[seed % 2]
    shapes = [Sphere(0.05), Box((0.3, 0.02, 0.1)), Capsule(0.03, 0.3), Cylinder(0.02, 0.2)]
    roles = ("static", "avoid", "pushable")
    things = [
        thing(roles[i % 3], shapes[i % 4], rng.uniform(-0.7, 0.7, 3), TURN, name=f"t{i}")
        for i in range(14)
    ]
    things.append(thing("static", HalfSpace(), np.array([0.0, 0.0, -0.2]), name="floor"))
    corners = rng.uniform(robot.lower, robot.upper, (4, robot.n_joints))
    share = np.linspace(0.0, 3.0, 120)
    q = np.array([np.interp(share, range(4), column) for column in corners.T]).T
    scene = to(JointGoal(q[-1]), *things)
    together, contacts = metrics.clearances(scene, robot, q)
    alone = [metrics.clearances(scene, robot, one[None]) for one in q]
    for key, value in together.items():
        assert value == min(found[key] for found, _ in alone), key
    deepest: dict[str, float] = {}
    for contact in (contact for _, found in alone for contact in found):
        other = "itself" if contact.role == "the robot itself" else contact.other
        deepest[other] = max(deepest.get(other, 0.0), contact.depth)
    found = {"itself" if c.role == "the robot itself" else c.other: c.depth for c in contacts}
    assert found == deepest


def test_the_side_of_a_stem_may_be_a_note(gantry: Robot) -> None:
    """Where pushes were foreseen it is told and makes nothing invalid; all else is judged alike."""
    fruit = FRUIT
    height = np.linspace(0.2, 0.75, 56)
    path = np.column_stack([np.full(56, 0.01), np.full(56, 0.06), height])
    path[-1] = TARGET
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject(
            "n", "pushable", Sphere(0.015), fruit,
            stem=Stem(np.array([fruit, fruit + [0.0, 0.05, 0.2]])),
        ),
    )  # fmt: skip
    motion = moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0)
    strict = metrics.judge(scene, gantry, motion)
    lenient = metrics.judge(scene, gantry, motion, stem_side=False)
    assert strict.violations == ("the tool passes n on the side of its stem",)
    assert strict.notes == ()
    assert lenient.violations == ()
    assert lenient.notes == strict.violations
    assert lenient.metrics == strict.metrics
    assert lenient.contacts == strict.contacts
    # what else is wrong stays wrong
    astray = metrics.judge(scene, gantry, motion, np.ones(3), stem_side=False)
    assert astray.violations == ("the trajectory does not begin at the start",)
    assert astray.notes == strict.violations
