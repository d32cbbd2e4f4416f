"""Execution: a reference, a joint controller, MuJoCo; and what was recorded."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from optipromp.arrays import BoolArray, FloatArray, frozen
from optipromp.simulation.contacts import ContactLog
from optipromp.simulation.engine import engine
from optipromp.simulation.reference import Reference
from optipromp.simulation.world import World


@dataclass(frozen=True, eq=False)
class Rollout:
    """What happened, R records at a fixed rate, F fruits and things (targets and pushables).

    Attributes:
        times: (R,) [s].
        q, velocity, torque: (R, n) of the independent joints.
        reference: (R, n) what the controller was told to follow.
        tool_point: (R, 3) [m], ``tool_axis`` (R, 3).
        fruit_ids: F ids; ``fruit_positions`` (R, F, 3) [m].
        attached: (R, F) whether each still hangs on its stem (False for what never did).
        fruit_force: (R, F) largest force of one other thing on each since the last record [N].
        stem_force: (R, F) the same of arm or tool on its stem [N].
        states: (R, nq) MuJoCo's generalised positions, for pictures.
        motion: when the reference ends and the hold begins [s].
        warnings: of MuJoCo, or where a number stopped being one; not empty means a failed run.
        limit_use: largest share of each limit.
        tension: largest pull along each stem, by id [N].
        torn_at: when each torn fruit came off, by id [s].
        tracking_error: largest distance of the tool point from the reference [m].
        joint_error: largest distance of a joint from the reference [rad or m].
    """

    times: FloatArray
    q: FloatArray
    velocity: FloatArray
    torque: FloatArray
    reference: FloatArray
    tool_point: FloatArray
    tool_axis: FloatArray
    fruit_ids: tuple[str, ...]
    fruit_positions: FloatArray
    attached: BoolArray
    fruit_force: FloatArray
    stem_force: FloatArray
    states: FloatArray
    motion: float
    warnings: tuple[str, ...]
    limit_use: Mapping[str, float] = field(default_factory=dict)
    tension: Mapping[str, float] = field(default_factory=dict)
    torn_at: Mapping[str, float] = field(default_factory=dict)
    tracking_error: float = 0.0
    joint_error: float = 0.0

    def arrays(self) -> dict[str, FloatArray]:
        """The records as arrays by name, for an NPZ file."""
        names = (
            "times", "q", "velocity", "torque", "reference", "tool_point", "tool_axis",
            "fruit_positions", "attached", "fruit_force", "stem_force", "states",
        )  # fmt: skip
        arrays = {name: getattr(self, name) for name in names}
        arrays["fruit_ids"] = np.array(self.fruit_ids, dtype=np.str_)
        arrays["motion"] = np.array(self.motion)
        return arrays


def run(world: World, motion: Reference, record_rate: float) -> tuple[Rollout, ContactLog]:
    """Execute ``motion`` and stand still at its end for ``control.hold``.

    The controller is computed torque, :math:`τ = M(q)(q̈_r + ω^2 e + 2ζω ė) + b(q, q̇)`, held between
    its ticks and cut at the torque limits; it knows the arm's masses and not its dry and viscous
    friction, nor what it touches.

    A number that stops being one, or a warning of MuJoCo, ends the run there.
    """
    return Execution(world, motion, record_rate).run()


class Execution:
    """One run: built, then run; ``data`` may be touched in between."""

    def __init__(self, world: World, motion: Reference, record_rate: float) -> None:
        self.world, self.motion = world, motion
        self.mujoco = engine()
        self.model, self.data = world.model, world.data(motion.q[0])
        p = world.parameters
        self.log = ContactLog(world, p.thresholds.stem_force)
        self.step = p.engine.timestep
        self.every = max(round(1.0 / (record_rate * self.step)), 1)
        self.tick = max(round(1.0 / (p.control.rate * self.step)), 1)
        self.gains = (p.control.frequency**2, 2.0 * p.control.damping_ratio * p.control.frequency)
        self.count = world.robot.n_segments
        self.hanging = {i: f for i, f in enumerate(world.fruits) if f.weld >= 0}
        self.welds = [f for f in world.fruits if f.weld >= 0]
        self.tension = {f.built.key: 0.0 for f in self.welds}
        self.torn: dict[str, float] = {}
        self.records: list[tuple[Any, ...]] = []
        self.peaks = np.zeros((2, len(world.shown)))
        self.joint_error = self.torque_use = self.position_use = 0.0
        self.torque: FloatArray = np.zeros(self.count)
        self._watch_contacts()

    def _watch_contacts(self) -> None:
        entities = self.world.entities
        robot = {i for i, e in enumerate(entities) if e.kind in ("link", "tool")}
        count = len(entities)
        self.of_pair: dict[int, list[tuple[int, int]]] = {}
        fruit_of = {f.entity: i for i, f in enumerate(self.world.shown)}
        stem_of = {f.stem_entity: i for i, f in enumerate(self.world.shown) if f.stem_entity >= 0}
        for a in range(count):
            for b in range(a, count):
                watchers = [(0, fruit_of[e]) for e in {a, b} if e in fruit_of]
                watchers += [
                    (1, stem_of[e]) for e, o in ((a, b), (b, a)) if e in stem_of and o in robot
                ]
                if watchers:
                    self.of_pair[a * count + b] = watchers

    def run(self) -> tuple[Rollout, ContactLog]:
        """Execute the motion and the hold."""
        p = self.world.parameters
        moving = max(round(self.motion.duration / self.step), 1)
        before = round(p.engine.settle / self.step)
        total = before + moving + round(p.control.hold / self.step)
        drives = self.world.drives
        at = np.clip(np.arange(total + 1) - before, 0, len(self.motion.times) - 1)
        q = drives.segments(self.motion.q[at])
        rate = drives.segments(self.motion.velocity[at], rates=True)
        acceleration = drives.segments(self.motion.acceleration[at], rates=True)
        still = (np.arange(total + 1) < before) | (np.arange(total + 1) - before > moving)
        rate[still], acceleration[still] = 0.0, 0.0
        warnings: tuple[str, ...] = ()
        with _quiet(self.mujoco):
            self._record(q[0])
            for k in range(total):
                self.mujoco.mj_step1(self.model, self.data)
                if k % self.tick == 0:
                    self._control(q[k], rate[k], acceleration[k])
                self.mujoco.mj_step2(self.model, self.data)
                warnings = self._warnings()
                if warnings:
                    break
                self._observe(q[k + 1])
                if (k + 1) % self.every == 0:
                    self._record(q[k + 1])
        return self._rollout((before + moving) * self.step, warnings), self.log

    def _control(self, q: FloatArray, rate: FloatArray, acceleration: FloatArray) -> None:
        data, n = self.data, self.count
        stiffness, damping = self.gains
        wanted = np.zeros(self.model.nv)
        wanted[:n] = (
            acceleration + stiffness * (q - data.qpos[:n]) + damping * (rate - data.qvel[:n])
        )
        torque = np.zeros(self.model.nv)
        self.mujoco.mj_mulM(self.model, data, torque, wanted)
        asked = torque[:n] + data.qfrc_bias[:n]
        limit = self.world.drives.torque
        self.torque = np.clip(asked, -limit, limit)
        self.torque_use = max(self.torque_use, float(np.max(np.abs(asked) / limit, initial=0.0)))
        data.qfrc_applied[:n] = self.torque

    def _observe(self, q: FloatArray) -> None:
        data, n = self.data, self.count
        self.joint_error = max(self.joint_error, float(np.max(np.abs(q - data.qpos[:n]))))
        self.log.add(data)
        for key, force in self.log.now.items():
            for row, column in self.of_pair.get(key, ()):
                if force > self.peaks[row, column]:
                    self.peaks[row, column] = force
        self._tear()

    def _tear(self) -> None:
        """Cut the stem of each fruit that is pulled beyond its threshold."""
        data = self.data
        kept = []
        for place, fruit in enumerate(self.welds):
            # welds are the only equalities, six rows each, in order, the active ones first
            pull = data.efc_force[6 * place : 6 * place + 3]
            axis = data.xmat[fruit.last].reshape(3, 3) @ fruit.along
            tension = _SIGN * float(pull @ axis)
            key = fruit.built.key
            if tension > self.tension[key]:
                self.tension[key] = tension
            if tension > fruit.built.abscission:
                data.eq_active[fruit.weld] = 0
                data.qfrc_applied[fruit.dofs] = fruit.built.bare.ravel()
                self.torn[key] = float(data.time)
            else:
                kept.append(fruit)
        self.welds = kept

    def _warnings(self) -> tuple[str, ...]:
        data = self.data
        found = [
            f"{name.removeprefix('mjWARN_').lower()} at {data.time:.3f} s"
            for name, kind in self.mujoco.mjtWarning.__members__.items()
            if name != "mjNWARNING" and data.warning[int(kind)].number > 0
        ]
        if not found and not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            found = [f"not a number at {data.time:.3f} s"]
        return tuple(found)

    def _record(self, q: FloatArray) -> None:
        data, n, drives = self.data, self.count, self.world.drives
        attached = [f.weld >= 0 and bool(data.eq_active[f.weld]) for f in self.world.shown]
        self.records.append(
            (
                data.time,
                drives.joints(data.qpos[:n]),
                drives.joints(data.qvel[:n], rates=True),
                self.torque[drives.first],
                drives.joints(q),
                [data.qpos[f.position : f.position + 3].copy() for f in self.world.shown],
                attached,
                *self.peaks.copy(),
                data.qpos.copy(),
            )
        )
        self.peaks[:] = 0.0

    def _rollout(self, motion: float, warnings: tuple[str, ...]) -> Rollout:
        robot = self.world.robot
        columns = [np.array(column) for column in zip(*self.records, strict=True)]
        times, q, velocity, torque, wanted, positions, attached, force, stem, states = columns
        shown = self.world.shown
        points, axes = robot.tool_pose(q)
        goals, _ = robot.tool_pose(wanted)
        span = robot.upper - robot.lower
        inside = np.minimum(q - robot.lower, robot.upper - q)
        bounded = np.isfinite(span)
        position = float(np.max(1.0 - 2.0 * inside[:, bounded] / span[bounded], initial=0.0))
        return Rollout(
            times=frozen(times), q=frozen(q), velocity=frozen(velocity), torque=frozen(torque),
            reference=frozen(wanted), tool_point=frozen(points), tool_axis=frozen(axes),
            fruit_ids=tuple(f.id for f in shown),
            fruit_positions=frozen(positions.reshape(len(times), len(shown), 3)),
            attached=frozen(attached.reshape(len(times), len(shown)), np.bool_),
            fruit_force=frozen(force), stem_force=frozen(stem), states=frozen(states),
            motion=motion, warnings=warnings,
            limit_use={"position": position, **self.motion.use, "torque": self.torque_use},
            tension={f.id: self.tension[f.built.key] for f in shown if f.weld >= 0},
            torn_at={f.id: self.torn[f.built.key] for f in shown if f.built.key in self.torn},
            tracking_error=float(np.linalg.norm(points - goals, axis=1).max()),
            joint_error=self.joint_error,
        )  # fmt: skip


_SIGN = -1.0  # of a pull up the stem in the rows of MuJoCo's weld


class _quiet:  # noqa: N801
    """Keeps MuJoCo from writing its warnings to a file; they are read from the data instead."""

    def __init__(self, mujoco: Any) -> None:
        self.mujoco = mujoco

    def __enter__(self) -> None:
        self.mujoco.set_mju_user_warning(lambda _: None)

    def __exit__(self, *_: object) -> None:
        self.mujoco.set_mju_user_warning(None)
