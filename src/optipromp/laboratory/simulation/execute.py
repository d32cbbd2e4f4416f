"""``simulate``: the entry point of the simulation."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import Plan
from optipromp.core.planning.legs import Picked
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.shown import Shown
from optipromp.core.trajectory import Trajectory
from optipromp.laboratory.simulation.outcome import Outcome
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.rollout import Rollout
from optipromp.laboratory.simulation.simulation import Simulation

if TYPE_CHECKING:
    from optipromp.looks.viewer.notebook import View3D
from dataclasses import replace

import numpy as np

from optipromp.control.controller import Controller
from optipromp.control.driver import scene_of, target_row, way_back
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import Code, OptiPrompError
from optipromp.core.planning.legs import AFTER, CARRY, after
from optipromp.core.planning.task import resolve
from optipromp.core.trajectory import State
from optipromp.laboratory.simulation.outcome import Cause


@dataclass(frozen=True, eq=False, repr=False)
class Run(Shown):
    """An executed plan.

    Attributes:
        scene: in which the plan was executed.
        robot: with its tool.
        parameters: of the physics.
        seed: of everything random.
        rollout: the records of the run.
        outcome: the judgement of the run.
        seconds: wall time, building the world included.
    """

    scene: Scene
    robot: Robot
    parameters: SimulationParameters
    seed: int
    rollout: Rollout
    outcome: Outcome
    seconds: float

    @property
    def success(self) -> bool:
        """Whether the target alone is in the tool and nothing was harmed."""
        return self.outcome.success

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time."""
        return float(self.rollout.times[-1]) / max(self.seconds, 1e-9)

    def _words(self) -> str:
        return f"in {self.scene.name}: {self.outcome.told}, {self.outcome.duration:.2f} s"

    def _table(self) -> Sequence[tuple[str, str]]:
        from optipromp.laboratory.simulation.words import run_rows

        return [("message", self.outcome.message), *run_rows(self)]

    def show(self) -> "View3D":
        """A 3-D view for notebooks: arm, fruits and stems as they moved, to turn and play.

        ``open()`` opens it in a browser. ``save(path)`` writes one HTML file that needs no network.

        Raises:
            InvalidRequestError: viser is not installed.
        """
        from optipromp.laboratory.simulation.words import run_page
        from optipromp.looks.viewer.notebook import View3D

        return View3D(run_page(self))


def simulate(
    plan_or_trajectory: Plan | Picked | Trajectory,
    scene: Scene | None = None,
    *,
    robot: Robot | None = None,
    parameters: SimulationParameters | None = None,
    seed: int = 0,
    record_rate: float = 100.0,
    failed_leg: bool = False,
) -> Run:
    """Execute a plan in the simulation and judge the run.

    Args:
        plan_or_trajectory: what to execute, whatever its status. Of a pick in several legs, all
            legs up to the one that failed; the outcome then says whether the target was placed.
        scene: the true scene; None: the scene of the plan. Another scene than the plan's shows the
            effect of detection errors.
        robot: with its tool; None: that of the plan, or of the scene of a bare trajectory.
        parameters: physical numbers, controller, thresholds.
        seed: of everything random. The same input and seed give the same run to the last bit.
        record_rate: of the rollout's records [Hz].
        failed_leg: of a pick, whether the best trajectory of the leg that failed is executed, too.

    Returns:
        The run. The outcome of a failed run names the cause; only wrong input raises.

    Raises:
        InvalidRequestError: MuJoCo is not installed, no scene for a bare trajectory, joint names
            that are not the robot's, a rate that is not positive.
        InvalidSceneError: something in the scene cannot be built.
    """
    began = time.perf_counter()
    parameters = parameters or SimulationParameters()
    picked = plan_or_trajectory if isinstance(plan_or_trajectory, Picked) else None
    given = plan_or_trajectory.reach if isinstance(plan_or_trajectory, Picked) else (
        plan_or_trajectory
    )  # fmt: skip
    if isinstance(given, Plan):
        trajectory = given.trajectory
        scene, robot = scene or given.scene, robot or given.robot
    else:
        trajectory = given
    if scene is None:
        raise InvalidRequestError("a bare trajectory needs the scene it is to be executed in")
    robot = robot or posed(scene)[0]
    if trajectory.joint_names != robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; {robot.name} has "
            f"{', '.join(robot.joint_names)}"
        )
    motion = trajectory.slowed(1.0 / parameters.control.speed)
    simulation = Simulation(
        scene, seed, parameters, robot=robot, q=motion.positions[0], record_rate=record_rate
    )
    if picked is None:
        rollout, outcome = simulation.follow(motion)
    else:
        rollout, outcome = follow_legs(simulation, picked, failed_leg)
    return Run(scene, robot, parameters, seed, rollout, outcome, time.perf_counter() - began)


