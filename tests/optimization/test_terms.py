"""What the functionals are: CHOMP's gradient in the limit, edge cases, invariances."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.geometry import Box, Sphere, pack
from optipromp.optimization import kernels
from optipromp.optimization.constraints import (
    ClearanceConstraint,
    CorridorConstraint,
    DriftConstraint,
    FunnelConstraint,
    GoalConstraint,
    LimitConstraint,
    SelfConstraint,
    StepConstraint,
    ToolStepConstraint,
    UprightConstraint,
)
from optipromp.optimization.problem import Problem, Surroundings
from optipromp.optimization.terms import (
    ObstacleTerm,
    PushTerm,
    SmoothnessTerm,
    Term,
    VelocityTerm,
)

EMPTY = pack([])
NOTHING = Surroundings(EMPTY, EMPTY, 0)
UP = np.array([0.0, 0.0, 1.0])


def reach(panda: Any, z: np.ndarray) -> np.ndarray:
    """A smooth motion of the Panda as a function of time in [0, 1]."""
    home = panda.robot.home
    a = np.array([0.5, -0.3, 0.4, 0.35, -0.4, 0.3, 0.2])
    b = np.array([0.2, 0.25, -0.3, 0.1, 0.3, -0.2, 0.4])
    z = np.asarray(z)[..., None]
    return np.asarray(home + a * z + b * np.sin(2.2 * z))


# --- the functional gradient -----------------------------------------------------------------


def chomp_gradient(
    panda: Any, z: np.ndarray, center: np.ndarray, radius: float, epsilon: float,
    which: np.ndarray | None, curved: bool = True,
) -> np.ndarray:  # fmt: skip
    """∫ Jᵀ‖x′‖[(I − x̂′x̂′ᵀ)∇c − cκ] at times z, from differences of the forward kinematics.

    One spherical obstacle, so distance and direction are written here; ``which`` (len(z),) picks
    one body sphere per time, None sums over all.
    """
    robot, n = panda.robot, panda.robot.n_joints
    body = np.asarray(robot.spheres.radius)

    def points(q: np.ndarray) -> np.ndarray:
        return np.asarray(robot.sphere_centers(q))

    h = 1e-4
    x, before, after = (points(reach(panda, z + s)) for s in (0.0, -h, h))
    velocity, acceleration = (after - before) / (2 * h), (after - 2 * x + before) / h**2
    q = reach(panda, z)
    jacobian = np.stack([(points(q + d) - points(q - d)) / 2e-6 for d in 1e-6 * np.eye(n)], axis=-1)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    along = velocity / np.maximum(speed, 1e-12)
    away = x - center
    span = np.linalg.norm(away, axis=-1, keepdims=True)
    d = span - radius - body[:, None]
    cost = np.where(
        d < 0, -d + epsilon / 2, np.where(d < epsilon, (d - epsilon) ** 2 / (2 * epsilon), 0)
    )
    slope = np.where(d < 0, -1.0, np.where(d < epsilon, (d - epsilon) / epsilon, 0.0))
    uphill = slope * away / span

    def across(v: np.ndarray) -> np.ndarray:
        return np.asarray(v - along * np.sum(along * v, axis=-1, keepdims=True))

    curvature = across(acceleration) / np.maximum(speed, 1e-12) ** 2
    force = speed * (across(uphill) - (cost * curvature if curved else 0.0))
    force = np.where(speed > 1e-9, force, 0.0)
    each = np.einsum("tbi,tbin->tbn", force, jacobian)
    return each.sum(axis=1) if which is None else each[np.arange(len(z)), which]


@pytest.mark.parametrize("reduction", ["sum", "max"])
def test_gradient_tends_to_the_functional_gradient(reduction: str, panda: Any) -> None:
    epsilon, radius = 0.2, 0.08
    tip = panda.robot.sphere_centers(reach(panda, np.array(0.5)))[-1]
    center = tip + [0.06, -0.10, 0.09]
    around = Surroundings(pack([(Sphere(radius), center, np.eye(3))]), EMPTY, 0)
    errors, flat, sizes = [], [], []
    for knots in (41, 81, 161, 321):
        z = np.linspace(0.0, 1.0, knots)
        q = reach(panda, z)
        term = ObstacleTerm("static", 1.0, epsilon, reduction)  # type: ignore[arg-type]
        problem = Problem(panda.robot, around, [term], (), knots, cutoff=0.3)
        problem.evaluate(q)
        gradient = problem.gradient() * (knots - 1)
        inner = np.arange(3, knots - 3)
        which = None
        if reduction == "max":  # compare where one sphere stays the largest: F jumps there not
            body = np.asarray(panda.robot.spheres.radius)
            x = panda.robot.sphere_centers(q)
            d = np.linalg.norm(x - center, axis=2) - radius - body
            cost = np.where(
                d < 0, -d + epsilon / 2, np.maximum(epsilon - d, 0) ** 2 / (2 * epsilon)
            )
            best = np.argmax(cost * np.linalg.norm(np.gradient(x, axis=0), axis=2), axis=1)
            same = [t for t in inner if len(set(best[t - 2 : t + 3])) == 1]
            inner = np.array(same)
            which = best[inner]
            assert len(inner) > 0.5 * knots
        arguments = panda, z[inner], center, radius, epsilon, which
        expected = chomp_gradient(*arguments)
        errors.append(np.linalg.norm(gradient[inner] - expected) / np.linalg.norm(expected))
        without = chomp_gradient(*arguments, curved=False)
        flat.append(np.linalg.norm(gradient[inner] - without) / np.linalg.norm(expected))
        sizes.append(np.linalg.norm(expected) / np.sqrt(len(inner)))
    assert min(sizes) > 1e-3
    assert errors[-1] < 5e-4
    assert errors[-1] < errors[0] / 16  # at least first order over three halvings, in fact second
    assert flat[-1] > 0.05  # the curvature term is there: without it nothing converges


# --- the cost itself -------------------------------------------------------------------------


@pytest.mark.parametrize("epsilon", [0.01, 0.3])
def test_obstacle_cost_is_smooth_where_its_pieces_meet(epsilon: float) -> None:
    cost, slope = kernels.obstacle_cost(0.0, epsilon)
    assert (cost, slope) == (pytest.approx(epsilon / 2), -1.0)
    assert kernels.obstacle_cost(epsilon, epsilon) == (0.0, 0.0)
    for d in (0.0, epsilon):
        low, high = (kernels.obstacle_cost(d + s * 1e-9, epsilon) for s in (-1, 1))
        assert low[0] == pytest.approx(high[0], abs=3e-9)
        assert low[1] == pytest.approx(high[1], abs=1e-6)
    assert kernels.obstacle_cost(-0.2, epsilon) == (pytest.approx(0.2 + epsilon / 2), -1.0)
    assert kernels.obstacle_cost(2 * epsilon, epsilon) == (0.0, 0.0)


def test_max_takes_one_point_and_sum_takes_all(panda: Any) -> None:
    around = panda.surroundings()
    values = {}
    for reduction in ("max", "sum"):
        term = ObstacleTerm("static", 1.0, 0.05, reduction)  # type: ignore[arg-type]
        values[reduction] = panda.problem([term], surroundings=around).evaluate(panda.q).merit
    assert 0.0 < values["max"] < values["sum"]
    # by hand, from the distances alone
    problem = panda.problem([], surroundings=around)
    problem.evaluate(panda.q)
    d = problem.evaluation.static.distance
    x = problem.evaluation.points[:, : problem.evaluation.tool]
    dt = 1.0 / (len(x) - 1)
    velocity = np.empty_like(x)
    velocity[1:-1] = (x[2:] - x[:-2]) / (2 * dt)
    velocity[0], velocity[-1] = (x[1] - x[0]) / dt, (x[-1] - x[-2]) / dt
    cost = np.where(d < 0, -d + 0.025, np.where(d < 0.05, (d - 0.05) ** 2 / 0.1, 0.0))
    rate = cost * np.linalg.norm(velocity, axis=2)
    weights = np.full(len(x), dt)
    weights[[0, -1]] *= 0.5
    assert values["max"] == pytest.approx(weights @ rate.max(axis=1), rel=1e-12)
    assert values["sum"] == pytest.approx(weights @ rate.sum(axis=1), rel=1e-12)


def test_push_is_what_the_method_says(panda: Any) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    goal, first = tools[-1] + 0.02, 3
    frame = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])
    weights = np.array([1.0, 0.25, 3.0])
    off = (tools[first:] - goal) @ frame.T
    trapezoid = np.full(len(off), 1.0 / (len(tools) - 1))
    trapezoid[[0, -1]] *= 0.5
    term = PushTerm(1.0, goal, frame, first, weights)
    value = panda.problem([term]).evaluate(panda.q).terms["push"]
    assert value == pytest.approx(float(trapezoid @ (off**2 @ weights)), rel=1e-12)
    term = PushTerm(1.0, goal, frame, first, weights, "reciprocal", 1e-9)
    value = panda.problem([term]).evaluate(panda.q).terms["push"]
    assert value == pytest.approx(float(np.sum(1.0 / np.abs(off[:-1, 1]))), rel=1e-9)


# --- nothing to do, and points where formulas are singular -----------------------------------


def from_line(tools: np.ndarray) -> np.ndarray:
    """Distance of tool points from the upright line through the last of them."""
    return np.asarray(np.hypot(*(tools - tools[-1])[:, :2].T))


def satisfied(panda: Any) -> dict[str, Term]:
    """Every constraint, kept by the case's trajectory with room to spare."""
    robot, q = panda.robot, panda.q
    tools, axes = robot.tool_pose(q)
    distances = panda.problem(cutoff=1.0)
    distances.evaluate(q)
    e = distances.evaluation
    aside = tools[:, None] + 0.2 * np.array([1.0, 0.0, 0.0])
    return {
        "touch": ClearanceConstraint("touch", "static", 9.0, e.static.distance.min() - 1e-9),
        "avoid": ClearanceConstraint("avoid", "dynamic", 9.0, e.dynamic.distance.min() - 1e-9),
        "self": SelfConstraint(9.0, 0.0),
        "drift": DriftConstraint(
            9.0, aside.reshape(-1, 3), np.tile([-1.0, 0.0, 0.0], (len(tools), 1)),
            np.array([0.0, 0.0, 1.0]), np.tile([-9.0, 9.0], (len(tools), 1)),
            np.full(len(tools), -2.0), 0,
        ),
        "funnel": FunnelConstraint(
            9.0, tools[-1], UP, 9.0, float(from_line(tools).max()) + 1e-12, 1.0, 0
        ),
        "corridor": CorridorConstraint(9.0, tools + 0.019, np.eye(3), 0.02, 0),
        "upright": UprightConstraint(
            9.0, axes[0], float(np.linalg.norm(axes - axes[0], axis=1).max()) + 1e-9, 0
        ),
        "goal": GoalConstraint(9.0, tools[-1], axes[-1]),
        "goal without axis": GoalConstraint(9.0, tools[-1], None),
        "limits": LimitConstraint(9.0, q.min(axis=0), q.max(axis=0)),
        "step": StepConstraint(9.0, np.abs(np.diff(q, axis=0)).max(axis=0) + 1e-12),
        "tool step": ToolStepConstraint(
            9.0, float(np.linalg.norm(np.diff(tools, axis=0), axis=1).max()) + 1e-9, 0
        ),
    }  # fmt: skip


