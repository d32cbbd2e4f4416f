r"""How stiff the stems are: learnt from how fruits give way, and from the wrench at the tool.

The stems of a plant are alike, so one factor :math:`\lambda` multiplies the stiffness that the push
model assumes for each. The belief is a probability of each of some factors. The tool feels

.. math:: F = \sum_i d_i / c_i(\lambda)

across the vertical, with the displacement :math:`d_i` of each pushed fruit, as it is seen, and the
compliance :math:`c_i` of its stem at the fruit. Places alone tell nothing: a fruit that the tool
pushes stands where the tool holds it, whatever its stem.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.bending import stems
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control.parameters import LoopParameters
from optipromp_loop.control.tracker import Tracked

FACTORS = frozen(np.geomspace(0.2, 5.0, 9))
"""Factors that are told apart: the range of moduli that is reported, 10 to 250 MPa."""


@dataclass(frozen=True, eq=False)
class Stiffness:
    """A belief about the factor of the stems' stiffness."""

    weights: FloatArray  # (K,) probabilities of :data:`FACTORS`
    observations: int = 0  # number of observations so far

    @classmethod
    def prior(cls, spread: float = PUSH.beam.stiffness_spread) -> Stiffness:
        """Log-normal about 1; ``spread``: its standard deviation as a factor."""
        weights = np.exp(-0.5 * (np.log(FACTORS) / math.log(spread)) ** 2)
        return cls(frozen(weights / weights.sum()))

    @cached_property
    def factor(self) -> float:
        """The geometric mean of the factor."""
        return float(np.exp(self.weights @ np.log(FACTORS)))

    @cached_property
    def spread(self) -> float:
        """The standard deviation of the factor, as a factor."""
        off = np.log(FACTORS / self.factor)
        return float(np.exp(np.sqrt(self.weights @ off**2)))

    def after(self, square: FloatArray) -> Stiffness:
        """The belief after an observation with normalised squared errors ``square`` (K,)."""
        weights = self.weights * np.exp(-0.5 * (square - square.min()))
        return Stiffness(frozen(weights / weights.sum()), self.observations + 1)

    def told(self, item: SceneObject, up: FloatArray) -> SceneObject:
        """A fruit whose stem is as stiff as is believed."""
        if item.stem is None or self.observations == 0:
            return item
        stiffness = self.factor * assumed(item, up)
        known = {"stem_stiffness": stiffness, "stem_stiffness_spread": self.spread}
        return replace(item, physical={**item.physical, **known})


def assumed(item: SceneObject, up: FloatArray) -> float:
    """EI that the push model assumes for the stem of a fruit [N m²]."""
    assert item.stem is not None
    beam, line = PUSH.beam, item.stem.root - item.position
    length = float(np.linalg.norm(line))
    lean = math.sqrt(max(1.0 - float(line @ up / length) ** 2, 0.0))
    mass = item.physical.get("mass", beam.fruit_density * item.shape.volume)
    implied = 0.5 * mass * beam.gravity * lean * length**2 / beam.grown_turn
    return max(beam.youngs_modulus * math.pi / 64.0 * beam.diameter**4, implied)


def told_factor(item: SceneObject, up: FloatArray) -> float:
    """The factor that :meth:`Stiffness.told` told of a fruit's stem; 1: none."""
    if "stem_stiffness_spread" not in item.physical:
        return 1.0
    return float(item.physical["stem_stiffness"]) / assumed(item, up)


def by_wrench(
    pushed: Sequence[tuple[SceneObject, FloatArray]],
    force: FloatArray,
    up: FloatArray,
    parameters: LoopParameters,
) -> FloatArray:
    """Squared errors (K,) of the force on the tool.

    ``pushed``: fruits and their displacements (3,) [m]. ``force``: (3,) of the world on the tool,
    without gravity [N]. ``up``: (3,) opposite to gravity. ``parameters``: with the deviation of a
    force.
    """
    items = [item for item, _ in pushed]
    base = np.array([told_factor(item, up) for item in items])
    away = np.array([by for _, by in pushed])
    away = away - (away @ up)[:, None] * up
    felt = force - (force @ up) * up
    out = np.zeros(len(FACTORS))
    for k, factor in enumerate(FACTORS):
        compliance = stems(items, up, factor / base).compliance[:, -1, -1]
        back = -(away / compliance[:, None]).sum(axis=0)  # of the fruits on the tool
        out[k] = np.square(back - felt).sum() / parameters.felt**2
    return out


class Felt:
    """What the force at the tool and the fruits that gave way tell of the stems.

    Attributes:
        force: (3,) of the world on the tool in this cycle, without gravity [N]; None: unknown.
        stiffness: of the stems, as far as it is known.
    """

    def __init__(self, parameters: LoopParameters) -> None:
        self.force: FloatArray | None = None
        self.stiffness, self._p = Stiffness.prior(), parameters
        self._at = np.full(3, np.inf)  # tool point of the last observation [m]

    @property
    def known(self) -> Stiffness | None:
        """What plans are told; None: too little is known."""
        return self.stiffness if self.stiffness.spread < self._p.told else None

    def learn(
        self, scene: Scene, look: Look, tracked: Tracked, pushed: Mapping[str, FloatArray],
        point: FloatArray,
    ) -> None:  # fmt: skip
        """Learn from a look at pushed fruits, with the tool at a ``point`` (3,) [m].

        ``scene``: that the push was planned in. ``tracked``: at the time of the look. ``pushed``:
        predicted displacements (3,), by id [m].
        """
        if self.force is None or float(np.linalg.norm(point - self._at)) < self._p.learnt:
            return
        if given := gave_way(scene, look, tracked, pushed, self._p):
            self._at = point
            square = by_wrench(given, self.force, scene.up, self._p)
            self.stiffness = self.stiffness.after(square)


def gave_way(
    scene: Scene, look: Look, tracked: Tracked, pushed: Mapping[str, FloatArray],
    parameters: LoopParameters,
) -> list[tuple[SceneObject, FloatArray]]:  # fmt: skip
    """The pushed fruits of a plan's scene that a look shows, and their displacements (3,) [m].

    ``tracked``: at the time of the look. ``pushed``: predicted displacements (3,), by id [m].
    """
    fruits = {item.id: item for item in scene.objects if item.stem is not None}
    found = np.array([look.camera @ item.position for item in look.detections]).reshape(-1, 3)
    out = []
    for row, name in enumerate(tracked.ids):
        if name not in pushed or name not in fruits or not len(found):
            continue
        away = np.linalg.norm(found - tracked.positions[row], axis=1)
        by = found[int(away.argmin())] - (tracked.positions[row] - pushed[name])
        if away.min() <= parameters.reach and np.linalg.norm(by) >= parameters.yielded:
            out.append((fruits[name], by))
    return out
