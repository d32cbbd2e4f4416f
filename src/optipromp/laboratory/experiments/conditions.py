"""Conditions of a pick: what moves, and what is seen wrongly (``optipromp study --conditions``).

==============  ===================================================================================
``none``        the scene is as first seen, every look is exact (and 60 ms late)
``zero-mean``   first seen and looked at with zero-mean errors of 5 mm and 5°
``detector``    the same with a bias of 10 mm, misses, hidden stems, false and swapped detections
``missed``      one of the three pushables nearest to the target was not seen at first
``lower``       all fruits hang 10 mm lower than first seen
``aside``       all fruits hang 15 mm aside, and jump by 10 mm at 3 s
``sway``        the plants sway within ± 20 mm at 0.5–1.6 Hz
``calibration`` camera and arm are each 5 mm and 1° off their believed places
``limp``        stems are three times softer than told
``all``         detector, missed, lower, aside, sway, calibration of the camera, limp, commands late
==============  ===================================================================================

Looks have zero-mean errors where the table does not say otherwise. Errors and rates are sourced in
:data:`optipromp.laboratory.simulation.detector_parameters.DETECTORS` and
:data:`optipromp.laboratory.generate.NOISES`, displacements in
:class:`optipromp.laboratory.simulation.DisturbanceParameters`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.experiments.variations import stiffened
from optipromp.laboratory.generate import NOISES, noisy
from optipromp.laboratory.simulation.detector_parameters import DETECTORS, DetectorParameters
from optipromp.laboratory.simulation.parameters import SimulationParameters

LOWER: dict[str, Any] = {"lower": 0.010}  # [m]: a choice, as the error of the noise "low"
ASIDE: dict[str, Any] = {"shift": 0.015, "jump": 0.010, "jump_at": 3.0}  # [m] [m] [s]: choices
SWAY: dict[str, Any] = {"sway": 0.02, "sway_frequency": 0.5, "sway_fastest": 1.6}
"""[m] [Hz] [Hz]: plants in wind sway by 10-30 mm; from a gutter's to a fruit's own frequency."""
ARM_OFF: dict[str, Any] = {"arm_offset": 0.005, "arm_turn": 1.0}  # [m] [deg]: calibration by hand
CAMERA_OFF: dict[str, Any] = {"camera_offset": 0.005, "camera_turn": 1.0}  # [m] [deg]: likewise
LATE: dict[str, Any] = {"command_delay": 0.01}  # [s]: cells of robots have 0-20 ms
LIMP = 1.0 / 3.0  # of the stiffness of stems: the range in which it is a guess
NEAREST = 3  # pushables of which one is missed: a choice
MISSED: dict[str, Any] = {"missed": 0.05, "hidden": 0.5}  # as the detector's


class Setting(NamedTuple):
    """What a run is made of: the truth, what is known of it at first, and who looks."""

    scene: Scene
    """The true one; the disturbances of ``parameters`` come on top."""
    seen: Scene
    """As first seen."""
    detector: DetectorParameters
    parameters: SimulationParameters


@dataclass(frozen=True)
class Condition:
    """A condition: its words, and the setting that it makes of a true scene and a seed."""

    words: str
    make: Callable[[Scene, int], Setting]

    def __call__(self, scene: Scene, seed: int) -> Setting:
        """The setting for a true scene; the same scene and seed give the same setting."""
        return self.make(scene, seed)


def drop_one(scene: Scene, seed: int) -> Scene:
    """The scene without one of the pushables that hang nearest to the target.

    A fruit from whose stem another hangs is not dropped.
    """
    target = scene.target
    assert target is not None
    rng = np.random.default_rng([seed, 11])
    parents = {item.stem.parent for item in scene.objects if item.stem is not None}
    near = sorted(
        (item for item in scene.pushables if item.id not in parents),
        key=lambda item: float(np.linalg.norm(item.position - target.position)),
    )
    if not near:
        return scene
    dropped = near[int(rng.integers(min(NEAREST, len(near))))].id
    return replace(scene, objects=tuple(item for item in scene.objects if item.id != dropped))


def _disturbed(**values: Any) -> SimulationParameters:
    p = SimulationParameters()
    return replace(p, disturbance=replace(p.disturbance, **values))


def _zero_mean(scene: Scene, seed: int) -> Scene:
    return noisy(scene, seed, NOISES["zero-mean"])


def _all(scene: Scene, seed: int) -> Setting:
    seen = noisy(scene, seed, NOISES["detector"])
    return Setting(
        scene,
        drop_one(seen, seed),
        replace(DETECTORS["detector"], **CAMERA_OFF),
        stiffened(_disturbed(**ASIDE, **SWAY, **LOWER, **LATE), LIMP),
    )


_WHITE = DETECTORS["zero-mean"]
_STILL = SimulationParameters()

CONDITIONS: dict[str, Condition] = {
    "none": Condition("as first seen", lambda s, k: Setting(s, s, DETECTORS["perfect"], _STILL)),
    "zero-mean": Condition(
        "errors of 5 mm, 5°", lambda s, k: Setting(s, _zero_mean(s, k), _WHITE, _STILL)
    ),
    "detector": Condition(
        "bias, misses, swaps",
        lambda s, k: Setting(s, noisy(s, k, NOISES["detector"]), DETECTORS["detector"], _STILL),
    ),
    "missed": Condition(
        "a neighbour not seen at first",
        lambda s, k: Setting(s, drop_one(s, k), replace(_WHITE, **MISSED), _STILL),
    ),
    "lower": Condition("10 mm lower", lambda s, k: Setting(s, s, _WHITE, _disturbed(**LOWER))),
    "aside": Condition(
        "15 mm aside, jump of 10 mm", lambda s, k: Setting(s, s, _WHITE, _disturbed(**ASIDE))
    ),
    "sway": Condition("sway ± 20 mm", lambda s, k: Setting(s, s, _WHITE, _disturbed(**SWAY))),
    "calibration": Condition(
        "camera and arm 5 mm, 1° off",
        lambda s, k: Setting(
            s, _zero_mean(s, k), replace(_WHITE, **CAMERA_OFF), _disturbed(**ARM_OFF)
        ),
    ),
    "limp": Condition(
        "stems 3 times softer", lambda s, k: Setting(s, s, _WHITE, stiffened(_STILL, LIMP))
    ),
    "all": Condition("all at once", _all),
}
"""By name; see the module's table."""