SATISFIED = (
    "touch", "avoid", "self", "drift", "funnel", "corridor", "upright", "goal", "goal without axis",
    "limits", "step", "tool step",
)  # fmt: skip


@pytest.mark.parametrize("name", SATISFIED)
def test_a_constraint_that_is_kept_costs_nothing(name: str, panda: Any) -> None:
    problem = panda.problem(constraints=[satisfied(panda)[name]], cutoff=1.0)
    value = problem.evaluate(panda.q).merit
    exact = not name.startswith("goal")  # an equality: zero to the square of rounding
    assert value == 0.0 if exact else value < 1e-28
    gradient = np.abs(problem.gradient()).max()
    assert gradient == 0.0 if exact else gradient < 1e-13
    if exact:
        assert not problem.curvature().any()


@pytest.mark.parametrize("name", [n for n in SATISFIED if not n.startswith("goal")])
def test_and_one_broken_by_a_little_costs_a_little(name: str, panda: Any) -> None:
    """The other side of the same threshold: the test above is not satisfied by a dead term."""
    term: Any = satisfied(panda)[name]
    little = 1e-3
    match name:
        case "touch" | "avoid":
            term.margin += little
        case "self":
            problem = panda.problem(cutoff=1.0)
            problem.evaluate(panda.q)
            robot = panda.robot
            x, pairs = robot.sphere_centers(panda.q), robot.self_pairs
            apart = np.linalg.norm(x[:, pairs[:, 0]] - x[:, pairs[:, 1]], axis=2)
            term.margin = float((apart - robot.spheres.radius[pairs].sum(axis=1)).min()) + little
        case "drift":
            tools = panda.robot.tool_pose(panda.q)[0]
            shares = (tools[:, None] - term.centers) @ np.array([-1.0, 0.0, 0.0])
            term.offset = np.full(len(tools), shares.min() + little)
        case "funnel":
            term.width -= little
        case "corridor" | "upright":
            term.tolerance -= 2 * little
        case "limits":
            term.upper = term.upper - little
        case "step" | "tool step":
            term.largest = term.largest - little
    value = panda.problem(constraints=[term], cutoff=1.0).evaluate(panda.q).merit
    assert 0.0 < value < 9.0 * len(panda.q) ** 2 * (3 * little) ** 2


