"""The steps of a run: the joint controller, MuJoCo, and the records."""

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.trajectory import Trajectory
from optipromp_sim.simulation.arm import GUARD
from optipromp_sim.simulation.contacts import ContactLog, is_sound, pressing
from optipromp_sim.simulation.disturbances import CARRIAGE_MASS
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.grasps import between_blades, carried_by, grip, scissor_of
from optipromp_sim.simulation.outcome import HarmLog
from optipromp_sim.simulation.parameters import STEM_FORCE
from optipromp_sim.simulation.records import Rollout, StemCut, used
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


class Reference(NamedTuple):
    """What the joint controller is asked for at one step, of the S segments."""

    q: FloatArray  # (S,)
    rate: FloatArray  # (S,)
    acceleration: FloatArray  # (S,)
    after: FloatArray  # (S,) the position at the end of the step


class JointControl:
    """Computed torque, :math:`τ = M(q)(q̈_r + ω^2 e + 2ζω ė) + b(q, q̇)`, cut at the torque limits.

    It knows the arm's masses, but neither its friction nor its contacts. A command delay gives it
    the reference of some steps ago.
    """

    def __init__(self, world: World, data: Any) -> None:
        p, n = world.parameters, world.robot.n_segments
        self._world, self._data, self._mul = world, data, engine().mj_mulM
        self._gains = p.control.frequency**2, 2.0 * p.control.damping_ratio * p.control.frequency
        self._late = round(p.disturbance.command_delay / p.engine.timestep)
        self._waiting: deque[Reference] = deque()
        # views of MuJoCo's data, of the robot alone
        self.q, self.velocity = data.qpos[:n], data.qvel[:n]
        self._bias, self._applied = data.qfrc_bias[:n], data.qfrc_applied[:n]
        self._wanted, self._inertial = np.zeros((2, world.model.nv))
        self.torque, self.most_asked, self.worst_error = np.zeros((3, n))

    def due(self, asked: Reference) -> Reference:
        """The reference that arrives now; of a late one, at first the arm stands."""
        if not self._late:
            return asked
        self._waiting.append(asked)
        if len(self._waiting) > self._late:
            return self._waiting.popleft()
        first = self._waiting[0].q
        return Reference(first, np.zeros_like(first), np.zeros_like(first), first)

    def drive(self, asked: Reference) -> None:
        """Set the torques, which hold until the next call."""
        n, (stiffness, damping) = len(asked.q), self._gains
        self._wanted[:n] = (
            asked.acceleration
            + stiffness * (asked.q - self.q)
            + damping * (asked.rate - self.velocity)
        )
        self._mul(self._world.model, self._data, self._inertial, self._wanted)
        torque = self._inertial[:n] + self._bias
        limit = self._world.drives.torque
        self.torque = np.minimum(np.maximum(torque, -limit), limit)
        np.maximum(self.most_asked, np.abs(torque), out=self.most_asked)
        self._applied[:] = self.torque

    def compare(self, after: FloatArray) -> None:
        """Note how far the segments are from where they should be, ``after`` (S,)."""
        np.maximum(self.worst_error, np.abs(after - self.q), out=self.worst_error)


class Happenings:
    """What moves, opens or breaks in a world without being touched."""

    def __init__(self, world: World, data: Any) -> None:
        p = world.parameters
        self._world, self._data, self._step = world, data, p.engine.timestep
        self._carriages = Carriages(world, data) if world.roots else None
        soft = ("static", "avoid") if p.thing.avoid_as == "soft" else ("static",)
        self._movers = [
            (int(world.model.body(f"{item.role}:{item.id}").mocapid[0]), course)
            for item, course in world.scene.movers
            if item.role in soft
        ]
        self._lid = p.robot.guard_until > 0.0
        self._breaks = p.disturbance.breaks

    def before(self, step: int) -> None:
        """Bring roots and movers to where they are at a step."""
        if self._carriages is not None:
            self._carriages.drive(self._data, step)
        for body, motion in self._movers:
            now = step * self._step - self._world.parameters.engine.settle
            at = motion.at(np.array([0.0, now]))
            self._data.mocap_pos[body] = at[1] - at[0]

    def after(self, step: int) -> None:
        """Open the mouth's lid once its time has come."""
        if self._lid and step * self._step >= self._world.parameters.robot.guard_until:
            self._lid, lid = False, self._world.model.geom(GUARD)
            lid.contype[0], lid.rgba[3] = 0, 0.0

    def broken(self, q: FloatArray) -> Fruit | None:
        """The target whose stem breaks now, once: the tool point is near; the segments at ``q``."""
        if self._breaks <= 0.0:
            return None
        world = self._world
        point = world.robot.tool_pose(world.drives.joints(q[None])[0])[0]
        target = next((fruit for fruit in world.shown if fruit.role == "target"), None)
        if target is None:
            self._breaks = 0.0
            return None
        place = self._data.qpos[target.position : target.position + 3]
        if float(np.linalg.norm(place - point)) >= self._breaks:
            return None
        self._breaks = 0.0
        return target


