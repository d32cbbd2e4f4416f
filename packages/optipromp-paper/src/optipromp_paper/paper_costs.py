"""The paper's functionals F_s, F_d, F_p and F_v, and the settings of its planner."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Unit

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import called
from optipromp.core.errors import InvalidRequestError
from optipromp.core.judging import Metrics, Violation
from optipromp.core.optimization.costs.joints import VelocityCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost, Reduction
from optipromp.core.optimization.evaluation import Cost, Evaluation
from optipromp.core.optimization.kernels import add_along
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning.options import Metres, Optimised, Phase
from optipromp.core.planning.result import Planned, Term
from optipromp.core.planning.task import Task
from optipromp.core.scenes.scene import PoseGoal, Scene
from optipromp.core.values import NotNegative, Positive

Strategy = Literal["joint", "sequential"]
Constraints = Literal["push-model", "paper"]
PushForm = Literal["quadratic", "reciprocal"]
PaperDrift = Literal["paper", "lateral-plane"]


@dataclass(frozen=True)
class PaperSettings(Optimised):
    r"""The settings of the paper's planner; what the paper leaves open is as its authors have it.

    ``corridor`` is also the tolerance of constraint 3 about the initial tool points: along x_g and
    z_g, and along z_g alone where ``drift`` is ``lateral-plane``.

    Attributes:
        strategy: ``sequential``: the paper's two stages; ``joint``: one solve.
        constraints: ``paper``: a plan is a success only if constraint 1 holds at every waypoint of
            the paper's window. ``push-model``: success is decided as for other planners. Both
            strategies plan with constraints 1 to 3 in any case.
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
        drift_offset: least d_n·(fk − X_n) of constraint 1 [m], of all pushables or by the id of a
            pushable (R_gripper where the id is missing); None: as the scene says (by default
            R_gripper).
        camera_phase: t_1, the phase of the camera point in (0, 1); None: such that steps before and
            after the camera point are equally long.
        via_deviation: standard deviation with which the ProMP is held to a pushable [m].
        trust_radii: first trust radii of the push stage of the sequential strategy [rad]. They are
            tried in this order, and the first valid plan is kept.
    """

    strategy: Strategy = "sequential"
    constraints: Constraints = "paper"
    alphas: tuple[NotNegative, NotNegative, NotNegative, NotNegative] = (1.0, 1.0, 1.0, 0.0)
    epsilon: Annotated[float, Gt(0.0), Unit("m")] = 0.01
    reduction: Reduction | None = None
    push: PushForm | None = None
    push_weights: tuple[NotNegative, NotNegative, NotNegative] = (1.0, 1.0, 1.0)
    drift: PaperDrift = "paper"
    drift_offset: Metres | Mapping[str, Metres] | None = None
    camera_phase: Phase | None = None
    via_deviation: Metres = 1e-3
    trust_radii: tuple[Positive, ...] = (0.005, 0.01, 0.02, 0.05, 0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        radii = list(self.trust_radii)
        if not radii or radii != sorted(radii):
            raise InvalidRequestError(
                f"trust_radii is {radii}: must be positive, from small to large [rad]"
            )


def weighted(task: Task, options: PaperSettings, first: int) -> list[Cost]:
    """F_s, F_d, F_p (from waypoint ``first`` on) and F_v with their weights.

    Without neighbours there is no F_p.
    """
    a, authors = options.alphas, options.strategy == "sequential"
    reduction = options.reduction or ("max" if authors else "sum")
    push = options.push or ("reciprocal" if authors else "quadratic")
    terms: list[Cost] = [
        ObstacleCost("static", a[0], options.epsilon, reduction),
        ObstacleCost("avoid", a[1], options.epsilon, reduction),
    ]
    if task.neighbours and isinstance(task.goal, PoseGoal):
        weights = np.asarray(options.push_weights, dtype=np.float64)
        terms.append(PushCost(a[2], task.goal.position, task.scene.frame, first, weights, push))
    terms.append(VelocityCost(a[3]))
    return terms


def functional_values(
    task: Task, options: PaperSettings, first: int, q: FloatArray
) -> dict[str, float]:
    """The values of the functionals at a trajectory ``q`` (T, n), by name."""
    terms, cutoff = weighted(task, options, first), options.epsilon
    problem = Problem(task.robot, task.surroundings, terms, (), len(q), cutoff=cutoff)
    return problem.evaluate(q).costs


def reported(task: Task, options: PaperSettings, made: Planned) -> dict[str, Term]:
    """Each functional at the trajectories of a plan, and over the stage that minimises it."""
    begin = made.begin
    before, after = (
        functional_values(task, options, made.first, each.positions)
        for each in (begin, made.trajectory)
    )
    out = {}
    for name in ("static", "avoid", "push", "velocity"):
        stage = next((s for s in made.stages if name in s.terms), None)
        first, last = before.get(name, 0.0), after.get(name, 0.0)
        history = () if stage is None else tuple(item.get(name, 0.0) for item in stage.history)
        out[name] = Term(first, first, last, history, "" if stage is None else stage.name)
    return out


@dataclass(frozen=True, eq=False)
class PushCost(Cost):
    r""":math:`F_p=\int_{t_1}^T\lVert fk(\xi_t)-X_g\rVert^2_{\mathcal F_g}dt`, or the authors' form.

    ``goal`` is X_g; the rows of ``frame`` (3, 3) are x_g, y_g and z_g. ``axis_weights`` (3,) weigh
    these axes in the quadratic form. The reciprocal form, that of the authors, has y_g alone;
    ``softening`` [m] keeps it finite.

    Raises:
        InvalidRequestError: another form.
    """

    weight: float
    goal: FloatArray
    frame: FloatArray
    first: int
    axis_weights: FloatArray
    form: PushForm = "quadratic"
    softening: float = 1e-4
    name = "push"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in ("quadratic", "reciprocal"):
            raise InvalidRequestError(f"push is {self.form!r}; use 'quadratic' or 'reciprocal'")

    def add(self, e: Evaluation, scale: float) -> float:
        if self.form == "reciprocal":
            return e.at_points(
                push_reciprocal, scale, self.goal, self.frame[1], self.softening, self.first
            )
        return e.at_points(
            push_quadratic, scale, self.goal, self.frame, self.axis_weights, e.dt, self.first
        )


@called
def push_quadratic(points, tool, goal, frame, axis_weights, dt, first, scale, force, stiffness):
    """F_p = ∫_{t1}^{T} Σ_a w_a (frame_a·(fk − X_g))² dt by the trapezoid rule."""
    total, last = 0.0, points.shape[0] - 1
    for t in range(first, last + 1):
        for a in range(3):
            w = axis_weights[a] * dt * (0.5 if t in (first, last) else 1.0)
            x, y, z = frame[a, 0], frame[a, 1], frame[a, 2]
            off = x * (points[t, tool, 0] - goal[0])
            off += y * (points[t, tool, 1] - goal[1]) + z * (points[t, tool, 2] - goal[2])
            total += w * off * off
            k = 2.0 * scale * w
            add_along(force[t, tool], stiffness[t, tool], k * off, k, x, y, z)
    return total


@called
def push_reciprocal(points, tool, goal, lateral, softening, first, scale, force, _stiffness):
    """The authors' Σ_t 1/|y_g·(fk − X_g)|, kept finite: Σ_t (y² + softening²)^(-1/2).

    The last waypoint is left out: at the target the cost is unbounded.
    """
    total = 0.0
    for t in range(first, points.shape[0] - 1):
        y = 0.0
        for i in range(3):
            y += lateral[i] * (points[t, tool, i] - goal[i])
        value = 1.0 / math.sqrt(y * y + softening * softening)
        total += value
        for i in range(3):
            force[t, tool, i] -= scale * y * value**3 * lateral[i]
    return total


def paper_violations(scene: Scene, metrics: Metrics) -> list[Violation]:
    """Where a judged trajectory breaks the paper's constraints 1 and 2 (method §5): by its
    ``metrics``, and the stems of its ``scene``."""
    out = []
    for item in scene.pushables:
        short, gap = metrics.drift_shortfall[item.id], metrics.stem_gap[item.id]
        if short is not None and short > 1e-4:  # [m] rounding
            near = f"{short * 1e3:.1f} mm nearer than constraint 1 asks for"
            text = f"the tool passes {item.id} {near}"
            out.append(Violation("drift", text, item.id, None, short, "m"))
        if item.stem is not None and gap is not None and gap < item.stem.radius:
            text = f"the line from the tool to {item.id} meets its stem"
            out.append(Violation("stem", text, item.id, None, item.stem.radius - gap, "m"))
    return out
