"""The tuned numbers of the paper's planner."""

from dataclasses import dataclass

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class PaperParameters(Checked):
    """The planner of the paper (``paper_stages.py``)."""

    stiffness: float = parameter(
        1e5,
        "1/m^2",
        "measured",
        "of constraints 1 to 3; at 1e4 scenario III lacks 0.5 mm of constraint 1",
    )
    joint_iterations: tuple[int, int] = parameter(
        (20, 40), "1", "measured", "in the stages of the joint strategy; decisions.md"
    )
    apart: float = parameter(
        1e5, "1/m^2", "choice", "of self-collision in a stage; the objective is 1 at first"
    )
    wish: float = parameter(
        1e4, "1/m^2", "choice", "of the tool among objects to avoid, in a collision stage"
    )
    hold: float = parameter(
        1e6,
        "1/m^2",
        "measured",
        "of constraints 1 to 3 in a collision stage after the push; at 1e4, 1 lacks 0.2 mm",
    )
    margin: float = parameter(
        1e-3, "m", "choice", "added to constraint 1, because penalties and barriers yield"
    )
    control_points: int = parameter(18, "1", "choice", "of the spline that moves the trajectory")
    unit: float = parameter(0.01, "rad, m", "choice", "of SciPy's variables and rows")
    barrier: float = parameter(0.03, "1", "choice", "initial barrier and tolerance of trust-constr")
    every: int = parameter(
        4, "1", "choice", "constraint 3 is set at every fourth waypoint; the spline is smooth"
    )
    most: int = parameter(
        400,
        "1",
        "measured",
        "waypoints with constraints; with 2,000, the QR in a step of trust-constr takes 1.5 s",
    )
    push_iterations: tuple[int, int] = parameter(
        (10, 15), "1", "published", "of scenarios III (push first) and IV (push last)"
    )
    collision_iterations: tuple[int, int] = parameter(
        (3, 15), "1", "published", "of scenarios IV (collision first) and III (last)"
    )
    held_iterations: int = parameter(
        60, "1", "measured", "of a collision stage with constraints; 15 leave contacts"
    )
    spread_starts: int = parameter(
        96,
        "1",
        "measured",
        "where no plan is valid: with 24, half of all seeds miss the branches of the "
        "elbow's roll between side clusters; with 96, none of 20",
    )


PAPER = PaperParameters()
