"""``judge``: the judgement of any trajectory in a scene, and the predicted harm of its push."""

from dataclasses import dataclass
from pathlib import Path

from optipromp import judging
from optipromp.errors import Code, InvalidRequestError
from optipromp.judging import Judgement
from optipromp.planning.prediction import push_model, tool_motion
from optipromp.planning.task import Task, resolve
from optipromp.pushing.model import Prediction
from optipromp.robots.model import Robot
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import Scene
from optipromp.trajectory import Trajectory


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
        """INVALID_PLAN where there are violations, else HARM_PREDICTED or ``success``."""
        if self.judgement.violations:
            return Code.INVALID_PLAN
        harmful = self.prediction is not None and self.prediction.harmful
        return Code.HARM_PREDICTED if harmful else Code.SUCCESS

    @property
    def message(self) -> str:
        """The status in words."""
        if self.judgement.violations:
            return self.judgement.message
        if self.prediction is not None and self.prediction.harmful:
            return str(self.prediction)
        message = "reaches the target, keeps all limits, touches nothing it must not"
        return "; ".join([message, *(f"note: {note}" for note in self.judgement.notes)])


def judge(
    scene: Scene | str | Path, trajectory: Trajectory, *, robot: Robot | None = None
) -> Verdict:
    """Judge a trajectory of any origin in a scene.

    Args:
        scene: a scene, a built-in scene's name, or a scene file.
        trajectory: of the robot, joints in the robot's order.
        robot: with its tool, in place of the scene's.

    Raises:
        InvalidRequestError: joints of other names or number than the robot's.
        InvalidSceneError, InvalidRobotError, StartInvalidError: wrong input.
    """
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene), robot)
    if trajectory.joint_names != task.robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory's joints are {', '.join(trajectory.joint_names)}; "
            f"{task.robot.name} has {', '.join(task.robot.joint_names)}"
        )
    return verdict(task, trajectory)


def verdict(task: Task, trajectory: Trajectory) -> Verdict:
    """The verdict on a trajectory of the task's robot."""
    prediction = predicted(task, trajectory)
    judgement = judging.judge(
        task.scene, task.robot, trajectory, task.start, stem_side=prediction is None
    )
    return Verdict(judgement, prediction)


def predicted(task: Task, trajectory: Trajectory, first: int = 0) -> Prediction | None:
    """The prediction of a trajectory's push from waypoint ``first`` on.

    None where no model applies, and for a trajectory that does not move.
    """
    q = trajectory.positions
    model = None if (q == q[0]).all() else push_model(task, q[-1])
    return None if model is None else model.predict(*tool_motion(task.robot, q[first:]))
