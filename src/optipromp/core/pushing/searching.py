"""The search for the tool path of least harm.

The search samples candidate paths, keeps those of least harm on few states, tries these on more
states (successive halving), and samples new candidates near them.
"""

import bisect
import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.pushing.candidates import Candidates
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.path import ToolPath

SURE = 0.5  # share of a good harm; a candidate of less on few states is tried on all at once

AxesAt = Callable[[FloatArray], FloatArray]
Judged = tuple[float, FloatArray, ToolPath]
"""Harm, numbers and path of a candidate."""


def search(
    model: PushModel, axes: AxesAt, rng: np.random.Generator, budget: Budget | None = None,
    serves: Callable[[float], bool] = lambda _: False,
) -> Iterator[tuple[ToolPath, float]]:  # fmt: skip
    """Search tool paths of little harm.

    A path is yielded as soon as it is good, otherwise at the end of a run if it is the best so far.
    After a good path the search goes on for another good one. Before a good path come those that
    are preferred to it where they are nearly as good (:meth:`Candidates.rather`).

    Args:
        model: of the push, with the candidates.
        axes: gives the tool axes (m, 3) at shares (m,) of a path.
        rng: samples the candidates.
        budget: asked after each candidate; when it is spent, no further one is tried.
        serves: asked after each round, with the harm that counts as good from then on, whether a
            path that was yielded serves after all.

    Yields:
        A path with its harm, and the harm that counts as good at that time.
    """
    candidates, schedule = model.candidates, model.candidates.schedule
    best, good = np.inf, model.good
    told = np.inf  # harm of the path that was yielded last, if it was not good
    refused = False  # whether a good one was yielded, and did not serve
    found: ToolPath | None = None
    numbers = np.zeros(0)  # of the path that was found
    seen: list[Judged] = []
    tried: set[ToolPath] = set()  # on all states, and no better than the best
    judged = _judging(model, axes)

    def late() -> bool:
        begun = found is not None or len(seen) > 0
        return begun and budget is not None and budget.spent()

    def preferred(x: FloatArray, good_one: ToolPath) -> Iterator[ToolPath]:
        most = good_one.harm + candidates.indifferent
        for other in candidates.rather(x, good_one):
            path = candidates.path(other)
            if not candidates.rather(other, path):
                value = judged(other, path, schedule.states, most)
                if value < most:
                    yield replace(path, harm=value)

    def settle(x: FloatArray, path: ToolPath) -> None:
        nonlocal best, found, numbers
        tried.add(path)
        value = judged(x, path, schedule.states, best)
        if value < best:
            best, found, numbers = value, replace(path, harm=value), x

    for run in range(schedule.runs):
        mean, spread = candidates.spread(run)
        seen = []
        for turn, step in enumerate(schedule.rounds):
            if turn and step.states != schedule.rounds[turn - 1].states:
                again = [(judged(x, p, step.states, np.inf), x, p) for _, x, p in seen]
                seen = sorted(again, key=lambda item: item[0])
            new = _sampled(candidates, mean, spread, seen, step.candidates, rng)
            if run == turn == 0 and len(candidates.first()):
                new = candidates.first()
            for x in new:
                limit = seen[-1][0] if len(seen) == schedule.kept else np.inf
                path = candidates.path(x)
                value = judged(x, path, step.states, limit)
                if value < limit or not seen:
                    bisect.insort(seen, (value, x, path), key=lambda item: item[0])
                    del seen[schedule.kept :]
                if value < SURE * good:
                    settle(x, path)
                if best < min(good, told) or late():
                    break
            for value, x, path in seen[: schedule.screened]:
                if best < min(good, told) or value >= best:
                    break
                if path not in tried:
                    settle(x, path)
            if found is None:
                found, numbers = replace(seen[0][2], harm=seen[0][0]), seen[0][1]
            if best < min(good, told) or late():
                if best < good and not late():
                    yield from ((path, good) for path in preferred(numbers, found))
                yield found, good
                if late():
                    return
                seen = [item for item in seen if item[2].points is not found.points]
                best, told, refused = np.inf, np.inf, True
                tried.clear()
            good = min(good * schedule.lenient, model.threshold)
            if serves(good):
                return
        if found is not None and best < (min(good, told) if refused else told):
            told = best
            yield found, good


def _judging(model: PushModel, axes: AxesAt) -> Callable[[FloatArray, ToolPath, int, float], float]:
    """A function of a candidate's numbers, its path, a number of states and a limit: its harm."""

    @functools.cache
    def axes_at(count: int) -> FloatArray:
        return axes(np.linspace(0.0, 1.0, count))

    def judged(x: FloatArray, path: ToolPath, states: int, limit: float) -> float:
        value = model.candidates.aside(x, path)
        if value < limit:
            value += model.harm(path.points, axes_at(len(path.points)), states, limit - value)
        return value

    return judged


def _sampled(
    candidates: Candidates,
    mean: FloatArray,
    spread: FloatArray,
    seen: list[Judged],
    count: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Sample candidates (count, k): the fresh ones about ``mean``, the others about the best seen.

    Each of the others is about one of the best, chosen at random. Its standard deviation is 0.3 of
    that of the best, plus 0.05 of the spread (cross-entropy method with a mixture in place of one
    Gaussian).
    """
    noise = rng.standard_normal((count, len(mean)))
    out = mean + spread * noise
    if seen:
        best = np.array([x for _, x, _ in seen])
        near = best[rng.integers(len(best), size=count)]
        near += (0.3 * best.std(axis=0) + 0.05 * spread) * noise
        out = np.where(rng.random((count, 1)) < candidates.schedule.fresh, out, near)
    return np.asarray(out)
