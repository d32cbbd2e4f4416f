"""The model of motion, held against matrix exponentials, quadrature and plain conditioning."""

import numpy as np
import pytest
from scipy.linalg import expm

from optipromp.core.arrays import FloatArray
from optipromp_loop.control.motion import Oscillators, PlantState, bare_plant, coupling

UP = np.array([0.0, 0.6, 0.8])
PLANT = bare_plant(UP, (0.4, 1.1), 0.03, 0.006)


def swings(count: int) -> Oscillators:
    same = np.ones(2 * count)
    return Oscillators(np.repeat(8.0 + np.arange(count), 2), 0.15 * same, 0.002 * same)


def some(count: int = 3) -> PlantState:
    """A state of a few fruits, some time after they were seen."""
    rng = np.random.default_rng(5)
    spread = np.tile(25e-6 * np.eye(3), (count, 1, 1))
    state = PLANT.with_fruits(swings(count), rng.normal(size=(count, 3)), spread)
    return state.after(0.3, 0.001)


def continuous(one: Oscillators) -> FloatArray:
    return np.array([[0.0, 1.0], [-(one.omega[0] ** 2), -2 * one.zeta[0] * one.omega[0]]])


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.7])
def test_a_transition_is_the_exponential_and_its_noise_the_integral(dt: float) -> None:
    one = Oscillators(np.array([6.0]), np.array([0.2]), np.array([0.01]))
    steps = one.transition(np.asarray(dt))
    matrix = continuous(one)
    assert np.allclose(np.ravel(steps), expm(matrix * dt).ravel(), atol=1e-12)
    # the intensity of white noise that holds the variance: 4 ζ ω³ σ²
    intensity = 4 * 0.2 * 6.0**3 * 0.01**2
    ends, weights = np.polynomial.legendre.leggauss(40)
    times = 0.5 * dt * (ends + 1.0)
    columns = np.array([expm(matrix * t)[:, 1] for t in times])
    integral = intensity * 0.5 * dt * np.einsum("t,ti,tj->ij", weights, columns, columns)
    xx, xv, vv = one.noise(steps)
    assert np.allclose([xx[0], xv[0], xv[0], vv[0]], integral.ravel(), rtol=1e-9, atol=1e-18)


def test_a_still_state_stays_as_it_is() -> None:
    later = PLANT.after(3.7, 0.001)
    assert np.allclose(later.covariance, PLANT.covariance, rtol=1e-12, atol=1e-18)
    total = PLANT.covariance[:4, :4].trace() / 2
    assert np.sqrt(total) == pytest.approx(0.006)


def drawn() -> PlantState:
    """A state of a few fruits that move."""
    state = some()
    mean = np.random.default_rng(0).normal(size=state.layout.size)
    return PlantState(state.layout, state.oscillators, mean, state.covariance)


def test_two_steps_are_one() -> None:
    one, two = drawn().after(0.25, 0.002), drawn().after(0.1, 0.002).after(0.15, 0.002)
    assert np.allclose(one.mean, two.mean, atol=1e-12)
    # noise that drives the sway within a step reaches the swings in the next
    scale = np.sqrt(one.covariance.diagonal())
    assert (np.abs(one.covariance - two.covariance) <= 0.05 * np.outer(scale, scale)).all()
    swings = [*range(4, 10), *range(14, 20)]
    same = np.setdiff1d(np.arange(one.layout.size), swings)
    both = np.ix_(same, same)
    assert np.allclose(one.covariance[both], two.covariance[both], atol=1e-14)


