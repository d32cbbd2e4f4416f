"""What a planner is, and the planners that are known by a name.

A planner is a value: its settings are its fields, and it has one method. A name joins by
:func:`register`, or by an entry point of the group :data:`GROUP` in a package's pyproject.toml::

    [project.entry-points."optipromp.planners"]
    mine = "my_package.planner:Mine"

An entry point is loaded when its name is asked for, or when all planners are listed.
"""

import warnings
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib import metadata
from typing import Any, Protocol, runtime_checkable

from optipromp.core.budget import Budget
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.result import Failed, Harmful, Planned
from optipromp.core.planning.task import Task
from optipromp.core.scenes.values import suggest

GROUP = "optipromp.planners"


@runtime_checkable
class Planner(Protocol):
    """Anything that solves a task.

    A planner may have further attributes. ``name`` and ``strategy`` are what its plans say of it,
    by default its class and nothing. Where ``approaches`` is true, the other approaches that the
    scene allows are tried too if the straight one fails. ``timed`` says that a time or a speed is
    asked for. ``iterations`` of 0 say that no optimisation is.
    """

    def solve(self, task: Task, budget: Budget) -> "Planned | Failed | Harmful":
        """The motion from ``task.state`` to the goal, or why there is none.

        The answer is judged by :func:`optipromp.plan`, whatever the planner thinks of it.

        Args:
            task: scene, robot, goal, neighbours and push model; with the seed of everything random
                and the demonstrations of the request.
            budget: to be asked, by ``budget.spent()``, before each step of the work; ``budget.say``
                tells what begins.
        """
        ...


Factory = Callable[..., Planner]
_known: dict[str, Factory] = {}


def register(name: str, factory: Factory) -> None:
    """Know a planner by a name, in this process.

    ``factory`` makes it from settings; a dataclass does. A name that is known is replaced.
    """
    _known[name] = factory


def _outside() -> dict[str, metadata.EntryPoint]:
    """The entry points whose names are not known yet."""
    found = metadata.entry_points(group=GROUP)
    return {entry.name: entry for entry in found if entry.name not in _known}


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
    """What makes the planner of a name.

    Raises:
        InvalidRequestError: no such name, or one whose package cannot be loaded.
    """
    if name in _known:
        return _known[name]
    outside = _outside()
    if name not in outside:
        valid = (*_known, *outside)
        near = suggest(name, valid).partition("; ")[2]
        words = f"{what} is {name!r}; valid: {', '.join(valid)}"
        raise InvalidRequestError(f"{words}; {near}" if near else words)
    return _load(outside[name])


def planners() -> dict[str, Factory]:
    """All planners by name, ours first; what cannot be loaded is warned of and left out."""
    for entry in _outside().values():
        try:
            _load(entry)
        except InvalidRequestError as error:
            warnings.warn(error.message, stacklevel=2)
    joined = [entry.name for entry in metadata.entry_points(group=GROUP)]
    first = [name for name in _known if name not in joined]
    return {name: _known[name] for name in (*first, *joined) if name in _known}


def planner_names() -> tuple[str, ...]:
    """The names of :func:`planners`."""
    return tuple(planners())


def settings_of(kind: Factory) -> tuple[str, ...]:
    """The settings of what a factory makes, where it is a dataclass."""
    return tuple(item.name for item in fields(kind)) if is_dataclass(kind) else ()


def make(name: str, **settings: Any) -> Planner:
    """The planner of a name, with settings.

    Raises:
        InvalidRequestError: no such name, or a setting that it has not.
    """
    kind = factory(name)
    for setting in settings:
        if setting not in settings_of(kind):
            valid = ", ".join(settings_of(kind)) or "none"
            raise InvalidRequestError(f"{setting} is no setting of {name}; valid: {valid}")
    return kind(**settings)


def label(planner: Planner | str) -> str:
    """What a plan says of its planner."""
    return planner if isinstance(planner, str) else getattr(planner, "name", type(planner).__name__)
