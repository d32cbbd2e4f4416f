"""The planners of the core as values: ``opti-promp``, ``i-promp`` and ``promp``."""

from dataclasses import dataclass, fields, replace
from typing import ClassVar

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning import goals, primitive
from optipromp.core.planning.follow import keeps_path
from optipromp.core.planning.lines import along_lines
from optipromp.core.planning.options import (
    STRATEGIES,
    PaperOptions,
    PlanOptions,
    Searched,
    Strategy,
    Timed,
)
from optipromp.core.planning.parameters import GOAL
from optipromp.core.planning.pick import pick
from optipromp.core.planning.planner import (
    WAY,
    Planner,
    factory,
    make,
    register,
    settings_of,
    strategist,
)
from optipromp.core.planning.primitive import learnt
from optipromp.core.planning.result import Failed, Harmful, Planned
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.shown import suggest

JOINT: Strategy = "joint"


@dataclass(frozen=True, eq=False)
class Chosen:
    """Goal configurations of a task.

    Attributes:
        q: configurations (m, n), best first.
        free: whether the configurations touch nothing.
        reason: why none is free, in words.
        seconds: wall time of inverse kinematics [s].
    """

    q: FloatArray
    free: bool
    reason: str
    seconds: float

    def told(self, made: Planned | Harmful) -> Planned | Failed | Harmful:
        """The answer of a planner that made ``made``: a failure where no configuration is free."""
        if isinstance(made, Harmful):
            return made
        made = replace(made, time={"inverse kinematics": self.seconds, **made.time})
        return made if self.free else Failed(Code.GOAL_IN_COLLISION, self.reason, made)

    @property
    def failed(self) -> Failed:
        """The failure where there is no configuration."""
        return Failed(Code.GOAL_UNREACHABLE, self.reason)


def goal_configurations(
    task: Task, budget: Budget, starts: int | None = None, near: FloatArray | None = None
) -> Chosen:
    """Goal configurations of a task.

    ``task``: scene and robot. ``budget``: of the plan. ``starts``: number of random starts of
    inverse kinematics; None: ``GOAL.starts``, or ``GOAL.few_starts`` where the budget is spent.
    ``near``: (n,) a configuration; a free goal configuration on its branch is the only one. The
    start takes its place where the tool has begun its approach.
    """
    budget.say("inverse kinematics")
    began = clock()
    if starts is None:
        starts = GOAL.few_starts if budget.spent() else GOAL.starts
    if task.entry is not None:
        near = task.start
    found, free, reason = goals.choose(task, task.seed, starts, near, budget)
    if task.scene.path is not None and len(found):
        found = found[keeps_path(task, found)]
        reason = reason or "no configuration found at the goal keeps the path's constraints"
    return Chosen(found, free, reason, clock() - began)


@dataclass(frozen=True)
class OptiProMP(Searched):
    """Pick a tool path in the push model, follow it with the whole arm, optimise and judge."""

    name: ClassVar[str] = "opti-promp"
    strategy: ClassVar[Strategy] = "joint"

    @property
    def approaches(self) -> bool:
        """Whether other approaches than the straight one are tried: only with a prediction."""
        return self.prediction

    def solve(self, task: Task, budget: Budget) -> Planned | Failed | Harmful:
        """See :class:`optipromp.core.planning.planner.Planner`."""
        promp = learnt(task, task.demonstrations)
        if task.scene.waypoints is not None:
            return along_lines(task, promp, self, budget)
        chosen = goal_configurations(pushed_aside(task), budget)
        if not len(chosen.q):
            return chosen.failed
        budget.say("optimising (joint)")
        sparing = task.sparing and chosen.free
        return chosen.told(pick(task, promp, self, chosen.q, budget, sparing))


