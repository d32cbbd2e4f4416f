"""A pick without physics: the arm is where it is told, and fruits move by a function of time."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from tests.simulation.eyes import truth

from optipromp.core.arrays import FloatArray
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line, Stretch
from optipromp.core.planning.task import posed
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.stages import AFTER, LoopStage
from optipromp_sim.simulation.detector import DETECTORS, Detector, Eye

Moves = Callable[[float], FloatArray]
"""Of a time [s]: the displacement (3,) of all fruits [m]."""


def still(_: float) -> FloatArray:
    return np.zeros(3)


def in_order(stages: Iterable[LoopStage]) -> bool:
    """Whether stages may follow one another, beginning after a look."""
    before = LoopStage.OBSERVE
    for stage in stages:
        if stage not in AFTER[before]:
            return False
        before = stage
    return True


@dataclass
class Picked:
    """What a controller did: its stretches, and references of the arm at each cycle."""

    controller: Controller
    stretches: list[Stretch] = field(default_factory=list)
    references: list[State] = field(default_factory=list)
    time: float = 0.0

    @property
    def stages(self) -> list[LoopStage]:
        return [event.stage for event in self.controller.events]

    @property
    def reasons(self) -> list[str]:
        return [event.why for event in self.controller.events]

    def nearest(self, scene: Scene, moved: FloatArray | float = 0.0) -> float:
        """Least distance of the tool from the target, which has ``moved``, at any time [m]."""
        q = np.array([state.q for state in self.references])
        points, _ = self.controller.robot.tool_pose(q)
        return float(np.linalg.norm(points - scene.target.position - moved, axis=1).min())

    def away(self, scene: Scene) -> float:
        """Distance of the tool from the target at the end [m]."""
        point, _ = self.controller.robot.tool_pose(self.references[-1].q)
        return float(np.linalg.norm(point - scene.target.position))


def eye_of(scene: Scene, name: str = "zero-mean", seed: int = 0) -> Eye:
    return Eye(Detector(scene, posed(scene)[0], DETECTORS[name], seed))


def pick(
    controller: Controller, scene: Scene, eye: Eye, moves: Moves = still, longest: float = 40.0,
    filtered: Callable[[tuple[Look, ...]], Iterable[Look]] = tuple,
) -> Picked:  # fmt: skip
    """Let a controller pick in a true scene; ``filtered``: what becomes of delivered looks."""
    done, period, fruits = Picked(controller), controller.parameters.period, truth(scene)
    line = Line.of(standing(controller.robot, posed(scene)[1]))
    for k in range(round(longest / period)):
        done.time = now = period * k
        reference = line.at(now)
        done.references.append(reference)
        by = moves(now)
        stems = tuple(stem + by for stem in fruits.stem_ends)
        there = fruits._replace(positions=fruits.positions + by, stem_ends=stems)
        eye.see(now, reference.q, there)
        for look in filtered(eye.delivered(now)):
            controller.see(look)
        stretch = controller(now, reference, reference)
        if stretch is not None:
            line = line.take(stretch, now, anew=controller.lost)
            done.stretches.append(stretch)
        if controller.ended and line.ended(now):
            break
    return done