def test_terms_are_zero_where_there_is_nothing_to_do(panda: Any) -> None:
    still = np.tile(panda.q[0], (len(panda.q), 1))
    goal = panda.robot.tool_pose(panda.q[0])[0]
    terms = [
        ObstacleTerm("static", 1.0, 0.01, "sum"),
        ObstacleTerm("avoid", 1.0, 0.01, "max"),
        PushTerm(1.0, goal, np.eye(3), 0, np.ones(3)),
        VelocityTerm(1.0),
        SmoothnessTerm(1.0),
    ]
    problem = panda.problem(terms, surroundings=NOTHING)
    value = problem.evaluate(still)
    assert set(value.terms) == {"static", "avoid", "push", "velocity", "smoothness"}
    assert value.merit < 1e-28
    assert np.abs(problem.gradient()).max() < 1e-13


def test_an_arm_that_stands_in_an_obstacle_has_a_finite_gradient(panda: Any) -> None:
    """‖dx/dt‖ is 0 and has no direction."""
    still = np.tile(panda.q[3], (len(panda.q), 1))
    for reduction in ("sum", "max"):
        terms = [
            ObstacleTerm("static", 1.0, 0.05, reduction),  # type: ignore[arg-type]
            ObstacleTerm("avoid", 1.0, 0.05, reduction),  # type: ignore[arg-type]
        ]
        problem = panda.problem(terms)
        assert problem.evaluate(still).merit == 0.0
        assert not problem.gradient().any()


