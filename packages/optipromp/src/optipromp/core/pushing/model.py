"""The interfaces of a push model and of its candidate paths, and models made of others."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.parameters import Calibration as Calibration
from optipromp.core.pushing.path import STEP, ToolPath, along, evenly, length


@dataclass(frozen=True)
class Round:
    """One round of a search.

    Attributes:
        candidates: number of tool paths that are sampled.
        states: number of states of the scene that each path is tried in.
    """

    candidates: int
    states: int


@dataclass(frozen=True)
class Schedule:
    """The rounds and numbers of a search.

    Attributes:
        rounds: of a run.
        runs: largest number of runs; the next run begins where no path is good.
        kept: number of best candidates, about which the next candidates are sampled.
        states: number of states in which the best candidate of a round is tried; a followed
            trajectory is tried in all states.
        fresh: share of the candidates that are sampled from :meth:`Candidates.spread`.
        lenient: factor on the harm that counts as good, after each round without a good path.
    """

    rounds: tuple[Round, ...]
    runs: int
    kept: int
    states: int
    fresh: float
    lenient: float


class Candidates(ABC):
    """The candidate paths of the tool in one scene, each given by k numbers.

    Attributes:
        schedule: of the search.
        entry: position along z_g at which paths begin [m]; -inf: anywhere.
    """

    schedule: Schedule
    entry: float = -math.inf

    @abstractmethod
    def path(self, x: FloatArray) -> ToolPath:
        """The path of a candidate (k,)."""

    @abstractmethod
    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Penalty that is added to a candidate's harm, for a detour or a lack of clearance."""

    @abstractmethod
    def first(self) -> FloatArray:
        """Candidates (m, k) that are tried before any sample; m may be 0."""

    @abstractmethod
    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (k,) of the first samples of a run."""


class Told(NamedTuple):
    """What is told of a push."""

    object: str = ""  # id of the object that is harmed most in the worst state
    cause: str = "nothing is harmed"  # the harm of that object, in words
    forces: Mapping[str, float] = {}  # largest on each pushed object in the perceived state [N]


def failing(probability: float, unseen: float) -> float:
    """Probability that a motion is not clean, of which a model tells a ``probability``, and which
    comes into a volume that is ``unseen`` [m³]: things in it are a Poisson process."""
    return probability - (1.0 - probability) * math.expm1(-PUSH.harm.unseen * unseen)


@dataclass(frozen=True, eq=False)
class Prediction:
    """The prediction for the push of a trajectory.

    Attributes:
        harm: mean over the states of the scene; see :class:`PushModel`.
        threshold: largest harm of a success.
        tell: gives ``object``, ``cause`` and ``forces`` (:class:`Told`) when one of them is first
            read: they cost more than the harm of a few states.
        probability: that the pick is not clean, see
            :class:`optipromp.core.pushing.parameters.Calibration`.
    """

    harm: float
    threshold: float
    tell: Callable[[], Told] = Told
    probability: float = math.nan

    told = cached_property(lambda self: self.tell())
    object = property(lambda self: self.told.object)
    cause = property(lambda self: self.told.cause)
    forces = property(lambda self: self.told.forces)

    def to_dict(self) -> dict[str, Any]:
        """All that is known, by name."""
        told: dict[str, Any] = self.told._asdict()
        head = {"harm": self.harm, "threshold": self.threshold}
        return head | told | {"probability": self.probability}

    def __eq__(self, other: Any) -> bool:
        return isinstance(other, Prediction) and self.to_dict() == other.to_dict()

    def __repr__(self) -> str:
        return f"Prediction({self.to_dict()})"

    def __reduce__(self) -> Any:
        return Prediction, (self.harm, self.threshold, partial(Told, *self.told), self.probability)

    @property
    def harmful(self) -> bool:
        """Whether the harm is above the threshold."""
        return self.harm > self.threshold

    def __str__(self) -> str:
        told = f"harm {self.harm:.2f} of at most {self.threshold:.2g}"
        if not math.isnan(self.probability):
            told += f"; not clean with probability {100.0 * self.probability:.0f} %"
        what = f"{self.object} {self.cause}".strip()
        return f"harm is predicted: {what} ({told})" if self.harmful else f"predicted {told}"

    def pushes(self, passage: Mapping[str, tuple[float, float] | None]) -> str:
        """Force on and passage of each pushed object, in words; empty for no pushed object.

        ``passage`` has the offsets of the tool along x_g and y_g from each passed object [m].
        """
        told = []
        for name, force in self.forces.items():
            way = passage.get(name)
            at = "" if way is None else " ({:+d}, {:+d}) mm".format(*(round(1e3 * x) for x in way))
            told.append(f"{name} {force:.1f} N{at}")
        return f"pushed, and passed at (x_g, y_g): {', '.join(told)}" if told else ""


@dataclass(frozen=True, eq=False)
class Moved:
    """The poses in which a motion of the tool leaves the objects that the model knows."""

    ids: tuple[str, ...]  # of N objects, the target first
    positions: FloatArray  # (N, 3) [m]
    turns: FloatArray  # (N,) of packs about -x_g [rad]


class PushModel(ABC):
    """A model of the push in one scene.

    The model predicts the *harm* of a tool path: 0 where nothing is pressed, 1 where a force
    reaches what a fruit or a pack bears. The harm is the mean over several states of the scene: the
    perceived state, and samples within the errors of detection.

    Attributes:
        good: harm below which the search ends.
        least: harm that no path avoids, part of every harm.
        threshold: largest harm of a success, for the share of promises that may be broken.
        calibration: of the harm; None where the harm was never compared with runs.
        states: number of states of the scene; the first is the perceived one.
        candidates: the paths that are searched.
    """

    good: float
    least: float = 0.0
    threshold: float
    calibration: Calibration | None = None
    states: int
    candidates: Candidates

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """Whether tool and last link, led through ``points`` (P, 3), surely touch no pushable.

        Pushables are at their positions before any push. False where the model cannot tell.
        """
        return False

    def drifting(self, by: Mapping[str, FloatArray]) -> "PushModel":
        """The model for motions of P points, while the roots of stems drift.

        ``by``: drifts (P, 3) at the points, by the ids of the fruits [m]; at least one. What does
        not hang does not drift.
        """
        return self

    @abstractmethod
    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """Mean harm of a motion of the tool over the first ``states`` states.

        ``points`` (P, 3) are tool points about :data:`STEP` apart, ``axes`` (P, 3) tool axes. A
        harm above ``limit`` may be returned as any number above ``limit``. A single state serves to
        compare candidates: a model may take longer steps for it.
        """

    @abstractmethod
    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """Id of the object that is harmed most in the worst state, and what happens to it."""

    def predict(
        self, points: FloatArray, axes: FloatArray, harm: float | None = None
    ) -> Prediction:
        """The harm over all states (``harm``, if known), its cause, and forces from 0.05 N on."""
        harm = self.harm(points, axes, self.states) if harm is None else harm
        chance = math.nan if self.calibration is None else self.calibration.probability(harm)
        tell = partial(self._told, points, axes, harm > self.threshold)
        return Prediction(harm, self.threshold, tell, chance)

    def _told(self, points: FloatArray, axes: FloatArray, harmful: bool) -> Told:
        forces = {k: force for k, force in self.forces(points, axes).items() if force >= 0.05}
        harmed = self.cause(points, axes) if harmful else Told()[:2]
        return Told(*harmed, forces)

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        """Largest force on each object but the target, by id, in the perceived state [N]."""
        return {}

    def pushing(self, points: FloatArray, axes: FloatArray) -> BoolArray:
        """Whether a motion through the points (P, 3) pushes anything at each point (P,).

        In the perceived state. A model that does not know says that every point pushes.
        """
        return np.ones(len(points), dtype=bool)

    @abstractmethod
    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """Final poses of the objects of the perceived state, after a motion through the points."""


class Guided(PushModel):
    """A model whose candidates, states and thresholds are those of another, ``lead``."""

    def __init__(self, lead: PushModel) -> None:
        self.lead, self.candidates, self.states = lead, lead.candidates, lead.states
        self.good, self.threshold, self.calibration = lead.good, lead.threshold, lead.calibration
        self.least = lead.least


class Combined(Guided):
    """Several models of one scene, whose harms are added, each in proportion to its threshold.

    Args:
        models: the first one provides the candidates.
    """

    def __init__(self, *models: PushModel) -> None:
        super().__init__(models[0])
        self.models, self.states = models, max(model.states for model in models)

    def drifting(self, by: Mapping[str, FloatArray]) -> PushModel:
        return Combined(*(model.drifting(by) for model in self.models))

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        return all(model.clear(points, axes) for model in self.models)

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
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
            self.models, key=lambda model: model.harm(points, axes, model.states) / model.threshold
        )
        return worst.cause(points, axes)

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        return {k: f for model in self.models for k, f in model.forces(points, axes).items()}

    def pushing(self, points: FloatArray, axes: FloatArray) -> BoolArray:
        pushed = [model.pushing(points, axes) for model in self.models]
        return np.asarray(np.logical_or.reduce(pushed))

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """See :class:`PushModel`; for an object of several models, the last model counts."""
        found = [model.moved(points, axes) for model in self.models]
        names = [name for one in found for name in one.ids]
        rows = list({name: row for row, name in enumerate(names)}.values())
        return Moved(
            tuple(names[row] for row in rows),
            np.concatenate([m.positions for m in found])[rows],
            np.concatenate([m.turns for m in found])[rows],
        )


class Continued(Guided):
    """A model of a push that has begun: every path is preceded by the motion so far.

    ``model``: of the scene before the push. ``points``, ``axes``: (P, 3) of the tool so far.
    """

    def __init__(self, model: PushModel, points: FloatArray, axes: FloatArray) -> None:
        super().__init__(model)
        self._points, self._axes = points, axes  # ``clear`` is never sure: pushables have moved

    def _whole(self, points: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = np.concatenate([self._points, points])
        count = max(2, math.ceil(length(points) / STEP) + 1)
        axes = along(points, np.concatenate([self._axes, axes]), count)
        return evenly(points, count), axes

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        return self.lead.harm(*self._whole(points, axes), states, limit)

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        return self.lead.cause(*self._whole(points, axes))

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        return self.lead.forces(*self._whole(points, axes))

    def pushing(self, points: FloatArray, axes: FloatArray) -> BoolArray:
        whole, turned = self._whole(points, axes)
        left = float(length(points)) - np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0))))
        rows = np.rint((len(whole) - 1) * (1.0 - left / max(float(length(whole)), 1e-9)))
        return self.lead.pushing(whole, turned)[np.maximum(rows, 0).astype(np.int64)]

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        return self.lead.moved(*self._whole(points, axes))
