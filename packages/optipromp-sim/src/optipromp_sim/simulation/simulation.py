"""``Simulation``: a scene in MuJoCo that is stepped by references of the joint controller."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, frozen
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.executor import Follower, Guard
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_sim.simulation.contacts import HarmSoFar, harm_so_far, in_tool, pressing
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.grasps import (
    between_blades,
    carried_by,
    grip,
    on_lip,
    scissor_of,
    suction_of,
)
from optipromp_sim.simulation.outcome import Outcome, judge
from optipromp_sim.simulation.parameters import SimulationParameters
from optipromp_sim.simulation.records import Rollout
from optipromp_sim.simulation.steps import Execution, Reference
from optipromp_sim.simulation.world import GRIP, World, build


class FruitStates(NamedTuple):
    """The F targets and pushables at one time, in the robot's base frame.

    Attributes:
        ids, roles: of the scene's objects.
        positions: (F, 3) [m].
        rotations: (F, 3, 3) local to base.
        velocities: (F, 3) [m/s].
        attached: (F,) whether each hangs on its stem; False without a stem.
        stem_ends: F arrays (N+1, 3), the joints and the end of each stem, root first [m]; (0, 3)
            without a stem.
    """

    ids: tuple[str, ...]
    roles: tuple[str, ...]
    positions: FloatArray
    rotations: FloatArray
    velocities: FloatArray
    attached: BoolArray
    stem_ends: tuple[FloatArray, ...]


class Touch(NamedTuple):
    """A contact point.

    Attributes:
        first, second: labels of the entities (``link:NAME``, ``tool:NAME``, ``fruit:ID``,
            ``thing:ID``, ``stem:ID``, ``static:ID`` or ``avoid:ID``).
        point: (3,) in the robot's base frame [m].
        force: (3,) of the first entity on the second [N].
    """

    first: str
    second: str
    point: FloatArray
    force: FloatArray


class Simulation:
    """A scene in MuJoCo, with an arm that follows one reference a period of its controller.

    :func:`simulate` and :class:`SimulatedArm` run on it.

    Args:
        scene: robot and objects.
        seed: of everything random. The same references give the same run to the last bit.
        parameters: of the physics; None: the defaults.
        robot: with its tool; None: the scene's.
        q: (n,) where the arm stands at first [rad or m]; None: the scene's start.
        record_rate: of the rollout's records [Hz].

    Attributes:
        scene, robot, parameters, seed: see above. ``world.scene`` is the true scene, disturbances
            included, in the frame where the arm believes its base to be.
        reference: the last one of the controller.

    Raises:
        InvalidRequestError: MuJoCo is not installed, or a rate that is not positive.
        InvalidSceneError: something in the scene cannot be built.
        StartInvalidError: a start that the robot does not have.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        parameters: SimulationParameters | None = None,
        *,
        robot: Robot | None = None,
        q: FloatArray | None = None,
        record_rate: float = 100.0,
    ) -> None:
        if not (np.isfinite(record_rate) and record_rate > 0):
            raise InvalidRequestError(f"record_rate is {record_rate}; it must be above 0 [Hz]")
        if robot is None or q is None:
            robot, state = posed(scene, robot)
            q = state.q if q is None else q
        self.scene, self.robot, self.seed = scene, robot, seed
        self._start, self._record_rate = frozen(q), record_rate
        self._world = build(scene, robot, parameters, seed)
        self.parameters = self._world.parameters
        self._begin(self._start)

    def _begin(self, q: FloatArray) -> None:
        still = Trajectory.through(np.tile(q, (2, 1)), 1.0, self.robot.joint_names)
        self._run = Execution(self._world, still, self._record_rate)
        self.reference = State(q)
        self._scratch: Any = None

    @property
    def world(self) -> World:
        """The model of MuJoCo, and what its parts stand for."""
        return self._world

    @property
    def data(self) -> Any:
        """The present ``MjData`` of ``world.model``; another after a reset."""
        return self._run.data

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self._run.data.time)

    @property
    def tick(self) -> float:
        """Time that one step takes, the period of the controller [s]."""
        return self._run.tick * self._run.step

    @property
    def broken(self) -> bool:
        """Whether the physics broke down: MuJoCo warned, or a value is not finite."""
        return bool(self._run.warnings)

    def reset(self, seed: int | None = None, q: FloatArray | None = None) -> State:
        """Begin anew.

        Args:
            seed: None: the same again. Another seed builds another world.
            q: (n,) where the arm stands [rad or m]; None: where it stood at first.

        Returns:
            The state of the arm.
        """
        another = seed is not None and seed != self.seed
        fingers = self.robot.tool is not None and self.robot.tool.fingers
        gone = self.parameters.robot.guard_until > 0.0  # a guard goes in a run
        if another or gone or (fingers and self._grips()):
            self.seed = self.seed if seed is None else seed
            self._world = build(self.scene, self.robot, self.parameters, self.seed)
        self._begin(self._start if q is None else frozen(q))
        return self.state()

    def step(self, reference: State) -> State:
        """Let the arm follow a reference for one period of its controller.

        Args:
            reference: position, velocity and acceleration of the n joints at the present time.

        Returns:
            The measured state at the end.

        Raises:
            ExecutionError: the physics broke down, now or before.
        """
        self.reference = reference
        if self.broken or not self._step():
            raise ExecutionError(f"the simulation broke down: {'; '.join(self._run.warnings)}")
        return self.state()

    def _step(self) -> bool:
        """One period of the controller; False after a warning of the engine."""
        drives, asked = self._world.drives, self.reference
        q = drives.segments(asked.q[None])[0]
        rate = drives.segments(asked.velocity[None], rates=True)[0]
        gain = drives.segments(asked.acceleration[None], rates=True)[0]
        return self._run.hold(Reference(q, rate, gain, q))

    def follow(self, motion: Trajectory) -> tuple[Rollout, Outcome]:
        """Execute a motion that begins where the arm is, and judge all that happened so far.

        The arm then stands still for ``control.hold``. The references are samples of the motion at
        every step of the engine.
        """
        self.reference = State(motion.positions[-1])
        rollout = self._run.run(motion)
        return rollout, judge(self._world, rollout, self._run.records.log)

    def grip(self) -> None:
        """Cut the stem of the target and hold the target (:func:`.grasps.grip`).

        A scissor closes, and holds the target if its stem is between the blades.

        Raises:
            InvalidRequestError: the scene has no target, or the robot no tool.
        """
        run, world = self._run, self._world
        target = next((fruit for fruit in world.shown if fruit.role == "target"), None)
        if target is None or self.robot.tool is None:
            raise InvalidRequestError(f"{self.scene.name} has no target or tool: no grip")
        if scissor_of(world) is not None:
            run.close()
            return
        run.stems.cut(run.data, target)
        grip(world, run.data, target)

    def close(self) -> None:
        """Hold the target, as :meth:`grip` does, if it is in the tool and not held already."""
        target = self.scene.target
        if target is not None and target.id in self.held() and not self._grips():
            self.grip()

    def _grips(self) -> bool:
        if self.robot.tool is None or self.scene.target is None:
            return False
        return bool(self._run.data.eq_active[self._world.model.equality(GRIP).id])

    def state(self) -> State:
        """Measured positions and velocities of the joints; the acceleration is the reference's."""
        drives, run = self._world.drives, self._run
        q = drives.joints(run.control.q[None])[0]
        velocity = drives.joints(run.control.velocity[None], rates=True)[0]
        return State(q, velocity, self.reference.acceleration)

    def fruits(self) -> FruitStates:
        """The targets and pushables now."""
        data, shown = self._run.data, self._world.shown
        at = [f.position for f in shown]
        return FruitStates(
            tuple(f.id for f in shown),
            tuple(f.role for f in shown),
            frozen(np.array([data.qpos[k : k + 3] for k in at]).reshape(-1, 3)),
            frozen(
                np.array([from_quaternion(data.qpos[k + 3 : k + 7]) for k in at]).reshape(-1, 3, 3)
            ),
            frozen(np.array([data.qvel[f.spin : f.spin + 3] for f in shown]).reshape(-1, 3)),
            frozen([f.weld >= 0 and bool(data.eq_active[f.weld]) for f in shown], np.bool_),
            self._stems(),
        )

    def _stems(self) -> tuple[FloatArray, ...]:
        """See :attr:`FruitStates.stem_ends`. MuJoCo's own places of bodies are a step old."""
        model, mujoco = self._world.model, engine()
        if self._scratch is None:
            self._scratch = mujoco.MjData(model)
        now = self._scratch
        now.qpos[:] = self._run.data.qpos
        mujoco.mj_kinematics(model, now)
        return tuple(frozen(fruit.stem(now)) for fruit in self._world.shown)

    def contacts(self) -> tuple[Touch, ...]:
        """The contact points of the last step."""
        names = [entity.label for entity in self._world.entities]
        _, pairs, points, forces = pressing(self._run.data, self._world)
        return tuple(
            Touch(names[a], names[b], frozen(point), frozen(force))
            for (a, b), point, force in zip(pairs, points, forces, strict=True)
        )

    def harm(self) -> HarmSoFar:
        """What was harmed so far."""
        return harm_so_far(self._world, self._run.records.log, len(self._run.stems.torn))

    def held(self) -> tuple[str, ...]:
        """The targets and pushables that the tool holds now; of a scissor, would cut off now."""
        world, q, now = self._world, self.state().q[None], self._run.data.qpos[None]
        if scissor_of(world) is not None:
            if self._run.cut is not None:
                return self._run.cut.stems if self._grips() else ()
            within = carried_by(world, between_blades(world, self._run.data)[0]).tolist()
            return tuple(each.id for each, own in zip(world.fruits, within, strict=True) if own)
        if suction_of(world) is not None:
            _, *found = pressing(self._run.data, world)
            touching = np.column_stack([np.zeros(len(found[0])), *found])
            poses = self.robot.tool_pose(q)
            return tuple(
                each.id for each in world.shown if on_lip(world, touching, *poses, each).item()
            )
        return tuple(each.id for each in world.shown if in_tool(world, q, now, each).item())

    def wrench(self) -> FloatArray:
        """(6,) of the world on the tool in the last step, in the robot's base frame.

        Force [N], and torque about the tool point [N m]. For a robot without a tool: on its last
        link. Of contacts, and the weight of a target that is gripped; without weight and inertia of
        the tool.
        """
        run, entities = self._run, self._world.entities
        kind = [e.kind == "tool" or (self.robot.tool is None and e.distal) for e in entities]
        mine = np.array(kind)
        found = pressing(run.data, self._world)
        tool, _ = self.robot.tool_pose(self.state().q)
        total, six, gripped = np.zeros((2, 3)), np.zeros(6), -1
        if self._grips():
            held = next(fruit for fruit in self._world.shown if fruit.role == "target")
            model = self._world.model
            gripped = [e.label for e in entities].index(f"fruit:{held.id}")
            force = model.body_subtreemass[held.body] * model.opt.gravity
            total += force, np.cross(run.data.xipos[held.body] - tool, force)
        for row, pair, point, force in zip(*found, strict=True):
            if not mine[pair].any() or gripped in pair:
                continue
            engine().mj_contactForce(self._world.model, run.data, row, six)
            turning = six[3:] @ run.data.contact[row].frame.reshape(3, 3)  # of spin and rolling
            sign = 1.0 if mine[pair[1]] else -1.0
            total += sign * np.array([force, np.cross(point - tool, force) + turning])
        return frozen(total.ravel())

    def rollout(self, motion: float | None = None) -> Rollout:
        """The records so far, of a motion that ended at the time ``motion`` [s]; None: now."""
        self._run.begin(self._run.control.q.copy())
        return self._run.rollout(self.time if motion is None else motion)

    def outcome(self) -> Outcome:
        """Stand still for ``control.hold`` at the last reference, then judge all that happened."""
        self.reference = State(self.reference.q)
        moved, control = self.time, self.parameters.control
        self._run.close()
        for _ in range(round(control.hold * control.rate)):
            if self.broken or not self._step():
                break
        self._run.begin(self._run.control.q.copy())
        return judge(self._world, self._run.rollout(moved), self._run.records.log)


