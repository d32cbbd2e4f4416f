"""Physical variations under which the same plans are executed (``optipromp study --vary``).

A variation changes the simulated world or its parameters; the planner is told of neither. The
ranges are those in which the guesses of the push models may be wrong; their sources stand in
:mod:`optipromp.laboratory.simulation.parameters`.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.scenes.trusses import rooted
from optipromp.laboratory.simulation.parameters import DisturbanceParameters, SimulationParameters

Variation = Callable[[Scene, np.random.Generator], tuple[Scene, SimulationParameters]]

LOWER = 0.010  # [m] from the detected height of every fruit down to the true one: a choice
OFF = 0.005  # [m] lateral error of the tool's position: a choice
ASIDE, LEAP, LEAP_AT = 0.015, 0.010, 2.0  # [m] [m] [s] of fruits moved after the look: choices
SWAY = 0.020  # [m] of plants in a light wind: a choice
BASE_OFF, BASE_TURN = 0.005, 1.0  # [m] [deg] of a calibration by hand: choices
LATE = 0.020  # [s] of commands over a busy network: a choice


def stiffened(p: SimulationParameters, factor: float) -> SimulationParameters:
    """The stiffness of every stem times ``factor``, also where it follows from the stem's lean."""
    stem = replace(
        p.stem, youngs_modulus=factor * p.stem.youngs_modulus, grown_turn=p.stem.grown_turn / factor
    )
    return replace(p, stem=stem)


def _friction(p: SimulationParameters, value: float) -> SimulationParameters:
    return replace(
        p,
        fruit=replace(p.fruit, friction=value),
        stem=replace(p.stem, friction=value),
        robot=replace(p.robot, tool_friction=value),
    )


def _density(p: SimulationParameters, factor: float) -> SimulationParameters:
    return replace(p, fruit=replace(p.fruit, density=factor * p.fruit.density))


def _damping(p: SimulationParameters, factor: float) -> SimulationParameters:
    stem = replace(
        p.stem,
        damping_time=factor * p.stem.damping_time,
        swing_damping=factor * p.stem.swing_damping,
    )
    return replace(p, stem=stem)


def _fruits(scene: Scene, change: Callable[[SceneObject], SceneObject]) -> Scene:
    objects = (change(item) if item.stem is not None else item for item in scene.objects)
    return replace(scene, objects=rooted(objects))


def _wider(scene: Scene, factor: float) -> Scene:
    def change(item: SceneObject) -> SceneObject:
        if not isinstance(item.shape, Sphere):
            return item
        return replace(item, shape=Sphere(factor * item.shape.radius))

    return _fruits(scene, change)


def _moved(scene: Scene, by: np.ndarray, roots: bool) -> Scene:
    """The fruits shifted ``by`` (3,) [m]; with ``roots``, the roots of their stems too."""

    def change(item: SceneObject) -> SceneObject:
        assert item.stem is not None
        points = np.array(item.stem.points)
        points[slice(None) if roots else slice(1)] += by
        stem = replace(item.stem, points=points)
        return replace(item, position=item.position + by, stem=stem)

    return _fruits(scene, change)


def _beside(scene: Scene, rng: np.random.Generator) -> Scene:
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    aside = np.cos(turn) * scene.frame[0] + np.sin(turn) * scene.frame[1]
    return _moved(scene, OFF * aside, roots=True)


def _drawn(scene: Scene, rng: np.random.Generator) -> tuple[Scene, SimulationParameters]:
    """All parameters at once, each sampled from the range of its rows in the table."""
    p = stiffened(SimulationParameters(), float(3.0 ** rng.uniform(-1.0, 1.0)))
    p = _friction(p, float(rng.uniform(0.2, 0.8)))
    p = _density(p, float(rng.uniform(0.5, 1.5)))
    p = _damping(p, float(np.exp(rng.uniform(np.log(0.2), np.log(4.0)))))
    return _wider(scene, float(rng.uniform(0.9, 1.1))), p


def _physics(change: Callable[[SimulationParameters], SimulationParameters]) -> Variation:
    return lambda scene, rng: (scene, change(SimulationParameters()))


def _disturbed(disturbance: DisturbanceParameters) -> Variation:
    return _physics(lambda p: replace(p, disturbance=disturbance))


def _world(change: Callable[[Scene, np.random.Generator], Scene]) -> Variation:
    return lambda scene, rng: (change(scene, rng), SimulationParameters())


VARIATIONS: dict[str, Variation] = {
    "as assumed": _physics(lambda p: p),
    "stems 3 times softer": _physics(lambda p: stiffened(p, 1.0 / 3.0)),
    "stems 3 times stiffer": _physics(lambda p: stiffened(p, 3.0)),
    "friction 0.2": _physics(lambda p: _friction(p, 0.2)),
    "friction 0.8": _physics(lambda p: _friction(p, 0.8)),
    "fruits half as heavy": _physics(lambda p: _density(p, 0.5)),
    "fruits 1.5 times as heavy": _physics(lambda p: _density(p, 1.5)),
    "fruits 10 % smaller": _world(lambda scene, rng: _wider(scene, 0.9)),
    "fruits 10 % larger": _world(lambda scene, rng: _wider(scene, 1.1)),
    "damping × 0.2": _physics(lambda p: _damping(p, 0.2)),
    "damping × 4": _physics(lambda p: _damping(p, 4.0)),
    "tool 5 mm off": _world(_beside),
    "fruits 10 mm lower": _world(
        lambda scene, rng: _moved(scene, -LOWER * np.asarray(scene.up), roots=False)
    ),
    "fruits turn freely": _physics(lambda p: replace(p, stem=replace(p.stem, calyx="free"))),
    "cluster 15 mm aside": _disturbed(DisturbanceParameters(shift=ASIDE)),
    "jump 10 mm in motion": _disturbed(DisturbanceParameters(jump=LEAP, jump_at=LEAP_AT)),
    "sway 20 mm": _disturbed(DisturbanceParameters(sway=SWAY)),
    "arm 5 mm, 1 degree off": _disturbed(
        DisturbanceParameters(arm_offset=BASE_OFF, arm_turn=BASE_TURN)
    ),
    "commands 20 ms late": _disturbed(DisturbanceParameters(command_delay=LATE)),
    "all drawn at random": _drawn,
}
"""By name. The first is the simulation's default, each next changes one thing, the last many."""
