r"""The sequential strategy of the paper: one functional after another, on SciPy's optimisers.

The push functional goes to trust-constr with the drift (1, 2), corridor (3) and limit (4)
constraints, collision and velocity to L-BFGS-B. The paper's order is push then collision between
side clusters (scenario III) and the reverse beside a table-top (scenario IV): what matters more is
minimised last but is less free then, so static things come first.

Both vary the control points of a cubic B-spline deviation from the conditioned ProMP, zero at both
ends: :math:`\xi = \xi_0 + Bc`. That keeps the update smooth, start and goal fixed, and, because the
basis is a partition of unity, bounds on c keep every knot inside the joint limits.
"""

import time
import warnings
from dataclasses import replace

import numpy as np
from scipy import optimize
from scipy.interpolate import BSpline

from optipromp.arrays import FloatArray
from optipromp.optimization.problem import Problem
from optipromp.planning import joint
from optipromp.planning.build import DRIFT_MARGIN, Knots, functionals
from optipromp.planning.options import PlanOptions
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome, Stage
from optipromp.planning.starts import Starts, initial, sides, tool_path
from optipromp.promp.model import ProMP
from optipromp.pushing.sides import Drift

CONTROL_POINTS = 18
CORRIDOR_EVERY = 4  # knots; the spline leaves no room for more between
PUSH_ITERATIONS = {"first": 10, "second": 15}  # of the paper's scenarios III and IV
COLLISION_ITERATIONS = {"first": 3, "second": 15}


def solve(
    setup: Setup, promp: ProMP, options: PlanOptions, goals: FloatArray, deadline: float
) -> Outcome:
    """Both stages in the paper's order, from the conditioned ProMP on the best goal branch."""
    began = time.perf_counter()
    paper = replace(options, window="paper", drift="paper", berth=0.0)
    drift = sides(setup, paper)[0]
    branch = Starts(setup, promp, paper, goals).branches([tool_path(setup, paper, drift)])[0]
    q0, knots = initial(setup, promp, branch), branch.knots
    basis = deviation_basis(knots.count)
    order = ("collision", "push") if setup.scene.static else ("push", "collision")
    q, stages = q0, []
    for place, name in zip(("first", "second"), order, strict=True):
        if options.iterations == 0 or (name == "push" and not setup.neighbours):
            continue
        stage_began = time.perf_counter()
        if name == "push":
            limit = options.iterations or PUSH_ITERATIONS[place]
            q, history, message = minimise_push(
                setup, options, knots, drift, basis, q, q0, limit, deadline
            )
            terms: tuple[str, ...] = ("push",)
            solver = "trust-constr"
        else:
            limit = options.iterations or COLLISION_ITERATIONS[place]
            q, history, message = minimise_collision(
                setup, options, knots, basis, q, limit, deadline
            )
            terms = ("static", "avoid", "velocity")
            solver = "l-bfgs-b"
        seconds = time.perf_counter() - stage_began
        stages.append(Stage(name, solver, terms, tuple(history), seconds, message))
    timing = {stage.name: stage.seconds for stage in stages}
    timing["sequential"] = time.perf_counter() - began
    return Outcome(
        joint.trajectory_of(setup, options, q0, knots.first),
        joint.trajectory_of(setup, options, q, knots.first), knots,
        tuple(stages), bool(stages), timing,
    )  # fmt: skip


def deviation_basis(n_knots: int, count: int = CONTROL_POINTS) -> FloatArray:
    """Cubic B-splines (T, K) on the knots, without the two that move an end."""
    inner = np.linspace(0.0, 1.0, count - 2)
    grid = np.concatenate([[0.0] * 3, inner, [1.0] * 3])
    z = np.linspace(0.0, 1.0, n_knots)
    design = BSpline.design_matrix(z, grid, 3).toarray()
    return np.ascontiguousarray(design[:, 1:-1])


