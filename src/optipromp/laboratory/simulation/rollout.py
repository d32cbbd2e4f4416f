"""The execution of a trajectory: the joint controller, the steps of MuJoCo, and the records."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Trajectory
from optipromp.laboratory.simulation.arm import GUARD
from optipromp.laboratory.simulation.contacts import ContactLog
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.kernels import is_sound
from optipromp.laboratory.simulation.stems import StemWatch
from optipromp.laboratory.simulation.world import World


@dataclass(frozen=True, eq=False)
class Rollout:
    """The records of a run: R records at a fixed rate, of F targets and pushables.

    Attributes:
        times: (R,) [s].
        q, velocity, torque: (R, n) of the independent joints.
        reference: (R, n) reference positions of the controller.
        tool_point: (R, 3) [m], ``tool_axis`` (R, 3).
        fruit_ids: F ids; ``fruit_positions`` (R, F, 3) [m].
        attached: (R, F) whether each still hangs on its stem; False without a stem.
        fruit_force: (R, F) largest force of one other object on each since the last record [N].
        stem_force: (R, F) largest force of arm or tool on its stem since the last record [N].
        states: (R, nq) MuJoCo's generalised positions, for pictures.
        contacts: (C, 9) contact points at each record, those with static and avoid objects left
            out: record, indices of two entities, point (3,) [m], force of the first entity on the
            second (3,) [N].
        motion: time at which the trajectory ends and the hold begins [s].
        warnings: of MuJoCo, or the place of a NaN; not empty means a failed run.
        limit_use: largest share of each limit.
        tension: largest pull along each stem, by id [N].
        torn_at: time at which each torn fruit came off, by id [s].
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
    contacts: FloatArray
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
            "fruit_positions", "attached", "fruit_force", "stem_force", "states", "contacts",
        )  # fmt: skip
        arrays = {name: getattr(self, name) for name in names}
        arrays["fruit_ids"] = np.array(self.fruit_ids, dtype=np.str_)
        arrays["motion"] = np.array(self.motion)
        return arrays


