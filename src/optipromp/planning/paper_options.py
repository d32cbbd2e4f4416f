"""Settings of the paper's own planner (method §5), all in one place."""

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np

from optipromp.errors import InvalidRequestError
from optipromp.optimization.costs.obstacles import Reduction
from optipromp.optimization.costs.tool import PushForm

PaperDrift = Literal["paper", "lateral-plane"]


@dataclass(frozen=True)
class PaperOptions:
    r"""Settings that the paper leaves open. Defaults are the paper's, or its authors'.

    Attributes:
        alphas: α1 … α4, the weights of F_s, F_d, F_p and F_v.
        epsilon: ε, the safety distance of the obstacle cost [m].
        reduction: of the obstacle cost over body points, ``max`` (the paper) or ``sum`` (CHOMP);
            None: ``sum`` for the joint strategy, ``max`` for the sequential one.
        push: form of F_p, ``quadratic`` (the paper) or ``reciprocal`` (the authors' runs:
            Σ_t 1/|y_g·(fk − X_g)|); None: ``quadratic`` for the joint strategy, ``reciprocal``
            for the sequential one.
        push_weights: weights of the quadratic F_p along x_g, y_g and z_g.
        drift: direction d_n of constraint 1: ``paper`` takes ±y_g, ``lateral-plane`` the direction
            away from the lateral part of the stem.
        drift_offset: least d_n·(fk − X_n) that constraint 1 asks for [m]; None: R_gripper.
        corridor: tolerance of constraint 3 about the initial tool points [m]: along x_g and z_g,
            and along z_g alone where ``drift`` is ``lateral-plane``.
        camera_phase: t_1, the phase of the camera point in (0, 1); None: 0.5 for promp and i-promp;
            for OptI-ProMP such that steps before and after the camera point are equally long.
        camera_point: whether the planner promp passes the camera point; None: as the scene says
            (by default yes).
        via_deviation: standard deviation with which a ProMP is held to a pushable [m].
        direction_deviation: standard deviation of I-ProMP's push direction [rad]; above 0 the
            direction is sampled.
        trust_radii: first trust radii of the push stage of the sequential strategy [rad]. They are
            tried in this order, and the first valid plan is kept.
    """

    alphas: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 0.0)
    epsilon: float = 0.01
    reduction: Reduction | None = None
    push: PushForm | None = None
    push_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    drift: PaperDrift = "paper"
    drift_offset: float | None = None
    corridor: float = 0.002
    camera_phase: float | None = None
    camera_point: bool | None = None
    via_deviation: float = 1e-3
    direction_deviation: float = 0.0
    trust_radii: tuple[float, ...] = (0.005, 0.01, 0.02, 0.05, 0.1)

    def __post_init__(self) -> None:
        def need(ok: bool, name: str, wanted: str) -> None:
            if not ok:
                raise InvalidRequestError(
                    f"paper.{name} is {getattr(self, name)}; it must be {wanted}"
                )

        for item in fields(self):
            value = getattr(self, item.name)
            numbers = value if isinstance(value, tuple) else (value,)
            finite = all(np.isfinite(x) for x in numbers if isinstance(x, float))
            need(finite, item.name, "finite")
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
        need(self.drift in get_args(PaperDrift), "drift", "'paper' or 'lateral-plane'")
        offset = self.drift_offset
        need(offset is None or offset >= 0, "drift_offset", "not negative [m]")
        need(self.corridor >= 0, "corridor", "not negative [m]")
        phase = self.camera_phase
        need(phase is None or 0.0 < phase < 1.0, "camera_phase", "between 0 and 1")
        need(self.via_deviation >= 0, "via_deviation", "not negative [m]")
        need(self.direction_deviation >= 0, "direction_deviation", "not negative [rad]")
        radii = self.trust_radii
        need(
            len(radii) > 0 and min(radii) > 0 and list(radii) == sorted(radii),
            "trust_radii", "positive, from small to large [rad]",
        )  # fmt: skip
