"""What a planner may be told."""

from dataclasses import dataclass, field, fields
from typing import Literal, get_args

import numpy as np

from optipromp.errors import InvalidRequestError
from optipromp.optimization.constraints import Priority
from optipromp.optimization.terms import PushForm, Reduction, Term
from optipromp.pushing.sides import DriftRule, Window

Planner = Literal["promp", "i-promp", "opti-promp"]
Strategy = Literal["joint", "sequential"]
PLANNERS: tuple[Planner, ...] = ("promp", "i-promp", "opti-promp")
STRATEGIES: tuple[Strategy, ...] = ("joint", "sequential")


@dataclass(frozen=True)
class PlanOptions:
    """Settings of a plan, with the defaults of the method.

    Attributes:
        knots: T; None chooses it so that no joint moves more than ``max_step`` between knots.
        duration: of the trajectory [s]; None takes the shortest that the limits allow.
        timeout: wall time [s] after which the best so far is returned, as TIMEOUT where it is not
            valid or nothing has been optimised yet.
        alphas: α1 … α4, weights of static, avoid, push and velocity.
        epsilon: safety distance of the obstacle cost [m].
        reduction: over body points, ``max`` (the paper) or ``sum`` (CHOMP); None: the strategy's
            own, ``sum`` for joint and ``max`` for sequential.
        push: form of F_p; None: the strategy's own, ``quadratic`` and ``reciprocal``.
        push_weights: weights of F_p along x_g, y_g, z_g.
        drift: which way the tool passes pushables.
        window: at which heights it passes them aside in the joint strategy (the sequential one
            keeps the paper's); see
            :func:`optipromp.pushing.sides.passing_windows`.
        foresight: whether, where fruits hang on stems before a cup, other ways past them are looked
            for when the one that ``drift`` asks for is foreseen to do harm; see
            :mod:`optipromp.planning.foresight`.
        drift_offset: how far it passes from their centres [m]; None: R_gripper.
        berth: how much farther, in radii of the pushable, it passes where nothing stands against
            it: a rim right under a fruit's centre may tip it either way. 0 in the paper.
        corridor: tolerance of constraint 3 [m]: along all three axes in the joint strategy.
        approach_speed: fastest that the tool moves from t_1 on where something is to be pushed
            [m/s]; ``duration`` overrides it.
        smoothness: weight of ½∫‖ξ̈‖² dt in the joint strategy.
        static_clearance: wanted between every body sphere and static things [m]. This setting and
            the next five are of the joint strategy.
        avoid_clearance: wanted between B_d and avoid things and pushables [m].
        self_clearance: wanted between links that are not neighbours [m].
        limit_margin: kept from the joint limits [rad or m].
        priority: stiffness of the constraints where they conflict.
        starts: how many goal configurations are solved for together.
        camera_phase: t_1, the phase of the camera point; None: so that knots before and after it
            take steps alike.
        camera_point: whether the promp planner is conditioned on the camera point; None: as the
            scene says, by default yes.
        max_step: no joint moves more between knots [rad or m]; the sequential strategy, without
            such a constraint, only chooses its knots by it.
        iterations: of the optimiser; None: its own schedule. 0 returns the initial trajectory,
            marked as not optimised.
        via_deviation: standard deviation with which a ProMP is held to a pushable [m].
        direction_deviation: of I-ProMP's push direction [rad]; above 0 it is sampled by the seed.
        terms: cost terms of your own, minimised with the others by the joint strategy.
    """

    knots: int | None = None
    duration: float | None = None
    timeout: float = 60.0
    alphas: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0)
    epsilon: float = 0.01
    reduction: Reduction | None = None
    push: PushForm | None = None
    push_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    drift: DriftRule = "shortest"
    window: Window = "rim"
    foresight: bool = True
    drift_offset: float | None = None
    berth: float = 0.8
    corridor: float = 0.002
    approach_speed: float = 0.1
    smoothness: float = 2e-6
    static_clearance: float = 0.012
    avoid_clearance: float = 0.005
    self_clearance: float = 0.005
    limit_margin: float = 0.01
    priority: Priority = field(default_factory=Priority)
    starts: int = 3
    camera_phase: float | None = None
    camera_point: bool | None = None
    max_step: float = 0.045
    iterations: int | None = None
    via_deviation: float = 1e-3
    direction_deviation: float = 0.0
    terms: tuple[Term, ...] = ()

    def __post_init__(self) -> None:
        def need(ok: bool, name: str, wanted: str) -> None:
            if not ok:
                raise InvalidRequestError(f"{name} is {getattr(self, name)}; it must be {wanted}")

        def whole(value: object) -> bool:
            return isinstance(value, int | np.integer)

        for item in fields(self):
            value = getattr(self, item.name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float) and not np.isfinite(number):
                    need(item.name == "timeout" and number > 0, item.name, "finite")
        knots, iterations = self.knots, self.iterations
        need(knots is None or (whole(knots) and knots >= 3), "knots", "a whole number, at least 3")
        need(self.duration is None or self.duration > 0, "duration", "positive [s]")
        need(self.timeout > 0, "timeout", "positive [s]")
        need(
            len(self.alphas) == 4 and min(self.alphas) >= 0, "alphas", "four weights, none negative"
        )
        need(self.epsilon > 0, "epsilon", "positive [m]")
        need(self.reduction in (None, "max", "sum"), "reduction", "'max' or 'sum'")
        need(self.push in (None, "quadratic", "reciprocal"), "push", "'quadratic' or 'reciprocal'")
        need(
            len(self.push_weights) == 3 and min(self.push_weights) >= 0,
            "push_weights", "three weights, none negative",
        )  # fmt: skip
        need(self.drift in get_args(DriftRule), "drift", " or ".join(get_args(DriftRule)))
        need(self.window in ("rim", "paper"), "window", "'rim' or 'paper'")
        need(self.drift_offset is None or self.drift_offset >= 0, "drift_offset", "not negative")
        need(self.berth >= 0, "berth", "not negative")
        need(self.corridor >= 0, "corridor", "not negative")
        need(self.approach_speed > 0, "approach_speed", "positive [m/s]")
        need(self.smoothness >= 0, "smoothness", "not negative")
        for name in ("static_clearance", "avoid_clearance", "self_clearance", "limit_margin"):
            need(getattr(self, name) >= 0, name, "not negative")
        stiffness = vars(self.priority).values()
        need(all(0 <= k < np.inf for k in stiffness), "priority", "finite and not negative")
        need(whole(self.starts) and self.starts >= 1, "starts", "a whole number, at least 1")
        phase = self.camera_phase
        need(phase is None or 0.0 < phase < 1.0, "camera_phase", "between 0 and 1")
        need(self.max_step > 0, "max_step", "positive")
        need(
            iterations is None or (whole(iterations) and iterations >= 0),
            "iterations", "a whole number, not negative",
        )  # fmt: skip
        need(self.via_deviation >= 0, "via_deviation", "not negative")
        need(self.direction_deviation >= 0, "direction_deviation", "not negative")
        need(all(isinstance(term, Term) for term in self.terms), "terms", "cost terms")
