r"""The paper's own planner, OptI-ProMP (method §5), whole: its functionals under its constraints.

Minimise :math:`\alpha_1F_s+\alpha_2F_d+\alpha_3F_p+\alpha_4F_v` from a conditioned ProMP, under

1. and 2. past each pushable n, at every waypoint of its window
   :math:`|z_g\cdot(fk-X_n)|\le r_n`, on the side away from its stem:
   :math:`d_n\cdot(fk(\xi_t)-X_n)\ge R_{gripper}`;
3. the tool within a tolerance of its initial points along x_g and z_g; y_g is free;
4. joint limits.

Constraints 1 to 3 are rows, each linear in one tool point
(:class:`ConstraintRows`), the same for both
strategies. ``joint`` solves for everything at once (Gauss-Newton,
the rows as penalties). ``sequential`` runs one stage for the push (SciPy's trust-constr, the rows
as constraints) and one for collision and velocity (L-BFGS-B): the push first between side clusters
(scenario III), the collision first beside static objects (scenario IV).
"""

import itertools
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize
from scipy.interpolate import BSpline

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import InvalidRequestError, suggest
from optipromp.core.judging import Judgement, Violation
from optipromp.core.optimization import gauss_newton
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import SmoothnessCost
from optipromp.core.optimization.costs.obstacles import ClearanceCost, SelfCost
from optipromp.core.optimization.costs.tool import GoalCost
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning import collision
from optipromp.core.planning.follow import Waypoints, free_count, reach_count, within_limits
from optipromp.core.planning.goals import find
from optipromp.core.planning.parameters import GOAL, PRIMITIVE, SOLVE, WAYPOINT
from optipromp.core.planning.pick import limits_and_clearances, schedule
from optipromp.core.planning.primitive import led_through, on_branch, via_points
from optipromp.core.planning.result import Planned, Stage, ViaPoint
from optipromp.core.planning.task import Task, pushed_aside, stands
from optipromp.core.planning.timing import paced, timed
from optipromp.core.planning.verdict import judged
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.rules import Drift, DriftRule, detection_variance, drift_choices
from optipromp.core.scenes.scene import JointGoal, PoseGoal
from optipromp.core.trajectory import Trajectory
from optipromp_paper.paper_costs import PaperSettings, paper_violations, weighted


@dataclass(frozen=True)
class PaperParameters:
    """Tuned numbers: our choices, unless a comment says where from; units in brackets."""

    # [1/m^2] measured: of constraints 1 to 3; at 1e4 scenario III lacks 0.5 mm of constraint 1
    stiffness: float = 1e5
    # measured: in the stages of the joint strategy; decisions.md
    joint_iterations: tuple[int, int] = (20, 40)
    apart: float = 1e5  # [1/m^2] of self-collision in a stage; the objective is 1 at first
    wish: float = 1e4  # [1/m^2] of the tool among objects to avoid, in a collision stage
    # [1/m^2] measured: of constraints 1 to 3 in a collision stage after the push; at 1e4, 1 lacks
    # 0.2 mm
    hold: float = 1e6
    margin: float = 1e-3  # [m] added to constraint 1, because penalties and barriers yield
    control_points: int = 18  # of the spline that moves the trajectory
    unit: float = 0.01  # [rad, m] of SciPy's variables and rows
    barrier: float = 0.03  # initial barrier and tolerance of trust-constr
    every: int = 4  # constraint 3 is set at every fourth waypoint; the spline is smooth
    # measured: waypoints with constraints; with 2,000, the QR in a step of trust-constr takes 1.5 s
    most: int = 400
    # published: of scenarios III (push first) and IV (push last)
    push_iterations: tuple[int, int] = (10, 15)
    # published: of scenarios IV (collision first) and III (last)
    collision_iterations: tuple[int, int] = (3, 15)
    held_iterations: int = 60  # measured: of a collision stage with constraints; 15 leave contacts
    # measured: where no plan is valid: with 24, half of all seeds miss the branches of the elbow's
    # roll between side clusters; with 96, none of 20
    spread_starts: int = 96


