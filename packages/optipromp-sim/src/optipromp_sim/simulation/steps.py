"""The steps of a run: the joint controller, MuJoCo, and the records."""

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.trajectory import Trajectory
from optipromp_sim.simulation.arm import GUARD
from optipromp_sim.simulation.contacts import ContactLog, is_sound, pressing
from optipromp_sim.simulation.disturbances import CARRIAGE_MASS, roots_of
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.grasps import between_blades, carried_by, scissor_of
from optipromp_sim.simulation.outcome import HarmLog
from optipromp_sim.simulation.parameters import STEM_FORCE
from optipromp_sim.simulation.rollout import Rollout, StemCut, used
from optipromp_sim.simulation.world import Fruit, World


class Carriages:
    r"""The carriages of a world's roots, driven along their motion.

    A root moves by the scene's motion of its fruit, and by the sway and the jump of a plant.
    MuJoCo integrates :math:`v_{k+1} = v_k + h a_k`, :math:`x_{k+1} = x_k + h v_{k+1}`. A carriage
    has :math:`v_k = (x_k - x_{k-1}) / h` and the force that gives it
    :math:`a_k = (x_{k+1} - 2 x_k + x_{k-1}) / h^2`, so it follows the motion exactly but for the
    pull of its stem; position and velocity are set anew before every step.

    ``world``: whose roots move. ``data``: at the beginning; roots and fruits are displaced and
    given their velocities.
    """

    def __init__(self, world: World, data: Any) -> None:
        self._world, self._step = world, float(world.model.opt.timestep)
        self._at = np.array([root.position for root in world.roots])[:, None] + np.arange(3)
        self._dofs = np.array([root.spin for root in world.roots])[:, None] + np.arange(3)
        self._hold = -np.asarray(world.model.opt.gravity)
        self._places = [self._place(k) for k in (-1, 0, 1)]
        velocity = self._velocity()
        for k, root in enumerate(world.roots):
            for index in root.fruits:
                fruit = world.fruits[index]
                data.qpos[fruit.position : fruit.position + 3] += self._places[1][k]
                data.qvel[fruit.spin : fruit.spin + 3] = velocity[k]
        self.drive(data, 0)
        engine().mj_forward(world.model, data)

    def _place(self, step: int) -> FloatArray:
        time, motion = step * self._step, self._world.motion
        courses = [root.course for root in self._world.roots]
        out = np.zeros((len(courses), 3)) if motion is None else motion.position(time)
        for k, course in enumerate(courses):
            if course is not None:
                out[k] += course.at(np.array([time - self._world.parameters.engine.settle]))[0]
        return out

    def _velocity(self) -> FloatArray:
        out: FloatArray = (self._places[1] - self._places[0]) / self._step
        return out

    def drive(self, data: Any, step: int) -> None:
        """Set places, velocities and forces of the carriages for the step after number ``step``."""
        if step > 0:
            self._places = [*self._places[1:], self._place(step + 1)]
        before, now, after = self._places
        data.qpos[self._at] = now
        data.qvel[self._dofs] = self._velocity()
        gain = (after - 2.0 * now + before) / self._step**2
        data.qfrc_applied[self._dofs] = CARRIAGE_MASS * (gain + self._hold)