@pytest.mark.parametrize("away", [0.0, 1e-300, 1e-12])
def test_coincident_points_are_finite(panda: Any, away: float) -> None:
    """Obstacles centred exactly on body spheres; a zero gradient of D would be a stuck solver."""
    center = panda.robot.sphere_centers(panda.q[3])[-1] + away
    around = Surroundings(
        pack([(Sphere(0.03), center, np.eye(3)), (Box((0.1, 0.1, 0.1)), center, np.eye(3))]),
        EMPTY, 0,
    )  # fmt: skip
    terms = [ObstacleTerm("static", 1.0, 0.01, "sum")]
    kept = [ClearanceConstraint("touch", "static", 10.0, 0.01)]
    problem = panda.problem(terms, kept, surroundings=around)
    assert np.isfinite(problem.evaluate(panda.q).merit)
    gradient = problem.gradient()
    assert np.isfinite(gradient).all()
    assert np.abs(gradient[3]).max() > 1e-3
    assert np.isfinite(problem.curvature()).all()


def test_a_surface_that_touches_exactly_costs_half_epsilon() -> None:
    """D = 0 to the last bit, on hand-made points."""
    points = np.zeros((3, 3, 3))
    points[:, 0, 1] = [-0.5, 0.0, 0.5]  # one body sphere passing by, tool points unused
    distance = np.array([[1.0], [0.0], [1.0]])
    normal = np.zeros((3, 1, 3))
    normal[1, 0, 0] = 1.0
    for use_max in (False, True):
        force, stiffness = np.zeros((3, 3, 3)), np.zeros((3, 3, 6))
        value = kernels.obstacle_functional(
            points, distance, normal, 0.02, 0.5, use_max, 1.0, force, stiffness
        )
        assert value == pytest.approx(0.5 * 0.01 * 1.0)
        np.testing.assert_allclose(force[1, 0], [-0.5, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(force[2, 0], [0.0, 0.005, 0.0], atol=1e-15)
        assert np.isfinite(stiffness).all()


def test_the_reciprocal_push_is_finite_on_the_line_itself(panda: Any) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    frame = np.eye(3)
    goal = tools[4].copy()
    term = PushTerm(1.0, goal, frame, 4, np.ones(3), "reciprocal", 1e-4)
    problem = panda.problem([term])
    problem.evaluate(panda.q)
    e = problem.evaluation
    assert np.isfinite(problem.gradient()).all()
    assert e.force[4, e.tool, 1] == 0.0  # y is 0 exactly: no way is downhill
    assert kernels.push_reciprocal(
        e.points, e.tool, goal, frame[1], 1e-4, 4, 0.0, e.force
    ) > 1e4  # fmt: skip


def test_two_spheres_at_one_place_are_finite() -> None:
    points = np.zeros((1, 6, 3))  # two spheres, tool point and tip, two bounding centres
    radius = np.array([0.1, 0.2])
    groups, pairs = np.array([[0, 1, 0, 1]]), np.array([[0, 1]])
    force, stiffness = np.zeros((1, 4, 3)), np.zeros((1, 4, 6))
    value = kernels.self_penalty(points, radius, groups, pairs, radius, 0.01, 4.0, force, stiffness)
    assert value == pytest.approx(0.5 * 4.0 * 0.31**2)
    assert np.isfinite(force).all()
    assert np.isfinite(stiffness).all()


def test_an_axis_that_points_the_wrong_way_is_finite(panda: Any) -> None:
    _, axes = panda.robot.tool_pose(panda.q)
    for axis in (axes[3], -axes[3]):
        terms = [UprightConstraint(5.0, axis, 0.0, 0), GoalConstraint(5.0, np.zeros(3), axis)]
        problem = panda.problem(constraints=terms)
        assert np.isfinite(problem.evaluate(panda.q).merit)
        assert np.isfinite(problem.gradient()).all()
        assert np.isfinite(problem.curvature()).all()


def test_between_its_walls_a_corridor_has_a_share_of_their_curvature_and_no_force(
    panda: Any,
) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]

    def seen(tolerance: float, within: float) -> tuple[float, float, np.ndarray]:
        term = CorridorConstraint(9.0, tools + 0.019, np.eye(3), tolerance, 0, within)
        problem = panda.problem(constraints=[term])
        value = problem.evaluate(panda.q).merit
        return value, float(np.abs(problem.gradient()).max()), problem.curvature().copy()

    value, gradient, between = seen(0.02, 0.25)
    assert value == gradient == 0.0
    walls = seen(0.018, 0.25)[2]
    np.testing.assert_allclose(between, 0.25 * walls, rtol=1e-12)
    np.testing.assert_array_equal(walls, seen(0.018, 0.0)[2])
    assert not seen(0.02, 0.0)[2].any()


def test_a_knot_is_asked_to_drift_no_more_than_it_may_be(panda: Any) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    up, lateral = np.array([0.0, 0.0, 1.0]), np.array([[0.0, 1.0, 0.0]])
    knot, weight = len(tools) - 1, 1e4

    def value(most: float, height: float) -> float:
        caps = np.full((len(tools), 1), most)
        term = DriftConstraint(
            weight, tools[None, knot] - height * up, lateral, up, np.array([[-0.035, 0.015]]),
            np.array([0.05]), knot, slope=4.0, most=caps,
        )  # fmt: skip
        return float(panda.problem(constraints=[term]).evaluate(panda.q).merit)

    for height in (0.0, 0.02):  # inside the window, and 5 mm over it: 20 mm less is asked for
        asked = 0.05 - 4.0 * max(0.0, height - 0.015)
        assert value(1.0, height) == pytest.approx(0.5 * weight * asked**2)
        assert value(0.02, height) == pytest.approx(0.5 * weight * 0.02**2)
        assert value(0.0, height) == 0.0


@pytest.mark.parametrize("edge", [-0.035, 0.015])
def test_drift_is_continuous_where_a_knot_enters_the_window(panda: Any, edge: float) -> None:
    tools = panda.robot.tool_pose(panda.q)[0]
    up, lateral = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
    knot, offset, weight = len(tools) - 1, 0.05, 1e4

    def value(height: float) -> float:
        center = tools[knot] - height * up
        term = DriftConstraint(
            weight, center[None], lateral[None], up, np.array([[-0.035, 0.015]]),
            np.array([offset]), knot, slope=4.0,
        )  # fmt: skip
        return float(panda.problem(constraints=[term]).evaluate(panda.q).merit)

    values = [value(edge + s * 1e-7) for s in (-1.0, 0.0, 1.0)]
    assert values[1] == pytest.approx(0.5 * weight * offset**2)
    assert np.ptp(values) < 1e-4 * values[1]
    inside, outside = (0.005, -0.005) if edge < 0 else (-0.005, 0.005)
    assert value(edge + inside) == pytest.approx(values[1])
    assert value(edge + outside) == pytest.approx(0.5 * weight * (offset - 4.0 * 0.005) ** 2)
    assert value(edge + 2.6 * outside) == 0.0


def test_the_funnel_opens_below_the_goal_and_no_wider_than_it_may(panda: Any) -> None:
    """½ w (ρ − width)², by hand: at the goal's height, in the cone, and where it is widest."""
    tools = panda.robot.tool_pose(panda.q)[0]
    knot, weight, aside = len(tools) - 1, 100.0, np.array([0.06, 0.08, 0.0])
    for height, width in ((0.0, 0.01), (0.02, 0.01), (-0.02, 0.01), (-0.03, 0.03), (-0.5, 0.05)):
        goal = tools[knot] - aside - height * UP
        term = FunnelConstraint(weight, goal, UP, 0.02, 0.01, 0.05, knot, slope=2.0)
        value = panda.problem(constraints=[term]).evaluate(panda.q).merit
        assert value == pytest.approx(0.5 * weight * (0.1 - width) ** 2), height
    on_the_line = FunnelConstraint(weight, tools[knot], UP, 0.02, 0.0, 0.0, knot)
    problem = panda.problem(constraints=[on_the_line])
    assert problem.evaluate(panda.q).merit == 0.0
    assert not problem.gradient().any()


# --- invariances -----------------------------------------------------------------------------

angle = st.floats(-2.5, 2.5)
shift = st.floats(-0.5, 0.5)


def about_z(turn: float) -> np.ndarray:
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def values_of(problem: Problem, q: np.ndarray) -> np.ndarray:
    value = problem.evaluate(q)
    return np.array([value.merit, *value.terms.values()])


def workspace_problem(panda: Any, turn: np.ndarray, order: Any = slice(None)) -> Problem:
    """Terms and constraints of the workspace, all things turned about the base's axis."""
    shapes = [
        (Sphere(0.05), panda.near_body(3, 50, 0.1), np.eye(3)),
        (Box((0.1, 0.05, 0.2)), panda.near_body(5, 70, 0.12), about_z(0.4)),
        (Sphere(0.02), panda.near_body(2, 24, 0.08), np.eye(3)),
    ]
    shapes = [(s, turn @ p, turn @ r) for s, p, r in shapes][order]
    around = Surroundings(pack(shapes), pack(shapes), 3)
    goal = turn @ panda.robot.tool_pose(panda.q[-1])[0] + turn @ [0.02, 0.01, 0.03]
    frame = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]) @ turn.T
    return Problem(
        panda.robot, around,
        [
            ObstacleTerm("static", 1.0, 0.06, "sum"), ObstacleTerm("avoid", 1.0, 0.06, "max"),
            PushTerm(1.0, goal, frame, 2, np.array([1.0, 2.0, 0.5])), VelocityTerm(0.1),
        ],
        [
            ClearanceConstraint("touch", "static", 9.0, 0.03),
            GoalConstraint(7.0, goal, frame[2]),
            DriftConstraint(
                5.0, goal[None], frame[1:2], frame[2], np.array([[-1.0, 1.0]]), np.array([0.05]), 1
            ),
        ],
        len(panda.q), cutoff=0.1,
    )  # fmt: skip