PAPER = PaperParameters()


class ConstraintRows(Cost):
    """Constraints 1 to 3 as rows ``lower ≤ axis·fk(ξ_t) ≤ upper``, each at one waypoint.

    The cost is the quadratic penalty ½ Σ weight·v², where v is the violation of a row [m]. ``at``
    (m,) are waypoints, ``axes`` (m, 3) unit vectors, ``lower`` and ``upper`` (m,) bounds [m].
    """

    def __init__(
        self, weight: float, at: IntArray, axes: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> None:
        super().__init__("rows", weight)
        self.at = np.asarray(at, dtype=np.int64)
        self.axes, self.lower, self.upper = axes, lower, upper
        x, y, z = axes.T
        self.outer = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)

    def add(self, e: Evaluation, scale: float) -> float:
        """The penalty, with its gradient and curvature added to ``e``."""
        value = np.einsum("mi,mi->m", e.points[self.at, e.tool], self.axes)
        off = value - np.clip(value, self.lower, self.upper)
        if scale > 0.0:
            out = np.flatnonzero(off)
            force, stiffness = e.force[:, e.tool], e.stiffness[:, e.tool]
            np.add.at(force, self.at[out], scale * off[out, None] * self.axes[out])
            np.add.at(stiffness, self.at[out], scale * self.outer[out])
        return 0.5 * float(off @ off)


@dataclass(frozen=True, eq=False)
class Posed:
    """The paper's problem for one goal configuration and one choice of sides."""

    task: Task  # scene and robot
    options: PaperSettings  # settings of the planner
    waypoints: Waypoints  # number of waypoints, and the first at or after t_1
    drift: Drift  # place of each pushable to pass, and the direction to its free side
    offsets: FloatArray  # (N,) lateral offset that constraint 1 asks for at each pushable [m]
    via: tuple[ViaPoint, ...]  # tool points that the ProMP was conditioned on, the target last
    initial: FloatArray  # (T, n) the conditioned ProMP
    points: FloatArray  # (T, 3) tool points of ``initial`` [m]

    def rows(self, weight: float = 0.0, every: int = 1, most: int | None = None) -> ConstraintRows:
        """Constraints 1 and 2 at ``most`` waypoints (None: all), 3 at each ``every``-th of them.

        A waypoint is in the window of a pushable where its initial height along z_g is, within the
        tolerance of constraint 3. The last waypoint, the goal, has no rows.
        """
        frame, options = self.task.scene.frame, self.options
        apart = 1 if most is None else math.ceil(self.waypoints.count / most)
        free = np.arange(self.waypoints.first, self.waypoints.count - 1)[::apart]
        rows: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
        for center, direction, (low, high), offset in zip(
            self.drift.centers, self.drift.directions, self.drift.windows, self.offsets, strict=True
        ):
            height = (self.points[free] - center) @ frame[2]
            at = free[(height >= low - options.corridor) & (height <= high + options.corridor)]
            least = np.full(len(at), float(center @ direction) + offset + PAPER.margin)
            rows.append((at, direction, least, np.full(len(at), np.inf)))
        for axis in frame[[0, 2] if options.drift == "paper" else [2]]:
            at = free[::every]
            middle = self.points[at] @ axis
            rows.append((at, axis, middle - options.corridor, middle + options.corridor))
        at, lower, upper = (np.concatenate([row[k] for row in rows]) for k in (0, 2, 3))
        axes = np.concatenate([np.tile(axis, (len(at), 1)) for at, axis, _, _ in rows])
        return ConstraintRows(weight, at, axes, lower, upper)

    def functionals(self) -> list[Cost]:
        """F_s, F_d, F_p and F_v with their weights, in the forms of the strategy."""
        return weighted(self.task, self.options, self.waypoints.first)

    def timed(self, q: FloatArray) -> Trajectory:
        """Waypoints ``q`` (T, n) as a trajectory, slow on the approach among what is pushed."""
        if stands(self.task):
            return paced(self.task, self.options, q, self.waypoints.first, None)
        slow = self.waypoints.first if self.task.neighbours else None
        return timed(self.task, self.options, q, slow)

    def problem(self, terms: Sequence[Cost], constraints: Sequence[Cost], ends: bool) -> Problem:
        """The problem over the waypoints; the first is fixed, with ``ends`` also the last."""
        task, options = pushed_aside(self.task), self.options  # before the arm comes
        cutoff = max(options.epsilon, options.static_clearance, options.avoid_clearance)
        return Problem(
            task.robot, task.surroundings, terms, constraints, self.waypoints.count,
            cutoff=cutoff + 1e-3, end_fixed=ends,
        )  # fmt: skip