class Execution:
    """One run in ``world`` from where ``motion`` begins, of ``record_rate`` records a second [Hz].

    The controller is computed torque, :math:`τ = M(q)(q̈_r + ω^2 e + 2ζω ė) + b(q, q̇)`, constant
    between its ticks and cut at the torque limits. It knows the arm's masses, but neither its
    friction nor its contacts. ``data`` may be changed before the run.
    """

    def __init__(self, world: World, motion: Trajectory, record_rate: float) -> None:
        self.world, self.motion = world, motion
        self.mujoco = engine()
        self.model, self.data = world.model, world.data(motion.positions[0])
        p = world.parameters
        self.carriages = Carriages(world, self.data) if world.roots else None
        soft = ("static", "avoid") if p.thing.avoid_as == "soft" else ("static",)
        self.movers = [
            (int(self.model.body(f"{item.role}:{item.id}").mocapid[0]), course)
            for item, course in world.scene.movers
            if item.role in soft
        ]
        crop, caught = world.scene.crop, p.thresholds.stem_force
        harm = None if crop is None else HarmLog(world, caught, crop)
        self.log = harm or ContactLog(world, caught)
        if harm is None and caught != STEM_FORCE:
            self.log.before = ContactLog(world, STEM_FORCE)
        self.stems = StemWatch(world, harm)
        self.step = p.engine.timestep
        self.every = max(round(1.0 / (record_rate * self.step)), 1)
        self.tick = max(round(1.0 / (p.control.rate * self.step)), 1)
        self.late = round(p.disturbance.command_delay / self.step)
        self.waiting: deque[tuple[FloatArray, ...]] = deque()
        self.gains = (p.control.frequency**2, 2.0 * p.control.damping_ratio * p.control.frequency)
        n = world.robot.n_segments
        # views of MuJoCo's data that every step reads or writes; from ``q`` on, the robot's alone
        data = self.data
        self.warned, self.positions, self.velocities = data.warning.number, data.qpos, data.qvel
        self.q, self.velocity = data.qpos[:n], data.qvel[:n]
        self.bias, self.applied = data.qfrc_bias[:n], data.qfrc_applied[:n]
        self.wanted, self.inertial = np.zeros((2, self.model.nv))
        self.torque, self.most_asked, self.worst_error = np.zeros((3, n))
        self.records: list[tuple[Any, ...]] = []
        self.contacts: list[FloatArray] = []
        self.steps = 0
        self.cut: StemCut | None = None
        self.warnings: tuple[str, ...] = ()
        shown, entities = world.shown, world.entities
        self.fruit_entities = np.array([f.entity for f in shown], dtype=np.int64)
        self.stem_entities = np.array([f.stem_entity for f in shown], dtype=np.int64)
        self.guarded = p.robot.guard_until > 0.0
        self.breaks = p.disturbance.breaks
        self.moving = np.array([e.kind not in ("static", "avoid") for e in entities])
        self.robot_entities = [i for i, e in enumerate(entities) if e.kind in ("link", "tool")]

    def run(self, motion: Trajectory | None = None) -> tuple[Rollout, ContactLog]:
        """Execute the motion, and stand still at its end for ``control.hold``.

        A NaN or a warning of MuJoCo ends the run.

        ``motion``: which begins where the arm is; None: that of the beginning.
        """
        p, began = self.world.parameters, self.steps
        self.motion = motion or self.motion
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
        self.begin(q[0])
        with quiet(self.mujoco):
            for k in range(total):
                if k == before + moving:
                    self.close()
                if not self.advance(q[k], rate[k], acceleration[k], q[k + 1]):
                    break
        return self.rollout((began + before + moving) * self.step), self.log

    def close(self) -> None:
        """Close the blades of a scissor, once; other tools stay open."""
        if self.cut is None and scissor_of(self.world) is not None:
            self.cut = self.stems.close(self.data)

    def begin(self, q: FloatArray) -> None:
        """Record the state at the beginning, once; ``q`` (S,) is the reference of the segments."""
        if not self.records:
            self.record(q)

    def advance(
        self, q: FloatArray, rate: FloatArray, acceleration: FloatArray, after: FloatArray
    ) -> bool:
        """One step of the engine; False after a NaN or a warning.

        The reference of the controller is ``q``, ``rate`` and ``acceleration`` (S,) of the
        segments; ``after`` (S,) is the reference position at the end of the step.
        """
        if self.late:
            q, rate, acceleration, after = self._delayed(q, rate, acceleration, after)
        if self.carriages is not None:
            self.carriages.drive(self.data, self.steps)
        for body, motion in self.movers:
            now = self.steps * self.step - self.world.parameters.engine.settle
            at = motion.at(np.array([0.0, now]))
            self.data.mocap_pos[body] = at[1] - at[0]
        self.mujoco.mj_step1(self.model, self.data)
        if self.steps % self.tick == 0:
            self._control(q, rate, acceleration)
            if self.breaks > 0.0:
                self._break_stem()
        self.mujoco.mj_step2(self.model, self.data)
        if not is_sound(self.warned, self.positions, self.velocities):
            self.warnings = self._warnings()
            return False
        np.maximum(self.worst_error, np.abs(after - self.q), out=self.worst_error)
        self.log.add(self.data)
        self.stems.tear(self.data)
        self.steps += 1
        if self.guarded and self.steps * self.step >= self.world.parameters.robot.guard_until:
            self.guarded, lid = False, self.model.geom(GUARD)
            lid.contype[0], lid.rgba[3] = 0, 0.0
        if self.steps % self.every == 0:
            self.record(after)
        return True

    def _delayed(self, *reference: FloatArray) -> tuple[FloatArray, ...]:
        """The reference of ``late`` steps ago; at first the arm stands."""
        self.waiting.append(reference)
        if len(self.waiting) > self.late:
            return self.waiting.popleft()
        first = self.waiting[0][0]
        return first, np.zeros_like(first), np.zeros_like(first), first

    def _control(self, q: FloatArray, rate: FloatArray, acceleration: FloatArray) -> None:
        n = len(q)
        stiffness, damping = self.gains
        self.wanted[:n] = acceleration + stiffness * (q - self.q) + damping * (rate - self.velocity)
        self.mujoco.mj_mulM(self.model, self.data, self.inertial, self.wanted)
        asked = self.inertial[:n] + self.bias
        limit = self.world.drives.torque
        self.torque = np.minimum(np.maximum(asked, -limit), limit)
        np.maximum(self.most_asked, np.abs(asked), out=self.most_asked)
        self.applied[:] = self.torque

    def _break_stem(self) -> None:
        """Cut the target's stem once the tool point is within ``breaks`` of the target."""
        drives, robot = self.world.drives, self.world.robot
        point = robot.tool_pose(drives.joints(self.q[None])[0])[0]
        target = next((fruit for fruit in self.world.shown if fruit.role == "target"), None)
        if target is None:
            self.breaks = 0.0
            return
        place = self.data.qpos[target.position : target.position + 3]
        if float(np.linalg.norm(place - point)) < self.breaks:
            self.stems.cut(self.data, target)
            self.breaks = 0.0

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
                data.time, data.qpos.copy(), self.velocity.copy(), self.torque, q,
                [f.weld >= 0 and bool(data.eq_active[f.weld]) for f in self.world.shown],
                forces[self.fruit_entities].max(axis=1),
                np.where(self.stem_entities >= 0, on_stems, 0.0),
            )
        )  # fmt: skip
        _, pairs, points, pushes = pressing(data, self.world, self.moving)
        record = np.full(len(pairs), len(self.records) - 1)
        self.contacts.append(np.column_stack([record, pairs, points, pushes]))

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
            cut=self.cut,
        )  # fmt: skip