@settings(max_examples=25, deadline=None)
@given(turn=angle)
def test_turning_the_world_with_the_base_changes_nothing(panda: Any, turn: float) -> None:
    plain = values_of(workspace_problem(panda, np.eye(3)), panda.q)
    assert (plain > 0.0).all()
    turned = panda.q + np.eye(7)[0] * turn
    np.testing.assert_allclose(
        values_of(workspace_problem(panda, about_z(turn)), turned), plain, rtol=1e-8
    )


@settings(max_examples=10, deadline=None)
@given(order=st.permutations([0, 1, 2]))
def test_the_order_of_obstacles_does_not_matter(panda: Any, order: list[int]) -> None:
    def ordered(problem: Problem) -> Problem:
        s = problem.surroundings
        swapped = type(s.static)(*(a[order] if len(a) == 3 else a for a in s.static))
        return Problem(
            panda.robot, Surroundings(swapped, swapped, 3), problem.terms, problem.constraints,
            len(panda.q), cutoff=0.1,
        )  # fmt: skip

    base = workspace_problem(panda, np.eye(3))
    np.testing.assert_array_equal(values_of(ordered(base), panda.q), values_of(base, panda.q))


@settings(max_examples=15, deadline=None)
@given(x=shift, y=shift, z=st.floats(0.0, 1.0), radius=st.floats(0.01, 0.2))
def test_one_more_obstacle_never_lowers_a_cost(
    panda: Any, x: float, y: float, z: float, radius: float
) -> None:
    base = panda.surroundings()
    extra = (Sphere(radius), np.array([x, y, z]), np.eye(3))
    shape = (Sphere(0.05), panda.near_body(3, 50, 0.1), np.eye(3))
    values = []
    for things in ([shape], [shape, extra]):
        around = Surroundings(pack(things), base.dynamic, base.shared)
        for reduction in ("sum", "max"):
            terms = [ObstacleTerm("static", 1.0, 0.05, reduction)]  # type: ignore[arg-type]
            kept = [ClearanceConstraint("touch", "static", 5.0, 0.02)]
            values.append(panda.problem(terms, kept, surroundings=around).evaluate(panda.q).merit)
    assert values[2] >= values[0] > 0.0
    assert values[3] >= values[1] > 0.0