def control_bounds(setup: Setup, basis: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (K, n) on the control points under which q + Bc keeps the joint limits."""
    robot = setup.robot
    support = basis > 0.0
    low = np.where(support[:, :, None], (robot.lower - q)[:, None, :], -np.inf).max(axis=0)
    high = np.where(support[:, :, None], (robot.upper - q)[:, None, :], np.inf).min(axis=0)
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


def minimise_collision(
    setup: Setup,
    options: PlanOptions,
    knots: Knots,
    basis: FloatArray,
    q: FloatArray,
    limit: int,
    deadline: float,
) -> tuple[FloatArray, list[dict[str, float]], str]:
    """α1 F_s + α2 F_d + α4 F_v by L-BFGS-B, from ``q`` (T, n)."""
    terms = functionals(setup, options, knots, options.reduction or "max", "reciprocal")
    problem = Problem(
        setup.robot, setup.surroundings, [t for t in terms if t.name != "push"], (), knots.count,
        cutoff=options.epsilon, end_fixed=True, body=setup.body,
    )  # fmt: skip
    shape = (basis.shape[1], q.shape[1])
    history = [problem.evaluate(q).terms]
    scale = 1.0 / max(sum(t.weight * history[0][t.name] for t in problem.terms), 1e-12)

    def objective(c: FloatArray) -> tuple[float, FloatArray]:
        value = problem.evaluate(q + basis @ c.reshape(shape))
        return scale * value.merit, scale * (basis.T @ problem.gradient()).ravel()

    def record(c: FloatArray) -> None:
        history.append(problem.evaluate(q + basis @ c.reshape(shape)).terms)
        if time.perf_counter() > deadline:
            raise StopIteration

    low, high = control_bounds(setup, basis, q)
    result = optimize.minimize(
        objective, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B",
        bounds=optimize.Bounds(low.ravel(), high.ravel()), callback=record,
        options={"maxiter": limit},
    )  # fmt: skip
    return q + basis @ result.x.reshape(shape), history, str(result.message)


def minimise_push(
    setup: Setup,
    options: PlanOptions,
    knots: Knots,
    drift: Drift,
    basis: FloatArray,
    q: FloatArray,
    reference: FloatArray,
    limit: int,
    deadline: float,
) -> tuple[FloatArray, list[dict[str, float]], str]:
    """F_p by trust-constr under constraints 1 to 4, from ``q``; 3 is about ``reference``."""
    terms = functionals(setup, options, knots, "max", options.push or "reciprocal")
    problem = Problem(
        setup.robot, setup.surroundings, [t for t in terms if t.name == "push"], (), knots.count,
        cutoff=options.epsilon, end_fixed=True, body=setup.body,
    )  # fmt: skip
    shape = (basis.shape[1], q.shape[1])
    history = [problem.evaluate(q).terms]
    scale = 1.0 / max(history[0]["push"], 1e-12)
    rows = Rows(setup, options, knots, drift, q, reference)

    def trajectory(c: FloatArray) -> FloatArray:
        return np.asarray(q + basis @ c.reshape(shape))

    def objective(c: FloatArray) -> tuple[float, FloatArray]:
        value = problem.evaluate(trajectory(c))
        return scale * value.merit, scale * (basis.T @ problem.gradient()).ravel()

    def constraint(c: FloatArray) -> FloatArray:
        return rows.values(trajectory(c))

    def jacobian(c: FloatArray) -> FloatArray:
        by_knot = rows.jacobian(trajectory(c))  # (m, n), each at its knot
        full = np.einsum("mk,mn->mkn", basis[rows.knots], by_knot)
        return np.asarray(full.reshape(len(by_knot), -1))

    def record(c: FloatArray, _: object) -> bool:
        history.append(problem.evaluate(trajectory(c)).terms)
        return time.perf_counter() > deadline

    low, high = control_bounds(setup, basis, q)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="delta_grad == 0.0", category=UserWarning)
        result = optimize.minimize(
            objective, np.zeros(shape[0] * shape[1]), jac=True, method="trust-constr",
            hess=optimize.BFGS(), bounds=optimize.Bounds(low.ravel(), high.ravel()),
            constraints=[
                optimize.NonlinearConstraint(
                    constraint, rows.lower, rows.upper, jac=jacobian, hess=optimize.BFGS()
                )
            ],
            callback=record, options={
                "maxiter": limit, "initial_tr_radius": 2.0, "initial_barrier_parameter": 0.03,
                "initial_barrier_tolerance": 0.03,
            },
        )  # fmt: skip
    return trajectory(result.x), history, str(result.message)


class Rows:
    """Constraints 1, 2 and 3 as rows ``lower ≤ a·fk(ξ_t) ≤ upper``, one tool point each.

    Which knots pass a pushable is settled by the trajectory the stage begins from.
    """

    def __init__(
        self,
        setup: Setup,
        options: PlanOptions,
        knots: Knots,
        drift: Drift,
        q: FloatArray,
        reference: FloatArray,
    ) -> None:
        self.robot = setup.robot
        x_g, _, z_g = setup.scene.frame
        points = setup.robot.tool_pose(q)[0]
        wanted = setup.robot.gripper_radius
        offset = (wanted if options.drift_offset is None else options.drift_offset) + DRIFT_MARGIN
        index, axes, lower, upper = [], [], [], []
        for center, direction, (low, high) in zip(
            drift.centers, drift.directions, drift.windows, strict=True
        ):
            for t in range(knots.first, knots.count - 1):
                if low <= float((points[t] - center) @ z_g) <= high:
                    index.append(t)
                    axes.append(direction)
                    lower.append(float(center @ direction) + offset)
                    upper.append(np.inf)
        initial = setup.robot.tool_pose(reference)[0]
        for t in range(knots.first, knots.count - 1, CORRIDOR_EVERY):
            for axis in (x_g, z_g):
                index.append(t)
                axes.append(axis)
                lower.append(float(initial[t] @ axis) - options.corridor)
                upper.append(float(initial[t] @ axis) + options.corridor)
        self.knots = np.array(index, dtype=np.int64)
        self.axes = np.array(axes).reshape(-1, 3)
        self.lower, self.upper = np.array(lower), np.array(upper)

    def values(self, q: FloatArray) -> FloatArray:
        """The rows (m,) at a trajectory."""
        points = self.robot.tool_pose(q)[0]
        return np.asarray(np.einsum("mi,mi->m", points[self.knots], self.axes))

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Derivatives (m, n) of each row with respect to the joints at its knot."""
        jp, _ = self.robot.tool_jacobian(q)
        return np.asarray(np.einsum("mi,min->mn", self.axes, jp[self.knots]))
