"""The interface of a push model, and the search for the tool path of least harm.

A model predicts what the tool does to the objects that it pushes along a path, as one number: the
*harm*. The harm is 0 where nothing is pressed, and 1 where a force reaches what a fruit or a pack
bears. A model has several states of the scene: the perceived one, and samples within the errors of
detection. The harm of a path is the mean over the states.

The search samples candidate paths, keeps those of least harm on few states, tries these on more
states (successive halving), and samples new candidates near them.
"""

import bisect
import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.budget import Budget
from optipromp.pushing.path import STEP, ToolPath, along, evenly, length
from optipromp.pushing.prediction import Calibration as Calibration
from optipromp.pushing.prediction import Prediction as Prediction


@dataclass(frozen=True)
class Round:
    """One round of a search.

    Attributes:
        candidates: how many tool paths are sampled.
        states: on how many states of the scene each is tried.
    """

    candidates: int
    states: int


@dataclass(frozen=True)
class Schedule:
    """How long a search goes on.

    Attributes:
        rounds: of one run.
        runs: largest number of runs; a further one begins where no path is good.
        kept: number of best candidates, about which the next ones are sampled.
        screened: number of these that are tried on ``states`` states after each round.
        states: number of states in the search; a followed trajectory is tried on all.
        fresh: share of the candidates that are sampled from the model's own spread.
        lenient: factor on the harm that counts as good, after each round that found no good path.
    """

    rounds: tuple[Round, ...]
    runs: int
    kept: int
    screened: int
    states: int
    fresh: float
    lenient: float


@dataclass(frozen=True, eq=False)
class Moved:
    """Where a motion of the tool leaves the objects that the model knows.

    Attributes:
        ids: of N objects, the target first.
        positions: (N, 3) [m].
        turns: (N,) about -x_g, as packs turn where they stand [rad].
    """

    ids: tuple[str, ...]
    positions: FloatArray
    turns: FloatArray


class PushModel(ABC):
    """A model of the push in one scene.

    The model predicts the *harm* of a tool path: 0 where nothing is pressed, 1 where a force
    reaches what a fruit or a pack bears. It is the mean over several sampled states of the scene.

    Attributes:
        speed: of the tool along a path [m/s].
        good: harm below which the search ends.
        threshold: largest harm of a success, for the share of promises that may be broken.
        calibration: of the harm; None: it was never compared with what happens.
        states: number of states of the scene; the first is the perceived one.
        schedule: of the search.
        entry: where paths begin along z_g [m]; -inf: anywhere.
        indifferent: a difference of harm that decides nothing where a path is preferred.
    """

    speed: float
    good: float
    threshold: float
    calibration: Calibration | None = None
    states: int
    schedule: Schedule
    entry: float = -math.inf
    indifferent: float = 0.0

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """Whether the tool and the last link, led through ``points`` (P, 3), surely touch nothing
        that they could push, where it is before any push. False where the model cannot tell.
        """
        return False

    @abstractmethod
    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """Mean harm of a motion of the tool over the first ``states`` states.

        ``points`` (P, 3) are tool points about :data:`STEP` apart, ``axes`` (P, 3) tool axes. Where
        the harm is above ``limit``, any number above ``limit`` may be returned. One state alone
        serves to compare candidates: a model may take longer steps there.
        """

    @abstractmethod
    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """Id of the object that is harmed most in the worst state, and what happens to it."""

    def predict(
        self, points: FloatArray, axes: FloatArray, harm: float | None = None
    ) -> Prediction:
        """The harm of a motion over all states (``harm``, where it is known), and its cause."""
        harm = self.harm(points, axes, self.states) if harm is None else harm
        harmed = self.cause(points, axes) if harm > self.threshold else ("", "nothing is harmed")
        pushed = {k: force for k, force in self.forces(points, axes).items() if force >= SLIGHT}
        chance = math.nan if self.calibration is None else self.calibration.probability(harm)
        return Prediction(harm, self.threshold, *harmed, pushed, chance)

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        """Largest force on each object but the target, by id, in the perceived state [N]."""
        return {}

    @abstractmethod
    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """Where the tool, led through points (P, 3), leaves the objects of the perceived state."""

    @abstractmethod
    def path(self, x: FloatArray) -> ToolPath:
        """The path of a candidate (k,)."""

    @abstractmethod
    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Penalty added to a candidate's harm: for a detour, for too little room for the tool."""

    @abstractmethod
    def first(self) -> FloatArray:
        """Candidates (m, k) that are tried before any is sampled; m may be 0."""

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """Candidates that are preferred to the good one ``x`` (k,) if they are nearly as good.

        Nearly: their harm is larger by less than :attr:`indifferent`.
        """
        return []

    @abstractmethod
    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (k,) of the candidates that a run begins with."""


class _Guided(PushModel):
    """A model whose candidates, speed and schedule are another's."""

    def __init__(self, lead: PushModel) -> None:
        self.lead, self.speed, self.schedule = lead, lead.speed, lead.schedule
        self.good, self.threshold, self.states = lead.good, lead.threshold, lead.states
        self.calibration = lead.calibration
        self.entry = lead.entry
        self.indifferent = lead.indifferent

    def path(self, x: FloatArray) -> ToolPath:
        """See :class:`PushModel`."""
        return self.lead.path(x)

    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """See :class:`PushModel`."""
        return self.lead.aside(x, path)

    def first(self) -> FloatArray:
        """See :class:`PushModel`."""
        return self.lead.first()

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """See :class:`PushModel`."""
        return self.lead.rather(x, path)

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """See :class:`PushModel`."""
        return self.lead.spread(run)