@settings(max_examples=25, deadline=None)
@given(offset=st.lists(shift, min_size=7, max_size=7), factor=st.floats(0.1, 3.0))
def test_joint_space_terms_know_no_place_and_scale_with_the_square(
    panda: Any, offset: list[float], factor: float
) -> None:
    terms = [VelocityTerm(1.0), SmoothnessTerm(0.01)]
    problem = panda.problem(terms, surroundings=NOTHING)
    plain = values_of(problem, panda.q)
    moved = panda.q[0] + factor * (panda.q - panda.q[0]) + np.array(offset)
    np.testing.assert_allclose(values_of(problem, moved), factor**2 * plain, rtol=1e-7)


def test_time_reversed_costs_the_same(panda: Any) -> None:
    around = panda.surroundings()
    terms: list[Term] = [
        ObstacleTerm("static", 1.0, 0.05, "sum"),
        ObstacleTerm("avoid", 1.0, 0.05, "max"),
        VelocityTerm(1.0),
        SmoothnessTerm(0.01),
    ]
    kept = [StepConstraint(2.0, np.full(7, 0.01)), SelfConstraint(3.0, 0.3)]
    problem = panda.problem(terms, kept, surroundings=around)
    forward = values_of(problem, panda.q)
    assert (forward > 0.0).all()
    np.testing.assert_allclose(values_of(problem, panda.q[::-1]), forward, rtol=1e-10)