def test_the_acceleration_of_the_sway_drives_the_swings() -> None:
    """A sway without a swing: the transition is the exponential of the joint system."""
    state, dt = drawn(), 0.3
    own, bank, found = state.oscillators, state.layout.bank, state.drives
    assert found.shape == (3, bank, 2, 2)
    assert np.array_equal(found, coupling(own.some([0, 2]), own.some([4, 6, 8])))
    whole = state.after(dt, 0.0)
    m, mean = state.layout.half, state.mean
    for fruit in range(3):
        swing = continuous(own.some([4 + 2 * fruit]))
        system = np.zeros((2 * bank + 2, 2 * bank + 2))
        system[-2:, -2:] = swing
        for k in range(bank):
            sway, at = continuous(own.some([2 * k])), slice(2 * k, 2 * k + 2)
            x = found[fruit, k]
            force = np.array([[0.0, 0.0], -sway[1]])  # of -s'' on y''
            assert np.allclose(x @ sway - swing @ x, force, atol=1e-9)
            system[at, at], system[-2:, at] = sway, force
        step = expm(system * dt)
        for axis in range(2):
            row = np.array([2 * k + axis for k in range(bank)] + [4 + 2 * fruit + axis])
            begin = np.stack([mean[row], mean[m + row]], 1).ravel()
            end = np.stack([whole.mean[row], whole.mean[m + row]], 1).ravel()
            assert np.allclose(step @ begin, end, atol=1e-9)


def test_motion_ahead_is_that_of_the_prediction() -> None:
    state, times = drawn(), np.array([0.0, 0.1, 0.3, 2.0])
    ahead = state.moves(times)
    for dt, moved in zip(times, ahead, strict=True):
        after = state.after(float(dt), 0.001)
        rest = after.mean[2 * after.layout.half :].reshape(-1, 3)
        whole = (after.layout.position @ after.mean).reshape(-1, 3)
        assert np.allclose(moved, whole - rest, atol=1e-12)
    assert np.allclose(ahead @ UP, 0.0, atol=1e-12)
    assert np.abs(ahead[1] - ahead[0]).max() > 0.01


def test_other_swings_leave_the_state_and_turn_its_future() -> None:
    state, other = drawn(), swings(3)
    other = Oscillators(1.5 * other.omega, other.zeta, 2.0 * other.sigma)
    turned = state.turned(other)
    assert turned.mean is state.mean
    assert turned.covariance is state.covariance
    assert (turned.oscillators.omega[4:] == other.omega).all()
    assert (turned.oscillators.sigma == state.oscillators.sigma).all()
    now, then = np.array([0.0]), np.array([0.2])
    assert np.allclose(turned.moves(now), state.moves(now), atol=1e-14)
    assert not np.allclose(turned.moves(then), state.moves(then), atol=1e-2)
    assert np.allclose(state.turned(swings(3)).moves(then), state.moves(then), atol=1e-14)


def test_a_fruit_starts_as_an_update_of_what_was_unknown() -> None:
    """A new fruit is the limit of a rest of huge variance that is then seen."""
    state, at, spread = some(2), np.array([[0.3, 0.2, 0.1]]), 16e-6 * np.eye(3)[None]
    born = state.with_fruits(swings(1), at, spread)
    vague = state.with_fruits(swings(1), np.zeros((1, 3)), 1e2 * np.eye(3)[None], known=True)
    none = np.zeros(0, dtype=np.int64)
    limit, _ = vague.updated(np.array([2]), at, spread, none)
    assert np.allclose(born.mean, limit.mean, atol=1e-6)  # 1e2 over 16e-6 costs digits
    assert np.allclose(born.covariance, limit.covariance, atol=1e-9)


def test_an_update_is_conditioning() -> None:
    state, noise = some(), np.tile(4e-6 * np.eye(3), (2, 1, 1))
    tracks, seen = np.array([0, 2]), np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    new, squares = state.updated(tracks, seen, noise, np.zeros(0, dtype=np.int64))
    rows = [0, 1, 2, 6, 7, 8]
    looked = state.layout.position[rows]
    joint = looked @ state.covariance @ looked.T + 4e-6 * np.eye(6)
    off = seen.ravel() - looked @ state.mean
    gain = np.linalg.solve(joint, looked @ state.covariance).T
    assert np.allclose(new.mean, state.mean + gain @ off, atol=1e-9)
    assert np.allclose(new.covariance, state.covariance - gain @ joint @ gain.T, atol=1e-12)
    assert squares.sum() == pytest.approx(off @ np.linalg.solve(joint, off))
    alone = np.linalg.solve(joint[:3, :3], off[:3])
    assert squares[0] == pytest.approx(off[:3] @ alone)