class Recorder:
    """The records of a run, and the log of its contacts; makes a :class:`Rollout` of them."""

    def __init__(self, world: World, data: Any, log: ContactLog, control: JointControl) -> None:
        self._world, self._data, self._control, self.log = world, data, control, log
        self.rows: list[tuple[Any, ...]] = []
        self._contacts: list[FloatArray] = []
        shown, entities = world.shown, world.entities
        self._fruits = np.array([f.entity for f in shown], dtype=np.int64)
        self._stems = np.array([f.stem_entity for f in shown], dtype=np.int64)
        self._moving = np.array([e.kind not in ("static", "avoid") for e in entities])
        self._robot = [i for i, e in enumerate(entities) if e.kind in ("link", "tool")]

    def add(self, q: FloatArray) -> None:
        """Record the present state; ``q`` (S,) is the reference position of the segments."""
        data = self._data
        forces = self.log.take_recent()
        on_stems = forces[self._stems][:, self._robot].max(axis=1)
        self.rows.append(
            (
                data.time, data.qpos.copy(), self._control.velocity.copy(), self._control.torque, q,
                [f.weld >= 0 and bool(data.eq_active[f.weld]) for f in self._world.shown],
                forces[self._fruits].max(axis=1),
                np.where(self._stems >= 0, on_stems, 0.0),
            )
        )  # fmt: skip
        _, pairs, points, pushes = pressing(data, self._world, self._moving)
        record = np.full(len(pairs), len(self.rows) - 1)
        self._contacts.append(np.column_stack([record, pairs, points, pushes]))

    def rollout(
        self, motion: float, curve: Trajectory, stems: "StemWatch", cut: StemCut | None,
        warnings: tuple[str, ...],
    ) -> Rollout:  # fmt: skip
        """The records so far; see :class:`Rollout`. ``curve``: whose rates count."""
        robot, drives = self._world.robot, self._world.drives
        columns = [np.array(column) for column in zip(*self.rows, strict=True)]
        times, states, velocity, torque, targets, attached, force, stem = columns
        q, wanted = drives.joints(states[:, : robot.n_segments]), drives.joints(targets)
        shown = self._world.shown
        points, axes = robot.tool_pose(q)
        goals, _ = robot.tool_pose(wanted)
        span = robot.upper - robot.lower
        inside = np.minimum(q - robot.lower, robot.upper - q)
        bounded = np.isfinite(span)
        position = float(np.max(1.0 - 2.0 * inside[:, bounded] / span[bounded], initial=0.0))
        torque_use = float(np.max(self._control.most_asked / drives.torque, initial=0.0))
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
            contacts=frozen(np.concatenate(self._contacts)),
            motion=motion, warnings=warnings,
            limit_use={"position": position, **used(robot, curve), "torque": torque_use},
            tension={f.id: stems.tension[f.built.key] for f in shown if f.weld >= 0},
            torn_at={f.id: stems.torn[f.built.key] for f in shown if f.built.key in stems.torn},
            tracking_error=float(np.linalg.norm(points - goals, axis=1).max()),
            joint_error=float(np.max(self._control.worst_error, initial=0.0)), cut=cut,
        )  # fmt: skip


