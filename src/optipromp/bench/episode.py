"""One pick, step by step: what a policy sees, what it does, and what became of it."""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from optipromp.bench.drive import driven
from optipromp.control.look import Look
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import State
from optipromp.laboratory.experiments.conditions import Situation
from optipromp.laboratory.simulation import Detector, Eye, Outcome, Simulation
from optipromp.laboratory.simulation.contacts import HarmSoFar
from optipromp.laboratory.simulation.detector import Truth

if TYPE_CHECKING:
    from optipromp.bench.flight import Word
    from optipromp.bench.flown import FlightWorld

RATE = 50.0  # [Hz] at which a policy is asked: a choice
HELD = 0.3  # [s] for which the tool must hold a fruit before a pick ends: a choice
LONGEST = 20.0  # [s] of a pick, after which it ends: a choice; plans take 4 to 12 s


@dataclass(frozen=True, eq=False)
class Observation:
    """What a policy knows at one moment.

    Attributes:
        time: since the beginning [s].
        q, velocity: (n,) of the joints, as measured [rad or m, per s].
        tool_point, tool_axis: (3,) in the robot's base frame [m].
        fruits: targets, pushables and objects to avoid as last seen, in the base frame.
        age: time since they were seen [s].
        force: (3,) of the world on the tool [N].
        look: the last one that was delivered, with its camera; its time is since the beginning.
    """

    time: float
    q: FloatArray
    velocity: FloatArray
    tool_point: FloatArray
    tool_axis: FloatArray
    fruits: tuple[SceneObject, ...]
    age: float
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    look: Look | None = None


class Episode:
    """One pick in the simulation, moved by joint velocities.

    ``situation``: true scene, scene as first seen, camera, physics. ``seed``: of physics and looks.
    The same velocities give the same episode to the last bit. ``rate``: at which velocities come
    [Hz]; divides the controller's rate. ``world``: that the episode happens in; None: the main
    simulation.
    """

    def __init__(
        self, situation: Situation, seed: int = 0, rate: float = RATE,
        world: "FlightWorld | None" = None,
    ) -> None:  # fmt: skip
        self.situation, self.seed = situation, seed
        own = world or Simulation(situation.scene, seed, situation.parameters)
        self.simulation: Simulation | FlightWorld = own
        count = 1.0 / (rate * self.simulation.tick)
        if not math.isclose(count, round(count), rel_tol=1e-9) or round(count) < 1:
            raise InvalidRequestError(f"rate is {rate:g} Hz; must divide the controller's rate")
        self.ticks, self.period = round(count), 1.0 / rate
        self.eye = Eye(Detector(situation.scene, self.robot, situation.detector, seed))
        self.state = self.simulation.state()
        self.reference = State(self.state.q)
        self._look: Look | None = None
        self._fruits = tuple(o for o in situation.seen.objects if o.role != "static")
        for _ in range(round(situation.parameters.engine.settle / self.simulation.tick)):
            self.state = self.simulation.step(self.reference)
        self._begin, self._held = self.simulation.time, dict[str, float]()
        self._see()

    @property
    def robot(self) -> Robot:
        """With its tool."""
        return self.simulation.robot

    @property
    def scene(self) -> Scene:
        """As first seen: static objects, approach and start are true."""
        return self.situation.seen

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self.simulation.time - self._begin

    @property
    def broken(self) -> bool:
        """Whether the physics broke down."""
        return self.simulation.broken

    @property
    def ended(self) -> bool:
        """Whether the time is over, or the physics broke down."""
        return self.broken or self.time >= LONGEST - 1e-9

    @property
    def done(self) -> bool:
        """Whether a fruit was held for a while, something was harmed, or the physics broke."""
        return self.broken or any(t >= HELD for t in self._held.values()) or self.harm().done

    def observe(self) -> Observation:
        """What a policy knows now."""
        point, axis = self.robot.tool_pose(self.state.q)
        look = self._look
        since = self.time if look is None else self.simulation.time - look.time
        return Observation(
            self.time, self.state.q, self.state.velocity, point, axis, self._fruits, since,
            self.simulation.wrench()[:3],
            None if look is None else replace(look, time=look.time - self._begin),
        )  # fmt: skip

    def act(self, velocity: FloatArray) -> None:
        """Let the joints come to velocities (n,) [rad/s or m/s] within one period."""
        wanted = np.asarray(velocity, dtype=np.float64)
        if wanted.shape != self.state.q.shape or not np.isfinite(wanted).all():
            raise InvalidRequestError(
                f"velocity has shape {wanted.shape}; must be {self.state.q.shape}, finite"
            )
        try:
            for each in driven(self.robot, self.reference, wanted, self.period, self.ticks):
                self.reference = each
                self.state = self.simulation.step(each)
        except ExecutionError:  # the simulation is broken, and the outcome tells of it
            pass
        held = self.simulation.held()
        self._held = {name: self._held.get(name, 0.0) + self.period for name in held}
        self._see()

    def _see(self) -> None:
        now, fruits = self.simulation.time, self.simulation.fruits()
        truth = Truth(fruits.ids, fruits.positions, fruits.rotations, fruits.stem_ends)
        self.eye.see(now, self.state.q, truth)
        for look in self.eye.delivered(now):
            self._look, self._fruits = look, look.in_base()

    def harm(self) -> HarmSoFar:
        """What was harmed so far; a fruit beside the target that was held for a while counts."""
        target = self.situation.scene.target
        kept = [name for name, t in self._held.items() if t >= HELD]
        others = len(kept) - (target is not None and target.id in kept)
        return replace(self.simulation.harm(), swallowed=others)

    def outcome(self) -> "Outcome | Word":
        """Stand still for a moment, and judge all that happened."""
        return self.simulation.outcome()


def score(outcome: "Outcome | Word") -> int:
    """An outcome as the benchmark counts it: 1 clean, -1 harmed, 0 missed; harm comes first."""
    if outcome.success:
        return 1
    if isinstance(outcome, Outcome):
        return -any(each not in ("not_picked", "not_placed") for each in outcome.causes)
    return -bool(outcome.harm or outcome.swallowed)