class Execution:
    """One run of ``motion`` in ``world``, with ``record_rate`` records a second [Hz].

    The controller is computed torque, :math:`τ = M(q)(q̈_r + ω^2 e + 2ζω ė) + b(q, q̇)`, constant
    between its ticks and cut at the torque limits. It knows the arm's masses, but neither its
    friction nor its contacts. ``data`` may be changed before the run.
    """

    def __init__(self, world: World, motion: Trajectory, record_rate: float) -> None:
        self.world, self.motion = world, motion
        self.mujoco = engine()
        self.model, self.data = world.model, world.data(motion.positions[0])
        p = world.parameters
        self.log = ContactLog(world, p.thresholds.stem_force)
        self.stems = StemWatch(world)
        self.step = p.engine.timestep
        self.every = max(round(1.0 / (record_rate * self.step)), 1)
        self.tick = max(round(1.0 / (p.control.rate * self.step)), 1)
        self.gains = (p.control.frequency**2, 2.0 * p.control.damping_ratio * p.control.frequency)
        n = world.robot.n_segments
        self.at = _Views.of(self.data, n)
        self.wanted, self.inertial = np.zeros((2, self.model.nv))
        self.torque, self.most_asked, self.worst_error = np.zeros((3, n))
        self.records: list[tuple[Any, ...]] = []
        self.contacts: list[FloatArray] = []
        self.steps = 0
        self.warnings: tuple[str, ...] = ()
        shown, entities = world.shown, world.entities
        self.fruit_entities = np.array([f.entity for f in shown], dtype=np.int64)
        self.stem_entities = np.array([f.stem_entity for f in shown], dtype=np.int64)
        self.guarded = p.robot.guard_until > 0.0
        self.moving = np.array([e.kind not in ("static", "avoid") for e in entities])
        self.robot_entities = [i for i, e in enumerate(entities) if e.kind in ("link", "tool")]

    def run(self) -> tuple[Rollout, ContactLog]:
        """Execute the motion, and stand still at its end for ``control.hold``.

        A NaN or a warning of MuJoCo ends the run.
        """
        p = self.world.parameters
        moving = max(round(self.motion.duration / self.step), 1)
        before = round(p.engine.settle / self.step)
        total = before + moving + round(p.control.hold / self.step)
        drives = self.world.drives
        at = np.arange(total + 1) - before
        asked, velocity, gain = self.motion.sample(at * self.step)
        q, rate = drives.segments(asked), drives.segments(velocity, rates=True)
        acceleration = drives.segments(gain, rates=True)
        still = (at < 0) | (at > moving)
        rate[still], acceleration[still] = 0.0, 0.0
        with quiet(self.mujoco):
            self.record(q[0])
            for k in range(total):
                if not self.advance(q[k], rate[k], acceleration[k], q[k + 1]):
                    break
        return self.rollout((before + moving) * self.step), self.log

    def advance(
        self, q: FloatArray, rate: FloatArray, acceleration: FloatArray, after: FloatArray
    ) -> bool:
        """One step of the engine; False after a NaN or a warning.

        The reference of the controller is ``q``, ``rate`` and ``acceleration`` (S,) of the
        segments; ``after`` (S,) is the reference position at the end of the step.
        """
        self.mujoco.mj_step1(self.model, self.data)
        if self.steps % self.tick == 0:
            self._control(q, rate, acceleration)
        self.mujoco.mj_step2(self.model, self.data)
        if not is_sound(self.at.warnings, self.at.positions, self.at.velocities):
            self.warnings = self._warnings()
            return False
        np.maximum(self.worst_error, np.abs(after - self.at.q), out=self.worst_error)
        self.log.add(self.data)
        self.stems.tear(self.data)
        self.steps += 1
        if self.guarded and self.steps * self.step >= self.world.parameters.robot.guard_until:
            self.guarded, lid = False, self.model.geom(GUARD)
            lid.contype[0], lid.rgba[3] = 0, 0.0
        if self.steps % self.every == 0:
            self.record(after)
        return True

    def _control(self, q: FloatArray, rate: FloatArray, acceleration: FloatArray) -> None:
        at, n = self.at, len(q)
        stiffness, damping = self.gains
        self.wanted[:n] = acceleration + stiffness * (q - at.q) + damping * (rate - at.velocity)
        self.mujoco.mj_mulM(self.model, self.data, self.inertial, self.wanted)
        asked = self.inertial[:n] + at.bias
        limit = self.world.drives.torque
        self.torque = np.minimum(np.maximum(asked, -limit), limit)
        np.maximum(self.most_asked, np.abs(asked), out=self.most_asked)
        at.applied[:] = self.torque

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

    def record(self, q: FloatArray) -> None:
        """Record the present state; ``q`` (S,) is the reference position of the segments."""
        data = self.data
        forces = self.log.take_recent()
        on_stems = forces[self.stem_entities][:, self.robot_entities].max(axis=1)
        self.records.append(
            (
                data.time, data.qpos.copy(), self.at.velocity.copy(), self.torque, q,
                [f.weld >= 0 and bool(data.eq_active[f.weld]) for f in self.world.shown],
                forces[self.fruit_entities].max(axis=1),
                np.where(self.stem_entities >= 0, on_stems, 0.0),
            )
        )  # fmt: skip
        self.contacts.append(self._touching(len(self.records) - 1))

    def _touching(self, record: int) -> FloatArray:
        """The present contacts as rows of ``Rollout.contacts``."""
        found, force = self.data.contact, self.data.efc_force
        at = np.asarray(found.efc_address)
        owners = self.world.geom_entity[np.asarray(found.geom)].reshape(-1, 2)
        counted = (at >= 0) & (owners >= 0).all(axis=1)
        rows = np.flatnonzero(counted & self.moving[owners].all(axis=1))
        own = force[at[rows, None] + np.arange(3)] if len(rows) else np.zeros((0, 3))
        frames = np.asarray(found.frame).reshape(-1, 3, 3)[rows]
        world = np.einsum("ci,cij->cj", own, frames)
        return np.column_stack(
            [np.full(len(rows), record), owners[rows], np.asarray(found.pos)[rows], world]
        )

    def rollout(self, motion: float) -> Rollout:
        """The records, of a motion that ended at ``motion`` [s]."""
        robot, drives, stems = self.world.robot, self.world.drives, self.stems
        columns = [np.array(column) for column in zip(*self.records, strict=True)]
        times, states, velocity, torque, targets, attached, force, stem = columns
        q, wanted = drives.joints(states[:, : robot.n_segments]), drives.joints(targets)
        shown = self.world.shown
        points, axes = robot.tool_pose(q)
        goals, _ = robot.tool_pose(wanted)
        span = robot.upper - robot.lower
        inside = np.minimum(q - robot.lower, robot.upper - q)
        bounded = np.isfinite(span)
        position = float(np.max(1.0 - 2.0 * inside[:, bounded] / span[bounded], initial=0.0))
        torque_use = float(np.max(self.most_asked / drives.torque, initial=0.0))
        return Rollout(
            times=frozen(times), q=frozen(q),
            velocity=frozen(drives.joints(velocity, rates=True)),
            torque=frozen(torque[:, drives.first]),
            reference=frozen(wanted), tool_point=frozen(points), tool_axis=frozen(axes),
            fruit_ids=tuple(f.id for f in shown),
            fruit_positions=frozen(
                np.stack([states[:, f.position : f.position + 3] for f in shown], axis=1)
                if shown else np.zeros((len(times), 0, 3))
            ),
            attached=frozen(attached.reshape(len(times), len(shown)), np.bool_),
            fruit_force=frozen(force), stem_force=frozen(stem), states=frozen(states),
            contacts=frozen(np.concatenate(self.contacts)),
            motion=motion, warnings=self.warnings,
            limit_use={"position": position, **used(robot, self.motion), "torque": torque_use},
            tension={f.id: stems.tension[f.built.key] for f in shown if f.weld >= 0},
            torn_at={f.id: stems.torn[f.built.key] for f in shown if f.built.key in stems.torn},
            tracking_error=float(np.linalg.norm(points - goals, axis=1).max()),
            joint_error=float(np.max(self.worst_error, initial=0.0)),
        )  # fmt: skip


def used(robot: Robot, trajectory: Trajectory) -> dict[str, float]:
    """Largest share of the limits of velocity, acceleration and jerk."""
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    shares = (judging.extremes(trajectory).largest / limits).max(axis=1)
    return dict(zip(judging.RATES, shares.tolist(), strict=True))


class _Views(NamedTuple):
    """Views of MuJoCo's data that every step reads or writes; from ``q`` on, the robot's alone."""

    warnings: IntArray
    positions: FloatArray
    velocities: FloatArray
    q: FloatArray
    velocity: FloatArray
    bias: FloatArray
    applied: FloatArray

    @classmethod
    def of(cls, data: Any, count: int) -> Self:
        return cls(
            data.warning.number, data.qpos, data.qvel, data.qpos[:count], data.qvel[:count],
            data.qfrc_bias[:count], data.qfrc_applied[:count],
        )  # fmt: skip


@contextmanager
def quiet(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to a file; they are read from the data instead."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
