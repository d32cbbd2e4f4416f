"""The tracker on plants that it does not model: errors, consistency."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from tests.control.plants import (
    FIELD,
    Eye,
    empty,
    look,
    looks,
    nearest,
    still,
    swaying,
)  # fmt: skip

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.objects import SceneObject
from optipromp_loop.control import Innovations, Look, Tracker, TrackerParameters
from optipromp_loop.control.tracker import Tracked

STILL = TrackerParameters(sway=0.0, swing=0.0, drift=0.0, steady=0.0)
LATENCY = 0.06


def squares(off: FloatArray, covariance: FloatArray) -> FloatArray:
    """(F,) normalised squares of errors (F, 3)."""
    return (off * np.linalg.solve(covariance, off[..., None])[..., 0]).sum(axis=1)


def followed(
    seed: int, frequencies: list[float], since: float, until: float, later: float = LATENCY,
    eye: Eye = FIELD, given: TrackerParameters | None = None,
) -> Iterator[tuple[Tracked, FloatArray]]:  # fmt: skip
    """Of a plant that sways: what is tracked, and the truth, so much ``later`` than each look."""
    rng = np.random.default_rng(seed)
    plant, tracker = swaying(rng, 8, 0.020, np.array(frequencies)), Tracker(empty(), given)
    for each in looks(plant, rng, eye, until):
        tracker.add(each)
        if each.time >= since:
            yield tracker.at(each.time + later), plant.at(each.time + later)


def errors(*which: Any) -> FloatArray:
    """Of all predicted positions [m]."""
    return np.concatenate([nearest(*pair)[1] for pair in followed(*which)])


@pytest.mark.parametrize(
    ("frequencies", "median", "most"),
    [([0.5], 0.0038, 0.007), ([1.6], 0.0045, 0.008), ([0.41, 0.61, 1.34], 0.004, 0.007)],
)
def test_where_a_swaying_fruit_is_now(frequencies: list[float], median: float, most: float) -> None:
    away = errors(1, frequencies, 2.0, 6.0)
    assert np.median(away) < median
    assert np.quantile(away, 0.9) < most


def test_a_sway_seen_for_long_is_foreseen() -> None:
    """0.4 s ahead after 8 s: amplitudes that follow what is seen find the one frequency."""

    def ahead(learning: float) -> float:
        given = TrackerParameters(learning=learning)
        return float(np.median(errors(3, [0.5], 8.0, 10.0, 0.4, Eye(), given)))

    learnt = ahead(TrackerParameters().learning)
    assert learnt < 0.005  # a sway of fruits that do not swing on their stems
    assert ahead(0.0) > 2.0 * learnt


def test_innovations_and_rests_are_consistent_on_a_still_plant() -> None:
    """Noise as stated, nothing moves: mean NIS and mean NEES are in their 95 % bands."""
    rng, plant, found, every = np.random.default_rng(1), still(6), [], []
    for _ in range(40):
        tracker = Tracker(empty(), STILL)
        for each in looks(plant, rng, Eye(), 0.75):
            tracker.add(each)
        tracked = tracker.at(0.75)
        rows, _ = nearest(tracked, plant.rest)
        found.append(squares(tracked.rest[rows] - plant.rest, tracked.rest_covariance[rows]))
        every.append(tracker.statistics.squares)
    whole = Innovations(np.concatenate(every))
    mean, low, high, fits = whole.consistent()
    assert fits, (mean, low, high)
    assert high - low < 0.25
    assert len(whole.squares) > 0.99 * 40 * 6 * 14
    deviation = np.sqrt(2 * 3 / (6 * 40))
    assert abs(np.mean(found) - 3.0) < 1.96 * deviation


def test_a_steady_share_of_the_error_stays_in_the_covariance() -> None:
    """A bias of 30 % of the variance: NIS fits, and the reported covariance covers the bias."""
    rng, plant, found = np.random.default_rng(8), still(6), []
    given = TrackerParameters(sway=0.0, swing=0.0, drift=0.0)
    white = Eye(noise=0.005 * np.sqrt(0.7))
    for _ in range(12):
        tracker = Tracker(empty(), given)
        bias = 0.005 * np.sqrt(0.3) * rng.standard_normal((6, 3))
        for k in range(30):
            each = look(0.05 * k, plant.rest + bias, rng, white)
            stated = tuple(
                SceneObject(d.id, d.role, d.shape, d.position, d.orientation, d.stem, sigma=0.005)
                for d in each.detections
            )
            tracker.add(Look(each.time, each.camera, stated))
        assert tracker.statistics.consistent(0.999)[3]
        tracked = tracker.at(1.5)
        rows, _ = nearest(tracked, plant.rest)
        found.append(squares(tracked.rest[rows] - plant.rest, tracked.rest_covariance[rows]))
    assert abs(np.mean(found) - 3.0) < 1.96 * np.sqrt(2 * 3 / 72)


def test_covariances_of_a_moving_plant_cover_the_errors() -> None:
    found = []
    for tracked, truth in followed(9, [0.4, 0.9, 1.5], 2.01, 5.0):
        rows, _ = nearest(tracked, truth)
        found.append(squares(tracked.positions[rows] - truth, tracked.covariance[rows]))
    assert 0.3 < np.mean(found) < 3.5
