"""One pick, step by step: what a policy sees, what it does, and what became of it."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.geometry.shapes import Primitive
from optipromp.core.planning.task import posed
from optipromp.core.planning.ways import back_along
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.held import RETREAT
from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.courses import path_back
from optipromp_loop.guard import Guard, Safe
from optipromp_loop.guard.motion import joints_for as joints_for
from optipromp_sim.detection import turned
from optipromp_sim.simulation import Detector, Eye, Outcome, Simulation
from optipromp_sim.simulation.contacts import HarmSoFar
from optipromp_sim.simulation.rollouts import Agent, Arena, Pick, Turn
from optipromp_sim.simulation.simulation import FruitStates
from optipromp_sim.situations import Situation

if TYPE_CHECKING:
    from optipromp_bench.flight import Word

TICK = 0.001  # [s] of a reference in the second engine, as of the main simulation's controller
RATE = 50.0  # [Hz] at which a policy is asked: a choice
HELD = 0.3  # [s] for which the tool must hold a fruit before a pick ends: a choice
LONGEST = 20.0  # [s] of a pick, after which it ends: a choice; plans take 4 to 12 s


@dataclass(frozen=True, eq=False)
class Observation:
    """What a policy knows at one moment."""

    time: float  # since the beginning [s]
    # (n,) of the joints, as measured [rad or m, per s]
    q: FloatArray
    velocity: FloatArray
    # (3,) in the robot's base frame [m]
    tool_point: FloatArray
    tool_axis: FloatArray
    # targets, pushables and objects to avoid as last seen, in the base frame
    fruits: tuple[SceneObject, ...]
    age: float  # time since they were seen [s]
    # (3,) of the world on the tool [N]
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    holding: bool = False  # whether the target's stem is cut, and the tool leaves with the target
    # the last one that was delivered, with its camera; its time is since the beginning
    look: Look | None = None


SIZE, TURN = 0.02, math.radians(2.0)
"""Deviations of a detection's size, as a share, and of its turn about each axis: choices, so that
the last digits of neither tell a fruit again."""


def nameless(look: Look, rng: np.random.Generator, errs: bool) -> Look:
    """A look whose detections come in any order under names of this look alone.

    ``errs``: whether size, turn and length of the stem have errors, too.
    """
    items = list[SceneObject]()
    for k, row in enumerate(rng.permutation(len(look.detections))):
        item = replace(look.detections[row], id=f"seen{k}")
        if errs:
            turn = turned(TURN * rng.standard_normal(3)) @ item.rotation
            one, other = 1.0 + SIZE * rng.standard_normal(2)
            shape, stem = item.shape, item.stem
            if isinstance(shape, Primitive):
                told = {each.name: getattr(shape, each.name) for each in fields(shape)}
                shape = replace(
                    shape,
                    **{
                        n: tuple(one * np.array(v)) if isinstance(v, tuple) else one * v
                        for n, v in told.items()
                    },
                )
            if stem is not None:
                stem = Stem.along(item.position, stem.vector, other * stem.length, stem.radius)
            item = replace(item, shape=shape, orientation=to_quaternion(turn), stem=stem)
        items.append(item)
    return replace(look, detections=tuple(items))


class FlightWorld:
    """A scene in the second engine, with the methods of the simulation that an episode calls.

    The arm is where its reference is. Plants stand still: conditions that move them, or change
    their physics, are of the first engine alone.
    """

    def __init__(self, scene: Scene, seed: int = 0, q: FloatArray | None = None) -> None:
        self.scene, self.tick, self.broken = scene, TICK, False
        self.robot, self.reference = posed(scene)
        if q is not None:
            self.reference = State(q)
        from optipromp_bench.flight import Flight

        try:
            self._flight = Flight(scene_to_dict(scene), self.reference.q, seed)
        except ValueError as error:
            raise InvalidRequestError(f"the second engine: {error}") from None
        self._items = {item.id: item for item in scene.objects}

    @property
    def time(self) -> float:
        """Since the beginning [s]."""
        return self._flight.time

    def step(self, reference: State) -> State:
        """Lead the cup to a reference within one tick; returns the state after it."""
        self.reference = reference
        try:
            self._flight.to(reference.q, TICK)
        except RuntimeError as error:
            self.broken = True
            raise ExecutionError(str(error)) from None
        return self.state()

    def state(self) -> State:
        """The reference."""
        return self.reference

    def fruits(self) -> FruitStates:
        """The targets and pushables now; velocities are not told (zero)."""
        ids = tuple(self._flight.ids)
        places = [self._flight.place(name) for name in ids]
        turns = [
            turn @ self._items[k].rotation for k, (_, turn, _) in zip(ids, places, strict=True)
        ]
        attached: BoolArray = np.ones(len(ids), dtype=np.bool_)
        return FruitStates(
            ids, tuple(self._items[name].role for name in ids),
            frozen(np.array([place for place, _, _ in places]).reshape(-1, 3)),
            frozen(np.array(turns).reshape(-1, 3, 3)),
            frozen(np.zeros((len(ids), 3))), attached, tuple(frozen(s) for _, _, s in places),
        )  # fmt: skip

    def held(self) -> tuple[str, ...]:
        """The fruits in the cup now."""
        return tuple(filter(self._flight.inside, self._flight.ids))

    def wrench(self) -> FloatArray:
        """(6,) of the world on the tool: force [N], and zeros."""
        return np.concatenate([self._flight.pushed(), np.zeros(3)])

    def harm(self) -> HarmSoFar:
        """What was harmed so far."""
        words = self._flight.harm()
        fruit, stem = self._flight.shares()
        static = 2.0 * any(word.endswith("touched") for word in words)
        return HarmSoFar(fruit, stem, static)

    def grip(self) -> None:
        """Cut the target off its stem, and fix the fruit in the cup where it is."""
        self._flight.take()

    def follow(self, motion: Trajectory) -> tuple[None, "Word"]:
        """Lead the cup along a motion that begins where the arm is, and judge all so far."""
        fine, self.reference = motion.resample(1.0 / TICK), State(motion.positions[-1])
        return None, self._flight.along(fine.times, fine.positions)

    def rollout(self) -> None:
        """The records so far: there are none."""

    def outcome(self) -> "Word":
        """Stand still for a moment, and judge all that happened."""
        from optipromp_bench.flight import Word

        if self.broken or not math.isfinite(self.time):
            return Word(False, (), ("the engine broke down",), math.nan)
        return self._flight.outcome()


Engine = Literal["arm", "flight"]
ENGINES: tuple[Engine, ...] = ("arm", "flight")
"""``arm``: the whole arm with its controller; ``flight``: a cup in flight, a model of its own."""


Made = Callable[[Situation, int, FloatArray | None], Arena["Outcome | Word"]]
ARENAS: Mapping[Engine, Made] = {
    "arm": lambda it, seed, q: Simulation(it.scene, seed, it.parameters, q=q),
    "flight": lambda it, seed, q: FlightWorld(it.scene, seed, q),
}
"""Of a situation, a seed, and where the arm is (n,); None: at the scene's start."""


