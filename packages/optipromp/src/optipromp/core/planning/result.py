"""The results of planning: stages of an optimisation, a planner's answers, a plan."""

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import clock
from optipromp.core.errors import Code
from optipromp.core.files import plain
from optipromp.core.judging import Judgement, Metrics, Overlap
from optipromp.core.planning.task import Task, as_of, passages
from optipromp.core.pushing.model import Prediction, PushModel, failing
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import reached
from optipromp.core.scenes.scene import Scene
from optipromp.core.shown import Shown
from optipromp.core.trajectory import State, Trajectory

Made = TypeVar("Made")
REACH, LIFT, RETREAT, CARRY = "reach", "lift", "retreat", "carry"  # the legs of a pick
AFTER = LIFT, RETREAT, CARRY


def best_of(
    made: Iterable[Made],
    rank: Callable[[Made], Any],
    enough: Callable[[Made], bool] = lambda best: False,
    best: Made | None = None,
) -> Made | None:
    """The motion of least rank; of equal ones the first; None where there is none.

    A stage proposes motions, times and judges each as it is asked for. No motion is asked for once
    the best so far is ``enough``. ``best`` is the best of the stages before.
    """
    for one in made:
        if best is None or rank(one) < rank(best):
            best = one
        if enough(best):
            break
    return best


class Proposal(NamedTuple, Generic[Made]):
    """What may become a motion.

    Attributes:
        rank: of the motion, or a lower bound of it.
        make: the motion; or work that gives it, or further proposals.
    """

    rank: Any
    make: Made | Callable[[], Any]

    def made(self) -> Any:
        """The motion, or what the work gives."""
        return self.make() if callable(self.make) else self.make


def cheapest(proposals: Iterable[Proposal[Made]], late: float = math.inf) -> Iterator[Made]:
    """The motions of proposals, those of least rank first.

    The work of least bound is done first; of equal ones, that which is nearest to a motion. Once
    there is a motion, no work is begun that would end after ``late`` [s], a time of the plan's
    clock, if it took as long as the longest work so far.
    """
    waiting, order, some = list[tuple[Any, int, int, Any]](), itertools.count(), False
    longest = 0.0

    def wait(new: Iterable[Proposal[Made]], depth: int) -> None:
        nonlocal some, longest
        began = clock()
        for rank, make in new:
            some |= not callable(make)
            heapq.heappush(waiting, (rank, -depth, next(order), make))
        longest = max(longest, clock() - began)

    wait(proposals, 0)
    while waiting:
        _, depth, _, make = heapq.heappop(waiting)
        if not callable(make):
            yield make
        elif not some or clock() + longest <= late:
            wait(make(), 1 - depth)


@dataclass(frozen=True)
class Stage:
    """One run of a solver.

    Attributes:
        name: ``push``, ``collision`` or ``joint``.
        solver: name of the solver.
        terms: names of the minimised terms.
        history: value of every term after each iteration, the initial value first.
        seconds: wall time [s].
        message: why the solver stopped.
    """

    name: str
    solver: str
    terms: tuple[str, ...]
    history: tuple[Mapping[str, float], ...]
    seconds: float
    message: str


@dataclass(frozen=True)
class Term:
    """One functional of a plan, without its weight.

    Attributes:
        initial: value at the conditioned ProMP.
        followed: value at the followed trajectory.
        final: value at the returned trajectory.
        history: values over the iterations of ``stage``, the initial value first.
        stage: name of the stage that minimises the functional; empty where none does.
    """

    initial: float
    followed: float
    final: float
    history: tuple[float, ...]
    stage: str


@dataclass(frozen=True, eq=False)
class ViaPoint:
    """A point that the primitive was conditioned on: ``name``, and ``position`` (3,) [m]."""

    name: str
    position: FloatArray


@dataclass(frozen=True, eq=False)
class Planned:
    """A planner's answer: a motion.

    Attributes:
        trajectory: the motion.
        first: index of the first waypoint on the approach.
        primitive: the conditioned ProMP; None: the trajectory itself.
        followed: the conditioned ProMP, led along the tool path; None: ``primitive``.
        stages: of the optimisation.
        optimised: whether an optimisation took place, or none was needed.
        time: wall time by stage [s].
        judgement: of the trajectory; None where the planner did not ask the judge.
        prediction: of the trajectory's push; None where the planner did not ask the push model.
        via: points of the tool that the primitive was conditioned on, the target last.
        beyond: the least harm of the tool paths out of the arm's reach.
        terms: functionals that the plan reports, by name.
    """

    trajectory: Trajectory
    first: int = 0
    primitive: Trajectory | None = None
    followed: Trajectory | None = None
    stages: tuple[Stage, ...] = ()
    optimised: bool = True
    time: Mapping[str, float] = field(default_factory=dict)
    judgement: Judgement | None = None
    prediction: Prediction | None = None
    via: tuple[ViaPoint, ...] = ()
    beyond: float = math.inf
    terms: Mapping[str, Term] = field(default_factory=dict)

    @property
    def begin(self) -> Trajectory:
        """The trajectory before the optimisation."""
        return self.primitive or self.trajectory


@dataclass(frozen=True, eq=False)
class Failed:
    """A planner's answer: there is no plan, for the reason in ``code`` and ``message``.

    ``nearest`` is the motion that comes nearest to one; None: the arm stays.
    """

    code: Code
    message: str
    nearest: Planned | None = None


