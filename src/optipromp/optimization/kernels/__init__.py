r"""Kernels of the planning loop: distances, functionals and penalties over all knots.

Everything that happens in the workspace happens at *points*: the B body spheres, the tool point and
a second point on the tool axis (the tip). A kernel reads point positions, adds the gradient of its
value with respect to them to ``force`` (T, B+2, 3), and a positive semi-definite curvature to
``stiffness`` (T, B+2, 6), stored as xx, yy, zz, xy, xz, yz; that of the tip is with respect to its
place about the tool point, where a term of the tool's axis lives. One pass pulls both back
to the joints:
the forces by :func:`optipromp.robots.kernels.pull_back`, the stiffnesses by :func:`add_stiffness`.
"""

from optipromp.optimization.kernels.assembly import add_stiffness
from optipromp.optimization.kernels.clearance import (
    clearance_field,
    clearance_in_cells,
    clearance_penalty,
    obstacle_cost,
    obstacle_functional,
    point_speed,
    self_penalties,
    self_penalty,
)
from optipromp.optimization.kernels.joints import (
    limit_penalty,
    smoothness,
    step_penalty,
    velocity_functional,
)
from optipromp.optimization.kernels.outer import add_outer
from optipromp.optimization.kernels.tool import (
    axis_penalty,
    corridor_penalty,
    drift_penalty,
    funnel_penalty,
    goal_penalty,
    push_quadratic,
    push_reciprocal,
    tool_step_penalty,
)

__all__ = [
    "add_outer",
    "add_stiffness",
    "axis_penalty",
    "clearance_field",
    "clearance_in_cells",
    "clearance_penalty",
    "corridor_penalty",
    "drift_penalty",
    "funnel_penalty",
    "goal_penalty",
    "limit_penalty",
    "obstacle_cost",
    "obstacle_functional",
    "point_speed",
    "push_quadratic",
    "push_reciprocal",
    "self_penalties",
    "self_penalty",
    "smoothness",
    "step_penalty",
    "tool_step_penalty",
    "velocity_functional",
]