class Execution:
    """One run in ``world`` from where ``motion`` begins, of ``record_rate`` records a second [Hz].

    ``data`` may be changed before the run.
    """

    def __init__(self, world: World, motion: Trajectory, record_rate: float) -> None:
        p, crop = world.parameters, world.scene.crop
        self.world, self.motion, self.data = world, motion, world.data(motion.positions[0])
        self.happens = Happenings(world, self.data)
        self.control = JointControl(world, self.data)
        caught = p.thresholds.stem_force
        harm = None if crop is None else HarmLog(world, caught, crop)
        log = harm or ContactLog(world, caught)
        if harm is None and caught != STEM_FORCE:
            log.before = ContactLog(world, STEM_FORCE)
        self.stems = StemWatch(world, harm)
        self.records = Recorder(world, self.data, log, self.control)
        self.step, self.steps = p.engine.timestep, 0
        self.every = max(round(1.0 / (record_rate * self.step)), 1)
        self.tick = max(round(1.0 / (p.control.rate * self.step)), 1)
        self._mujoco = engine()
        self._watched = self.data.warning.number, self.data.qpos, self.data.qvel  # views
        self.cut: StemCut | None = None
        self.warnings: tuple[str, ...] = ()

    def run(self, motion: Trajectory | None = None) -> Rollout:
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
        with quiet():
            for k in range(total):
                if k == before + moving:
                    self.close()
                if not self.advance(Reference(q[k], rate[k], acceleration[k], q[k + 1])):
                    break
        return self.rollout((began + before + moving) * self.step)

    def hold(self, asked: Reference) -> bool:
        """One period of the controller with one reference; False after a NaN or a warning."""
        self.begin(self.control.q.copy())
        with quiet():
            return all(self.advance(asked) for _ in range(self.tick))

    def close(self) -> None:
        """Close the blades of a scissor, once, and hold a target that was cut; others stay open."""
        if self.cut is None and scissor_of(self.world) is not None:
            self.cut, taken = self.stems.close(self.data), self.world.scene.taken
            for fruit in self.world.shown:
                if fruit.role == "target" and {item.id for item in taken} <= {*self.cut.stems}:
                    grip(self.world, self.data, fruit)

    def begin(self, q: FloatArray) -> None:
        """Record the state at the beginning, once; ``q`` (S,) is the reference of the segments."""
        if not self.records.rows:
            self.records.add(q)

    def advance(self, asked: Reference) -> bool:
        """One step of the engine; False after a NaN or a warning."""
        asked, model, data = self.control.due(asked), self.world.model, self.data
        self.happens.before(self.steps)
        self._mujoco.mj_step1(model, data)
        if self.steps % self.tick == 0:
            self.control.drive(asked)
            if (fruit := self.happens.broken(self.control.q)) is not None:
                self.stems.cut(data, fruit)
        self._mujoco.mj_step2(model, data)
        if not is_sound(*self._watched):
            self.warnings = self._warnings()
            return False
        self.control.compare(asked.after)
        self.records.log.add(data)
        self.stems.tear(data)
        self.steps += 1
        self.happens.after(self.steps)
        if self.steps % self.every == 0:
            self.records.add(asked.after)
        return True

    def _warnings(self) -> tuple[str, ...]:
        data = self.data
        found = [
            f"{name.removeprefix('mjWARN_').lower()} at {data.time:.3f} s"
            for name, kind in self._mujoco.mjtWarning.__members__.items()
            if name != "mjNWARNING" and data.warning[int(kind)].number > 0
        ]
        if not found and not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            found = [f"not a number at {data.time:.3f} s"]
        return tuple(found)

    def rollout(self, motion: float) -> Rollout:
        """The records, of a motion that ended at ``motion`` [s]."""
        return self.records.rollout(motion, self.motion, self.stems, self.cut, self.warnings)


@contextmanager
def quiet() -> Iterator[None]:
    """Keep MuJoCo from writing its warnings to a file; they are read from the data instead."""
    engine().set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        engine().set_mju_user_warning(None)


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
        roots, size = world.scene.tops, Counter(world.scene.tops.values())
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
        """Close the blades of the scissor: fruits beyond the stems between them come off.

        Those of a truss that comes off whole stay on its stem.
        """
        pieces, between = between_blades(self._world, data)
        beyond = carried_by(self._world, pieces)
        bodies = {
            fruit.body for fruit, is_off in zip(self._world.fruits, beyond, strict=True) if is_off
        }
        gone = np.array([fruit.body in bodies for fruit in self._fruits], dtype=np.bool_)
        off = [self._fruits[i].built.key for i in np.flatnonzero(gone)]
        own = {item.id for item in self._world.scene.taken}
        if len(own) > 1:
            mine = np.array([fruit.id in own for fruit in self._fruits], dtype=np.bool_)
            gone &= ~(mine & gone[mine].all())
        self._cut(data, gone, torn=False)
        return StemCut(tuple(off), tuple(between), float(data.time))

    def cut(self, data: Any, fruit: Fruit) -> None:
        """Cut the stem of a fruit on purpose: it does not count as torn."""
        mine = np.array([one.built.key == fruit.built.key for one in self._fruits], dtype=np.bool_)
        self._cut(data, mine, torn=False)

    def _cut(self, data: Any, gone: BoolArray, *, torn: bool = True) -> None:
        for i in np.flatnonzero(gone):
            fruit, key = self._fruits[i], self._fruits[i].built.key
            data.eq_active[fruit.weld] = 0
            data.qfrc_applied[fruit.dofs] -= (fruit.built.grown - fruit.built.bare).ravel()
            for carrier, torque in fruit.built.carried_by.items():
                data.qfrc_applied[self._by_id[carrier].dofs] -= torque.ravel()
            if torn:
                self.torn[key] = float(data.time)
            self._torn_by[key] = float(self._tension[i])
        held = np.flatnonzero(~gone)
        self._hold([self._fruits[i] for i in held], self._tension[held])
