"""The search for the tool path of least harm.

The search samples candidate paths, tries the best of few states in more states (successive
halving), and samples new candidates near the best ones.
"""

import bisect
import functools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget
from optipromp.core.pushing.model import Candidates, PushModel
from optipromp.core.pushing.path import ToolPath

AxesAt = Callable[[FloatArray], FloatArray]
Judged = tuple[float, FloatArray, ToolPath]  # harm, numbers and path of a candidate


def search(
    model: PushModel,
    axes: AxesAt,
    rng: np.random.Generator,
    budget: Budget | None = None,
    serves: Callable[[float], bool] = lambda _: False,
) -> Iterator[tuple[ToolPath, float]]:
    """Search tool paths of little harm.

    A good path is yielded at once, the best path so far at the end of a run. After a good path the
    search continues.

    Args:
        model: of the push, with the candidates.
        axes: gives the tool axes (m, 3) at shares (m,) of a path.
        rng: samples the candidates.
        budget: a spent budget ends the search after the present candidate.
        serves: whether a yielded path serves for a harm that counts as good; asked after each
            round, as that harm grows.

    Yields:
        A path with its harm, and the harm that counts as good at that time.
    """
    candidates, schedule = model.candidates, model.candidates.schedule
    best, good = np.inf, model.good
    told = np.inf  # harm of the last yielded path, if that path was not good
    refused = False  # whether a good path was yielded, and did not serve
    found: ToolPath | None = None
    seen: list[Judged] = []
    tried: set[ToolPath] = set()  # paths that were tried in all states of the search
    judged = _judging(model, axes)
    rounds = schedule.rounds if model.least <= model.threshold else schedule.rounds[:1]

    def late() -> bool:
        begun = found is not None or len(seen) > 0
        return begun and budget is not None and budget.spent()

    def settle(x: FloatArray, path: ToolPath) -> None:
        nonlocal best, found
        tried.add(path)
        value = judged(x, path, schedule.states, best)
        if value < best:
            best, found = value, replace(path, harm=value)

    for run in range(schedule.runs):
        mean, spread = candidates.spread(run)
        seen = []
        for turn, step in enumerate(rounds):
            if turn and step.states != rounds[turn - 1].states:
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
                if value < 0.5 * good:  # in few states: surely worth all states
                    settle(x, path)
                if best < min(good, told) or late():
                    break
            value, x, path = seen[0]
            if value < best and best >= min(good, told) and path not in tried:
                settle(x, path)
            if found is None:
                found = replace(seen[0][2], harm=seen[0][0])
            if best < min(good, told) or late():
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
    """The harm of a candidate as a function of its numbers, path, number of states, and limit."""

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
    """Sample candidates (count, k): fresh ones about ``mean``, the others about the best seen.

    Cross-entropy method with a mixture in place of a Gaussian: each of the others is about a random
    one of the best, with 0.3 of the standard deviation of the best plus 0.05 of the spread.
    """
    noise = rng.standard_normal((count, len(mean)))
    out = mean + spread * noise
    if seen:
        best = np.array([x for _, x, _ in seen])
        near = best[rng.integers(len(best), size=count)]
        near += (0.3 * best.std(axis=0) + 0.05 * spread) * noise
        out = np.where(rng.random((count, 1)) < candidates.schedule.fresh, out, near)
    return np.asarray(out)