def drift_offsets(task: Task, options: PaperSettings) -> FloatArray:
    """The lateral offset (N,) that constraint 1 asks for at each neighbour [m].

    It is that of the options, else of the scene, else R_gripper.
    """
    wanted = options.drift_offset
    wanted = task.scene.options.get("drift_offset") if wanted is None else wanted
    wanted = task.robot.gripper_radius if wanted is None else wanted
    if not isinstance(wanted, Mapping):
        return np.full(len(task.neighbours), float(wanted))
    ids = [item.id for item in task.scene.pushables]
    for name in wanted:
        if name not in ids:
            raise InvalidRequestError(f"drift_offset of {name!r}: {suggest(name, ids)}")
    usual = task.robot.gripper_radius
    return np.array([float(wanted.get(item.id, usual)) for item in task.neighbours])


def posed_problems(
    task: Task, promp: ProMP, options: PaperSettings, goals: FloatArray
) -> Iterator[list[Posed]]:
    """For each goal configuration of ``goals`` (m, n): the problems of all choices of sides.

    The configuration whose motion takes the fewest waypoints comes first.
    """
    positions, offsets = [obj.position for obj in task.neighbours], drift_offsets(task, options)
    names = ["camera", *(obj.id for obj in task.neighbours), "goal"]
    branches: list[tuple[FloatArray, FloatArray]] = []
    for goal in goals:
        branch = None
        if positions:
            points, deviations = via_points(task, positions, options.via_deviation)
            branch = on_branch(task, points, goal)
        if branch is None:
            branches.append((goal[None], np.zeros(1)))
            continue
        variances = deviations.astype(np.float64) ** 2  # a deviation may be an integer
        variances[1:-1] += [detection_variance(obj) for obj in task.neighbours]
        branches.append((branch, variances / PRIMITIVE.lever_arm**2))
    branches.sort(key=lambda branch: spaced(task, options, branch[0]).count)
    for values, variances in branches:
        waypoints = spaced(task, options, values)
        phases = np.linspace(waypoints.phase, 1.0, len(values)) if len(values) > 1 else [1.0]
        q = led_through(promp, task.start, np.array(phases), values, variances, waypoints.count)
        met, points = (task.robot.tool_pose(one)[0] for one in (values, q))
        via = tuple(map(ViaPoint, names[-len(met) :], met))
        yield [
            Posed(task, options, waypoints, drift, offsets, via, q, points)
            for drift in paper_choices(task, options.drift)
        ]


def paper_choices(task: Task, rule: DriftRule) -> list[Drift]:
    """The choices of sides, each pushable's window being its own extent along z_g."""
    half = np.array([item.extent(task.scene.frame[2]) for item in task.neighbours])
    windows = np.column_stack([-half, half])
    return [
        replace(drift, windows=windows)
        for drift in drift_choices(task.scene, task.neighbours, rule)
    ]


