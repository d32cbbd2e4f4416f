"""What a planner is, and the planners that are known by a name.

A planner is a value: its settings are its fields, and it has one method. A name joins by
:func:`register`, or by an entry point of the group :data:`GROUP` in a package's pyproject.toml::

    [project.entry-points."optipromp.planners"]
    mine = "my_package.planner:Mine"

An entry point is loaded when its name is asked for, or when all planners are listed.
"""

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from importlib import metadata
from typing import Any, Protocol, runtime_checkable

from optipromp.core.budget import Budget
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.result import Failed, Harmful, Planned, Term
from optipromp.core.planning.task import Task
from optipromp.core.scenes.scene import Scene
from optipromp.core.scenes.values import suggest

GROUP = "optipromp.planners"
WAY = "path", "waypoints"
"""What a scene may say of the whole way to its goal."""


@runtime_checkable
class Planner(Protocol):
    """Anything that solves a task.

    A planner may have further attributes. Its plans report ``name`` (by default the name of its
    class) and ``strategy`` (by default none). Where ``approaches`` is true, the other approaches
    that the scene allows are tried too if the straight one fails. ``timed`` says that a duration or
    a speed is set, ``iterations`` of 0 that no optimisation is. ``takes_strategy``, an attribute of
    the class, says that the planner has the settings ``strategy`` and ``constraints``: it serves a
    request of opti-promp that names another strategy or other constraints than the default ones,
    and its ``functionals(task, settings, outcome)`` are the terms that every plan reports.
    ``ignores`` names those of :data:`WAY` for which it does not plan: such scenes are refused.
    """

    def solve(self, task: Task, budget: Budget) -> "Planned | Failed | Harmful":
        """The motion from ``task.state`` to the goal, or why there is none.

        :func:`optipromp.plan` judges the motion, whatever the planner thinks of it.

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
    try:
        factory = entry.load()
    except Exception as error:  # another package's code
        where = f"{entry.dist.name}: " if entry.dist is not None else ""
        raise InvalidRequestError(
            f"planner {entry.name!r} cannot be loaded: {where}{entry.value}: "
            f"{type(error).__name__}: {error}"
        ) from error
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


def strategist() -> str:
    """The name of the planner that takes a strategy and constraints; see :class:`Planner`."""
    for names in (lambda: [*_known], _joined):  # entry points are read only where they must be
        for name in names():
            with suppress(InvalidRequestError):  # of another package, which no request needs here
                if getattr(factory(name), "takes_strategy", False):
                    return name
    raise InvalidRequestError("no planner takes a strategy and constraints; install one that does")


def functionals(
    task: Task, planner: Planner, options: PlanOptions, outcome: Planned
) -> dict[str, Term]:
    """The functionals that a plan of ``planner`` reports: those of :func:`strategist`."""
    kind: Any = factory(strategist())
    of_its_own = getattr(planner, "takes_strategy", False)
    reported: dict[str, Term] = kind.functionals(task, planner if of_its_own else options, outcome)
    return reported


def settings_of(kind: Factory) -> tuple[str, ...]:
    """The names of the settings of a planner whose factory is a dataclass; else none."""
    return tuple(item.name for item in fields(kind)) if is_dataclass(kind) else ()


def make(name: str, **settings: Any) -> Planner:
    """The planner of a name, with settings."""
    kind = factory(name)
    for setting in settings:
        if setting not in settings_of(kind):
            valid = suggest(setting, settings_of(kind) or ["none"])
            raise InvalidRequestError(f"{setting} is no setting of {name}; {valid}")
    return kind(**settings)


def check_way(planner: Planner, scene: Scene) -> None:
    """Refuse a planner for a scene that says of the way to its goal what the planner ignores."""
    for said in getattr(planner, "ignores", ()):
        if getattr(scene, said) is not None:
            strategy = getattr(planner, "strategy", None)
            name = label(planner) if strategy is None else f"{label(planner)} ({strategy})"
            raise InvalidRequestError(
                f"planner {name} ignores what the scene says in {said!r}: must be opti-promp with "
                f"its usual strategy and constraints, or a scene without {said!r}"
            )


def label(planner: Planner | str) -> str:
    """The name that a plan reports for its planner."""
    return planner if isinstance(planner, str) else getattr(planner, "name", type(planner).__name__)
