"""What the functionals are: CHOMP's gradient in the limit, and their values by hand."""

from typing import Any

import numpy as np
import pytest
from tests.optimization.builders import EMPTY, reach

from optipromp.core.geometry import Sphere, pack
from optipromp.core.optimization.costs.obstacles import ObstacleCost, chomp_cost
from optipromp.core.optimization.problem import Problem, Surroundings
from optipromp_paper.paper import PushCost


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
    for waypoints in (41, 81, 161, 321):
        z = np.linspace(0.0, 1.0, waypoints)
        q = reach(panda, z)
        term = ObstacleCost("static", 1.0, epsilon, reduction)  # type: ignore[arg-type]
        problem = Problem(panda.robot, around, [term], (), waypoints, cutoff=0.3)
        problem.evaluate(q)
        gradient = problem.gradient() * (waypoints - 1)
        inner = np.arange(3, waypoints - 3)
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
            assert len(inner) > 0.35 * waypoints
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


@pytest.mark.parametrize("epsilon", [0.01, 0.3])
def test_the_chomp_cost_is_smooth_where_its_pieces_meet(epsilon: float) -> None:
    cost, slope = chomp_cost(0.0, epsilon)
    assert (cost, slope) == (pytest.approx(epsilon / 2), -1.0)
    assert chomp_cost(epsilon, epsilon) == (0.0, 0.0)
    for d in (0.0, epsilon):
        low, high = (chomp_cost(d + s * 1e-9, epsilon) for s in (-1, 1))
        assert low[0] == pytest.approx(high[0], abs=3e-9)
        assert low[1] == pytest.approx(high[1], abs=1e-6)
    assert chomp_cost(-0.2, epsilon) == (pytest.approx(0.2 + epsilon / 2), -1.0)
    assert chomp_cost(2 * epsilon, epsilon) == (0.0, 0.0)


def test_max_takes_one_point_and_sum_takes_all(panda: Any) -> None:
    around = panda.surroundings()
    values = {}
    for reduction in ("max", "sum"):
        term = ObstacleCost("static", 1.0, 0.05, reduction)  # type: ignore[arg-type]
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
    term = PushCost(1.0, goal, frame, first, weights)
    value = panda.problem([term]).evaluate(panda.q).costs["push"]
    assert value == pytest.approx(float(trapezoid @ (off**2 @ weights)), rel=1e-12)
    term = PushCost(1.0, goal, frame, first, weights, "reciprocal", 1e-9)
    value = panda.problem([term]).evaluate(panda.q).costs["push"]
    assert value == pytest.approx(float(np.sum(1.0 / np.abs(off[:-1, 1]))), rel=1e-9)


@pytest.mark.parametrize("reduction", ["sum", "max"])
def test_f_d_is_over_b_d_alone(reduction: Any, panda: Any) -> None:
    """An object to avoid that only the tool is near costs F_d nothing; the tool's wish has it."""
    spheres, waypoint = panda.robot.spheres, 4
    distal = np.asarray(spheres.distal)
    at = panda.robot.tool_pose(panda.q[waypoint])[0]
    around = Surroundings(EMPTY, pack([(Sphere(0.03), at, np.eye(3))]), 1)

    def terms(*names: Any) -> dict[str, float]:
        costs = [ObstacleCost(name, 1.0, 0.02, reduction) for name in names]
        problem = panda.problem(costs, surroundings=around, cutoff=0.3)
        value = problem.evaluate(panda.q)
        e = problem.evaluation
        assert e.dynamic.distance[:, ~distal[np.argsort(spheres.link, kind="stable")]].min() > 0.02
        assert bool(np.any(problem.gradient())) == (value.cost > 0.0)
        return value.costs

    assert terms("avoid") == {"avoid": 0.0}
    assert terms("tool avoid")["tool avoid"] > 1e-3


def test_f_d_and_the_tool_s_part_are_the_whole(panda: Any) -> None:
    """Over objects to avoid, the sums over B_d and over the rest are the sum over all spheres."""
    dynamic = panda.surroundings().dynamic
    around = Surroundings(dynamic, dynamic, len(dynamic.kind))
    names: tuple[Any, ...] = ("static", "avoid", "tool avoid")
    costs = [ObstacleCost(name, 1.0, 0.08, "sum") for name in names]
    value = panda.problem(costs, surroundings=around).evaluate(panda.q).costs
    assert min(value.values()) > 0.0
    assert value["static"] == pytest.approx(value["avoid"] + value["tool avoid"], rel=1e-12)