def at_phase(count: int, phase: float) -> Waypoints:
    """``count`` waypoints, of which the first at or after a phase is the first on the path."""
    return Waypoints(count, int(np.ceil(phase * (count - 1) - 1e-9)))


def spaced(task: Task, options: PaperSettings, values: FloatArray) -> Waypoints:
    """Waypoints between which no joint moves much more than the wanted step.

    The step holds before t_1 and after it. ``values`` (m, n) are the configurations that the motion
    is led through after the start.
    """
    reach = values[0] - task.start
    if len(values) == 1:
        count = options.waypoints or free_count(reach, options.max_step)
        return at_phase(count, options.camera_phase or 0.5)
    tools = task.robot.tool_pose(values)[0]
    path = float(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())
    moved = float(np.abs(np.diff(values, axis=0)).max(axis=1).sum())
    before = max(reach_count(reach, options.max_step), WAYPOINT.fewest_reach)
    after = max(
        1.6 * moved / (WAYPOINT.share * options.max_step),
        WAYPOINT.fewest_approach,
        path / WAYPOINT.tool_step,
    )
    count = options.waypoints or within_limits(10 * np.ceil((before + after) / 10))
    phase = min(max(0.2, before / (before + after)), 0.75)
    return at_phase(count, options.camera_phase or phase)


def further(task: Task, seed: int, known: FloatArray) -> FloatArray:
    """Free goal configurations (m, n) that differ from the ``known`` ones (k, n), best first.

    More starts of inverse kinematics find them on all branches and rolls of the elbow.
    """
    if isinstance(task.goal, JointGoal):
        return known[:0]
    found = find(task, seed, PAPER.spread_starts)
    away = np.abs(found[:, None] - known).max(axis=2).min(axis=1)
    return collision.free(task, found[away > GOAL.distinct])


