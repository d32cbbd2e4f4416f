"""Every functional and every constraint against finite differences, on every kind of robot."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.optimization.terms import CONSTRAINTS, FRAME, TERMS, constraints, terms

from optipromp.core.errors import InvalidRequestError
from optipromp.core.optimization.costs.joints import VelocityCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost, SelfCost
from optipromp.core.optimization.costs.tool import CorridorCost, GoalCost, UprightCost
from optipromp_paper.paper import PushCost


def dense_curvature(problem: Any, q: np.ndarray) -> np.ndarray:
    """Σ_t Σ_b Jᵀ C J plus the joint bands, from Jacobians by differences: nothing banded."""
    problem.evaluate(q)
    e, n = problem.evaluation, q.shape[1]
    stiffness, band, points = e.stiffness.copy(), e.band.copy(), e.tool + 2
    waypoints = range(problem.first, problem.last + 1)
    size = len(waypoints) * n
    full = np.zeros((size, size))
    step = 1e-6
    jacobians = np.empty((*e.points[:, :points].shape, n))
    for j in range(n):
        moved = []
        for sign in (-1.0, 1.0):
            e.move_to(q + sign * step * np.eye(n)[j])
            moved.append(e.points[:, :points].copy())
        jacobians[..., j] = (moved[1] - moved[0]) / (2.0 * step)
    jacobians[:, -1] -= jacobians[:, -2]  # the tip's curvature is about the tool point
    for u, t in enumerate(waypoints):
        at = slice(u * n, (u + 1) * n)
        for b in range(points):
            xx, yy, zz, xy, xz, yz = stiffness[t, b]
            c = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            full[at, at] += jacobians[t, b].T @ c @ jacobians[t, b]
        for distance in range(3):
            if u + distance < len(waypoints):
                ahead = slice((u + distance) * n, (u + distance + 1) * n)
                block = np.diag(band[t, distance])
                full[ahead, at] += block
                if distance:
                    full[at, ahead] += block
    return full


@pytest.mark.parametrize("name", [*TERMS, *CONSTRAINTS])
def test_a_value_knows_no_scale_and_what_is_added_is_linear_in_it(name: str, panda: Any) -> None:
    cost = {**terms(panda), **constraints(panda)}[name]
    problem = panda.problem([cost])
    problem.evaluate(panda.q)
    e = problem.evaluation

    def added(scale: float) -> tuple[float, list[np.ndarray]]:
        e.clear()
        value = cost.add(e, scale)
        return value, [a.copy() for a in (e.force, e.stiffness, e.joint_gradient, e.band)]

    value, nothing = added(0.0)
    assert value > 0.0
    assert not any(a.any() for a in nothing)
    (one, ones), (three, threes) = added(1.0), added(3.0)
    assert one == three == value
    assert any(a.any() for a in ones)
    for a, b in zip(ones, threes, strict=True):
        np.testing.assert_allclose(b, 3.0 * a, rtol=1e-12, atol=1e-12 * np.abs(b).max(initial=1.0))


@pytest.mark.parametrize("name", TERMS)
def test_gradient_of_functional(name: str, case: Any, check_gradient: Callable[..., None]) -> None:
    check_gradient(case.problem([terms(case)[name]]), case.q)


@pytest.mark.parametrize("name", CONSTRAINTS)
def test_gradient_of_constraint(name: str, case: Any, check_gradient: Callable[..., None]) -> None:
    problem = case.problem(constraints=[constraints(case)[name]])
    if case.name == "scara" and name == "upright":  # no joint of a SCARA turns its tool axis
        assert problem.evaluate(case.q).merit > 1.0
        assert np.abs(problem.gradient()).max() < 1e-12
        return
    check_gradient(problem, case.q)


def test_gradient_of_everything_together(case: Any, check_gradient: Callable[..., None]) -> None:
    everything = [terms(case)[name] for name in TERMS], [constraints(case)[n] for n in CONSTRAINTS]
    check_gradient(case.problem(*everything), case.q)
    check_gradient(case.problem(*everything, end_fixed=True), case.q)


@pytest.mark.parametrize("name", [*TERMS, *CONSTRAINTS])
def test_curvature_is_the_dense_gauss_newton_matrix(name, case, unbanded):
    term = {**terms(case), **constraints(case)}[name]
    problem = case.problem([term])
    expected = dense_curvature(problem, case.q)
    problem.evaluate(case.q)
    curvature = unbanded(problem.curvature())
    size = np.abs(expected).max()
    if name == "push reciprocal":  # concave in y away from the target: it offers no curvature
        assert size == 0.0
        assert not curvature.any()
        return
    assert size > 0.0 or (case.name == "scara" and name == "upright")
    np.testing.assert_allclose(curvature, expected, atol=1e-12 + 1e-7 * size, rtol=0)
    assert np.linalg.eigvalsh(curvature).min() > -1e-10 * size


def test_curvature_of_everything_together(case: Any, unbanded: Callable[..., np.ndarray]) -> None:
    problem = case.problem(
        [terms(case)[name] for name in TERMS],
        [constraints(case)[name] for name in CONSTRAINTS],
        end_fixed=True,
    )
    expected = dense_curvature(problem, case.q)
    problem.evaluate(case.q)
    curvature = unbanded(problem.curvature())
    size = np.abs(expected).max()
    np.testing.assert_allclose(curvature, expected, atol=1e-7 * size, rtol=0)
    assert np.linalg.eigvalsh(curvature).min() > -1e-10 * size
    metric = unbanded(problem.metric)
    assert np.linalg.eigvalsh(metric).min() > 0.0


@pytest.mark.parametrize("name", ["velocity", "smoothness", "limits", "step"])
def test_curvature_in_the_joints_is_the_true_hessian(name, panda, unbanded):
    """Quadratic in the joints: no approximation is made, so differences of the gradient agree."""
    problem = panda.problem([{**terms(panda), **constraints(panda)}[name]])
    hessian = []
    for t in range(problem.first, problem.last + 1):
        for j in range(panda.q.shape[1]):
            gradients = []
            for sign in (-1.0, 1.0):
                q = panda.q.copy()
                q[t, j] += sign * 1e-5
                problem.evaluate(q)
                gradients.append(problem.gradient()[problem.first : problem.last + 1].ravel())
            hessian.append((gradients[1] - gradients[0]) / 2e-5)
    problem.evaluate(panda.q)
    expected = np.array(hessian)
    np.testing.assert_allclose(
        unbanded(problem.curvature()), expected, atol=1e-6 * np.abs(expected).max()
    )


@pytest.mark.parametrize("name", ["goal", "corridor", "upright"])
def test_curvature_at_a_vanishing_residual_is_the_second_difference(name, panda, unbanded):
    """Where the residuals vanish Gauss-Newton is Newton: weights and factors of 2 show."""
    tools, axes = panda.robot.tool_pose(panda.q)
    term = {
        "goal": GoalCost(70.0, tools[-1], axes[-1]),
        "corridor": CorridorCost(60.0, tools, FRAME, 0.0, 1),
        "upright": UprightCost(60.0, axes[-1:], 0.0, len(tools) - 1),
    }[name]
    problem = panda.problem(constraints=[term])
    inner = slice(problem.first, problem.last + 1)
    delta = np.zeros_like(panda.q)
    delta[inner] = np.random.default_rng(1).normal(size=delta[inner].shape)
    h = 1e-4
    low, mid, high = (problem.evaluate(panda.q + s * h * delta).merit for s in (-1, 0, 1))
    problem.evaluate(panda.q + 1e-9 * delta)
    quadratic = delta[inner].ravel() @ unbanded(problem.curvature()) @ delta[inner].ravel()
    assert quadratic > 1.0
    second = (low - 2.0 * mid + high) / h**2
    if name == "upright":  # a distance: its curvature is that along the direction it left in
        assert 0.5 * quadratic < second <= quadratic * 1.001
    else:
        assert second == pytest.approx(quadratic, rel=1e-4)


def test_self_curvature_bounds_the_coupled_one(case, unbanded):
    """Two moving spheres share a residual; their separate blocks of 2w n nᵀ majorise its matrix."""
    weight, margin = 30.0, 0.25
    problem = case.problem(constraints=[SelfCost(weight, margin)])
    problem.evaluate(case.q)
    curvature = unbanded(problem.curvature())
    robot, n = case.robot, case.robot.n_joints
    pairs, radius = robot.self_pairs, np.asarray(robot.spheres.radius)
    coupled = np.zeros_like(curvature)
    step = 1e-6
    for u in range(len(case.q) - 1):
        q = case.q[u + 1]
        steps = step * np.eye(n)
        moved = robot.sphere_centers(np.concatenate([q + steps, q - steps]))
        jacobian = np.moveaxis((moved[:n] - moved[n:]) / (2 * step), 0, -1)
        centers = robot.sphere_centers(q)
        away = centers[pairs[:, 0]] - centers[pairs[:, 1]]
        apart = np.linalg.norm(away, axis=1)
        close = apart - radius[pairs].sum(axis=1) < margin
        normal = away[close] / apart[close, None]
        relative = jacobian[pairs[close, 0]] - jacobian[pairs[close, 1]]
        rows = np.einsum("pi,pin->pn", normal, relative)
        coupled[u * n : (u + 1) * n, u * n : (u + 1) * n] = weight * rows.T @ rows
    assert np.abs(coupled).max() > 0.0
    assert np.linalg.eigvalsh(curvature - coupled).min() > -1e-6 * np.abs(curvature).max()


def test_costs_of_one_name_both_count(panda: Any, check_gradient: Callable[..., None]) -> None:
    twice = panda.problem([VelocityCost(1.0), VelocityCost(2.0)])
    once = panda.problem([VelocityCost(3.0)])
    assert twice.evaluate(panda.q).merit == pytest.approx(once.evaluate(panda.q).merit)
    check_gradient(twice, panda.q)


NAN = float("nan")


@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        *((VelocityCost, (value,), "weight of velocity") for value in (-1e-12, -1.0, NAN)),
        *((ObstacleCost, ("static", 1.0, value, "max"), "epsilon") for value in (0.0, -0.01, NAN)),
        (ObstacleCost, ("static", 1.0, 0.01, "mean"), "'max' or 'sum'"),
        (PushCost, (1.0, np.zeros(3), np.eye(3), 0, np.ones(3), "cubic"), "'quadratic' or 'recip"),
    ],
)
def test_what_is_refused(kind: Any, given: tuple[Any, ...], words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        kind(*given)
