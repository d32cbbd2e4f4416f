"""The settings of plans and of planners (method §5)."""

import functools
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from inspect import signature
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from optipromp.core.errors import InvalidRequestError, short, suggest, unknown
from optipromp.core.optimization.costs import Cost
from optipromp.core.parameters import Settings
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.rules import DriftRule


def _fits(value: object, hint: Any) -> bool:
    """Whether a value has the type ``hint``; a whole number is a float, a bool is no number."""
    kind, of = get_origin(hint), get_args(hint)
    if kind is UnionType or kind is Union:
        return any(_fits(value, one) for one in of)
    if kind is Literal:
        return isinstance(value, str) and value in of
    if kind is Mapping:
        return isinstance(value, Mapping) and all(
            _fits(key, of[0]) and _fits(item, of[1]) for key, item in value.items()
        )
    if kind is tuple:
        return isinstance(value, tuple | list) and all(_fits(item, of[0]) for item in value)
    if hint in (int, float):
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            return False
        return hint is float or isinstance(value, int | np.integer)
    return isinstance(value, kind or hint)


def check_types(options: object, prefix: str) -> None:
    """Refuse settings of a wrong type, and infinite numbers other than the timeout."""
    kind: Any = type(options)
    for name, hint in _hints(kind).items():
        value: Any = getattr(options, name)
        if not _fits(value, hint):
            wanted = str(hint).replace("typing.", "") if get_origin(hint) else hint.__name__
            literals = (one for one in (hint, *get_args(hint)) if get_origin(one) is Literal)
            words = [word for one in literals for word in get_args(one)]
            if words and isinstance(value, str):
                told = f"it must be one of these: {suggest(value, words)}"
                raise InvalidRequestError(f"{prefix}{name} is {value}; {told}")
            require(options, prefix, False, name, f"of type {wanted}")
        for number in numbers(value):
            if _fits(number, float) and not abs(number) < _LARGEST_SETTING:
                require(options, prefix, name == "timeout" and number == math.inf, name, "finite")


def numbers(value: Any) -> Iterable[Any]:
    """The values of a setting that is a mapping or a sequence, or else the setting itself."""
    if isinstance(value, Mapping):
        return value.values()
    return value if isinstance(value, tuple | list) else (value,)


_LARGEST_SETTING = 1e9  # in the setting's unit: a choice
_LEAST = 1e-6  # [rad, m or m/s] least step or speed: 20,000 such steps are 0.02 rad
_MOST_WAYPOINTS = 20_000  # the solver keeps 20 KB for each waypoint


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    """The types of the fields of a class."""
    hints = get_type_hints(kind)
    return {item.name: hints[item.name] for item in fields(kind)}


def require(options: object, prefix: str, ok: bool, name: str, wanted: str) -> None:
    """Refuse the setting ``name`` of ``options`` where it is not ``ok``."""
    if not ok:
        value = short(getattr(options, name)).strip("'")
        raise InvalidRequestError(f"{prefix}{name} is {value}; it must be {wanted}")


@dataclass(frozen=True)
class Timed(Settings):
    """Settings of the motion of every planner of the core.

    Attributes:
        waypoints: number T of waypoints, 3 to 20,000; None: as many as keep every joint's step
            below ``max_step``.
        duration: of the trajectory [s]; None: a short one within the limits and
            ``approach_speed``.
        approach_speed: largest speed of the tool on its path, where something is to be pushed
            [m/s]; None: the speed of the push model. ``duration`` overrides it. A plan whose tool
            is faster among fruits than pushes are predicted for is no success.
        velocity_scaling: share of the joints' velocity limits that the motion uses, in (0, 1]. The
            push keeps its speed where that is lower.
        acceleration_scaling: share of their limits of acceleration and jerk, likewise.
        unhurried: the tool keeps that speed on its whole path, also where nothing is near.
        corridor: largest distance of the tool from its path, along each axis [m].
    """

    waypoints: int | None = None
    duration: float | None = None
    approach_speed: float | None = None
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0
    unhurried: bool = False
    corridor: float = 0.002

    @property
    def timed(self) -> bool:
        """Whether a duration or a speed is set, so that the tool may be too fast among fruits."""
        return self.duration is not None or self.approach_speed is not None

    def __post_init__(self) -> None:
        need = functools.partial(require, self, "")
        check_types(self, "")
        count, speed = self.waypoints, self.approach_speed
        fits = count is None or 3 <= count <= _MOST_WAYPOINTS
        need(fits, "waypoints", f"a whole number >= 3, at most {_MOST_WAYPOINTS}")
        need(self.duration is None or self.duration > 0, "duration", "positive [s]")
        need(speed is None or speed >= _LEAST, "approach_speed", f"at least {_LEAST:g} [m/s]")
        need(self.corridor >= 0, "corridor", "not negative")
        for name in ("velocity_scaling", "acceleration_scaling"):
            need(_LEAST <= getattr(self, name) <= 1.0, name, "above 0 and at most 1")