Answer = Planned | Failed | Proposal[Any]
"""A planner's answer: a motion, or why there is none; or, where all tool paths do harm, a proposal
to follow the path of least harm, which is its rank."""


class Said(NamedTuple):
    """Reason and notes ``of`` a verdict or another, with words and notes about them."""

    before: str
    of: Any = None
    after: str = ""
    more: tuple[str, ...] = ()

    @property
    def reason(self) -> str:
        """Why a plan has its status; put together when it is read."""
        return self.before + (self.of.reason if self.of else "") + self.after

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks that do not change the status."""
        return (*(self.of.notes if self.of else ()), *self.more)

    @property
    def message(self) -> str:
        """The reason and the notes in one line."""
        return "; note: ".join([self.reason, *self.notes])


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A plan: a trajectory, its metrics, and whether it is a success.

    Attributes:
        task: the scene bound to its robot, start and goal.
        planner: ``promp``, ``i-promp``, ``opti-promp``, or the name of another planner.
        seed: of everything random.
        status: ``success`` only if the judge found nothing wrong and the predicted harm is small.
        said: why the plan has this status, and remarks.
        trajectory: the optimised one; the best that was found, whatever the status.
        initial: the conditioned ProMP.
        followed: the ProMP led along the tool path; equal to ``initial`` where there is no path.
        prediction: of the push, with its harm; None where no push model applies.
        judgement: of the trajectory, by the independent judge.
        stages: optimisation stages in the order they ran.
        time: wall time, ``total`` and per stage [s].
        first: index of the first waypoint on the approach.
        via: points of the tool that the planner conditioned the primitive on, the target last.
        terms: functionals that the planner reports, by name; of ours none.
    """

    task: Task
    planner: str
    seed: int
    status: Code
    said: Said
    trajectory: Trajectory
    initial: Trajectory
    followed: Trajectory
    prediction: Prediction | None
    judgement: Judgement
    stages: tuple[Stage, ...]
    time: Mapping[str, float] = field(default_factory=dict)
    first: int = 0
    via: tuple[ViaPoint, ...] = ()
    terms: Mapping[str, Term] = field(default_factory=dict)

    reason = property(lambda self: self.said.reason)
    notes = property(lambda self: self.said.notes)
    message = property(lambda self: self.said.message)

    @property
    def metrics(self) -> Metrics:
        """See :class:`optipromp.core.judging.Metrics`."""
        return self.judgement.metrics

    @property
    def contacts(self) -> tuple[Overlap, ...]:
        """Pairs that touch but must not."""
        return self.judgement.contacts

    @property
    def harm(self) -> float:
        """The predicted harm; 0 where no push model applies."""
        return 0.0 if self.prediction is None else self.prediction.harm

    @property
    def failure(self) -> float:
        """Probability that the motion is not clean; nan where no push model tells it."""
        alone = math.nan if self.prediction is None else self.prediction.probability
        return failing(alone, self.metrics.unseen or 0.0)

    @property
    def valid(self) -> bool:
        """Whether the judge finds nothing wrong; harm may be predicted."""
        return self.status in (Code.SUCCESS, Code.HARM_PREDICTED)

    @property
    def duration(self) -> float:
        """Of the motion [s]."""
        return self.trajectory.duration

    @property
    def scene(self) -> Scene:
        """The scene of the task."""
        return self.task.scene

    @property
    def robot(self) -> Robot:
        """The scene's robot with its tool."""
        return self.task.robot

    @property
    def risk(self) -> float:
        """Share of promised successes that may be broken; it decides on the status."""
        return self.task.risk

    @property
    def start(self) -> State | None:
        """The state in which the plan begins; None: at rest at the scene's start."""
        return self.task.state if self.task.underway.begun else None

    @property
    def push_model(self) -> PushModel | None:
        """The push model for the trajectory's last configuration; None where no model applies."""
        bound = as_of(self.task, passages(self.task, self.trajectory))
        return bound.push_model(self.trajectory.positions[-1])

    @property
    def goal(self) -> int | None:
        """The index among the scene's goals of the goal that is reached; None: none."""
        return reached(self.robot, self.scene.goals, self.trajectory.positions[-1])

    def _words(self) -> str:
        return f"{self.scene.name}, {self.planner}: {self.status}, {self.trajectory.duration:.2f} s"

    @property
    def success(self) -> bool:
        """Whether the status is ``success``."""
        return self.status == Code.SUCCESS

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON."""
        document = {
            "scene": self.scene.name,
            "planner": self.planner,
            "seed": self.seed,
            "risk": self.risk,
            "status": self.status,
            "message": self.message,
            "metrics": self.metrics.to_dict(),
            "terms": {name: vars(term) for name, term in self.terms.items()},
            "stages": [vars(stage) for stage in self.stages],
            "predicted_harm": None if self.prediction is None else self.prediction.to_dict(),
            "contacts": [vars(contact) for contact in self.contacts],
            "time": self.time,
            "first": self.first,
            "via": [vars(via) for via in self.via],
            "assumed": list(self.scene.assumed),
        }
        if len(self.scene.goals) > 1:
            document["goal"] = self.goal
        return dict(plain(document))
