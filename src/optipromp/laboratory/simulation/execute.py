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
from optipromp.laboratory.simulation.legs import follow_legs
from optipromp.laboratory.simulation.outcome import Outcome
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.rollout import Rollout
from optipromp.laboratory.simulation.simulation import Simulation

if TYPE_CHECKING:
    from optipromp.looks.viewer.notebook import View3D


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