@dataclass(frozen=True)
class Optimised(Timed):
    """Settings of every motion that is optimised, beside those of :class:`Timed`.

    Attributes:
        max_step: largest step of a joint between two waypoints [rad or m].
        smoothness: weight of ½∫‖ξ̈‖² dt.
        static_clearance: wanted between every body sphere and static objects [m].
        avoid_clearance: wanted between the arm (B_d) and objects to avoid or push [m].
        self_clearance: wanted between links that are not neighbours [m].
        limit_margin: wanted distance of the joints from their limits [rad or m].
        iterations: of the optimiser, at most; None: the optimiser's schedule. With 0 the followed
            trajectory is returned, marked as not optimised.
        costs: user's costs, minimised with the others.
    """

    max_step: float = 0.045
    smoothness: float = 2e-6
    static_clearance: float = 0.012
    avoid_clearance: float = 0.005
    self_clearance: float = 0.005
    limit_margin: float = 0.01
    iterations: int | None = None
    costs: tuple[Cost, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        need, steps = functools.partial(require, self, ""), self.iterations
        need(self.max_step >= _LEAST, "max_step", f"at least {_LEAST:g} [rad or m]")
        for name in (
            "smoothness", "static_clearance", "avoid_clearance", "self_clearance", "limit_margin",
        ):  # fmt: skip
            need(getattr(self, name) >= 0, name, "not negative")
        need(steps is None or steps >= 0, "iterations", "a whole number >= 0")


@dataclass(frozen=True)
class Searched(Optimised):
    """Settings of a motion whose tool path is searched, beside those of :class:`Optimised`.

    Attributes:
        prediction: whether the tool path is searched in the push model, where one applies; without
            prediction, ``rule`` gives the path. The plan reports the predicted harm in any case.
        rule: side on which the tool passes each neighbour without a prediction: away from the stem
            along y_g (``paper``) or in the plane (``lateral-plane``), or the shorter way
            (``shortest``).
    """

    prediction: bool = True
    rule: DriftRule = "shortest"


@dataclass(frozen=True)
class PlanOptions(Searched):
    """Cost and risk that a plan may have, and the settings of a planner that is chosen by name.

    A planner that is a value has its own settings.

    Attributes:
        timeout: wall time of planning [s], without reading the scene's file and compiling. After
            it, the best trajectory so far is returned; the status is TIMEOUT if this trajectory is
            not valid or nothing has been optimised yet.
        effort: number of steps of work, at most: iterations, candidates and batches of samples. It
            ends a plan as the timeout does, at the same place on every machine. None: no limit.
        risk: share of promised successes that may be broken, over many scenes. It sets the largest
            predicted harm of a success; a smaller risk refuses more plans.
    """

    timeout: float = 60.0
    effort: int | None = None
    risk: float = PUSH.harm.risk

    def __post_init__(self) -> None:
        super().__post_init__()
        need, most = functools.partial(require, self, ""), self.effort
        need(self.timeout > 0, "timeout", "positive [s]")
        need(0.0 < self.risk < 1.0, "risk", "between 0 and 1")
        need(most is None or most > 0, "effort", "a whole number > 0")


DEFAULTS = PlanOptions()


def stated(
    options: PlanOptions | None, settings: Mapping[str, Any], verb: Callable[..., object]
) -> PlanOptions:
    """The options of a call of ``verb``, with the settings that it got as keywords of their own."""
    options = options or DEFAULTS
    if not settings:
        return options
    names = [item.name for item in fields(PlanOptions)]
    for name in settings:
        if name not in names:
            valid = [one for one in signature(verb).parameters if one != "settings"]
            raise InvalidRequestError(
                f"{verb.__name__} has no argument {name!r}: {unknown(name, [*valid, *names])}"
            )
    return replace(options, **settings)
