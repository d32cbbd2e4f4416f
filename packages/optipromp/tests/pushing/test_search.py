"""The search for the tool path of least harm, in a model whose best path is known."""

import itertools
import time
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest

from optipromp.core.budget import Budget, clock
from optipromp.core.pushing.model import Candidates, Moved, Prediction, PushModel, Round, Schedule
from optipromp.core.pushing.path import ToolPath, through, turning
from optipromp.core.pushing.searching import search

UP = np.array([0.0, 0.0, 1.0])
BEST = np.array([0.03, -0.05])  # [m] where the entry of the path of least harm is
SCALE = 0.02  # [m] from there for a harm of 1
ROUNDS = (Round(30, 1), *[Round(20, 1)] * 4, *[Round(20, 4)] * 4)


@dataclass
class Bowl(PushModel, Candidates):
    """Straight paths from an entry to the origin; the harm is the square of its distance to BEST.

    In each state the best entry is a little elsewhere: on all states together the least harm is
    their variance, not 0. ``cruel``: above the limit the harm is infinite, as it may be.
    """

    good: float = 0.0
    threshold: float = 1.0
    speed: float = 0.1
    states: int = 9
    cruel: bool = False
    begin: tuple[tuple[float, float], ...] = ()
    runs: int = 1
    asked: list[int] = field(default_factory=list)
    settled: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.candidates = self
        self.off = np.vstack([np.zeros(2), np.random.default_rng(1).normal(0.0, 0.004, (8, 2))])
        self.schedule = Schedule(ROUNDS, self.runs, 5, self.states, 0.3, 1.1)

    def harm(
        self, points: np.ndarray, axes: np.ndarray, states: int, limit: float = np.inf
    ) -> float:
        assert axes.shape == points.shape
        np.testing.assert_array_equal(axes, np.tile(UP, (len(points), 1)))
        self.asked.append(states)
        if states == self.states:
            self.settled.append(points.tobytes())
        value = self.exact(points[0, :2], states)
        return np.inf if self.cruel and value > limit else value

    def exact(self, entry: np.ndarray, states: int) -> float:
        off = entry - BEST - self.off[:states]
        return float(np.mean(np.sum(off**2, axis=1))) / SCALE**2

    @property
    def deepest(self) -> tuple[np.ndarray, float]:
        """The best entry on all states, and its harm."""
        entry = BEST + self.off.mean(axis=0)
        return entry, self.exact(entry, self.states)

    def cause(self, points: np.ndarray, axes: np.ndarray) -> tuple[str, str]:
        return "bowl", "is missed"

    def moved(self, points: np.ndarray, axes: np.ndarray) -> Moved:
        return Moved((), np.zeros((0, 3)), np.zeros(0))

    def path(self, x: np.ndarray) -> ToolPath:
        return through(np.array([[*x, -0.2], [0.0, 0.0, 0.0]]), self.speed)

    def aside(self, x: np.ndarray, path: ToolPath) -> float:
        return 0.0

    def first(self) -> np.ndarray:
        return np.array(self.begin).reshape(-1, 2)

    def spread(self, run: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(2), np.full(2, 0.05)


def found(model: Bowl, seed: int = 0, budget: Budget | None = None) -> list[tuple[ToolPath, float]]:
    return list(search(model, partial(turning, UP, None), np.random.default_rng(seed), budget))


@pytest.mark.parametrize("seed", range(5))
def test_no_path_is_tried_on_all_states_twice(seed: int) -> None:
    model = Bowl()
    found(model, seed)
    assert len(set(model.settled)) == len(model.settled) > 1


@pytest.mark.parametrize("seed", range(5))
def test_the_best_path_is_found(seed: int) -> None:
    model = Bowl()
    (path, _), *_ = found(model, seed)[::-1]
    entry, harm = model.deepest
    assert np.linalg.norm(path.points[0, :2] - entry) < 0.1 * SCALE
    assert path.harm == pytest.approx(harm, abs=0.01)
    assert path.harm == model.exact(path.points[0, :2], model.states)  # as all states have it
    np.testing.assert_allclose(path.points[-1], 0.0, atol=1e-12)


def test_other_paths_come_for_who_asks_on() -> None:
    """A good path comes at once, then others; without a good one each is better than the last."""
    counts = []
    for seed, good in itertools.product(range(8), (0.5, 0.001)):
        paths = found(Bowl(good=good, runs=4), seed)
        harms = [path.harm for path, _ in paths]
        assert len({path.points.tobytes() for path, _ in paths}) == len(paths)
        pairs = itertools.pairwise(zip(harms, (wanted for _, wanted in paths), strict=True))
        for (earlier, wanted), (later, asked) in pairs:
            assert later < earlier or later < asked or earlier < wanted
        assert (harms[0] < 0.5) or good < 0.5
        counts.append(len(paths))
    assert max(counts) > 2
    assert np.mean(np.array(counts) > 1) > 0.5


@pytest.mark.parametrize("good", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("seed", range(5))
def test_a_round_ends_early_only_with_a_path(seed: int, good: float) -> None:
    """Whoever refuses good paths is not left with rounds in which nothing is tried."""
    runs = 4
    model = Bowl(good=good, runs=runs)
    paths = found(model, seed)
    whole = runs * len(ROUNDS) - len(paths)
    assert len(model.asked) >= whole * min(step.candidates for step in ROUNDS)


@pytest.mark.parametrize("seed", range(3))
def test_the_same_seed_gives_the_same_paths(seed: int) -> None:
    one, other = (found(Bowl(good=0.3), seed) for _ in range(2))
    assert len(one) == len(other)
    for (first, good), (second, same) in zip(one, other, strict=True):
        np.testing.assert_array_equal(first.points, second.points)
        assert (first.harm, good) == (second.harm, same)
    different = found(Bowl(good=0.3), seed + 100)
    assert not np.array_equal(one[-1][0].points, different[-1][0].points)


@pytest.mark.parametrize("good", [0.0, 0.3, 2.0])
def test_a_harm_above_the_limit_need_not_be_exact(good: float) -> None:
    """A model may give up a candidate that is sure to be worse than is asked for."""
    exact, cruel = found(Bowl(good=good)), found(Bowl(good=good, cruel=True))
    assert [path.harm for path, _ in exact] == [path.harm for path, _ in cruel]
    np.testing.assert_array_equal(exact[-1][0].points, cruel[-1][0].points)


def test_a_first_candidate_that_is_good_comes_before_any_is_drawn() -> None:
    entry = (BEST[0], BEST[1])
    model = Bowl(good=1.0, begin=(entry, (0.5, 0.5)))
    path, good = next(search(model, partial(turning, UP, None), np.random.default_rng(0)))
    np.testing.assert_allclose(path.points[0, :2], entry)
    assert good == 1.0
    assert model.asked == [1, model.states]  # on one state, then on all; no other candidate


def test_each_round_without_a_good_path_is_easier_to_please() -> None:
    """A path that is not good comes at the end of a run, with the harm that counts as good."""
    model = Bowl(good=0.001)  # less than the variance of the states: never reached
    assert model.deepest[1] > model.good * 1.1 ** len(ROUNDS)
    ((path, good),) = found(model)
    assert good == pytest.approx(0.001 * 1.1 ** len(ROUNDS))
    assert path.harm > good
    assert len(found(Bowl(good=0.001, runs=3))) <= 3


def test_no_harm_above_the_threshold_is_good() -> None:
    goods = [good for _, good in found(Bowl(good=0.9, threshold=1.0, runs=3))]
    assert max(goods) == 1.0


def test_the_search_ends_when_what_is_held_serves() -> None:
    """After the first path, as soon as a harm of 0.002 is good."""
    model = Bowl(good=0.001)
    paths = search(
        model, partial(turning, UP, None), np.random.default_rng(0), None, lambda good: good > 0.002
    )
    assert list(paths) == []  # no path of so little harm was found before
    rounds = int(np.ceil(np.log(2.0) / np.log(1.1)))
    assert rounds < len(ROUNDS)
    assert len(model.asked) < sum(step.candidates + 1 for step in ROUNDS[:rounds]) + 5


def test_the_search_ends() -> None:
    """It judges no more than the schedule says: each candidate on few states, the best on all."""
    model = Bowl(good=1e-9, runs=2)
    found(model)
    sampled = sum(step.candidates for step in ROUNDS)
    again = model.schedule.kept  # where the number of states changes
    assert len(model.asked) <= 2 * (sampled + again + len(ROUNDS))


class Slow(Bowl):
    """Takes a millisecond a candidate."""

    def harm(self, *args: object, **more: object) -> float:
        time.sleep(1e-3)
        return super().harm(*args, **more)  # type: ignore[arg-type]


def test_from_the_deadline_on_the_best_so_far_comes_and_the_search_ends() -> None:
    whole = Slow(good=1e-9)
    found(whole)
    late = Slow(good=1e-9)
    ((path, _),) = found(late, budget=Budget(clock() - 1.0))
    assert np.isfinite(path.harm)
    assert len(late.asked) <= 2  # one candidate, on one state and then on all
    assert len(whole.asked) > 100
    seconds = 0.05
    began = clock()
    paths = found(Slow(good=1e-9, runs=100), budget=Budget(began + seconds))
    assert clock() - began < 10.0 * seconds
    assert len(paths) == 1


def test_a_detour_counts_as_harm() -> None:
    """What a candidate's harm is raised by moves the best path."""

    class Leaning(Bowl):
        def aside(self, x: np.ndarray, path: ToolPath) -> float:
            return 200.0 * max(0.0, float(x[0]))

    (path, _), *_ = found(Leaning())[::-1]
    assert path.points[0, 0] < 0.3 * BEST[0]
    assert path.points[0, 1] == pytest.approx(BEST[1], abs=0.2 * SCALE)


def test_a_prediction_names_a_cause_only_above_the_threshold() -> None:
    model = Bowl()
    harmless, harmful = (
        model.predict(model.path(x).points, np.tile(UP, (len(model.path(x).points), 1)))
        for x in (BEST, BEST + 2.0 * SCALE)
    )
    assert harmless.harm == model.exact(BEST, model.states)
    assert not harmless.harmful
    assert (harmless.object, harmless.cause) == ("", "nothing is harmed")
    assert str(harmless) == f"predicted harm {harmless.harm:.2f} of at most 1"
    assert harmful.harm > 1.0
    assert harmful.harmful
    told = f"harm is predicted: bowl is missed (harm {harmful.harm:.2f} of at most 1)"
    assert str(harmful) == told
    assert not Prediction(1.0, 1.0).harmful