class Episode(Pick["Outcome | Word"]):
    """One pick in the simulation, moved by joint velocities.

    ``situation``: true scene, scene as first seen, camera, physics. ``seed``: of physics and looks.
    The same velocities give the same episode to the last bit. ``engine``: that it happens in.
    ``longest``: time after which it ends [s]; None: LONGEST.
    """

    def __init__(
        self, situation: Situation, seed: int = 0, engine: Engine = "arm",
        longest: float | None = None,
    ) -> None:  # fmt: skip
        own = ARENAS[engine](situation, seed, None)
        self.situation, self.seed, self.period = situation, seed, 1.0 / RATE
        self.longest = longest or LONGEST
        self._held = dict[str, float]()
        eye = Eye(Detector(situation.scene, own.robot, situation.detector, seed))
        super().__init__(own, eye, situation.parameters.engine.settle, self.period)
        self._look: Look | None = None
        self._rng = np.random.default_rng([seed, 12])
        self._fruits = tuple(o for o in situation.seen.objects if o.role != "static")
        self._learn()

    @property
    def robot(self) -> Robot:
        """With its tool."""
        return self.arena.robot

    @property
    def scene(self) -> Scene:
        """As first seen: static objects, approach and start are true."""
        return self.situation.seen

    @property
    def ended(self) -> bool:
        """Whether the time is over, or the physics broke down."""
        return self.broken or self.time >= self.longest - 1e-9

    @property
    def done(self) -> bool:
        """Whether a fruit was held for a while, something was harmed, or the physics broke.

        With a target that is taken: whether the tool is away, in place of the first.
        """
        if self.broken or self.harm().done:
            return True
        if self.taken is not None:
            return bool(np.linalg.norm(self.point() - self.taken) >= RETREAT)
        return any(t >= HELD for t in self._held.values())

    def over(self, leaving: bool) -> bool:
        """Whether nobody acts any more. A policy that is ``leaving`` goes on with its target."""
        done = self.done or self.ended
        if done and leaving and not (self.ended or self.taken is not None or self.harm().done):
            target = self.situation.scene.target
            if target is not None and self._held.get(target.id, 0.0) >= HELD:
                self.take()
            return self.done
        return done

    def observe(self) -> Observation:
        """What a policy knows now."""
        point, axis = self.robot.tool_pose(self.state.q)
        look = self._look
        since = self.time if look is None else self.arena.time - look.time
        return Observation(
            self.time, self.state.q, self.state.velocity, point, axis, self._fruits, since,
            self.arena.wrench()[:3], self.taken is not None,
            None if look is None else replace(look, time=look.time - self.began),
        )  # fmt: skip

    def toward(self, velocity: FloatArray, curve: Trajectory | None = None) -> list[State]:
        """The turn in which the joints come to velocities (n,) [rad/s or m/s] within a period.

        ``curve``: on which they come there, from the last reference on; None: at a constant
        acceleration.
        """
        wanted = np.asarray(velocity, dtype=np.float64)
        if wanted.shape != self.state.q.shape or not np.isfinite(wanted).all():
            raise InvalidRequestError(
                f"velocity has shape {wanted.shape}; must be {self.state.q.shape}, finite"
            )
        if curve is None:
            return driven(self.robot, self.reference, wanted, self.period, self.ticks)
        at = self.period / self.ticks * np.arange(1, self.ticks + 1)
        return [State(*rows) for rows in zip(*curve.sample(at), strict=True)]

    def act(self, velocity: FloatArray) -> None:
        """Let the joints come to velocities (n,) [rad/s or m/s] within one period."""
        self.lead(self.toward(velocity))

    def lead(self, turn: Turn) -> None:
        """Move the arm by a turn, and count how long fruits are held."""
        super().lead(turn)
        if not isinstance(turn, Trajectory):
            held = self.arena.held()
            self._held = {name: self._held.get(name, 0.0) + self.period for name in held}
            self._learn()

    def _learn(self) -> None:
        for look in self.looks:
            self._look = nameless(look, self._rng, self.situation.detector.position > 0.0)
            self._fruits = self._look.in_base()

    def harm(self) -> HarmSoFar:
        """What was harmed so far; a fruit beside the target that was held for a while counts."""
        taken = {item.id for item in self.situation.scene.taken}
        kept = {name for name, t in self._held.items() if t >= HELD}
        return replace(self.arena.harm(), swallowed=len(kept - taken))


