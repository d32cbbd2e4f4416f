"""The results of planning: stages of an optimisation, an outcome, a plan, a verdict."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optipromp import judging
from optipromp.arrays import FloatArray
from optipromp.errors import Code, InvalidRequestError
from optipromp.files import plain
from optipromp.judging import Judgement, Metrics, Overlap
from optipromp.planning.options import Planner, PlanOptions, Strategy
from optipromp.planning.task import Task, push_model, resolve, tool_motion
from optipromp.pushing.model import Prediction
from optipromp.robots.model import Robot
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import PoseGoal, Scene
from optipromp.shown import Shown
from optipromp.trajectory import Trajectory
from optipromp.trajectory_files import read_trajectory

BELOW = PlanOptions.corridor  # [m] under the camera point's height that counts as at it


@dataclass(frozen=True)
class Stage:
    """One run of a solver.

    Attributes:
        name: ``push``, ``collision`` or ``joint``.
        solver: its name.
        terms: names of what it minimises.
        history: value of every term after each iteration, the initial one first.
        seconds: wall time.
        message: why it stopped.
        trust_radius: first trust radius, of a push stage of the sequential strategy [rad].
        tried_radii: the radii tried, up to the one that was kept; all, where none was valid.
    """

    name: str
    solver: str
    terms: tuple[str, ...]
    history: tuple[Mapping[str, float], ...]
    seconds: float
    message: str
    trust_radius: float | None = None
    tried_radii: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class ViaPoint:
    """A point that the primitive was conditioned on: ``name``, and ``position`` (3,) [m]."""

    name: str
    position: FloatArray


@dataclass(frozen=True, eq=False)
class Planned:
    """The outcome of a planner: three trajectories, and what was done between them.

    Attributes:
        primitive: the conditioned ProMP.
        followed: the conditioned ProMP, led along the tool path; without a path, equal to
            ``primitive``.
        trajectory: the optimised one.
        first: index of the first waypoint on the approach.
        stages: of the optimisation.
        optimised: whether an optimisation took place.
        time: by stage [s].
        judgement: of the trajectory; None where it is not judged yet.
        prediction: of its push; None where it is not predicted yet.
        via: points of the tool that the primitive was conditioned on, the target last.
    """

    primitive: Trajectory
    followed: Trajectory
    trajectory: Trajectory
    first: int
    stages: tuple[Stage, ...]
    optimised: bool
    time: Mapping[str, float]
    judgement: Judgement | None = None
    prediction: Prediction | None = None
    via: tuple[ViaPoint, ...] = ()


@dataclass(frozen=True)
class Term:
    """One functional of a plan, without its weight.

    Attributes:
        initial: value at the conditioned ProMP.
        followed: value at the followed trajectory.
        final: value at the returned trajectory.
        history: values over the iterations of ``stage``, the initial value first.
        stage: name of the stage that minimises it; empty where none does.
    """

    initial: float
    followed: float
    final: float
    history: tuple[float, ...]
    stage: str


class Terms(Mapping[str, Term]):
    """Functionals by name, computed when they are first read, because few users read them."""

    def __init__(self, compute: Callable[[], dict[str, Term]]) -> None:
        self._compute: Callable[[], dict[str, Term]] | None = compute
        self._values: dict[str, Term] = {}

    def _known(self) -> dict[str, Term]:
        if self._compute is not None:
            self._values, self._compute = self._compute(), None
        return self._values

    def __getitem__(self, name: str) -> Term:
        return self._known()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known())

    def __len__(self) -> int:
        return len(self._known())

    def __repr__(self) -> str:
        return repr(self._known())

    def __reduce__(self) -> tuple[type[dict[str, Term]], tuple[dict[str, Term]]]:
        return dict, (self._known(),)


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A plan: a trajectory, its metrics, and whether it is a success.

    It keeps three trajectories: ``initial`` is the conditioned ProMP, ``followed`` is the ProMP led
    along the tool path, ``trajectory`` is the optimised one.

    Attributes:
        scene: what was planned for.
        robot: the scene's robot with its tool.
        planner: ``promp``, ``i-promp`` or ``opti-promp``.
        strategy: of opti-promp.
        seed: of everything random.
        status: ``success`` only if the judge found nothing wrong and no harm is predicted.
        message: the reasons for the status.
        trajectory: the best one found, whatever the status.
        initial: the conditioned ProMP.
        followed: the ProMP led along the tool path; equal to ``initial`` where there is no path.
        prediction: the predicted harm of the push; None where no push model applies.
        metrics: see :class:`optipromp.judging.Metrics`.
        terms: ``static``, ``avoid``, ``push``, ``velocity``; computed when first read.
        stages: optimisation stages in the order they ran.
        contacts: pairs that touch but must not.
        time: ``total`` and per stage [s].
        first: index of the first waypoint on the approach.
        via: points of the tool that ``promp`` and ``i-promp`` conditioned the primitive on.
        pushed: tool points and axes (P, 3) of the push that came before, where the plan goes on
            with one that ran.
    """

    scene: Scene
    robot: Robot
    planner: Planner
    strategy: Strategy | None
    seed: int
    status: Code
    message: str
    trajectory: Trajectory
    initial: Trajectory
    followed: Trajectory
    prediction: Prediction | None
    metrics: Metrics
    terms: Mapping[str, Term]
    stages: tuple[Stage, ...]
    contacts: tuple[Overlap, ...]
    time: Mapping[str, float] = field(default_factory=dict)
    first: int = 0
    via: tuple[ViaPoint, ...] = ()
    pushed: tuple[FloatArray, FloatArray] | None = None

    def _words(self) -> str:
        strategy = f" {self.strategy}" if self.strategy else ""
        return (
            f"{self.scene.name}, {self.planner}{strategy}: {self.status}, "
            f"{self.trajectory.duration:.2f} s"
        )

    @property
    def success(self) -> bool:
        """Whether the status is ``success``."""
        return self.status == Code.SUCCESS

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON."""
        document = {
            "scene": self.scene.name,
            "planner": self.planner,
            "strategy": self.strategy,
            "seed": self.seed,
            "status": self.status,
            "message": self.message,
            "metrics": self.metrics.to_dict(),
            "terms": {name: vars(term) for name, term in self.terms.items()},
            "stages": [vars(stage) for stage in self.stages],
            "predicted_harm": None if self.prediction is None else vars(self.prediction),
            "contacts": [vars(contact) for contact in self.contacts],
            "time": self.time,
            "first": self.first,
            "via": [vars(via) for via in self.via],
        }
        return dict(plain(document))


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
        found = self.prediction
        if found is not None and found.harmful:
            return str(found)
        message = "reaches the target, keeps all limits, touches nothing it must not"
        pushes = "" if found is None else found.pushes(self.judgement.metrics.passage)
        notes = [*self.judgement.notes, pushes] if pushes else self.judgement.notes
        return "; ".join([message, *(f"note: {note}" for note in notes)])


def judge(
    scene: Scene | str | Path, trajectory: Trajectory | str | Path, *, robot: Robot | None = None
) -> Verdict:
    """Judge a trajectory of any origin in a scene.

    It must begin at the scene's start, if the scene states one, and begin and end at rest.

    Args:
        scene: a scene, a built-in scene's name, or a scene file.
        trajectory: of the robot, joints in the robot's order; or a file or folder of one, see
            :func:`optipromp.trajectory_files.read_trajectory`.
        robot: with its tool, in place of the scene's.

    Raises:
        InvalidRequestError: joints of other names or number than the robot's; a file that cannot be
            read.
        InvalidSceneError, InvalidRobotError, StartInvalidError: wrong input.
    """
    task = resolve(scene if isinstance(scene, Scene) else load_scene(scene), robot)
    if not isinstance(trajectory, Trajectory):
        trajectory = read_trajectory(trajectory, task.robot.joint_names)
    if trajectory.joint_names != task.robot.joint_names:
        raise InvalidRequestError(
            f"the trajectory's joints are {', '.join(trajectory.joint_names)}; "
            f"{task.robot.name} has {', '.join(task.robot.joint_names)}"
        )
    return verdict(task, trajectory)


def verdict(task: Task, trajectory: Trajectory) -> Verdict:
    """The verdict on a trajectory of the task's robot."""
    prediction = predicted(task, trajectory, _approach(task, trajectory))
    start = None if task.scene.start is None else task.state
    judgement = judging.judge(
        task.scene, task.robot, trajectory, start, stem_side=prediction is None
    )
    return Verdict(judgement, prediction)


def _approach(task: Task, trajectory: Trajectory) -> int:
    """The first waypoint at the camera point's height or above, along z_g; as a plan's approach.

    Below it nothing hangs, and what the model steps through there only moves its later steps.
    """
    if not isinstance(task.goal, PoseGoal):
        return 0
    points, _ = task.robot.tool_pose(trajectory.positions)
    return int(np.argmax((points - task.camera) @ task.scene.frame[2] > -BELOW))


def predicted(task: Task, trajectory: Trajectory, first: int = 0) -> Prediction | None:
    """The prediction of a trajectory's push from waypoint ``first`` on.

    None where no model applies, and for a trajectory that does not move.
    """
    q = trajectory.positions
    model = None if (q == q[0]).all() else push_model(task, q[-1])
    return None if model is None else model.predict(*tool_motion(task.robot, q[first:]))
