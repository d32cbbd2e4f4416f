"""Conditions of a pick: what moves, and what is seen wrongly (``optipromp study --conditions``).

==============  ===================================================================================
``none``        the scene is as first seen, every look is exact (and 60 ms late)
``zero-mean``   first seen and looked at with zero-mean errors of 5 mm and 5°
``detector``    the same with a bias of 10 mm, misses, hidden stems, false and swapped detections
``missed``      one of the three pushables nearest to the target was not seen at first
``lower``       all fruits hang 10 mm lower than first seen
``aside``       all fruits hang 15 mm aside, and jump by 10 mm at 3 s
``sway``        the roots sway within ± 10 mm at 0.5–1.6 Hz, since 4 s before the first look
``calibration`` the camera is 5 mm and 1° (root mean square) off its believed place in the hand
``limp``        stems are three times softer than told
``all``         detector, missed, lower, aside, sway, calibration and limp at once; commands 10 ms
                late
==============  ===================================================================================

Stems of 10–25 cm have their resonance at 1–2 Hz: roots that sway within ± 10 mm make fruits swing
by about ± 20 mm. Plants that sway are first seen at once, where the fruits are at that moment. The
arm stands still until then (``engine.settle``).

A miscalibrated camera has seen the fruits at first, too. Looks have zero-mean errors where the
table does not say otherwise. Errors and rates are sourced in
:data:`optipromp.laboratory.simulation.detector_parameters.DETECTORS` and
:data:`optipromp.laboratory.generate.NOISES`, displacements beside the constants below and in
:class:`optipromp.laboratory.simulation.DisturbanceParameters`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from optipromp.control.driver import shifted
from optipromp.core.arrays import frame_along
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.scenes.trusses import rooted
from optipromp.laboratory.experiments.variations import stiffened
from optipromp.laboratory.generate import NOISES, noisy
from optipromp.laboratory.generate.noise import LOOK
from optipromp.laboratory.simulation.detector import Detector
from optipromp.laboratory.simulation.detector_parameters import DETECTORS, DetectorParameters
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.simulation import Simulation

LOWER: dict[str, Any] = {"lower": 0.010}  # [m]: a choice, as the error of the noise "low"
ASIDE: dict[str, Any] = {"shift": 0.015, "jump": 0.010, "jump_at": 3.0}  # [m] [m] [s]: choices
SWAY: dict[str, Any] = {"sway": 0.010, "sway_frequency": 0.5, "sway_fastest": 1.6}
"""[m] [Hz] [Hz] of roots: fruits in wind sway by 10-30 mm, from a gutter's to their own frequency.
"""
SETTLE = 4.0  # [s] of sway before the first look, in which swings build up: a choice
CAMERA_OFF: dict[str, Any] = {"camera_offset": 0.005 / 3**0.5, "camera_turn": 1.0 / 3**0.5}
"""[m] [deg] about each of three axes: 5 mm and 1° in all, of a calibration by hand."""
LATE: dict[str, Any] = {"command_delay": 0.01}  # [s]: cells of robots have 0-20 ms
JUMP_LATER = ASIDE["jump_at"] + SETTLE  # [s] of simulation: 3 s after the first look
LIMP = 1.0 / 3.0  # of the stiffness of stems: the range in which it is a guess
NEAREST = 3  # pushables of which one is missed: a choice
MISSED: dict[str, Any] = {"missed": 0.05, "hidden": 0.5}  # as the detector's


class Situation(NamedTuple):
    """What a run is made of: the truth, what is known of it at first, and who looks."""

    scene: Scene
    """The true one; the disturbances of ``parameters`` come on top."""
    seen: Scene
    """As first seen."""
    detector: DetectorParameters
    parameters: SimulationParameters
    camera: Callable[[Scene, Robot, DetectorParameters, int], Detector] = Detector
    """Makes the camera of a closed loop."""
    figures: Mapping[str, Any] = {}
    """What rows tell of the first pictures."""
    further: "Callable[[], Situation] | None" = None
    """After one picture more, where there is no plan; None: there is none."""


@dataclass(frozen=True)
class Condition:
    """A condition: its words, and the setting that it makes of a true scene and a seed."""

    words: str
    make: Callable[[Scene, int], Situation]

    def __call__(self, scene: Scene, seed: int) -> Situation:
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
    objects = tuple(item for item in scene.objects if item.id != dropped)
    return replace(scene, objects=objects, may_touch=pairs_among(scene.may_touch, [dropped]))


def miscalibrated(seen: Scene, scene: Scene, detector: DetectorParameters, seed: int) -> Scene:
    """The scene ``seen`` as a camera sees it whose calibration is off.

    The camera looks along the approach at the target of the true ``scene``, from the distance of
    the first look. ``detector`` and ``seed`` give the error, which later looks have, too.
    """
    target = scene.target
    assert target is not None
    error = Detector(scene, posed(scene)[0], detector, seed).miscalibration
    approach = scene.frame[2]
    camera = Pose(target.position - LOOK * approach, frame_along(approach))
    moved = camera @ error @ camera.inverse()
    return replace(
        seen,
        objects=tuple(
            item if item.role == "static" else item.transformed(moved) for item in seen.objects
        ),
    )


def seen_at_once(seen: Scene, scene: Scene, seed: int, parameters: SimulationParameters) -> Scene:
    """The scene ``seen`` with its fruits where they are at the end of the settling.

    Fruits on stems, and their stems, are shifted by as much as those of the true ``scene`` have
    moved since the beginning of a simulation with ``seed`` and ``parameters``, whose arm stands.
    """
    simulation = Simulation(scene, seed, parameters)
    for _ in range(round(parameters.engine.settle / simulation.tick)):
        simulation.step(simulation.reference)
    now = simulation.fruits()
    true = {item.id: item.position for item in scene.objects}
    moved = {name: now.positions[row] - true[name] for row, name in enumerate(now.ids)}
    return replace(
        seen,
        objects=rooted(
            shifted(item, moved[item.id]) if item.stem is not None and item.id in moved else item
            for item in seen.objects
        ),
    )


def _disturbed(**values: Any) -> SimulationParameters:
    """The default physics with disturbances; a sway has settled before the first look."""
    p = SimulationParameters()
    settle = SETTLE if values.get("sway") else p.engine.settle
    return replace(
        p,
        disturbance=replace(p.disturbance, **values),
        engine=replace(p.engine, settle=settle),
    )


def _zero_mean(scene: Scene, seed: int) -> Scene:
    return noisy(scene, seed, NOISES["zero-mean"])


def _calibration(scene: Scene, seed: int) -> Situation:
    detector = replace(_WHITE, **CAMERA_OFF)
    seen = miscalibrated(_zero_mean(scene, seed), scene, detector, seed)
    return Situation(scene, seen, detector, _STILL)


def _sway(scene: Scene, seed: int) -> Situation:
    parameters = _disturbed(**SWAY)
    return Situation(scene, seen_at_once(scene, scene, seed, parameters), _WHITE, parameters)


def _all(scene: Scene, seed: int) -> Situation:
    detector = replace(DETECTORS["detector"], **CAMERA_OFF)
    values = {**ASIDE, **SWAY, **LOWER, **LATE, "jump_at": JUMP_LATER}
    parameters = stiffened(_disturbed(**values), LIMP)
    noticed = noisy(scene, seed, NOISES["detector"])
    seen = seen_at_once(noticed, scene, seed, _disturbed(**SWAY))  # before the fruits are shifted
    seen = drop_one(miscalibrated(seen, scene, detector, seed), seed)
    return Situation(scene, seen, detector, parameters)


_WHITE = DETECTORS["zero-mean"]
_STILL = SimulationParameters()

CONDITIONS: dict[str, Condition] = {
    "none": Condition("as first seen", lambda s, k: Situation(s, s, DETECTORS["perfect"], _STILL)),
    "zero-mean": Condition(
        "errors of 5 mm, 5°", lambda s, k: Situation(s, _zero_mean(s, k), _WHITE, _STILL)
    ),
    "detector": Condition(
        "bias, misses, swaps",
        lambda s, k: Situation(s, noisy(s, k, NOISES["detector"]), DETECTORS["detector"], _STILL),
    ),
    "missed": Condition(
        "a neighbour not seen at first",
        lambda s, k: Situation(s, drop_one(s, k), replace(_WHITE, **MISSED), _STILL),
    ),
    "lower": Condition("10 mm lower", lambda s, k: Situation(s, s, _WHITE, _disturbed(**LOWER))),
    "aside": Condition(
        "15 mm aside, jump of 10 mm", lambda s, k: Situation(s, s, _WHITE, _disturbed(**ASIDE))
    ),
    "sway": Condition("roots sway ± 10 mm", _sway),
    "calibration": Condition("camera 5 mm, 1° off", _calibration),
    "limp": Condition(
        "stems 3 times softer", lambda s, k: Situation(s, s, _WHITE, stiffened(_STILL, LIMP))
    ),
    "all": Condition("all at once", _all),
}
"""By name; see the module's table."""
