"""The planners of a study, and one planner's answer to a scene."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import lengths
from optipromp.core.errors import Code
from optipromp.core.planning import Plan, PlanOptions, plan, planner_names
from optipromp.core.planning.planners import make
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

STUDY_PLANNERS = (
    "straight", "promp", "i-promp", "i-promp-guard", "drift", "paper", "obstacles", "chomp",
    "opti-promp",
)  # fmt: skip


def study_planners() -> tuple[str, ...]:
    """All registered names: those of :data:`STUDY_PLANNERS` in that order, then all others."""
    known = planner_names()
    ours = tuple(name for name in STUDY_PLANNERS if name in known)
    return ours + tuple(name for name in known if name not in ours)


@dataclass(frozen=True, eq=False)
class Answer:
    """A planner's answer to a scene."""

    planner: str  # its name
    status: Code  # ``success`` only where the judge found no violation
    message: str  # the status in words
    trajectory: Trajectory | None  # to execute; None where the planner has none
    seconds: float  # wall time of planning [s]
    harm: float | None = None  # predicted harm of the push; None where no push model applies
    guard: float = 0.0  # time until which the tool's mouth is closed [s]; 0: it is open
    # predicted probability that the pick is not clean; None where it is not predicted
    failure: float | None = None
    tilt: float = 0.0  # angle between the planner's approach and the scene's [degrees]


def attempt(scene: Scene, planner: str, *, seed: int = 0, risk: float = PlanOptions.risk) -> Answer:
    """Plan a scene with a registered planner.

    ``scene``: as detected. ``planner``: one of :func:`study_planners`. ``seed``: of everything
    random. ``risk``: share of promised successes that may be broken, see :class:`PlanOptions`.
    """
    solver = make(planner)
    made = plan(scene, planner=solver, seed=seed, options=PlanOptions(risk=risk))
    moves = bool(np.ptp(made.trajectory.positions, axis=0).max() > 0.0)
    told = made.prediction
    return Answer(
        planner, made.status, made.message, made.trajectory if moves else None, made.time["total"],
        None if told is None else told.harm,
        pushed(made) if getattr(solver, "guard", False) else 0.0,
        None if told is None or math.isnan(told.probability) else told.probability,
        float(np.rad2deg(np.arccos(min(made.scene.frame[2] @ scene.frame[2], 1.0)))),
    )  # fmt: skip


def pushed(made: Plan) -> float:
    """The time at which the last push of an i-promp plan is done [s]; 0 without a push."""
    if len(made.via) < 3:  # camera, pushes, goal
        return 0.0
    points, _ = made.robot.tool_pose(made.trajectory.positions)
    return float(made.trajectory.times[np.argmin(lengths(points - made.via[-2].position))])
