"""The settings of a plan."""

from dataclasses import dataclass, field, fields
from typing import Literal, get_args

import numpy as np

from optipromp.errors import InvalidRequestError
from optipromp.optimization.costs import Cost
from optipromp.planning.paper_options import PaperOptions

Planner = Literal["promp", "i-promp", "opti-promp"]
Strategy = Literal["joint", "sequential"]
Constraints = Literal["push-model", "paper"]
PLANNERS: tuple[Planner, ...] = get_args(Planner)
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)


@dataclass(frozen=True)
class PlanOptions:
    """Settings of a plan. Those of the paper's own planners are in :attr:`paper`.

    Attributes:
        waypoints: number T of waypoints, at least 3; None: as many as keep every joint's step below
            ``max_step``.
        duration: of the trajectory [s]; None: the shortest that the limits and ``approach_speed``
            allow.
        timeout: wall time of planning [s]. When it is over, the best trajectory so far is returned;
            its status is TIMEOUT if it is not valid or nothing has been optimised yet.
        prediction: true: where a model of the push applies, the tool path is searched in it. False:
            the rule of the method gives the path. The plan reports the predicted harm either way.
        approach_speed: largest speed of the tool on its path, where something is to be pushed
            [m/s]; None: the speed of the push model. ``duration`` overrides it.
        corridor: largest distance of the tool from its path, along each axis [m].
        max_step: largest step of a joint between two waypoints [rad or m].
        smoothness: weight of ½∫‖ξ̈‖² dt.
        static_clearance: wanted between every body sphere and static objects [m].
        avoid_clearance: wanted between the arm (B_d) and objects to avoid or push [m].
        self_clearance: wanted between links that are not neighbours [m].
        limit_margin: kept from the joint limits [rad or m].
        iterations: of the optimiser, at most; None: its own schedule. With 0 the followed
            trajectory is returned, marked as not optimised.
        costs: costs of your own, minimised with the others.
        constraints: ``push-model``: the default planner. ``paper``: the paper's constraints 1 to 3,
            and a plan is a success only if constraint 1 holds at every waypoint of the paper's
            window. The strategy ``sequential`` plans with these constraints in any case; ``paper``
            makes its success depend on constraint 1 too.
        paper: settings of the paper's own planners; see :class:`PaperOptions`.
    """

    waypoints: int | None = None
    duration: float | None = None
    timeout: float = 60.0
    prediction: bool = True
    approach_speed: float | None = None
    corridor: float = 0.002
    max_step: float = 0.045
    smoothness: float = 2e-6
    static_clearance: float = 0.012
    avoid_clearance: float = 0.005
    self_clearance: float = 0.005
    limit_margin: float = 0.01
    iterations: int | None = None
    costs: tuple[Cost, ...] = ()
    constraints: Constraints = "push-model"
    paper: PaperOptions = field(default_factory=PaperOptions)

    def __post_init__(self) -> None:
        def need(ok: bool, name: str, wanted: str) -> None:
            if not ok:
                raise InvalidRequestError(f"{name} is {getattr(self, name)}; it must be {wanted}")

        def whole(value: object) -> bool:
            return isinstance(value, int | np.integer) and not isinstance(value, bool)

        for item in fields(self):
            number = getattr(self, item.name)
            if isinstance(number, float) and not np.isfinite(number):
                need(item.name == "timeout" and number > 0, item.name, "finite")
        count, steps = self.waypoints, self.iterations
        need(count is None or (whole(count) and count >= 3), "waypoints", "a whole number >= 3")
        need(self.duration is None or self.duration > 0, "duration", "positive [s]")
        need(self.timeout > 0, "timeout", "positive [s]")
        need(isinstance(self.prediction, bool), "prediction", "true or false")
        speed = self.approach_speed
        need(speed is None or speed > 0, "approach_speed", "positive [m/s]")
        need(self.max_step > 0, "max_step", "positive [rad or m]")
        for name in (
            "corridor", "smoothness", "static_clearance", "avoid_clearance", "self_clearance",
            "limit_margin",
        ):  # fmt: skip
            need(getattr(self, name) >= 0, name, "not negative")
        need(steps is None or (whole(steps) and steps >= 0), "iterations", "a whole number >= 0")
        need(all(isinstance(cost, Cost) for cost in self.costs), "costs", "cost terms")
        need(self.constraints in get_args(Constraints), "constraints", "'push-model' or 'paper'")
        need(isinstance(self.paper, PaperOptions), "paper", "PaperOptions")
