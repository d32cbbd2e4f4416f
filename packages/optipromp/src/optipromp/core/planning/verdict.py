"""Status and predicted harm of a trajectory in a scene.

The judge finds violations of the whole arm. The push model predicts what the tool does to the
fruits. Both look at the trajectory from its first instant to its last. Planning, loading, checking
and reporting all call :func:`verdict`, or its parts :func:`judged` and :func:`predicted`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.judging import Judgement, Overlap
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.result import REACH, RETREAT, Plan, Said
from optipromp.core.planning.task import MOST_POINTS, Task, as_of, passages, resolve, spaced
from optipromp.core.pushing.model import Prediction, PushModel, Told
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, along
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory, read_trajectory

BELOW = PlanOptions.corridor  # [m] a height this little below the entry counts as the entry's
VALID = "reaches the target, keeps all limits, touches nothing it must not"
GUESSED = (
    f"by guessed limits: fruit {PUSH.harm.fruit_force:g} N, target {PUSH.harm.target_force:g} N, "
    f"stem {PUSH.harm.stem_force:g} N, pull {PUSH.harm.pull:g} N"
)
"""What fruits and stems bear in the push model: no source of it is cited."""
COARSE = 0.01
"""[m] where the tool moves farther between two waypoints, the curve between them is sampled."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judgement of a trajectory and the prediction of its push.

    Attributes:
        judgement: metrics and violations, of the independent judge.
        prediction: of the push; None where no model applies.
    """

    judgement: Judgement
    prediction: Prediction | None

    @property
    def status(self) -> Code:
        """START_IN_COLLISION or INVALID_PLAN with violations; else HARM_PREDICTED or ``success``.

        With a harmful push it is HARM_PREDICTED too where the tool's speed is the only violation.
        """
        if self.judgement.at_start:
            return Code.START_IN_COLLISION
        harmful = self.prediction is not None and self.prediction.harmful
        if harmful and all(v.kind == "speed" for v in self.judgement.violations):
            return Code.HARM_PREDICTED
        return Code.INVALID_PLAN if self.judgement.violations else Code.SUCCESS

    @property
    def reason(self) -> str:
        """Why the trajectory has this status."""
        if self.judgement.at_start:
            return "at the start " + "; ".join(map(str, self.judgement.at_start))
        wrong = [*map(str, self.judgement.violations)]
        if self.status is Code.HARM_PREDICTED:
            wrong.insert(0, str(self.prediction))
        return "; ".join(wrong) or VALID

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on a success: those of the judge, where the pushed fruits are passed, and which
        limits of what hangs are guesses."""
        if self.status is not Code.SUCCESS:
            return ()
        push, figures = self.prediction, self.judgement.metrics
        if push is None or not (forces := push.forces):
            return self.judgement.notes
        hangs = any(figures.stem_projection.get(name) is not None for name in forces)
        pushes = push.pushes(figures.passage)
        return (*self.judgement.notes, pushes, *([GUESSED] if hangs else []))

    @property
    def message(self) -> str:
        """The reason for the status, and the notes."""
        return Said("", self).message


def judge(
    scene: Scene | str | Path,
    trajectory: Trajectory | str | Path,
    *,
    robot: Robot | None = None,
    risk: float = PlanOptions.risk,
) -> Verdict:
    """Judge a trajectory of any origin in a scene.

    It must begin at the scene's start, if the scene states one, and begin and end at rest.

    Args:
        scene: a scene, a built-in scene's name, or a scene file.
        trajectory: of the robot, joints in the robot's order; or the file or folder of a
            trajectory (:func:`optipromp.core.trajectory.read_trajectory`).
        robot: with its tool, in place of the scene's.
        risk: share of promised successes that may be broken, see :class:`PlanOptions`.

    Raises:
        InvalidRequestError: a risk that is not between 0 and 1; joints of other names or number
            than the robot's; a file that cannot be read.
        InvalidSceneError, InvalidRobotError, StartInvalidError: wrong input.
    """
    risk = PlanOptions(risk=risk).risk
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene), robot)
    task = replace(task, risk=risk)
    if not isinstance(trajectory, Trajectory):
        robot = task.robot
        trajectory = read_trajectory(trajectory, robot.joint_names, robot.turns.as_motion)
    if trajectory.joint_names != task.robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory's joints are {', '.join(trajectory.joint_names)}; "
            f"{task.robot.name} has {', '.join(task.robot.joint_names)}"
        )
    return verdict(task, trajectory, anywhere=task.scene.start is None)


def verdict_of(plan: Plan) -> Verdict:
    """The verdict on a plan's trajectory, in the plan's scene and from the plan's start."""
    return verdict(plan.task, plan.trajectory)


def verdict(task: Task, trajectory: Trajectory, *, anywhere: bool = False) -> Verdict:
    """The verdict on a trajectory of the task's robot.

    The trajectory must begin in the task's state; with ``anywhere``, at rest in any configuration.
    """
    prediction = predicted(task, trajectory)
    judgement = judged(task, trajectory, stem_side=prediction is None, anywhere=anywhere)
    return Verdict(judgement, prediction)


Judged = TypeVar("Judged", Plan, Verdict)


def deciding(legs: Mapping[str, Judged]) -> dict[str, Judged]:
    """The legs of a pick whose status is that of the whole, by name.

    A retreat that tells a harm tells that of the whole pick. Then a reach does not fail by harm.
    """
    told = RETREAT in legs and legs[RETREAT].prediction is not None
    spared = REACH if told and legs[REACH].status is Code.HARM_PREDICTED else None
    return {name: leg for name, leg in legs.items() if name != spared}