@dataclass(frozen=True, eq=False)
class Solved:
    """A posed problem, the trajectory that solves it, and its judgement."""

    posed: Posed
    trajectory: Trajectory
    stages: tuple[Stage, ...]
    judgement: Judgement
    objective: float  # Σ α·F with the quadratic F_p; compares valid plans

    @property
    def valid(self) -> bool:
        """Whether the judge found no violation."""
        return not self.judgement.violations

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key: valid before invalid, then by the objective."""
        return not self.valid, self.objective


def solve(
    task: Task, promp: ProMP, options: PaperSettings, goals: FloatArray, budget: Budget
) -> Planned:
    """Plan as the paper does, to each of the ``goals`` (m, n) in turn until a plan is valid.

    Each initial trajectory is ``promp``, conditioned on its goal. Stems leave choices of the side
    on which a pushable is passed: the valid plan of least objective is the answer. The sequential
    strategy tries all choices with the smallest trust radius, then with the next. Where the
    smallest radius gives no valid plan, further goal configurations are tried
    (:func:`further`).
    """
    began = clock()
    strategy, radii = options.strategy, options.trust_radii
    if strategy == "joint" or not task.neighbours:
        radii = radii[:1]  # there is no push stage to begin from them
    tried: list[float] = []
    best: Solved | None = None
    by_goal = list(posed_problems(task, promp, options, goals))

    def attempts() -> Iterator[tuple[float, list[Posed]]]:
        """Trust radii with the choices of sides of a goal, in the order in which they are tried."""
        yield from itertools.product(radii[:1], by_goal)
        more = further(pushed_aside(task), task.seed, goals)
        new = list(posed_problems(task, promp, options, more))
        yield from itertools.product(radii[:1], new)
        yield from itertools.product(radii[1:], by_goal + new)

    first = by_goal[0][0]
    budget.spent()
    unmoved = _judged(first, first.initial, ())  # the budget learns what the last judgement takes
    if budget.spent():
        best, radii = unmoved, ()
    for radius, same_goal in attempts():
        tried += [radius] if radius not in tried else []
        for posed in same_goal:
            if best is None or not budget.spent():
                if strategy == "joint":
                    solved = _joint(posed, budget)
                else:
                    solved = _judged(posed, *staged(posed, radius, budget))
                best = solved if best is None or solved.rank < best.rank else best
        assert best is not None  # there is at least one choice of sides
        if best.valid or not best.stages or budget.spent():
            break
    assert best is not None  # there is at least one goal configuration
    told = f"; trust radii tried [rad]: {', '.join(f'{radius:g}' for radius in tried)}"
    stages = tuple(
        replace(stage, message=stage.message + told) if stage.name == "push" else stage
        for stage in best.stages
    )
    times = {stage.name: stage.seconds for stage in stages}
    times[strategy] = clock() - began
    same = best.posed is first
    initial = unmoved.trajectory if same else best.posed.timed(best.posed.initial)
    return Planned(
        best.trajectory, best.posed.waypoints.first, initial, None, stages, bool(stages), times,
        best.judgement, via=best.posed.via,
    )  # fmt: skip


def _judged(posed: Posed, q: FloatArray, stages: Sequence[Stage]) -> Solved:
    """Judge waypoints ``q`` (T, n); with ``constraints: paper`` also by constraints 1 and 2."""
    task, options = posed.task, posed.options
    trajectory = posed.timed(q)
    judgement = judged(task, trajectory, stem_side=True)
    if options.constraints == "paper":
        missing = [
            Violation(
                "drift",
                f"the tool passes {name} {1e3 * (offset - short):.1f} mm aside; constraint 1 "
                f"of the paper asks for {1e3 * offset:.1f} mm", name, None, short, "m",
            )
            for (name, short), offset in zip(
                drift_shortfalls(posed, q).items(), posed.offsets, strict=True
            )
            if short > 0.0
        ]  # fmt: skip
        missing += [
            found
            for found in paper_violations(task.scene, judgement.metrics)
            if found.kind == "stem"  # constraint 2; constraint 1 is asked above, for the offset
        ]
        judgement = replace(judgement, violations=(*judgement.violations, *missing))
    same = replace(options, reduction="sum", push="quadratic")
    terms = weighted(task, same, posed.waypoints.first)
    value = posed.problem(terms, (), True).evaluate(q)
    return Solved(posed, trajectory, tuple(stages), judgement, value.cost)


def drift_shortfalls(posed: Posed, q: FloatArray) -> dict[str, float]:
    """What constraint 1 lacks at the worst waypoint of each pushable's window [m], by its id.

    The lack is at most 0 where the constraint holds. Tool points come from the judge's kinematics.
    """
    _, _, points, _ = judging.swept(posed.task.scene, posed.task.robot, q)
    up, drift = posed.task.scene.frame[2], posed.drift
    out = {}
    for name, center, direction, (low, high), offset in zip(
        drift.ids, drift.centers, drift.directions, drift.windows, posed.offsets, strict=True
    ):
        off = points[posed.waypoints.first :] - center
        height = off @ up
        within = (height >= low) & (height <= high)
        within[np.argmin(np.abs(height))] = True  # also where two waypoints leap over the window
        out[name] = float(offset) - float((off[within] @ direction).min())
    return out


def _joint(posed: Posed, budget: Budget) -> Solved:
    """All functionals and constraints in one Gauss-Newton solve, from the conditioned ProMP."""
    options, task = posed.options, posed.task
    if options.iterations == 0:
        return _judged(posed, posed.initial, ())
    began = clock()
    constraints = [*limits_and_clearances(task, options), posed.rows(PAPER.stiffness)]
    if isinstance(task.goal, PoseGoal):
        constraints.append(GoalCost(SOLVE.must, task.goal.position, task.goal.axis))
    terms = [*posed.functionals(), SmoothnessCost(options.smoothness), *options.costs]
    problem = posed.problem(terms, constraints, ends=not isinstance(task.goal, PoseGoal))
    usual = schedule(options)
    if options.iterations is None:
        usual = replace(usual, iterations=PAPER.joint_iterations)
    result = gauss_newton.solve(problem, posed.initial, usual, budget)
    seconds = clock() - began
    names = tuple(term.name for term in terms)
    stage = Stage("joint", "gauss-newton", names, result.history, seconds, result.message)
    return _judged(posed, result.q, [stage])


def staged(posed: Posed, radius: float, budget: Budget) -> tuple[FloatArray, list[Stage]]:
    """Waypoints (T, n) after both stages, and the stages; the push's first trust is ``radius``.

    With ``constraints: paper``, a collision stage after the push keeps constraints 1 to 3 as
    penalties. Otherwise the collision stage may undo a part of the drift, as the authors' does.
    """
    options, q = posed.options, posed.initial
    stages: list[Stage] = []
    if options.iterations == 0:
        return q, stages
    order = ("collision", "push") if posed.task.scene.static else ("push", "collision")
    for place, name in enumerate(order):
        if stages and budget.cut:
            break
        if name == "push" and posed.drift.ids:
            limit = options.iterations or PAPER.push_iterations[place]
            q, stage = _push(posed, q, radius, limit, budget)
            stages.append(stage)
        elif name == "collision":
            hold = options.constraints == "paper" and place == 1
            limit = options.iterations or (
                PAPER.held_iterations if hold else PAPER.collision_iterations[place]
            )
            q, stage = _collision(posed, q, limit, budget, hold)
            stages.append(stage)
    return q, stages


class Spline:
    """Trajectories q + Bc about a trajectory q (T, n): the variable of the sequential strategy.

    B (T, k) are cubic B-splines over the waypoints, times ``PAPER.unit``, without the two that move
    an end. So start and goal stay, and the change is smooth. The splines are a partition of unity:
    bounds on the control points c (k, n) keep every waypoint within the joint limits, or bring a
    waypoint back that is outside.

    The objective is that of the stage's functionals over its first value. Self-collision and the
    costs ``held`` are penalties beside it.
    """

    def __init__(
        self, posed: Posed, q: FloatArray, names: Sequence[str], budget: Budget,
        held: Sequence[Cost] = (),
    ) -> None:  # fmt: skip
        robot, self.budget = posed.task.robot, budget
        grid = np.concatenate(
            [[0.0] * 3, np.linspace(0.0, 1.0, PAPER.control_points - 2), [1.0] * 3]
        )
        design = BSpline.design_matrix(np.linspace(0.0, 1.0, len(q)), grid, 3).toarray()
        self.basis = np.ascontiguousarray(PAPER.unit * design[:, 1:-1])
        self.q, self.shape = q, (self.basis.shape[1], q.shape[1])
        moved = (self.basis > 0.0)[:, :, None]
        low = np.where(moved, (robot.lower - q)[:, None, :], -np.inf).max(axis=0)
        high = np.where(moved, (robot.upper - q)[:, None, :], np.inf).min(axis=0)
        low, high = np.minimum(low, high), np.maximum(low, high)  # both limits may be exceeded
        self.bounds = optimize.Bounds(low.ravel() / PAPER.unit, high.ravel() / PAPER.unit)
        terms = [term for term in posed.functionals() if term.name in names]
        apart = SelfCost(PAPER.apart, posed.options.self_clearance)
        self.problem = posed.problem(terms, [apart, *held], ends=True)
        self.began = clock()
        value = self.problem.evaluate(q)
        self.history = [value.costs]
        self.size = max(value.cost, 1e-12)

    def begin(self) -> FloatArray:
        """The control points (flat) of the trajectory itself, drawn within the joint limits."""
        return np.clip(np.zeros(math.prod(self.shape)), self.bounds.lb, self.bounds.ub)

    def at(self, c: FloatArray) -> FloatArray:
        """The trajectory (T, n) of control points ``c`` (flat)."""
        return np.asarray(self.q + self.basis @ c.reshape(self.shape))

    def objective(self, c: FloatArray) -> tuple[float, FloatArray]:
        """The objective of control points ``c`` (flat), and its gradient."""
        value = self.problem.evaluate(self.at(c), self.size)
        gradient = self.basis.T @ self.problem.gradient()
        return value.merit / self.size, gradient.ravel() / self.size

    def record(self, intermediate_result: optimize.OptimizeResult) -> None:
        """Record the costs after an iteration of SciPy's, which ends once the budget is spent."""
        self.history.append(self.problem.evaluate(self.at(intermediate_result.x)).costs)
        if self.budget.spent():
            raise StopIteration

    def stage(self, name: str, solver: str, message: str) -> Stage:
        """The record of the stage."""
        names = tuple(term.name for term in self.problem.costs)
        seconds = clock() - self.began
        return Stage(name, solver, names, tuple(self.history), seconds, message)