@dataclass(frozen=True)
class ConditionedProMP(Timed):
    """The primitive, conditioned on start, camera point and target: the planner ``promp``.

    Attributes:
        camera_phase: t_1, the phase of the camera point in (0, 1); None: 0.5.
        camera_point: whether the camera point is passed; None: as the scene says (by default yes).
        via_deviation: standard deviation with which the ProMP is held to a point [m].
    """

    camera_phase: float | None = None
    camera_point: bool | None = None
    via_deviation: float = 1e-3
    name: ClassVar[str] = "promp"
    ignores: ClassVar[tuple[str, ...]] = WAY
    interactive: ClassVar[bool] = False  # whether neighbours are among the points

    def __post_init__(self) -> None:
        super().__post_init__()
        self._options()

    def _options(self) -> PlanOptions:
        """The settings as options of a plan, checked."""
        timed = {item.name: getattr(self, item.name) for item in fields(Timed)}
        paper = {name: value for name, value in vars(self).items() if name not in timed}
        return PlanOptions(**timed, paper=PaperOptions(**paper))

    def solve(self, task: Task, budget: Budget) -> Planned | Failed | Harmful:
        """See :class:`optipromp.core.planning.planner.Planner`."""
        promp = learnt(task, task.demonstrations)
        chosen = goal_configurations(task, budget, GOAL.few_starts, primitive.end(promp))
        if not len(chosen.q):
            return chosen.failed
        budget.say(self.name)
        began = clock()
        made = primitive.plan_primitive(task, promp, self._options(), chosen.q, self.interactive)
        made = replace(made, time={self.name: clock() - began})
        return replace(chosen, free=True).told(made)  # the judge reports contacts at the goal


@dataclass(frozen=True)
class IProMP(ConditionedProMP):
    """The primitive, conditioned also on every neighbour and its pushed pose.

    Attributes:
        direction_deviation: standard deviation of the push direction [rad]; above 0 the direction
            is sampled.
        guard: the mouth is closed while the tool pushes. The closed rim, not the tool point, is led
            under each neighbour and under its pushed pose.
    """

    direction_deviation: float = 0.0
    guard: bool = False
    name: ClassVar[str] = "i-promp"
    interactive: ClassVar[bool] = True


_OURS = {kind.name: kind for kind in (ConditionedProMP, IProMP, OptiProMP)}
PLANNERS = tuple(_OURS)
for _name, _kind in _OURS.items():
    register(_name, _kind)

USUAL = vars(PlanOptions())
"""The default of each option."""
OF_A_PLAN = "timeout", "effort", "risk"  # options of a request, whatever the planner


def chosen_planner(planner: Planner | str, strategy: str, options: PlanOptions) -> Planner:
    """The planner of a request: a value as it is, or the planner of a name with its options.

    A request of opti-promp with the strategy ``sequential``, or with the constraints of the paper,
    means the planner that takes a strategy (:func:`strategist`). The planners promp, i-promp and
    opti-promp ignore options that are no settings of theirs.
    """
    if strategy not in STRATEGIES:
        raise InvalidRequestError(f"strategy is {strategy!r}; {suggest(strategy, STRATEGIES)}")
    given = {k: v for k, v in vars(options).items() if k not in OF_A_PLAN and v != USUAL[k]}
    if not isinstance(planner, str):
        if isinstance(planner, type) or not isinstance(planner, Planner):
            raise InvalidRequestError(
                f"planner is {planner!r}: must be a name, or an object with solve(task, budget)"
            )
        if given or strategy != JOINT:
            extra = ", ".join([*given, *(["strategy"] if strategy != JOINT else [])])
            raise InvalidRequestError(f"{extra}: must be settings of the planner that is given")
        return planner
    kind = factory(planner)
    if kind in _OURS.values():
        of_paper = {k: v for k, v in vars(options.paper).items() if not hasattr(options, k)}
        given |= {} if kind is OptiProMP else of_paper
        if kind is OptiProMP and (strategy != JOINT or options.constraints == "paper"):
            planner = strategist()
            given |= {"strategy": strategy, "constraints": options.constraints}
        given = {k: v for k, v in given.items() if k in settings_of(factory(planner))}
    return make(planner, **given)
