"""Status and harm of a trajectory in a scene: the one place that tells them.

The judge tells what the whole arm violates, the model of the push what the tool does to the fruits,
both from the arm's first instant to its last. Whatever plans, loads, checks or reports takes
:func:`verdict` or its parts: :func:`judged`, which needs no model, and :func:`predicted`.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from optipromp import judging
from optipromp.arrays import FloatArray, lengths
from optipromp.errors import Code, InvalidRequestError
from optipromp.judging import Judgement
from optipromp.planning.options import PlanOptions
from optipromp.planning.result import Plan
from optipromp.planning.task import MOST_POINTS, Task, push_model, resolve, spaced
from optipromp.planning.underway import underway
from optipromp.pushing.model import Prediction, PushModel
from optipromp.robots.model import Robot
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import Scene
from optipromp.trajectory import Trajectory
from optipromp.trajectory_files import read_trajectory

BELOW = PlanOptions.corridor  # [m] under the entry's height that counts as at it
COARSE = 0.01  # [m] a tool's motion between two rows beyond which the curve between is looked at


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judgement of a trajectory and the prediction of its push.

    Attributes:
        judgement: metrics and violations, by the independent judge.
        prediction: of the push; None where no model applies.
    """

    judgement: Judgement
    prediction: Prediction | None

    @property
    def status(self) -> Code:
        """START_IN_COLLISION or INVALID_PLAN where there are violations, else HARM_PREDICTED or
        ``success``.

        A push that is predicted to harm is so too where the tool is faster than predicted for.
        """
        if self.judgement.at_start:
            return Code.START_IN_COLLISION
        harmful = self.prediction is not None and self.prediction.harmful
        if harmful and all(v.kind == "speed" for v in self.judgement.violations):
            return Code.HARM_PREDICTED
        return Code.INVALID_PLAN if self.judgement.violations else Code.SUCCESS

    @property
    def message(self) -> str:
        """The status in words."""
        if self.judgement.at_start:
            return "at the start " + "; ".join(map(str, self.judgement.at_start))
        wrong = [*map(str, self.judgement.violations)]
        if self.status is Code.HARM_PREDICTED:
            wrong.insert(0, str(self.prediction))
        if wrong:
            return "; ".join(wrong)
        message = "reaches the target, keeps all limits, touches nothing it must not"
        found = self.prediction
        pushes = "" if found is None else found.pushes(self.judgement.metrics.passage)
        notes = [*self.judgement.notes, *([pushes] if pushes else [])]
        return "; ".join([message, *(f"note: {note}" for note in notes)])


def judge(
    scene: Scene | str | Path, trajectory: Trajectory | str | Path, *, robot: Robot | None = None,
    risk: float = PlanOptions.risk,
) -> Verdict:  # fmt: skip
    """Judge a trajectory of any origin in a scene.

    It must begin at the scene's start, if the scene states one, and begin and end at rest.

    Args:
        scene: a scene, a built-in scene's name, or a scene file.
        trajectory: of the robot, joints in the robot's order; or a file or folder of one, see
            :func:`optipromp.trajectory_files.read_trajectory`.
        robot: with its tool, in place of the scene's.
        risk: share of promised successes that may be broken, see :class:`PlanOptions`.

    Raises:
        InvalidRequestError: a risk that is not between 0 and 1; joints of other names or number than the robot's; a file that cannot be
            read.
        InvalidSceneError, InvalidRobotError, StartInvalidError: wrong input.
    """
    risk = PlanOptions(risk=risk).risk
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene), robot)
    task = replace(task, risk=risk)
    if not isinstance(trajectory, Trajectory):
        trajectory = read_trajectory(trajectory, task.robot.joint_names)
    if trajectory.joint_names != task.robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory's joints are {', '.join(trajectory.joint_names)}; "
            f"{task.robot.name} has {', '.join(task.robot.joint_names)}"
        )
    return verdict(task, trajectory, anywhere=task.scene.start is None)


def verdict_of(plan: Plan) -> Verdict:
    """The verdict on a plan's trajectory, in its scene, from the state that it began in."""
    task = replace(resolve(plan.scene, plan.robot, plan.start), risk=plan.risk)
    if plan.start is not None:
        task = replace(underway(task, None, None), pushed=plan.pushed)
    return verdict(task, plan.trajectory)


def verdict(task: Task, trajectory: Trajectory, *, anywhere: bool = False) -> Verdict:
    """The verdict on a trajectory of the task's robot.

    It must begin in the task's state; with ``anywhere`` it may begin in any, at rest.
    """
    prediction = predicted(task, trajectory)
    found = judged(task, trajectory, stem_side=prediction is None, anywhere=anywhere)
    return Verdict(found, prediction)


def judged(
    task: Task, trajectory: Trajectory, *, stem_side: bool, anywhere: bool = False
) -> Judgement:
    """The judgement of a trajectory; see :func:`verdict` and :func:`optipromp.judging.judge`."""
    state = None if anywhere else task.state
    return judging.judge(
        task.scene, task.robot, trajectory, state, stem_side=stem_side, begun=task.begun
    )


def predicted(task: Task, trajectory: Trajectory) -> Prediction | None:
    """The prediction of what a trajectory's tool does to what it may push.

    None where no model applies, and for a trajectory that does not move.
    """
    q = trajectory.positions
    model = None if (q == q[0]).all() else push_model(task, q[-1])
    return None if model is None else model.predict(*led(task, model, trajectory))


def led(task: Task, model: PushModel, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Tool points and axes (P, 3) of a trajectory, as a model is led through them.

    From the arm's first instant on; but what comes before the tool's last entry into the height of
    the model's paths is left out where it surely touches nothing.
    """
    points, axes = _followed(task.robot, trajectory)
    below = np.flatnonzero(points @ task.scene.frame[2] <= model.entry - BELOW)
    first = min(int(below[-1]) + 1, len(points) - 2) if len(below) else 0
    if first and not model.clear(*spaced(points[: first + 1], axes[: first + 1])):
        first = 0
    return spaced(points[first:], axes[first:])


def _followed(robot: Robot, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Tool points and axes (M, 3) at the rows, and on the curve between rows that are far apart."""
    points, axes = robot.tool_pose(trajectory.positions)
    parts = np.maximum(np.ceil(lengths(np.diff(points, axis=0)) / COARSE), 1.0)
    if parts.max() == 1.0 or parts.sum() > MOST_POINTS:
        return points, axes
    row = np.repeat(np.arange(len(parts)), parts.astype(np.int64))
    share = (np.arange(len(row)) - np.searchsorted(row, row)) / parts[row]
    at = trajectory.times[row] + share * np.diff(trajectory.times)[row]
    q, _, _ = trajectory.sample(at)
    q[share == 0.0] = trajectory.positions[:-1]  # without rounding
    return robot.tool_pose(np.vstack([q, trajectory.positions[-1:]]))
