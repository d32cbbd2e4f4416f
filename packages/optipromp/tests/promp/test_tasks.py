import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import (
    ConditioningWarning,
    JointPoint,
    ProMP,
    TaskPoint,
    condition,
    condition_with_report,
)
from optipromp.core.promp.tasks import Rows, TaskMap

seeds = st.integers(0, 10**6)


def pose(promp: ProMP, arm: TaskMap, phase: float) -> tuple[np.ndarray, np.ndarray]:
    point, axis, _, _ = arm(promp.mean_trajectory([phase]))
    return point[0], axis[0]


def reachable(promp: ProMP, arm: TaskMap, seed: int, spread: float) -> list[TaskPoint]:
    """Poses that one sample of a wider prior takes, so that all can be met together."""
    wide = promp.with_weights(promp.mean, spread**2 * promp.covariance)
    z = [0.3, 0.6, 1.0]
    sample = wide.sample(np.random.default_rng(seed), 1, z)[0]
    point, axis, _, _ = arm(sample)
    return [TaskPoint(p, x, a) for p, x, a in zip(z, point, axis, strict=True)]


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_rows_differentiate(arm: TaskMap, seed: int) -> None:
    """Position rows exactly; axis rows along the great circle, where it matters."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(2, 7))
    point, axis, _, _ = arm(q)
    factor = rng.normal(size=(3, 3))
    rows = Rows.of(
        [
            TaskPoint(0.1, point[0] + rng.normal(size=3), axis[0], factor @ factor.T),
            TaskPoint(0.2, point[1] + rng.normal(size=3), axis[1], 0.1),
        ]
    )
    residual, jacobian = rows.evaluate(arm, q)
    assert np.abs(residual[:, 3:]).max() < 1e-7
    h = 1e-6
    for j in range(7):
        step = np.zeros(7)
        step[j] = h
        ahead, behind = rows.evaluate(arm, q + step)[0], rows.evaluate(arm, q - step)[0]
        np.testing.assert_allclose(jacobian[:, :, j], (behind - ahead) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(
        np.linalg.norm(residual[0, :3]), np.linalg.norm(rows.position[0] - point[0])
    )


def test_axis_rows_are_an_angle(arm: TaskMap) -> None:
    q = np.zeros((1, 7))  # the axis points along x
    for target, angle in (([0, 1, 0], np.pi / 2), ([-1, 0, 0], np.pi), ([1, 0, 0], 0.0)):
        residual, _ = Rows.of([TaskPoint(0.1, np.zeros(3), np.array(target))]).evaluate(arm, q)
        assert np.linalg.norm(residual[0, 3:]) == pytest.approx(angle, abs=1e-12)


@given(seeds, st.sampled_from([1.0, 3.0]))
@example(1121, 3.0)  # out of reach of the first six restarts
@settings(max_examples=10, deadline=None)
def test_exact_points_are_hit(arm: TaskMap, arm_promp: ProMP, seed: int, spread: float) -> None:
    points = reachable(arm_promp, arm, seed, spread)
    result, report = condition_with_report(arm_promp, points, arm, iterations=200)
    assert report.missed == ()
    for point in points:
        x, a = pose(result, arm, point.phase)
        np.testing.assert_allclose(x, point.position, atol=1e-6)
        np.testing.assert_allclose(a, point.axis, atol=1e-6)
    scale = np.abs(arm_promp.covariance).max()
    assert np.linalg.eigvalsh(result.covariance)[0] > -1e-12 * scale
    # what is exact has no variance: tool point and axis of samples differ to second order only
    q, covariance = result.marginals([point.phase for point in points])
    _, _, Jp, Ja = arm(q)
    for J in (Jp, Ja):
        assert np.abs(J @ covariance @ J.transpose(0, 2, 1)).max() < 1e-10


def test_finds_the_most_probable(arm: TaskMap, arm_promp: ProMP) -> None:
    """Against L-BFGS-B on the weights themselves, to the 0.1 % a step at which it stops."""
    factor = 0.05 * np.random.default_rng(0).normal(size=(3, 3))
    points = [
        TaskPoint(p.phase, p.position, p.axis, factor @ factor.T + 1e-4 * np.eye(3), 1e-2)
        for p in reachable(arm_promp, arm, 0, 1.0)
    ]
    precision = np.linalg.inv(arm_promp.covariance)
    noise = [np.linalg.inv(np.asarray(p.covariance)) for p in points]
    values = arm_promp.basis.evaluate([p.phase for p in points])

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        x, a, Jp, Ja = arm(values @ w.reshape(7, 5).T)
        force = precision @ (w - arm_promp.weights)
        total, gradient = (w - arm_promp.weights) @ force, force
        for i, p in enumerate(points):
            e, cosine = p.position - x[i], a[i] @ p.axis
            sine = np.linalg.norm(np.cross(a[i], p.axis))
            angle = np.arctan2(sine, cosine)
            total += e @ noise[i] @ e + angle**2 / 1e-2
            across = (p.axis - cosine * a[i]) / max(float(sine), 1e-12)
            pull = Jp[i].T @ noise[i] @ e + angle / 1e-2 * Ja[i].T @ across
            gradient = gradient - np.outer(pull, values[i]).ravel()
        return float(0.5 * total), gradient

    def settle(w: np.ndarray) -> float:
        return float(minimize(cost, w, jac=True, method="L-BFGS-B").fun)

    result, report = condition_with_report(arm_promp, points, arm)
    assert report.converged
    reached = cost(result.weights)[0]
    assert reached <= 1.03 * settle(result.weights) + 0.01
    assert reached <= 1.05 * settle(arm_promp.weights) + 0.05


def test_a_linear_map_needs_no_iteration(arm_promp: ProMP) -> None:
    """Then task points are joint points, and the update must be the same."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(3, 7)), rng.normal(size=3)

    def linear(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        m = len(q)
        return (
            q @ A.T + b,
            np.tile([0.0, 0.0, 1.0], (m, 1)),
            np.tile(A, (m, 1, 1)),
            np.zeros((m, 3, 7)),
        )

    x = rng.normal(size=3)
    result, report = condition_with_report(arm_promp, TaskPoint(0.4, x, covariance=0.01), linear)
    H = np.kron(A, arm_promp.basis.evaluate([0.4]))
    S = H @ arm_promp.covariance @ H.T + 0.01 * np.eye(3)
    K = np.linalg.solve(S, H @ arm_promp.covariance).T
    np.testing.assert_allclose(
        result.weights, arm_promp.weights + K @ (x - b - H @ arm_promp.weights), atol=1e-9
    )
    np.testing.assert_allclose(
        result.covariance, arm_promp.covariance - K @ H @ arm_promp.covariance, atol=1e-9
    )
    assert report.converged
    assert report.iterations <= 2


def test_uncertain_points_give_way(arm: TaskMap, arm_promp: ProMP) -> None:
    """Uncertain in y only: x and z are met, y stays nearer to where the movement was."""
    x, _ = pose(arm_promp, arm, 1.0)
    asked = x + [0.05, 0.1, 0.0]
    point = TaskPoint(1.0, asked, covariance=np.diag([0.0, 1.0, 0.0]))
    result, report = condition_with_report(arm_promp, point, arm)
    reached, _ = pose(result, arm, 1.0)
    np.testing.assert_allclose(reached[[0, 2]], asked[[0, 2]], atol=1e-8)
    assert abs(reached[1] - asked[1]) > 0.02
    assert report.missed == ()
    assert report.position_error[0] == pytest.approx(np.linalg.norm(reached - asked), abs=1e-9)


def test_out_of_reach_is_said(arm: TaskMap, arm_promp: ProMP) -> None:
    far = TaskPoint(1.0, np.array([1e4, 0.0, 0.0]))
    with pytest.warns(ConditioningWarning, match=r"misses point\(s\) 1"):
        result = condition(arm_promp, [JointPoint(0.0, np.zeros(7)), far], arm, 20)
    assert np.isfinite(result.mean).all()
    assert np.isfinite(result.covariance).all()
    _, report = condition_with_report(arm_promp, far, arm, 20, initial=arm_promp.mean)
    assert report.missed == (0,)
    assert not report.converged
    assert report.position_error[0] > 9e3


def test_opposite_axis(arm: TaskMap, arm_promp: ProMP) -> None:
    x, a = pose(arm_promp, arm, 1.0)
    wide = arm_promp.with_weights(arm_promp.mean, 25.0 * arm_promp.covariance)
    result, report = condition_with_report(wide, TaskPoint(1.0, 0.7 * x, -a), arm)
    assert report.missed == ()
    np.testing.assert_allclose(pose(result, arm, 1.0)[1], -a, atol=1e-6)


def test_from_a_singular_posture(arm: TaskMap, arm_promp: ProMP) -> None:
    """Stretched out, the tool cannot move inwards to first order."""
    stretched = arm_promp.with_weights(np.zeros((7, 5)), arm_promp.covariance)
    goal = TaskPoint(1.0, np.array([1.0, 0.0, 0.0]))
    result, report = condition_with_report(stretched, goal, arm)
    assert np.isfinite(result.mean).all()
    assert report.missed == ()


def test_initial_weights_choose_a_solution(arm: TaskMap, arm_promp: ProMP) -> None:
    points = reachable(arm_promp, arm, 5, 1.0)
    result, _ = condition_with_report(arm_promp, points, arm)
    again, report = condition_with_report(arm_promp, points, arm, initial=result.mean)
    assert report.iterations <= 3
    np.testing.assert_allclose(again.mean, result.mean, atol=0.02)
    with pytest.raises(InvalidRequestError, match="initial"):
        condition(arm_promp, points, arm, initial=np.zeros(3))


def test_contradictions_are_refused(arm: TaskMap, arm_promp: ProMP) -> None:
    x, a = pose(arm_promp, arm, 0.5)
    here = TaskPoint(0.5, x, a)
    with pytest.raises(InvalidRequestError, match=r"positions 0\.1 apart"):
        condition(arm_promp, [here, TaskPoint(0.5, x + [0.1, 0, 0])], arm)
    with pytest.raises(InvalidRequestError, match="axes"):
        condition(arm_promp, [here, TaskPoint(0.5, x, -a)], arm)
    with pytest.raises(InvalidRequestError, match="points 1 and 0 contradict"):
        condition(arm_promp, [here, JointPoint(0.5, np.zeros(7))], arm)
    twice, report = condition_with_report(arm_promp, [here, here], arm)
    assert report.missed == ()
    np.testing.assert_allclose(pose(twice, arm, 0.5)[0], x, atol=1e-8)
    agreeing = arm_promp.mean_trajectory([0.5])[0]
    both, report = condition_with_report(arm_promp, [here, JointPoint(0.5, agreeing)], arm)
    assert report.missed == ()
    assert np.isfinite(both.covariance).all()


def test_task_map_is_checked(arm: TaskMap, arm_promp: ProMP) -> None:
    point = TaskPoint(0.5, np.zeros(3))

    def short(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        x, a, Jp, Ja = arm(q)
        return x[:, :2], a, Jp, Ja

    def broken(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        x, a, Jp, Ja = arm(q)
        return x, a, Jp * np.nan, Ja

    with pytest.raises(InvalidRequestError, match="task_map: expected"):
        condition(arm_promp, point, short)
    with pytest.raises(InvalidRequestError, match="not finite"):
        condition(arm_promp, point, broken)


def test_no_variance_left(arm: TaskMap, arm_promp: ProMP) -> None:
    """A ProMP that is certain of everything misses, finitely, and says so."""
    certain = arm_promp.with_weights(arm_promp.mean, np.zeros((35, 35)))
    x, a = pose(certain, arm, 0.5)
    result, report = condition_with_report(certain, TaskPoint(0.5, x + 0.1, a), arm)
    assert report.missed == (0,)
    np.testing.assert_array_equal(result.mean, certain.mean)
    _, report = condition_with_report(certain, TaskPoint(0.5, x, a), arm)
    assert report.missed == ()
