"""A cost of your own, in plain NumPy: checked, minimised alone, and planned with.

A cost returns its value and adds its gradient where it lives: here on the joints (`Posture`) and on
the tool point (`Ceiling`). No Jacobian is written. The gradient is first compared with finite
differences, as you should for any new cost; then a problem made of both and of a smoothness cost is
solved. At the end the planner itself takes a cost along.

    python examples/05_cost_term_in_numpy.py
"""

import numpy as np

from optipromp import Cup, PlanOptions, load_robot, plan, with_tool
from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.obstacles import pack
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import SmoothnessCost
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.optimization.gauss_newton import GaussNewtonOptions, solve
from optipromp.core.optimization.problem import Problem, Surroundings


class Posture(Cost):
    """½ ∫ ‖q − q_ref‖² dt: prefer to stay near a posture."""

    def __init__(self, weight: float, reference: FloatArray) -> None:
        super().__init__("posture", weight)
        self.reference = reference

    def add(self, e: Evaluation, scale: float) -> float:
        """Value; its gradient goes to the joints, its curvature to their diagonal."""
        away = e.q - self.reference
        e.joint_gradient += scale * e.dt * away
        e.band[:, 0] += scale * e.dt
        return 0.5 * e.dt * float(np.sum(away**2))


class Ceiling(Cost):
    """½ ∫ max(0, z − h)² dt of the tool point: stay below a height."""

    def __init__(self, weight: float, height: float) -> None:
        super().__init__("ceiling", weight)
        self.height = height

    def add(self, e: Evaluation, scale: float) -> float:
        """Value; its gradient is a force on the tool point, along z."""
        above = np.maximum(e.tool_points[:, 2] - self.height, 0.0)
        e.force[:, e.tool, 2] += scale * e.dt * above
        e.stiffness[:, e.tool, 2] += scale * e.dt * (above > 0.0)
        return 0.5 * e.dt * float(np.sum(above**2))


def largest_error(problem: Problem, q: FloatArray, step: float = 1e-6) -> float:
    """Largest difference between the problem's gradient and central differences."""
    problem.evaluate(q)
    gradient, worst = problem.gradient(), 0.0
    for waypoint in range(problem.first, problem.last + 1, 5):
        for joint in range(q.shape[1]):
            change = np.zeros_like(q)
            change[waypoint, joint] = step
            slope = problem.evaluate(q + change).merit - problem.evaluate(q - change).merit
            worst = max(worst, abs(slope / (2.0 * step) - gradient[waypoint, joint]))
    return worst


robot = with_tool(load_robot("panda"), Cup(radius=0.03))
start = robot.home
goal = start + np.array([0.9, 0.3, 0.0, 0.2, 0.0, 0.1, 0.0])
waypoints = 40
straight = start + np.linspace(0.0, 1.0, waypoints)[:, None] * (goal - start)
nothing = pack([])
highest = float(robot.tool_pose(straight)[0][:, 2].max())
costs = [
    SmoothnessCost(1e-4),
    Posture(0.05, straight),
    Ceiling(400.0, highest - 0.05),
]
problem = Problem(
    robot,
    Surroundings(nothing, nothing, 0),
    costs,
    [],
    waypoints,
    cutoff=0.02,
    end_fixed=True,
)

rng = np.random.default_rng(0)
error = largest_error(problem, straight + 0.05 * rng.standard_normal(straight.shape))
print(f"gradient against finite differences: {error:.1e}")
if error > 1e-4:
    raise SystemExit("the gradient is wrong")

result = solve(problem, straight, GaussNewtonOptions(stages=(1.0,), iterations=(30,)))
for cost in costs:
    before, after = result.history[0][cost.name], result.history[-1][cost.name]
    print(f"{cost.name:<10} {before:.3e} → {after:.3e}")
if not result.history[-1]["ceiling"] < 0.1 * result.history[0]["ceiling"]:
    raise SystemExit("the tool is still above the ceiling")

# In a plan: opti-promp minimises it with its own costs.
alone = plan("scenario-4")
start, end = alone.trajectory.positions[0], alone.trajectory.positions[-1]
line = np.linspace(start, end, alone.trajectory.n_waypoints)
options = PlanOptions(waypoints=len(line), costs=(Posture(0.1, line),))
with_posture = plan("scenario-4", options=options)
for name, result in (("alone", alone), ("with the posture", with_posture)):
    away = float(np.abs(result.trajectory.positions - line).max())
    print(f"{name}: {result.status}, {away:.3f} rad from a straight line in the joints")
if not with_posture.success:
    raise SystemExit(1)
