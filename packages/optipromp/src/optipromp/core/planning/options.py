"""The settings of plans and of planners (method §5)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from inspect import signature
from typing import Annotated, Any

from annotated_types import Ge, Gt, Le, Lt, Unit

from optipromp.core.errors import InvalidRequestError, unknown
from optipromp.core.optimization.costs import Cost
from optipromp.core.parameters import Settings
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.rules import DriftRule
from optipromp.core.values import NotNegative

_LEAST = 1e-6  # [rad, m or m/s] least step or speed: 20,000 such steps are 0.02 rad
_MOST_WAYPOINTS = 20_000  # the solver keeps 20 KB for each waypoint

Metres = Annotated[float, Ge(0.0), Unit("m")]
Share = Annotated[float, Ge(_LEAST), Le(1.0)]
Phase = Annotated[float, Gt(0.0), Lt(1.0)]


@dataclass(frozen=True)
class Timed(Settings, largest=1e9):
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

    waypoints: Annotated[int | None, Ge(3), Le(_MOST_WAYPOINTS)] = None
    duration: Annotated[float | None, Gt(0.0), Unit("s")] = None
    approach_speed: Annotated[float | None, Ge(_LEAST), Unit("m/s")] = None
    velocity_scaling: Share = 1.0
    acceleration_scaling: Share = 1.0
    unhurried: bool = False
    corridor: Metres = 0.002

    @property
    def timed(self) -> bool:
        """Whether a duration or a speed is set, so that the tool may be too fast among fruits."""
        return self.duration is not None or self.approach_speed is not None


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

    max_step: Annotated[float, Ge(_LEAST), Unit("rad or m")] = 0.045
    smoothness: NotNegative = 2e-6
    static_clearance: Metres = 0.012
    avoid_clearance: Metres = 0.005
    self_clearance: Metres = 0.005
    limit_margin: Annotated[float, Ge(0.0), Unit("rad or m")] = 0.01
    iterations: Annotated[int | None, Ge(0)] = None
    costs: tuple[Cost, ...] = ()


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
        timeout: wall time of planning, of a pick that of all its legs, without reading the scene's
            file and compiling [s]. After it, the best trajectory so far is returned; the status is
            TIMEOUT if this trajectory is not valid or nothing has been optimised yet.
        effort: number of steps of work, at most: iterations, candidates and batches of samples. It
            ends a plan as the timeout does, at the same place on every machine. None: no limit.
        risk: share of promised successes that may be broken, over many scenes. It sets the largest
            predicted harm of a success; a smaller risk refuses more plans.
    """

    timeout: Annotated[float, Gt(0.0), Unit("s or inf")] = 60.0
    effort: Annotated[int | None, Gt(0)] = None
    risk: Annotated[float, Gt(0.0), Lt(1.0)] = PUSH.harm.risk


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
