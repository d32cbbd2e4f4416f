"""What a planner is, the planners of a name, and the default one: ``opti-promp``.

A planner is a value: its settings are its fields, and it has one method. A name joins by
:func:`register`, or by an entry point of the group :data:`GROUP` in a package's pyproject.toml::

    [project.entry-points."optipromp.planners"]
    mine = "my_package.planner:Mine"

An entry point is loaded when its name is asked for, or when all planners are listed.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib import metadata
from typing import Any, ClassVar, Protocol, runtime_checkable

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import Code, InvalidRequestError, others_code, suggest, unknown
from optipromp.core.planning import goals
from optipromp.core.planning.follow import keeps_path
from optipromp.core.planning.lines import along_lines
from optipromp.core.planning.options import PlanOptions, Searched
from optipromp.core.planning.parameters import GOAL
from optipromp.core.planning.pick import pick
from optipromp.core.planning.primitive import learnt
from optipromp.core.planning.result import Answer, Failed, Proposal
from optipromp.core.planning.task import Task, pushed_aside
from optipromp.core.pushing.path import ToolPath
from optipromp.core.scenes.scene import Scene
from optipromp.core.values import fitted

GROUP = "optipromp.planners"
WAY = "path", "waypoints"  # what a scene may say of the whole way to its goal


@runtime_checkable
class Planner(Protocol):
    """Anything that solves a task.

    A planner may have further attributes. Its plans report ``name`` (by default the name of its
    class). Where ``approaches`` is true, the other approaches that the scene allows are tried too
    if the straight one fails. ``timed`` says that a duration or a speed is set, ``iterations`` of 0
    that no optimisation is. ``ignores`` names those of :data:`WAY` for which it does not plan: such
    scenes are refused.
    """

    def solve(self, task: Task, budget: Budget) -> Answer:
        """The motion from ``task.state`` to the goal, or why there is none.

        :func:`optipromp.plan` judges the motion, whatever the planner thinks of it. A proposal has
        the predicted harm of a path as rank, and makes the motion that follows the path: it does so
        where no other approach is harmless.

        Args:
            task: scene, robot, goal, neighbours and push model; with the seed of everything random
                and the demonstrations of the request.
            budget: asked, by ``budget.spent()``, before each step of the work; ``budget.say`` takes
                a short text as each part of the work begins.
        """
        ...


Factory = Callable[..., Planner]
_known: dict[str, Factory] = {}


def register(name: str, factory: Factory) -> None:
    """Give a planner a name, in this process; the name may replace a registered one.

    ``factory`` makes the planner from its settings, as a dataclass does.
    """
    _known[name] = factory


def _joined() -> dict[str, metadata.EntryPoint]:
    """The entry points of installed packages, by name."""
    return {entry.name: entry for entry in metadata.entry_points(group=GROUP)}


def _load(entry: metadata.EntryPoint) -> Factory:
    where = f"{entry.dist.name}: " if entry.dist is not None else ""
    with others_code(f"planner {entry.name!r} cannot be loaded: {where}{entry.value}"):
        factory = entry.load()
    if not callable(factory):
        raise InvalidRequestError(
            f"planner {entry.name!r} is {entry.value}: must be a class or a function that makes one"
        )
    register(entry.name, factory)
    return _known[entry.name]


def factory(name: str, what: str = "planner") -> Factory:
    """The factory of the planner with a name; ``what`` is the name's word in an error."""
    if name in _known:
        return _known[name]
    joined = _joined()
    if name not in joined:
        valid = dict.fromkeys((*_known, *joined))
        near = suggest(name, valid).partition("; ")[2]
        words = f"{what} is {name!r}; valid: {', '.join(valid)}"
        raise InvalidRequestError(f"{words}; {near}" if near else words)
    return _load(joined[name])


def planners() -> dict[str, Factory]:
    """All planners by name, ours first; with a warning for each that cannot be loaded."""
    joined = _joined()
    for entry in [entry for name, entry in joined.items() if name not in _known]:
        try:
            _load(entry)
        except InvalidRequestError as error:
            warnings.warn(error.message, stacklevel=2)
    first = [name for name in _known if name not in joined]
    return {name: _known[name] for name in (*first, *joined) if name in _known}


def planner_names() -> tuple[str, ...]:
    """The names of :func:`planners`."""
    return tuple(planners())


def settings_of(kind: Factory) -> tuple[str, ...]:
    """The names of the settings of a planner whose factory is a dataclass; else none."""
    return tuple(item.name for item in fields(kind)) if is_dataclass(kind) else ()