def test_the_obstacle_functional_is_of_the_path_not_of_the_speed(panda: Any) -> None:
    """∫ c ‖x′‖ dt is a line integral: another timing of the same path costs the same."""
    around = panda.surroundings()
    costs = []
    for warp in (lambda z: z, lambda z: z + 0.12 * np.sin(2 * np.pi * z)):
        z = np.linspace(0.0, 1.0, 801)
        term = ObstacleTerm("static", 1.0, 0.05, "sum")
        q = reach(panda, warp(z))
        problem = Problem(panda.robot, around, [term], (), len(q), cutoff=0.06)
        costs.append(problem.evaluate(q).merit)
    assert costs[0] > 1e-5
    assert costs[1] == pytest.approx(costs[0], rel=2e-3)


def test_an_evaluation_leaves_its_input_alone_and_repeats(panda: Any) -> None:
    problem = workspace_problem(panda, np.eye(3))
    q = panda.q.copy()
    first = values_of(problem, q), problem.gradient(), problem.curvature().copy()
    np.testing.assert_array_equal(q, panda.q)
    problem.evaluate(q + 0.1)
    again = values_of(problem, q), problem.gradient(), problem.curvature()
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_cutoff_is_no_part_of_the_answer(
    panda: Any, unbanded: Callable[..., np.ndarray]
) -> None:
    """Bounding spheres skip what cannot matter: with a huge cutoff nothing is skipped."""
    terms = [ObstacleTerm("static", 1.0, 0.05, "sum"), ObstacleTerm("avoid", 1.0, 0.05, "max")]
    results = []
    for cutoff in (0.05, 10.0):
        problem = panda.problem(terms, cutoff=cutoff)
        results.append((problem.evaluate(panda.q).merit, problem.gradient().copy()))
    assert results[0][0] == results[1][0] > 0.0
    np.testing.assert_array_equal(results[0][1], results[1][1])