def whole(legs: Mapping[str, Plan]) -> tuple[Code, str]:
    """Status and message of a motion of several ``legs``, by name: of the first that fails."""
    for name, leg in deciding(legs).items():
        if not leg.success:
            return leg.status, f"{name}: {leg.message}"
    (_, first), *others = legs.items()
    told = f"; then {' and '.join(name for name, _ in others)}, judged likewise" if others else ""
    return Code.SUCCESS, (first.message if first.success else VALID) + told


def judged(
    task: Task, trajectory: Trajectory, *, stem_side: bool, anywhere: bool = False
) -> Judgement:
    """The judgement of a trajectory; see :func:`verdict`."""
    state = None if anywhere else task.state
    return judging.judge(
        task.scene, task.robot, trajectory, state, stem_side=stem_side, begun=task.underway.begun
    )


def predicted(task: Task, trajectory: Trajectory) -> Prediction | None:
    """The prediction of a trajectory's push.

    The roots of pushables that move are where they are at each time. None where no model applies,
    and for a trajectory that does not move.
    """
    q = trajectory.positions
    task = as_of(task, passages(task, trajectory))
    model = None if (q == q[0]).all() else task.push_model(q[-1])
    return None if model is None else prediction(model, led(task, model, trajectory))


class PushMotion(NamedTuple):
    """The motion of the tool whose push a model predicts."""

    points: FloatArray  # (P, 3) of the tool [m]
    axes: FloatArray  # (P, 3) of the tool
    struck: Overlap | None  # deepest of the tool or the last link before the approach
    drift: Mapping[str, FloatArray]  # displacements (P, 3) of the roots that move, by id [m]

    def among(self, model: PushModel) -> PushModel:
        """The model whose roots drift as they do in this motion."""
        return model.drifting(self.drift) if self.drift else model


def led(task: Task, model: PushModel, trajectory: Trajectory) -> PushMotion:
    """The motion of a trajectory's tool that the model predicts.

    The motion before the approach is left out where it surely touches nothing. There the arm is
    faster than the tool of a push model: an object that it strikes counts as harmed.
    """
    q, points, axes, times = _followed(task.robot, trajectory)

    def moved(rows: slice, struck: Overlap | None = None) -> PushMotion:
        path, turned = spaced(points[rows], axes[rows])
        if not task.courses:
            return PushMotion(path, turned, struck, {})
        at = along(points[rows], times[rows, None], len(path))[:, 0]
        since = np.append(0.0, at[:-1])  # roots drift from time 0 on, while the tool waits
        fastest = max(course.fastest for course in task.courses.values())
        steps = np.maximum(np.ceil((at - since) * fastest / STEP), 1).astype(np.int64)
        row = np.repeat(np.arange(len(at)), steps)
        share = (np.arange(len(row)) - np.searchsorted(row, row) + 1) / steps[row]
        here = np.where(share < 1.0, np.maximum(row - 1, 0), row)
        now = since[row] + share * (at - since)[row]
        drift = {name: course.at(now) for name, course in task.courses.items()}
        return PushMotion(path[here], turned[here], struck, drift)

    if task.back is not None:
        return moved(slice(None))
    heights = points @ task.scene.frame[2] - model.candidates.entry
    below, level = (np.flatnonzero(heights <= most) for most in (-BELOW, BELOW))
    first = below[-1] + 1 if len(below) else level[-1] if len(level) else 0
    first = min(int(first), len(heights) - 2)  # of the tool's last rise from the entry
    struck = None
    before = moved(slice(first + 1)) if first else None
    if before and not before.among(model).clear(before.points, before.axes):
        by = {name: course.at(times) for name, course in task.courses.items()}
        among = task.underway.begun and judging.struck(task.scene, task.robot, q[:1], by)
        if not among:
            struck = judging.struck(task.scene, task.robot, q[: first + 1], by)
        first = 0
    return moved(slice(first, None), struck)


def harm_of(model: PushModel, motion: PushMotion) -> float:
    """The harm of a motion; where the arm strikes something before the approach, 2 thresholds."""
    if motion.struck is not None:
        return 2.0 * model.threshold
    return motion.among(model).harm(motion.points, motion.axes, model.states)


def prediction(model: PushModel, motion: PushMotion, harm: float | None = None) -> Prediction:
    """The prediction of a motion; ``harm``: its harm, where that is known."""
    if motion.struck is None:
        return motion.among(model).predict(motion.points, motion.axes, harm)
    cause = f"is struck by {motion.struck.link} before the approach"
    tell = partial(Told, motion.struck.other, cause)
    return Prediction(harm_of(model, motion), model.threshold, tell, 1.0)


def _followed(
    robot: Robot, trajectory: Trajectory
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Configurations (M, n), tool points and axes (M, 3), times (M,) of a trajectory's waypoints.

    Samples of the curve are added between waypoints whose tool points are over ``COARSE`` apart.
    """
    q = trajectory.positions
    points, axes = robot.tool_pose(q)
    parts = np.maximum(np.ceil(lengths(np.diff(points, axis=0)) / COARSE), 1.0)
    if parts.max() == 1.0 or parts.sum() > MOST_POINTS:
        return q, points, axes, trajectory.times
    row = np.repeat(np.arange(len(parts)), parts.astype(np.int64))
    share = (np.arange(len(row)) - np.searchsorted(row, row)) / parts[row]
    at = trajectory.times[row] + share * np.diff(trajectory.times)[row]
    fine, _, _ = trajectory.sample(at)
    fine[share == 0.0] = q[:-1]  # without rounding
    fine = np.vstack([fine, q[-1:]])
    return fine, *robot.tool_pose(fine), np.append(at, trajectory.times[-1])