@contextmanager
def quiet(mujoco: Any) -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to a file; they are read from the data instead."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


_SIGN = -1.0  # of a pull up the stem in the rows of MuJoCo's weld


class StemWatch:
    """The stems that hold a fruit, the largest pull along each, and the fruits that came off.

    ``harm``: by whose crop fruits come off; None: by the pull along the stem alone.
    """

    def __init__(self, world: World, harm: HarmLog | None = None) -> None:
        self._world, self._harm = world, harm
        self.torn: dict[str, float] = {}  # time at which each torn fruit came off, by key [s]
        self._torn_by: dict[str, float] = {}
        fruits = [fruit for fruit in world.fruits if fruit.weld >= 0]
        self._by_id = {fruit.id: fruit for fruit in fruits}
        roots = roots_of(world.scene.objects)
        size = Counter(roots.values())
        self._tops = {name: top for name, top in roots.items() if size[top] > 1}  # of trusses
        self._truss_force = world.parameters.stem.truss_force
        self._hold(fruits, np.zeros(len(fruits)))

    def _hold(self, fruits: list[Fruit], tension: FloatArray) -> None:
        self._fruits, self._tension = fruits, tension
        self._last = np.array([f.last for f in fruits], dtype=np.int64)
        self._bodies = np.array([f.body for f in fruits], dtype=np.int64)
        self._along = np.array([f.along for f in fruits]).reshape(-1, 3, 1)
        self._abscission = np.array([f.built.abscission for f in fruits], dtype=np.float64)
        names = [self._tops.get(f.id, "") for f in fruits]
        self._trusses = [
            np.array([name == top for name in names]) for top in sorted({*names} - {""})
        ]

    @property
    def tension(self) -> dict[str, float]:
        """Largest pull along each stem, by key [N]."""
        keys = [fruit.built.key for fruit in self._fruits]
        return self._torn_by | dict(zip(keys, self._tension.tolist(), strict=True))

    def tear(self, data: Any) -> None:
        """Cut the stem of each fruit that is pulled beyond its threshold."""
        count = len(self._fruits)
        if not count:
            return
        up = data.xmat.take(self._last, axis=0).reshape(-1, 3, 3) @ self._along
        # welds are the only equalities, six rows each, in order, the active ones first
        forces = data.efc_force[: 6 * count].reshape(-1, 1, 6)[:, :, :3]
        pulls = _SIGN * (forces @ up).ravel()
        np.maximum(self._tension, pulls, out=self._tension)
        gone = pulls > self._abscission
        if self._harm is not None:
            turns = data.efc_force[: 6 * count].reshape(-1, 6)[:, 3:]
            frames = data.xmat.take(self._bodies, axis=0).reshape(-1, 3, 3)
            # about the calyx; a weld's rows of turning are of half the turn, in the fruit's frame
            moments = 0.5 * np.einsum("wij,wj->wi", frames, turns)
            pull = _SIGN * forces[:, 0]
            gone = self._harm.pull(self._fruits, pull, up[:, :, 0], moments, self._abscission)
        for mine in self._trusses:  # a truss comes off whole where none of its fruits does
            if not (gone & mine).any() and float(pulls[mine].sum()) > self._truss_force:
                gone = gone | mine
        if gone.any():
            self._cut(data, gone)

    def close(self, data: Any) -> StemCut:
        """Close the blades of the scissor: fruits beyond the stems between them come off."""
        pieces, between = between_blades(self._world, data)
        beyond = carried_by(self._world, pieces)
        bodies = {
            fruit.body for fruit, is_off in zip(self._world.fruits, beyond, strict=True) if is_off
        }
        gone = np.array([fruit.body in bodies for fruit in self._fruits], dtype=np.bool_)
        off = [self._fruits[i].built.key for i in np.flatnonzero(gone)]
        if off:
            self._cut(data, gone)
            self.torn = {key: time for key, time in self.torn.items() if key not in off}
        return StemCut(tuple(off), tuple(between), float(data.time))

    def cut(self, data: Any, fruit: Fruit) -> None:
        """Cut the stem of a fruit on purpose: it does not count as torn."""
        mine = np.array([one.built.key == fruit.built.key for one in self._fruits], dtype=np.bool_)
        if mine.any():
            self._cut(data, mine)
            del self.torn[fruit.built.key]

    def _cut(self, data: Any, gone: BoolArray) -> None:
        for i in np.flatnonzero(gone):
            fruit, key = self._fruits[i], self._fruits[i].built.key
            data.eq_active[fruit.weld] = 0
            data.qfrc_applied[fruit.dofs] -= (fruit.built.grown - fruit.built.bare).ravel()
            for carrier, torque in fruit.built.carried_by.items():
                data.qfrc_applied[self._by_id[carrier].dofs] -= torque.ravel()
            self.torn[key] = float(data.time)
            self._torn_by[key] = float(self._tension[i])
        held = np.flatnonzero(~gone)
        self._hold([self._fruits[i] for i in held], self._tension[held])