class Driven:
    """A policy as an agent: its velocities, until the episode is over.

    ``act``: gives velocities (n,), or None: it has no more. ``leaves``: whether it goes on once it
    holds its target. ``guard``: through which its velocities pass; None: none. Keeps ``actions``,
    the wall ``times`` that they took [s], what the guard made of them, ``safe``, and the time of
    the processor that it ``spent`` [s].
    """

    def __init__(
        self, act: Callable[[Observation], FloatArray | None], leaves: bool = False,
        guard: Guard | None = None,
    ) -> None:  # fmt: skip
        self._act, self.leaves, self.guard = act, leaves, guard
        self.actions, self.times = list[FloatArray](), list[float]()
        self.safe, self.spent = list[Safe](), list[float]()

    def __call__(self, pick: Episode) -> list[State] | None:
        """See :class:`optipromp_sim.simulation.rollouts.Agent`."""
        if pick.over(self.leaves):
            return None
        seen = pick.observe()
        began = time.perf_counter()
        velocity = self._act(seen)
        self.times.append(time.perf_counter() - began)
        if velocity is None and self.guard is not None and self.guard.leads:
            velocity = np.zeros(self.guard.robot.n_joints)  # the loop picks to the end
        if velocity is None:
            return None
        self.actions.append(velocity)
        if self.guard is None:
            return pick.toward(velocity)
        began = time.process_time()
        safe = guarded(self.guard, velocity, pick)
        self.spent.append(time.process_time() - began)
        self.safe.append(safe)
        return pick.toward(safe.velocity, safe.curve)


