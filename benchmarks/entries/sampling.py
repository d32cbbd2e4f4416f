"""Entries that sample primitives in the push model: MPPI, receding horizon."""

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmarks.entries.pathed import Pathed
from optipromp.core.arrays import FloatArray
from optipromp.core.planning import Plan, plan
from optipromp.core.planning.task import Task, spaced
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.scenes.scene import Scene
from optipromp_bench.primitive import COUNT, path_of

SMALL = 0.02  # harm that a squared weight counts as: of equal paths the straighter: a choice


@dataclass(frozen=True)
class ByMppi(Pathed):
    """Model predictive path integral: the mean of sampled weights, by exp(-cost / temperature)."""

    name: ClassVar[str] = "mppi"
    rounds: ClassVar[int] = 10
    samples: ClassVar[int] = 48
    deviation: ClassVar[float] = 0.5
    temperature: ClassVar[float] = 0.1
    states: ClassVar[int] = 4

    def path(self, task: Task, model: PushModel | None, seed: int) -> ToolPath:
        """See :class:`Pathed`."""
        mean, rng = np.zeros(2 * COUNT), np.random.default_rng(seed)
        best, least = mean, np.inf
        for k in range(self.rounds if model is not None else 0):
            assert model is not None
            wide = self.deviation * 0.85**k
            drawn = np.vstack([mean, mean + wide * rng.standard_normal((self.samples, 2 * COUNT))])
            cost = _costs(task, model, drawn, self.states)
            if cost.min() < least:
                best, least = drawn[int(cost.argmin())], float(cost.min())
            share = np.exp(-(cost - cost.min()) / self.temperature)
            mean = share @ drawn / share.sum()
        if model is not None and _costs(task, model, mean[None], self.states)[0] < least:
            best = mean
        return path_of(task, best.reshape(2, COUNT))


@dataclass(frozen=True)
class ByHorizon(Pathed):
    """Receding-horizon pushes: of two short pushes to come the best, of which one is made.

    In the spirit of Dogar and Srinivasa's planning of pushes in clutter: actions are short motions
    of the tool, their effect is simulated, and the plan is made anew after each.
    """

    name: ClassVar[str] = "receding"
    layers: ClassVar[int] = 6
    states: ClassVar[int] = 5
    aside: ClassVar[float] = 0.03
    """[m] of a layer's places off the last one."""

    def path(self, task: Task, model: PushModel | None, seed: int) -> ToolPath:
        """See :class:`Pathed`."""
        begin, end = task.camera, task.goal.position  # type: ignore[union-attr]
        across = task.scene.frame[:2]
        turns = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
        moves = self.aside * np.vstack(
            [np.zeros(2), np.column_stack([np.cos(turns), np.sin(turns)])]
        )
        taken, off = [begin], np.zeros(2)
        for layer in range(1, self.layers if model is not None else 0):
            assert model is not None
            line = [begin + (layer + k) / self.layers * (end - begin) for k in (0, 1)]
            best: tuple[float, FloatArray] | None = None
            for one, two in itertools.product(moves, moves):
                places = [off + one, off + one + two]
                ahead = [p + w @ across for p, w in zip(line, places, strict=True)]
                if layer + 1 >= self.layers:
                    ahead = ahead[:1]
                points = through(np.array([*taken, *ahead, end]), PUSH.hanging.speed).points
                axes = task.axes(np.linspace(0.0, 1.0, len(points)))
                wide = sum(float(w @ w) for w in places) / 0.06**2
                cost = model.harm(*spaced(points, axes), self.states) + SMALL * wide
                if best is None or cost < best[0]:
                    best = cost, off + one
            assert best is not None
            off = best[1]
            taken.append(line[0] + off @ across)
        return through(np.array([*taken, end]), PUSH.hanging.speed)


def _costs(task: Task, model: PushModel, drawn: FloatArray, states: int) -> FloatArray:
    small = SMALL * np.sum(drawn**2, axis=1)
    harm = []
    for weights in np.clip(drawn, -1.5, 1.5):
        points = path_of(task, weights.reshape(2, COUNT)).points
        axes = task.axes(np.linspace(0.0, 1.0, len(points)))
        harm.append(model.harm(*spaced(points, axes), states))
    return np.asarray(np.array(harm) + small)


class Refusing:
    """A planner of its own as an entry; it knows the push model, and refuses by it."""

    planner: ClassVar[Pathed]

    def plan(self, scene: Scene, seed: int) -> Plan:
        """See :class:`optipromp_bench.tracks.Planning`."""
        return plan(scene, planner=self.planner, seed=seed)


class Mppi(Refusing):
    """MPPI on the push model."""

    planner = ByMppi()


class Receding(Refusing):
    """Receding-horizon pushes in the push model."""

    planner = ByHorizon()