def _collision(
    posed: Posed, q: FloatArray, limit: int, budget: Budget, hold: bool
) -> tuple[FloatArray, Stage]:
    """Minimise α1 F_s + α2 F_d + α4 F_v by L-BFGS-B, from ``q`` (T, n).

    A weak penalty keeps the tool off objects to avoid; with ``hold``, one keeps constraints 1 to 3.
    """
    tool = np.array(posed.task.body.distal)
    held: list[Cost] = [ClearanceCost("tool avoid", "dynamic", PAPER.wish, 0.0, tool)]
    held += [posed.rows(PAPER.hold)] if hold else []
    spline = Spline(posed, q, ("static", "avoid", "velocity"), budget, held)
    result = optimize.minimize(
        spline.objective, spline.begin(), jac=True, method="L-BFGS-B",
        bounds=spline.bounds, callback=spline.record, options={"maxiter": limit},
    )  # fmt: skip
    return spline.at(result.x), spline.stage("collision", "l-bfgs-b", str(result.message))


def _push(
    posed: Posed, q: FloatArray, radius: float, limit: int, budget: Budget
) -> tuple[FloatArray, Stage]:
    """Minimise F_p by trust-constr under constraints 1 to 4, from ``q`` (T, n)."""
    spline, robot = Spline(posed, q, ("push",), budget), posed.task.robot
    rows = posed.rows(every=PAPER.every, most=PAPER.most)

    def values(c: FloatArray) -> FloatArray:
        points, _ = robot.tool_pose(spline.at(c))
        return np.asarray(np.einsum("mi,mi->m", points[rows.at], rows.axes) / PAPER.unit)

    def jacobian(c: FloatArray) -> FloatArray:
        points, _ = robot.tool_jacobian(spline.at(c))
        of_joints = np.einsum("mi,min->mn", rows.axes, points[rows.at]) / PAPER.unit
        full = np.einsum("mk,mn->mkn", spline.basis[rows.at], of_joints)
        return np.asarray(full.reshape(len(rows.at), spline.basis.shape[1] * robot.n_joints))

    constraint = optimize.NonlinearConstraint(
        values, rows.lower / PAPER.unit, rows.upper / PAPER.unit, jac=jacobian, hess=optimize.BFGS()
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="delta_grad == 0.0", category=UserWarning)
        result = optimize.minimize(
            spline.objective, spline.begin(), jac=True, method="trust-constr",
            hess=optimize.BFGS(), bounds=spline.bounds,
            constraints=[constraint] if len(rows.at) else [],  # among a few waypoints none is free
            callback=spline.record, options={
                "maxiter": limit, "initial_tr_radius": radius / PAPER.unit,
                "initial_barrier_parameter": PAPER.barrier,
                "initial_barrier_tolerance": PAPER.barrier,
            },
        )  # fmt: skip
    message = f"{result.message} First trust radius: {radius:g} rad"
    return spline.at(result.x), spline.stage("push", "trust-constr", message)
