"""The optimisation problem of a setup: which terms and constraints, with which numbers."""

from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.optimization.constraints import (
    ClearanceConstraint,
    CorridorConstraint,
    DriftConstraint,
    GoalConstraint,
    LimitConstraint,
    SelfConstraint,
    StepConstraint,
    UprightConstraint,
)
from optipromp.optimization.evaluation import Evaluation
from optipromp.optimization.problem import Problem
from optipromp.optimization.terms import (
    ObstacleTerm,
    PushForm,
    PushTerm,
    Reduction,
    SmoothnessTerm,
    Term,
    VelocityTerm,
)
from optipromp.planning.options import PlanOptions
from optipromp.planning.setup import Setup
from optipromp.pushing.sides import Drift

DRIFT_MARGIN = 1e-3  # [m] so that the drift still holds at the knots once the penalty has settled
TOUCH_MARGIN = 1e-3  # [m] under which clearance outranks the goal
UPRIGHT = np.deg2rad(8.0)  # [rad] tilt of the tool allowed on the approach


@dataclass(frozen=True)
class Knots:
    """How many knots a trajectory has, and the phase t_1 of the camera point."""

    count: int
    camera_phase: float

    @property
    def first(self) -> int:
        """Index of the first knot at or after t_1."""
        return int(np.ceil(self.camera_phase * (self.count - 1) - 1e-9))


def functionals(
    setup: Setup, options: PlanOptions, knots: Knots, reduction: Reduction, push: PushForm
) -> list[Term]:
    """F_s, F_d, F_p and F_v with their weights; no F_p without neighbours to push past."""
    a = options.alphas
    terms: list[Term] = [
        ObstacleTerm("static", a[0], options.epsilon, reduction),
        ObstacleTerm("avoid", a[1], options.epsilon, reduction),
    ]
    if setup.neighbours and setup.goal_position is not None:
        terms.append(
            PushTerm(
                a[2], setup.goal_position, setup.scene.frame, knots.first,
                np.asarray(options.push_weights, dtype=np.float64), push,
            )
        )  # fmt: skip
    terms.append(VelocityTerm(a[3]))
    return terms


def drift_constraint(setup: Setup, options: PlanOptions, knots: Knots, drift: Drift) -> Term:
    """Constraints 1 and 2."""
    offset = options.drift_offset
    wanted = setup.robot.gripper_radius if offset is None else offset
    return DriftConstraint(
        options.priority.drift, drift.centers, drift.directions, setup.scene.frame[2],
        drift.windows, np.full(len(drift.ids), wanted + DRIFT_MARGIN),
        knots.first,
    )  # fmt: skip


def constraints(
    setup: Setup, options: PlanOptions, knots: Knots, drift: Drift, reference: FloatArray
) -> list[Term]:
    """Every constraint of the joint problem; ``reference`` (T, 3) are the initial tool points."""
    p, robot, frame = options.priority, setup.robot, setup.scene.frame
    proximal = ~np.asarray(setup.body.distal)
    margin = np.minimum(options.limit_margin, 0.25 * (robot.upper - robot.lower))
    first = knots.first
    terms: list[Term] = [
        LimitConstraint(p.limits, robot.lower + margin, robot.upper - margin),
        StepConstraint(p.step, np.full(robot.n_joints, options.max_step)),
        ClearanceConstraint("touch", "static", p.touch, TOUCH_MARGIN),
        ClearanceConstraint("clearance", "static", p.clearance, options.static_clearance),
        ClearanceConstraint("avoid", "dynamic", p.avoid, options.avoid_clearance, proximal),
        SelfConstraint(p.avoid, options.self_clearance),
    ]
    if setup.goal_position is not None:
        terms.append(GoalConstraint(p.goal, setup.goal_position, setup.goal_axis))
    if drift.ids:
        assert setup.goal_axis is not None
        terms += [
            drift_constraint(setup, options, knots, drift),
            CorridorConstraint(p.corridor, reference, frame[[0, 2]], options.corridor, first),
            UprightConstraint(p.upright, setup.goal_axis, UPRIGHT, first),
        ]
    return terms


def joint_problem(
    setup: Setup,
    options: PlanOptions,
    knots: Knots,
    drift: Drift,
    reference: FloatArray,
    evaluation: Evaluation | None = None,
) -> Problem:
    """All terms and constraints in one problem."""
    terms = functionals(
        setup, options, knots, options.reduction or "sum", options.push or "quadratic"
    )
    terms += [SmoothnessTerm(options.smoothness), *options.terms]
    return Problem(
        setup.robot, setup.surroundings, terms,
        constraints(setup, options, knots, drift, reference), knots.count,
        cutoff=max(options.epsilon, options.static_clearance, options.avoid_clearance) + 1e-3,
        end_fixed=setup.goal_joints is not None, body=setup.body, evaluation=evaluation,
    )  # fmt: skip