def test_a_held_rest_does_not_change_and_the_covariance_stays_one() -> None:
    state = some()
    rest = state.layout.rests(np.array([1]))
    seen = np.array([[0.1, 0.2, 0.3]])
    noise = 1e-6 * np.eye(3)[None]
    new, _ = state.updated(np.array([1]), seen, noise, np.array([1]))
    assert (new.mean[rest] == state.mean[rest]).all()
    same = np.ix_(rest, rest)
    assert np.allclose(new.covariance[same], state.covariance[same], rtol=1e-12)
    assert np.linalg.eigvalsh(new.covariance)[0] > -1e-15
    assert not np.allclose(new.mean, state.mean)


def test_fewer_fruits_are_a_marginal() -> None:
    state = some(3)
    kept = state.only(np.array([0, 2]))
    whole, part = state.layout.position, kept.layout.position
    rows = [0, 1, 2, 6, 7, 8]
    assert np.allclose((whole @ state.mean)[rows], part @ kept.mean)
    joint = (whole @ state.covariance @ whole.T)[np.ix_(rows, rows)]
    assert np.allclose(joint, part @ kept.covariance @ part.T)
    assert (kept.oscillators.omega[-2:] == 10.0).all()


def test_amplitudes_follow_the_energy_of_the_posterior() -> None:
    state = some()
    m, own = state.layout.half, state.oscillators
    free = np.zeros(m), np.full(m, np.inf)
    whole = state.learnt(1.0, free)
    energies = []
    for k in range(m // 2):
        energy = 0.0
        for j in (2 * k, 2 * k + 1):
            place = state.mean[j] ** 2 + state.covariance[j, j]
            speed = state.mean[m + j] ** 2 + state.covariance[m + j, m + j]
            energy += 0.25 * (place + speed / own.omega[j] ** 2)
        energies.append(energy)
    energies[2:] = [float(np.mean(energies[2:]))] * (m // 2 - 2)  # all swings alike
    assert whole.oscillators.sigma**2 == pytest.approx(np.repeat(energies, 2))
    half = state.learnt(0.5, free).oscillators.sigma ** 2
    assert half == pytest.approx(0.5 * (own.sigma**2 + whole.oscillators.sigma**2))
    assert (state.learnt(1.0, (np.ones(m), free[1])).oscillators.sigma == 1.0).all()
    assert (state.learnt(1.0, (free[0], np.full(m, 1e-12))).oscillators.sigma == 1e-6).all()
    bare = PLANT.learnt(1.0, (np.zeros(4), np.ones(4))).oscillators.sigma
    assert bare == pytest.approx(PLANT.oscillators.sigma)


def test_innovations_of_the_models_own_motion_are_what_it_says() -> None:
    """Truth drawn from the model: squares are χ² of 3, errors of positions too."""
    rng, count, dt = np.random.default_rng(11), 3, 0.05
    spread = np.tile(9e-6 * np.eye(3), (count, 1, 1))
    rest = rng.normal(size=(count, 3))
    state = PLANT.with_fruits(swings(count), rest, spread, known=True)
    truth = rng.multivariate_normal(state.mean, state.covariance)
    squares, errors = [], []
    for _ in range(600):
        point = PlantState(
            state.layout, state.oscillators, truth, np.zeros((len(truth), len(truth)))
        )
        moved = point.after(dt, 0.001)
        truth = rng.multivariate_normal(moved.mean, moved.covariance, method="eigh")
        state = state.after(dt, 0.001)
        looked = state.layout.position
        seen = (looked @ truth).reshape(-1, 3) + 0.003 * rng.standard_normal((count, 3))
        state, square = state.updated(np.arange(3), seen, spread, np.zeros(0, dtype=np.int64))
        squares.append(square)
        off = looked @ (state.mean - truth)
        errors.append(off @ np.linalg.solve(looked @ state.covariance @ looked.T, off))
    # 1800 squares of 3 degrees: standard deviation of their mean 0.058
    assert np.mean(squares) == pytest.approx(3.0, abs=0.15)
    assert np.mean(errors) == pytest.approx(9.0, abs=1.0)