class Combined(_Guided):
    """Several models of one scene. Their harms are added, each in proportion to its threshold.

    Args:
        models: the first one gives paths, speed and schedule.
    """

    def __init__(self, *models: PushModel) -> None:
        super().__init__(models[0])
        self.models, self.states = models, max(model.states for model in models)

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """See :class:`PushModel`; for every model."""
        return all(model.clear(points, axes) for model in self.models)

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """The sum, each harm in proportion to its model's threshold."""
        total = 0.0
        for model in self.models:
            share = self.threshold / model.threshold
            left = (limit - total) / share
            total += share * model.harm(points, axes, min(states, model.states), left)
            if total > limit:
                break
        return total

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """The cause of the model that predicts most harm."""
        worst = max(
            self.models,
            key=lambda model: model.harm(points, axes, model.states) / model.threshold,
        )
        return worst.cause(points, axes)

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        """See :class:`PushModel`; of all models."""
        return {k: f for model in self.models for k, f in model.forces(points, axes).items()}

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """As each model predicts it; for an object of several models, the last one counts."""
        found = [model.moved(points, axes) for model in self.models]
        names = [name for one in found for name in one.ids]
        rows = list({name: row for row, name in enumerate(names)}.values())
        return Moved(
            tuple(names[row] for row in rows), np.concatenate([m.positions for m in found])[rows],
            np.concatenate([m.turns for m in found])[rows],
        )  # fmt: skip


class Continued(_Guided):
    """A model of a push that has begun: the motion so far comes before every path.

    Args:
        model: of the scene as it was before the push.
        points, axes: (P, 3) of the tool so far.
    """

    def __init__(self, model: PushModel, points: FloatArray, axes: FloatArray) -> None:
        super().__init__(model)
        self._points, self._axes = points, axes  # ``clear`` is never sure: what was pushed is away

    def _whole(self, points: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = np.concatenate([self._points, points])
        count = max(2, math.ceil(length(points) / STEP) + 1)
        axes = along(points, np.concatenate([self._axes, axes]), count)
        return evenly(points, count), axes

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """See :class:`PushModel`; of the whole motion."""
        return self.lead.harm(*self._whole(points, axes), states, limit)

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """See :class:`PushModel`; of the whole motion."""
        return self.lead.cause(*self._whole(points, axes))

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        """See :class:`PushModel`; of the whole motion."""
        return self.lead.forces(*self._whole(points, axes))

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """See :class:`PushModel`; by the whole motion."""
        return self.lead.moved(*self._whole(points, axes))


SLIGHT = 0.05  # [N] a choice: of a force that is not told
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
    the model prefers to it where they are nearly as good (:meth:`PushModel.rather`).

    Args:
        model: of the push.
        axes: gives the tool axes (m, 3) at shares (m,) of a path.
        rng: samples the candidates.
        budget: asked after each candidate; when it is spent, no further one is tried.
        serves: asked after each round, with the harm that counts as good from then on, whether a
            path that was yielded serves after all.

    Yields:
        A path with its harm, and the harm that counts as good at that time.
    """
    schedule, best, good = model.schedule, np.inf, model.good
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
        most = good_one.harm + model.indifferent
        for other in model.rather(x, good_one):
            path = model.path(other)
            if not model.rather(other, path):
                value = judged(other, path, schedule.states, most)
                if value < most:
                    yield replace(path, harm=value)

    for run in range(schedule.runs):
        mean, spread = model.spread(run)
        seen = []
        for turn, step in enumerate(schedule.rounds):
            if turn and step.states != schedule.rounds[turn - 1].states:
                again = [(judged(x, p, step.states, np.inf), x, p) for _, x, p in seen]
                seen = sorted(again, key=lambda item: item[0])
            new = _candidates(model, mean, spread, seen, step.candidates, rng)
            if run == turn == 0 and len(model.first()):
                new = model.first()
            for x in new:
                limit = seen[-1][0] if len(seen) == schedule.kept else np.inf
                path = model.path(x)
                value = judged(x, path, step.states, limit)
                if value < limit or not seen:
                    bisect.insort(seen, (value, x, path), key=lambda item: item[0])
                    del seen[schedule.kept :]
                if value < SURE * good:
                    tried.add(path)
                    value = judged(x, path, schedule.states, best)
                    if value < best:
                        best, found, numbers = value, replace(path, harm=value), x
                if best < min(good, told) or late():
                    break
            for value, x, path in seen[: schedule.screened]:
                if best < min(good, told) or value >= best:
                    break
                if path in tried:
                    continue
                tried.add(path)
                value = judged(x, path, schedule.states, best)
                if value < best:
                    best, found, numbers = value, replace(path, harm=value), x
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
        value = model.aside(x, path)
        if value < limit:
            value += model.harm(path.points, axes_at(len(path.points)), states, limit - value)
        return value

    return judged


def _candidates(
    model: PushModel,
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
        out = np.where(rng.random((count, 1)) < model.schedule.fresh, out, near)
    return np.asarray(out)
