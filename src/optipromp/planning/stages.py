"""What the strategies hand back."""

from collections.abc import Mapping
from dataclasses import dataclass

from optipromp.arrays import FloatArray
from optipromp.metrics import Judgement
from optipromp.optimization.problem import Problem
from optipromp.optimization.terms import PushForm, Reduction
from optipromp.planning.build import Knots, functionals
from optipromp.planning.options import PlanOptions
from optipromp.planning.setup import Setup
from optipromp.trajectory import Trajectory


@dataclass(frozen=True)
class Stage:
    """One run of a solver.

    Attributes:
        name: ``push``, ``collision`` or ``joint``.
        solver: its name.
        terms: what it minimises.
        history: value of every term after each iteration, the initial one first.
        seconds: wall time.
        message: why it stopped.
    """

    name: str
    solver: str
    terms: tuple[str, ...]
    history: tuple[Mapping[str, float], ...]
    seconds: float
    message: str


@dataclass(frozen=True, eq=False)
class Outcome:
    """Trajectories before and after, the stages between, and the judge's word if already heard.

    ``values`` are the functionals at the trajectory, by their names, where they are known.
    """

    initial: Trajectory
    trajectory: Trajectory
    knots: Knots
    stages: tuple[Stage, ...]
    optimised: bool
    time: Mapping[str, float]
    judgement: Judgement | None = None
    values: Mapping[str, float] | None = None


def value_of(
    setup: Setup, options: PlanOptions, knots: Knots, q: FloatArray, paper: bool
) -> dict[str, float]:
    """The functionals at one trajectory (T, n), by their names."""
    reduction: Reduction = options.reduction or ("max" if paper else "sum")
    push: PushForm = options.push or ("reciprocal" if paper else "quadratic")
    terms = functionals(setup, options, knots, reduction, push)
    problem = Problem(
        setup.robot, setup.surroundings, terms, (), len(q), cutoff=options.epsilon, body=setup.body
    )
    return problem.evaluate(q).terms