class SimulatedArm(Follower):
    """An arm in the simulation of a scene; fruits hang, swing and tear as in ``simulate``.

    Args:
        scene: in which the arm moves, from the scene's start.
        robot: with its tool; None: the scene's.
        parameters: of the physics.
        guard: when to refuse a motion and when to stop.
        seed: of everything random.
        real_time: whether a simulated second takes a second; else it takes as long as it needs.

    Attributes:
        simulation: in which the arm moves.

    Raises:
        InvalidRequestError: MuJoCo is not installed.
        InvalidSceneError: something in the scene cannot be built.
    """

    def __init__(
        self,
        scene: Scene,
        robot: Robot | None = None,
        parameters: SimulationParameters | None = None,
        guard: Guard | None = None,
        *,
        seed: int = 0,
        real_time: bool = False,
    ) -> None:
        self.simulation = Simulation(scene, seed, parameters, robot=robot)
        super().__init__(self.simulation.robot, guard)
        self._real_time = real_time

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time

    def state(self) -> State:
        """Simulated positions and velocities; the acceleration is the commanded one."""
        return self.simulation.state()

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        """See :class:`Follower`."""
        yield self._ticks()

    def command(self, reference: State) -> None:
        """See :class:`Follower`."""
        self.simulation.reference = reference

    def _ticks(self) -> Iterator[float]:
        began, wall = self.time, time.perf_counter()
        while True:
            yield self.time - began
            with suppress(ExecutionError):
                self.simulation.step(self.simulation.reference)
            if self.simulation.broken:
                return
            if self._real_time:
                time.sleep(max(0.0, self.time - began - (time.perf_counter() - wall)))

    def outcome(self) -> Outcome:
        """Stand still for ``control.hold``, then judge all that happened so far."""
        return self.simulation.outcome()