def guarded(guard: Guard, velocity: FloatArray, episode: Episode) -> Safe:
    """What a guard makes of a policy's velocities (n,) in an episode."""
    seen = episode.observe()
    look = seen.look
    looks = () if look is None or look.time <= guard.time else (look,)
    guard.feel(episode.time, seen.force)
    return guard(velocity, episode.reference, looks, episode.time)


def score(outcome: "Outcome | Word") -> int:
    """An outcome as the benchmark counts it: 1 clean, -1 harmed, 0 missed; harm comes first."""
    return {"clean": 1, "missed": 0, "harmed": -1}[outcome.result]


def as_it_came(robot: Robot, q: FloatArray) -> Trajectory:
    """The way back along the last 10 cm of a tool's way, where it came by ``q`` (k, n)."""
    back = back_along(q, robot.tool_pose(q)[0], RETREAT)
    return path_back(robot, back, PUSH.hanging.speed)


def leaving(agent: Agent[Any]) -> Agent[Any]:
    """An agent that leaves :func:`as_it_came`, where it holds the target alone and has not left."""
    left = False

    def turn(pick: Pick[Any]) -> Turn | None:
        nonlocal left
        made = None if left else agent(pick)
        if made is not None or left:
            return made
        left = True
        if pick.taken is not None or pick.judged().result != "clean":
            return None
        pick.take()
        return as_it_came(pick.arena.robot, np.array(pick.path))

    return turn


BRAKE = 0.9  # share of the acceleration limit that brakes before the end of a range: a choice


def driven(
    robot: Robot, before: State, wanted: FloatArray, period: float, count: int
) -> list[State]:
    """References of ``count`` ticks of a controller in which the joints come to a velocity.

    The acceleration is constant, at most its limit. The velocity is at most its limit, and so low
    that the joint can brake before the end of its range.

    ``robot``: whose limits are kept. ``before``: the last reference. ``wanted``: (n,) velocity at
    the end [rad/s or m/s]. ``period``: time from ``before`` to the last tick [s].

    Returns: The references, a tick apart, the last one ``period`` after ``before``.
    """
    most = BRAKE * robot.acceleration
    ahead = before.q + 0.5 * period * before.velocity  # about where the velocity is reached
    up, down = robot.upper - ahead, ahead - robot.lower
    rise = _braking(up, most, period, before.velocity)
    fall = _braking(down, most, period, -before.velocity)
    top = np.minimum(robot.velocity, rise)
    low = -np.minimum(robot.velocity, fall)
    aim = np.clip(wanted, np.minimum(low, top), top)
    change = np.clip(
        aim - before.velocity, -robot.acceleration * period, robot.acceleration * period
    )
    gain, out = change / period, []
    for k in range(1, count + 1):
        t = period * k / count
        q = before.q + t * before.velocity + 0.5 * t * t * gain
        out.append(State(np.clip(q, robot.lower, robot.upper), before.velocity + t * gain, gain))
    return out


def _braking(room: FloatArray, most: FloatArray, period: float, speed: FloatArray) -> FloatArray:
    """The velocity (n,) a period later from which a joint still stops within its range.

    Where ``room`` (n,) is negative, the joint has to stop within the period, and turns back: it
    brakes from ``speed`` (n,) by ``most`` (n,) throughout.
    """
    lead = 0.5 * most * period
    far = np.nan_to_num(np.maximum(room, 0.0), posinf=1e9)
    return np.where(room >= 0.0, np.sqrt(lead**2 + 2.0 * most * far) - lead, speed - most * period)
