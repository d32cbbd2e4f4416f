"""How well bases follow demonstrations, and the choice of their number."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.promp import (
    Basis,
    Demonstration,
    Demonstrations,
    JointPoint,
    ProMP,
    condition,
    fit,
    held_out_residuals,
    residuals,
)


def motions(seed: int, demos: int, count: int = 8, size: int = 60) -> np.ndarray:
    """Smooth motions (N, T, 2) of so many bases exactly, ends and middle tied together."""
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(2 * count, 4))
    source = ProMP(Basis(count), rng.normal(size=(2, count)), factor @ factor.T)
    return source.sample(rng, demos, size)


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(4, 12), st.booleans())
@settings(max_examples=30, deadline=None)
def test_residuals_are_those_of_least_squares(seed, demos, count, uneven):
    y = np.random.default_rng(seed).normal(size=(demos, 40, 2)).cumsum(axis=1)
    times = np.linspace(0.0, 1.0, 40) ** (2 if uneven else 1)
    given_as = [Demonstration(times, item) for item in y]
    if uneven:
        given_as[0] = Demonstration(times[1:], y[0, 1:])
    for item, rest in zip(given_as, residuals(given_as, Basis(count)), strict=True):
        values = Basis(count).evaluate(item.phases)
        best = np.linalg.lstsq(values, item.positions, rcond=None)[0]
        np.testing.assert_allclose(rest, item.positions - values @ best, atol=1e-5)


def test_held_out_residuals_by_the_public_functions() -> None:
    """Leave one out, condition on the ends, compare: with fit and condition themselves."""
    y = motions(0, 5)
    squares = []
    for i in range(5):
        learnt = fit(np.delete(y, i, axis=0), Basis(6))
        reached = condition(learnt, [JointPoint(0.0, y[i, 0]), JointPoint(1.0, y[i, -1])])
        squares.append((y[i] - reached.mean_trajectory(60)) ** 2)
    found = held_out_residuals(y, [6])
    assert found == {6: pytest.approx(np.sqrt(np.mean(squares)), rel=1e-9)}


@given(st.integers(0, 10**6), st.sampled_from([6, 8, 11]), st.integers(6, 25))
@settings(max_examples=10, deadline=None)
def test_finds_the_number_of_bases_that_made_the_motion(seed: int, count: int, demos: int) -> None:
    """One movement of so many bases under noise on all samples but the ends."""
    rng = np.random.default_rng(seed)
    noise = 0.05 * np.sin(np.pi * np.linspace(0.0, 1.0, 60))[:, None]
    movement = Basis(count).evaluate(60) @ rng.normal(size=(count, 2))
    y = movement + noise * rng.normal(size=(demos, 60, 2))
    tried: list[int] = []
    found = held_out_residuals(y, progress=tried.append)
    assert tried == list(found) == list(range(4, 21))
    best = min(found, key=lambda k: found[k])
    assert best >= count  # too few bases cannot follow the motion
    # more of them win by chance only: in 906 cases of 17 demonstrations two did, by 0.05 %
    assert found[count] <= (1.05 if demos < 10 else 1.01) * found[best]
    assert held_out_residuals(y, [7, count])[count] == found[count]  # no chance in it


def test_counts_beyond_the_samples_are_left_out() -> None:
    y = motions(0, 4, size=9)
    assert list(held_out_residuals(y)) == [4, 5, 6, 7, 8, 9]
    assert list(held_out_residuals(y, [12, 5])) == [12, 5]


def test_refuses() -> None:
    y = motions(0, 3)
    with pytest.raises(InvalidDemonstrationError, match="at least two"):
        held_out_residuals(y[:1])
    with pytest.raises(InvalidRequestError, match="count"):
        held_out_residuals(y, [3])
    partial = [Demonstration(np.arange(60.0), item, span=(0.0, 90.0)) for item in y]
    with pytest.raises(InvalidDemonstrationError, match="partial"):
        held_out_residuals(partial)


def test_recorded_demonstrations(recorded: Demonstrations) -> None:
    """Too few bases cannot follow them, too many predict worse; the best lies between."""
    found = held_out_residuals(recorded, [5, 13, 19])
    assert min(found, key=lambda k: found[k]) == 13
    largest = {k: max(np.abs(part).max() for part in residuals(recorded, Basis(k))) for k in found}
    assert largest[5] > 0.3 > 0.15 > largest[13] > largest[19]
