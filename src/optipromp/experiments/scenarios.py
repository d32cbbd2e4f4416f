"""The paper's four scenarios, its published figures and ours."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optipromp.errors import Code
from optipromp.planning import Plan, Planner, PlanOptions, Strategy, plan
from optipromp.scenes.io import load_scene
from optipromp.scenes.scene import Scene

if TYPE_CHECKING:
    from optipromp.promp.model import ProMP


@dataclass(frozen=True)
class Published:
    """What the paper reports of a scenario.

    Attributes:
        M_c: smallest distance from a body point to the core of an obstacle [m].
        M_p: offset at each pushable, by its id [m].
        reductions: by term, the factor its cost falls by and the iterations that takes.
    """

    M_c: float
    M_p: Mapping[str, float]
    reductions: Mapping[str, tuple[float, int]]


@dataclass(frozen=True)
class Case:
    """One run.

    Attributes:
        key: short name, also of the run's folder.
        scene: built-in scene.
        title: what the run shows.
        planner: see :func:`optipromp.planning.plan`.
        strategy: of opti-promp.
        expected: how the run must end; None where the paper's own way may end either way.
        published: the paper's figures, where it gives some.
        options: settings that differ from the default.
        start: (n,) in place of the scene's own.
    """

    key: str
    scene: str
    title: str
    planner: Planner
    strategy: Strategy = "joint"
    expected: Code | None = None
    published: Published | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    start: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Reduction:
    """How far one term's cost fell.

    Attributes:
        term: name of the term.
        stage: the stage that optimises it.
        paper: the paper's factor.
        paper_iterations: and its iterations.
        same: our factor after as many iterations (or fewer, where the stage ended earlier).
        final: our factor at the end of the stage; infinite where nothing is left, NaN where there
            was nothing to lower.
        iterations: our iterations.
    """

    term: str
    stage: str
    paper: float
    paper_iterations: int
    same: float
    final: float
    iterations: int


@dataclass(frozen=True)
class Row:
    """A case and the plan it led to."""

    case: Case
    plan: Plan

    @property
    def as_expected(self) -> bool:
        """Whether the run ended as it must."""
        return self.case.expected is None or self.plan.status is self.case.expected

    @property
    def reductions(self) -> tuple[Reduction, ...]:
        """Cost reductions beside the paper's; empty where it gives none."""
        if self.case.published is None:
            return ()
        rows = []
        for name, (factor, iterations) in self.case.published.reductions.items():
            term = self.plan.terms[name]
            history = term.history or (term.initial, term.final)
            at = min(iterations, len(history) - 1)
            rows.append(
                Reduction(
                    term=name,
                    stage=term.stage,
                    paper=factor,
                    paper_iterations=iterations,
                    same=_factor(history[0], history[at]),
                    final=_factor(history[0], history[-1]),
                    iterations=len(history) - 1,
                )
            )
        return tuple(rows)

    def to_dict(self) -> dict[str, Any]:
        """The plan's document with the paper's figures beside it."""
        published = self.case.published
        paper = None
        if published is not None:
            paper = {
                "M_c": published.M_c,
                "M_p": dict(published.M_p),
                "reductions": {
                    name: {"factor": factor, "iterations": iterations}
                    for name, (factor, iterations) in published.reductions.items()
                },
            }
        return {
            "case": self.case.key,
            "title": self.case.title,
            **self.plan.to_dict(),
            "as_expected": self.as_expected,
            "paper": paper,
            "reductions": [vars(item) for item in self.reductions],
        }


_III = Published(
    M_c=0.157,
    M_p={"n1": -0.01, "n2": 0.001968},
    reductions={"push": (15.5, 10), "avoid": (9.5, 15)},
)
_IV = Published(
    M_c=0.0352,
    M_p={"n1": -0.0084, "n2": 0.03379},
    reductions={"static": (4.2, 3), "push": (2.2, 15)},
)

CASES: tuple[Case, ...] = (
    Case(
        "1-plain",
        "scenario-1",
        "ProMP on start and target",
        "promp",
        expected=Code.INVALID_PLAN,
        options={"camera_point": False},
    ),
    Case(
        "1-camera",
        "scenario-1",
        "ProMP also on a point below the cluster",
        "promp",
        expected=Code.INVALID_PLAN,
        options={"camera_point": True},
    ),
    Case("2", "scenario-2", "I-ProMP pushes", "i-promp", expected=Code.INVALID_PLAN),
    Case(
        "3-joint",
        "scenario-3",
        "side clusters",
        "opti-promp",
        expected=Code.SUCCESS,
        published=_III,
    ),
    Case(
        "3-sequential",
        "scenario-3",
        "side clusters",
        "opti-promp",
        "sequential",
        published=_III,
    ),
    Case(
        "4-joint",
        "scenario-4",
        "table-top",
        "opti-promp",
        expected=Code.SUCCESS,
        published=_IV,
    ),
    Case("4-sequential", "scenario-4", "table-top", "opti-promp", "sequential", published=_IV),
    Case(
        "4-near",
        "scenario-4",
        "table-top, from a start whose ProMP comes near it",
        "opti-promp",
        "sequential",
        published=_IV,
        start=(-0.25, -0.69, 0.42, -2.12, 0.21, 2.58, 1.44),
    ),
)


def run_scenarios(
    *,
    seed: int = 0,
    demonstrations: "str | Path | ProMP | None" = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Row, ...]:
    """Run every case of the paper's scenarios I to IV.

    Args:
        seed: of every plan.
        demonstrations: what the Panda's primitive (scenarios III and IV) is learnt from.
        progress: called with a word on what is being done.
    """
    rows = []
    for case in CASES:
        if progress is not None:
            progress(f"scenario {case.key}: {case.title}")
        panda = case.planner == "opti-promp"
        rows.append(
            Row(
                case,
                plan(
                    _scene(case),
                    planner=case.planner,
                    strategy=case.strategy,
                    demonstrations=demonstrations if panda else None,
                    seed=seed,
                    options=PlanOptions(**case.options),
                    progress=progress,
                ),
            )
        )
    return tuple(rows)


def _scene(case: Case) -> Scene:
    scene = load_scene(case.scene)
    return scene if case.start is None else replace(scene, start=np.array(case.start))


def _factor(before: float, after: float) -> float:
    if after > 0.0:
        return before / after
    return math.inf if before > 0.0 else math.nan