def make(name: str, **settings: Any) -> Planner:
    """The planner of a name, with settings."""
    kind = factory(name)
    for setting in settings:
        if setting not in settings_of(kind):
            valid = unknown(setting, settings_of(kind) or ["none"])
            raise InvalidRequestError(f"{setting} is no setting of {name}; {valid}")
    if isinstance(kind, type) and is_dataclass(kind):
        settings = fitted(kind, settings)
    with others_code(f"planner {name!r} cannot be made"):
        return kind(**settings)


def check_way(planner: Planner, scene: Scene) -> None:
    """Refuse a planner for a scene that says of the way to its goal what the planner ignores."""
    for said in getattr(planner, "ignores", ()):
        if getattr(scene, said) is not None:
            raise InvalidRequestError(
                f"planner {label(planner)} ignores what the scene says in {said!r}: must be "
                f"opti-promp, or a scene without {said!r}"
            )


def label(planner: Planner | str) -> str:
    """The name that a plan reports for its planner."""
    return planner if isinstance(planner, str) else getattr(planner, "name", type(planner).__name__)


@dataclass(frozen=True, eq=False)
class Chosen:
    """Goal configurations of a task."""

    q: FloatArray  # configurations (m, n), best first
    reason: str  # why none is free, in words; else empty
    seconds: float  # wall time of inverse kinematics [s]

    def told(self, made: Any) -> Answer:
        """The answer of a planner that made ``made``: a failure where no configuration is free."""
        if isinstance(made, Proposal):
            return Proposal(made.rank, lambda: self.told(made.made()))
        made = replace(made, time={"inverse kinematics": self.seconds, **made.time})
        return Failed(Code.GOAL_IN_COLLISION, self.reason, made) if self.reason else made

    @property
    def failed(self) -> Failed:
        """The failure where there is no configuration."""
        return Failed(Code.GOAL_UNREACHABLE, self.reason)


def goal_configurations(
    task: Task, budget: Budget, starts: int | None = None, near: FloatArray | None = None
) -> Chosen:
    """Goal configurations of a task.

    ``starts``: number of random starts of inverse kinematics; None: ``GOAL.starts``, or
    ``GOAL.few_starts`` where the budget is spent. ``near``: (n,) a configuration; a free goal
    configuration on its branch is the only one. The start takes its place where the tool has begun
    its approach.
    """
    budget.say("inverse kinematics")
    began = clock()
    if starts is None:
        starts = GOAL.few_starts if budget.spent() else GOAL.starts
    if task.underway.entry is not None:
        near = task.start
    found, reason = goals.choose(task, task.seed, starts, near, budget)
    if task.scene.path is not None and len(found):
        found = found[keeps_path(task, found)]
        if not len(found):
            reason = reason or "no configuration found at the goal keeps the path's constraints"
    return Chosen(found, reason, clock() - began)


@dataclass(frozen=True)
class OptiProMP(Searched):
    """Pick a tool path in the push model, follow it with the whole arm, optimise and judge."""

    name: ClassVar[str] = "opti-promp"

    @property
    def approaches(self) -> bool:
        """Whether other approaches than the straight one are tried: only with a prediction."""
        return self.prediction

    def solve(self, task: Task, budget: Budget, only: ToolPath | None = None) -> Answer:
        """See :class:`Planner`; ``only``: the tool path to follow, in place of a search."""
        promp = learnt(task, task.demonstrations)
        if task.scene.waypoints is not None:
            return along_lines(task, promp, self, budget)
        chosen = goal_configurations(pushed_aside(task), budget)
        if not len(chosen.q):
            return chosen.failed
        budget.say("optimising (joint)")
        sparing = only is None and not chosen.reason
        return chosen.told(pick(task, promp, self, chosen.q, budget, sparing, only))


PLANNERS = "promp", "i-promp", "opti-promp"  # ours, which the package registers
USUAL = vars(PlanOptions())  # the default of each option
OF_A_PLAN = "timeout", "effort", "risk"  # options of a request, whatever the planner


def chosen_planner(planner: Planner | str, options: PlanOptions) -> Planner:
    """The planner of a request: a value as it is, or the planner of a name with its options.

    The planners promp, i-promp and opti-promp ignore options that are no settings of theirs.
    """
    given = {k: v for k, v in vars(options).items() if k not in OF_A_PLAN and v != USUAL[k]}
    if not isinstance(planner, str):
        if isinstance(planner, type) or not isinstance(planner, Planner):
            raise InvalidRequestError(
                f"planner is {planner!r}: must be a name, or an object with solve(task, budget)"
            )
        if given:
            extra = ", ".join(given)
            raise InvalidRequestError(f"{extra}: must be settings of the planner that is given")
        return planner
    kind = factory(planner)
    if planner in PLANNERS:
        given = {k: v for k, v in given.items() if k in settings_of(kind)}
    return make(planner, **given)
