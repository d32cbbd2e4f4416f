"""The optimisation problem of a setup: which terms and constraints, with which numbers."""

from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.optimization.constraints import (
    ClearanceConstraint,
    CorridorConstraint,
    DriftConstraint,
    FunnelConstraint,
    GoalConstraint,
    LevelConstraint,
    LimitConstraint,
    SelfConstraint,
    StepConstraint,
    ToolStepConstraint,
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
from optipromp.pushing.plane import ploughs
from optipromp.pushing.sides import Drift
from optipromp.robots.tools import FrankaHand

DRIFT_MARGIN = 1e-3  # [m] so that the drift still holds at the knots once the penalty has settled
TOUCH_MARGIN = 1e-3  # [m] under which clearance outranks the goal
ASIDE_MARGIN = 4e-3  # [m] that the tool may swing out beyond what the pushables ask for
CAPTURE_LEAST = 2e-3  # [m] off the approach line at the target, for a mouth hardly wider than it
UPRIGHT = np.deg2rad(2.0)  # [rad] tilt of the tool allowed on the approach
TOOL_STEP = 0.006  # [m] between knots of the approach
WITHIN = 3e-3  # of the stiffness of a corridor's walls, between them
FOLLOW = 1e-3  # [m] that a hand may leave the way it was given


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


def widths(setup: Setup, options: PlanOptions, drift: Drift) -> tuple[FloatArray, FloatArray]:
    """How far (N,) the tool must pass each neighbour, and how far it should [m]."""
    wanted = options.drift_offset
    least = (setup.robot.gripper_radius if wanted is None else wanted) + DRIFT_MARGIN
    radii = np.array([thing.radius for thing in setup.neighbours])
    berths = options.berth if drift.berths is None else drift.berths
    return np.full(len(radii), least), least + berths * radii


def capture_height(setup: Setup) -> float:
    """How far below the goal the tool begins to take in the target [m]."""
    assert setup.scene.target is not None
    return float(getattr(setup.robot.tool, "depth", 0.0)) + setup.scene.target.radius


def drift_constraints(
    setup: Setup, options: PlanOptions, knots: Knots, drift: Drift, reference: FloatArray
) -> list[Term]:
    """Constraints 1 and 2, and the wider berth that a real fruit wants.

    No knot is asked to pass a neighbour farther aside than ``reference`` (T, 3) does: where ways
    past two of them contradict, that one is the compromise.
    """
    weights = options.priority.drift, options.priority.berth
    most = np.einsum("tni,ni->tn", reference[:, None] - drift.centers, drift.directions)
    return [
        DriftConstraint(
            weight, drift.centers, drift.directions, setup.scene.frame[2], drift.windows,
            offset, knots.first, most=most,
        )
        for weight, offset in zip(weights, widths(setup, options, drift), strict=True)
    ]  # fmt: skip


def funnel_constraint(setup: Setup, options: PlanOptions, knots: Knots, drift: Drift) -> Term:
    """How far from the approach line the tool may be, at every height."""
    target, up = setup.scene.target, setup.scene.frame[2]
    assert target is not None
    off = drift.centers - target.position
    flat = off - (off @ up)[:, None] * up
    ends = flat + (widths(setup, options, drift)[1] + ASIDE_MARGIN)[:, None] * drift.directions
    return FunnelConstraint(
        options.priority.funnel, target.position, up, below=capture_height(setup),
        width=max(CAPTURE_LEAST, setup.robot.gripper_radius - target.radius),
        widest=float(np.max(np.linalg.norm(ends, axis=1))), first=knots.first,
    )  # fmt: skip


def follow_constraints(
    setup: Setup, options: PlanOptions, knots: Knots, reference: FloatArray
) -> list[Term]:
    """A hand's tool point keeps to the way it was given, points along the approach and is level."""
    p, robot = options.priority, setup.robot
    assert setup.goal_axis is not None
    assert isinstance(robot.tool, FrankaHand)
    mine = np.flatnonzero(robot.spheres.link == len(robot.link_names) - 1)
    opens = robot.flange_rotation @ robot.tool.rotation[:, 1]
    along = robot.spheres.center[mine] @ opens
    first = setup.body.tool - len(mine)  # the tool's spheres come last
    pair = first + int(np.argmin(along)), first + int(np.argmax(along))
    return [
        CorridorConstraint(p.follow, reference, np.eye(3), FOLLOW, knots.first, WITHIN),
        UprightConstraint(p.follow, setup.goal_axis, UPRIGHT, knots.first),
        LevelConstraint(p.level, pair, setup.scene.frame[0], knots.first),
    ]


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
        ClearanceConstraint("tool avoid", "dynamic", p.tool_avoid, 0.0, ~proximal),
        SelfConstraint(p.avoid, options.self_clearance),
    ]
    if setup.goal_position is not None:
        terms.append(GoalConstraint(p.goal, setup.goal_position, setup.goal_axis))
    if ploughs(setup.scene, robot.tool):
        terms += follow_constraints(setup, options, knots, reference)
    elif drift.ids:
        assert setup.goal_axis is not None
        terms += [
            *drift_constraints(setup, options, knots, drift, reference),
            funnel_constraint(setup, options, knots, drift),
            ToolStepConstraint(p.tool_step, TOOL_STEP, knots.first),
            CorridorConstraint(p.corridor, reference, frame, options.corridor, first, WITHIN),
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
