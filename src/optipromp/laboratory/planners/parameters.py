"""The tuned numbers of the paper's planner.

Nothing sets them. Each is a choice of ours, unless its comment says measured, published or guess.
A unit stands in brackets; a number without one is a count or a ratio.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperParameters:
    """The planner of the paper (``paper_stages.py``)."""

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