def follow_legs(
    simulation: Simulation, picked: Picked, failed_leg: bool = False
) -> tuple[Rollout, Outcome]:
    """Execute the legs of a pick one after the other, and judge the whole; see :func:`go_on`."""
    slower = 1.0 / simulation.parameters.control.speed
    done = simulation.follow(picked.reach.trajectory.slowed(slower))
    return go_on(simulation, picked, *done, failed_leg)


def go_on(
    simulation: Simulation, picked: Picked, rollout: Rollout, outcome: Outcome,
    failed_leg: bool = False,
) -> tuple[Rollout, Outcome]:  # fmt: skip
    """Execute the legs after an executed reach, of which records and judgement are given.

    If the reach picked the target, the stem of the target is cut and the target is held where it is
    in the tool. No leg is executed after a reach that did not pick it. A leg whose plan failed is
    executed with ``failed_leg`` only; without it the run ends before that leg. The target is
    *placed* where its centre is within ``thresholds.placed`` of its place at the end of the carry.
    """
    slower, done = 1.0 / simulation.parameters.control.speed, replace(outcome, placed=False)
    if outcome.success and outcome.picked is not False:
        simulation.grip()
        for name in AFTER:
            leg = picked.legs.get(name)
            if leg is not None and (leg.success or failed_leg):
                rollout, outcome = simulation.follow(leg.trajectory.slowed(slower))
        done = replace(outcome, placed=False)
    if not picked.success:
        return rollout, _unplaced(done, f"of the plan, {picked.message} ({picked.status})")
    if not done.success:
        return rollout, done
    off, limit = _off(simulation, picked, rollout), simulation.parameters.thresholds.placed
    if off is None:
        return rollout, done
    if off > limit:
        message = f"the target ends {1e3 * off:.1f} mm from its place"
        return rollout, replace(_unplaced(done, message), message=message, placed_off=off)
    message = f"{outcome.message}; it was brought to its place, {1e3 * off:.1f} mm off"
    return rollout, replace(outcome, placed=True, placed_off=off, message=message)


def bring(
    simulation: Simulation, controller: Controller, q: FloatArray, done: tuple[Rollout, Outcome]
) -> tuple[Rollout, Outcome, Picked | None]:
    """Retreat and carry after a reach in closed loop, in the scene as it is tracked by then.

    ``simulation``: at the end of the reach. ``controller``: at the end of the reach. ``q``: (k, n)
    commanded configurations of the reach from its last plan on. ``done``: records and judgement of
    the reach.

    Returns: Records and judgement of the whole, and the pick; None where the reach did not succeed.
    """
    rollout, outcome = done
    if not (outcome.success and controller.plans):
        return rollout, replace(outcome, placed=False), None
    made, robot = controller.plans[-1], controller.robot
    tracked = controller.tracker.at(simulation.time)
    seen = target_row(tracked) is not None
    scene = scene_of(controller.scene, tracked) if seen else made.scene
    curve = way_back(robot, q, controller.parameters.retreat_speed)
    task = replace(resolve(scene, robot, State(curve.positions[0])), risk=made.risk)
    reach: Plan = replace(
        made, task=task, status=Code.SUCCESS, reason="executed in closed loop", notes=(),
        trajectory=curve, initial=curve, followed=curve, first=0,
    )  # fmt: skip
    try:
        picked = after(reach)
    except OptiPrompError as error:
        return rollout, _unplaced(outcome, f"no way to the place: {error.message}"), None
    return *go_on(simulation, picked, rollout, outcome), picked


def _unplaced(outcome: Outcome, why: str) -> Outcome:
    """The outcome of a pick whose target was not brought to its place."""
    causes = (*outcome.causes, Cause.NOT_PLACED)
    return replace(
        outcome, success=False, cause=causes[0], causes=causes, placed=False,
        message=f"{why}; executed until then: {outcome.message}",
    )  # fmt: skip


def _off(simulation: Simulation, picked: Picked, rollout: Rollout) -> float | None:
    """Distance of the target's centre from its place at the end [m]; None without a carry.

    The place of the centre is that which the last leg plans for: the pose in which the tool took
    the target, carried along.
    """
    target, place = picked.reach.scene.target, picked.reach.scene.place
    if target is None or place is None or CARRY not in picked.legs:
        return None
    (*_, last) = picked.legs.values()
    held = next(one for one in last.scene.attached if one.id == target.id)
    robot, q = picked.reach.robot, last.trajectory.positions[-1]
    _, turns = robot.segment_frames(q)
    tip, _ = robot.tool_pose(q)
    wanted = tip + turns[-1] @ robot.tool_rotation @ held.position
    row = rollout.fruit_ids.index(target.id)
    return float(np.linalg.norm(rollout.fruit_positions[-1, row] - wanted))
