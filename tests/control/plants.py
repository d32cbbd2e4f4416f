"""Plants that move by sums of sines, and a detector that looks at them: not the tracker's model."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject, Stem
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control.tracker import Tracked

UP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.018


def camera(below: float = 0.3) -> Pose:
    """A camera under the plant that looks up and is turned about its axis."""
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    return Pose(np.array([0.5, 0.0, 0.5 - below]), turn)


def hanging(count: int) -> FloatArray:
    """Rest positions (count, 3) of fruits beside each other, none behind another."""
    angle = 2.4 * np.arange(count)
    ring = 0.045 * np.sqrt(np.arange(count) + 0.2)
    return np.stack(
        [0.5 + ring * np.cos(angle), ring * np.sin(angle), 0.5 + 0.01 * np.sin(7.0 * angle)], 1
    )


@dataclass(frozen=True, eq=False)
class Swaying:
    """Fruits at ``rest`` (F, 3) that all sway by a sum of sines.

    ``frequencies``, ``phases`` (S,); ``amplitudes`` (S, 3) [m]; each fruit also swings by
    ``swing`` (F, 2) [m] at its own frequency (F,).
    """

    rest: FloatArray
    frequencies: FloatArray
    phases: FloatArray
    amplitudes: FloatArray
    swing: FloatArray
    own: FloatArray

    def at(self, time: float) -> FloatArray:
        """(F, 3) [m]."""
        common = np.sin(2 * np.pi * self.frequencies * time + self.phases) @ self.amplitudes
        swing = np.zeros_like(self.rest)
        swing[:, :2] = (
            self.swing * np.sin(2 * np.pi * self.own * time + np.arange(len(swing)))[:, None]
        )
        return self.rest + common + swing

    def hung_at(self, time: float, omega: float, zeta: float) -> FloatArray:
        """(F, 3) [m] of fruits on pendulums of angular frequency ``omega`` [rad/s], which the sway
        of their roots drives: the steady state, without swings of their own."""
        rates = 2 * np.pi * self.frequencies
        response = rates**2 / (omega**2 - rates**2 + 2j * zeta * omega * rates)
        waves = (1.0 + response) * np.exp(1j * (rates * time + self.phases))
        return self.rest + waves.imag @ self.amplitudes


def swaying(
    rng: np.random.Generator, count: int, amplitude: float, frequencies: FloatArray
) -> Swaying:
    """Sines of random directions whose amplitudes sum to ``amplitude`` [m]; swings of 2 mm."""
    share = rng.uniform(0.3, 1.0, len(frequencies))
    share *= amplitude / share.sum()
    turn = rng.uniform(0.0, 2 * np.pi, len(frequencies))
    ways = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], 1)
    swing = 0.002 * rng.standard_normal((count, 2)) if amplitude else np.zeros((count, 2))
    return Swaying(
        hanging(count),
        frequencies,
        rng.uniform(0.0, 2 * np.pi, len(frequencies)),
        share[:, None] * ways,
        swing,
        rng.uniform(1.0, 2.2, count),
    )


@dataclass(frozen=True)
class Eye:
    """A detector: errors [m], probabilities to miss, to find what is not, and to swap two ids."""

    noise: float = 0.005
    missed: float = 0.0
    spurious: float = 0.0
    swapped: float = 0.0
    stems: bool = True


FIELD = Eye(missed=0.05, spurious=0.02, swapped=0.2)


def detection(
    name: str, place: FloatArray, pose: Pose, role: str = "pushable", **more: object
) -> SceneObject:
    """An object at ``place`` (3,) in the base frame, as a camera at ``pose`` sees it."""
    item = SceneObject(name, role, Sphere(RADIUS), place, **more)
    return item.transformed(pose.inverse())


def look(
    time: float, places: FloatArray, rng: np.random.Generator, eye: Eye, pose: Pose | None = None
) -> Look:
    """What a detector sees of fruits at ``places`` (F, 3); the first is the target."""
    pose = camera() if pose is None else pose
    names = [f"seen-{k}" for k in range(len(places))]
    if rng.random() < eye.swapped:
        one, other = rng.choice(len(places), 2, replace=False)
        names[one], names[other] = names[other], names[one]
    found = []
    for k, place in enumerate(places):
        error, chance = eye.noise * rng.standard_normal(3), rng.random()
        if chance < eye.missed:
            continue
        at = place + error
        stem = Stem.along(at, UP, 0.15) if eye.stems else None
        role = "target" if k == 0 else "pushable"
        found.append(detection(names[k], at, pose, role, stem=stem, sigma=eye.noise))
    if rng.random() < eye.spurious * len(places):
        at = np.array([0.5, 0.0, 0.5]) + rng.uniform(-0.15, 0.15, 3)
        found.append(detection("ghost", at, pose, sigma=eye.noise))
    return Look(time, pose, tuple(found))


def looks(
    plant: Swaying, rng: np.random.Generator, eye: Eye, seconds: float, rate: float = 20.0
) -> Iterator[Look]:
    """Looks at ``rate`` [Hz] from time 0."""
    for k in range(round(seconds * rate)):
        yield look(k / rate, plant.at(k / rate), rng, eye)


def empty(*static: SceneObject) -> Scene:
    """A scene of which the tracker takes the vertical and the static objects."""
    target = SceneObject("target", "target", Sphere(RADIUS), np.array([0.5, 0.0, 0.5]))
    return Scene("plant", "panda", (target, *static))


def still(count: int) -> Swaying:
    return swaying(np.random.default_rng(0), count, 0.0, np.array([1.0]))


def nearest(tracked: Tracked, truth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of each true fruit: index (F,) of the nearest confirmed track, and its distance (F,)."""
    sure = np.flatnonzero(tracked.confirmed)
    away = np.linalg.norm(truth[:, None] - tracked.positions[sure], axis=2)
    return sure[away.argmin(axis=1)], away.min(axis=1)
