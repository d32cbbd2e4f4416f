"""The paper's four scenarios: its published figures, and the plans of this library."""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.geometry import Box, Sphere
from optipromp.core.planning import ConditionedProMP, IProMP, OptiProMP, Plan, Planner, plan
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import SceneObject
from optipromp_paper.paper import Paper

if TYPE_CHECKING:
    from optipromp.core.promp.model import ProMP


@dataclass(frozen=True)
class Published:
    """The figures that the paper reports of a scenario."""

    M_c: float  # smallest distance from a body point to the core of an obstacle [m]
    # lower bound of M_c that the paper verifies: the clusters' radius, or the table-top's half
    # depth [m]
    M_c_above: float
    # offset at each pushable, by its id [m]; its sign must be opposite to the stem's
    M_p: Mapping[str, float]
    reductions: Mapping[str, tuple[float, int]]  # factor of a term's cost, after iterations


@dataclass(frozen=True)
class Case:
    """One run."""

    key: str  # short name, also of the run's folder
    scene: str  # built-in scene
    title: str  # in words
    planner: Planner
    expected: Code | None = None  # code of the plan; None where any code is right
    published: Published | None = None  # the paper's figures, where there are some
    start: tuple[float, ...] | None = None  # (n,) in place of the scene's


@dataclass(frozen=True)
class Reduction:
    """The factors by which the cost of a term falls.

    A factor is infinite where the cost falls to 0, and NaN where it was 0 before.
    """

    term: str  # name of the term
    stage: str  # name of the stage that optimises the term
    paper: float  # the paper's factor
    paper_iterations: int  # the paper's number of iterations
    same: float  # our factor after as many iterations (or fewer, where the stage ends earlier)
    final: float  # our factor at the end of the stage
    iterations: int  # our number of iterations
    kept: float  # our factor in the final plan, after the stages that follow
    valid: bool  # whether the judge finds no violation in that plan; factors of others mean nothing


@dataclass(frozen=True)
class ScenarioRow:
    """A case and its plan."""

    case: Case
    plan: Plan

    @property
    def as_expected(self) -> bool:
        """Whether the plan's code is the expected one."""
        return self.case.expected is None or self.plan.status is self.case.expected

    @property
    def staged(self) -> bool:
        """Whether the plan is of the paper's two stages."""
        return getattr(self.case.planner, "strategy", None) == "sequential"

    @functools.cached_property
    def M_c_joints(self) -> float:
        """M_c over joint origins and tool point, as the paper's is [m]; infinite if no obstacle."""
        q = self.plan.trajectory.positions
        origins, _ = self.plan.robot.segment_frames(q)
        tips, _ = self.plan.robot.tool_pose(q)
        points = np.concatenate([origins.reshape(-1, 3), tips])
        scene = self.plan.scene
        others = scene.static + scene.avoid
        return min((float(core_distances(item, points).min()) for item in others), default=np.inf)

    @property
    def thresholds(self) -> dict[str, bool]:
        """Whether our figures pass the paper's tests of its Table I, by figure."""
        published, metrics = self.case.published, self.plan.metrics
        if published is None:
            return {}
        out = {
            "M_c": metrics.M_c is not None and metrics.M_c > published.M_c_above,
            "M_c_joints": self.M_c_joints > published.M_c_above,
        }
        for name in published.M_p:
            offset, stem = metrics.M_p.get(name), metrics.stem_projection.get(name)
            out[f"M_p {name}"] = offset is not None and stem is not None and offset * stem < 0.0
        return out

    @property
    def reductions(self) -> tuple[Reduction, ...]:
        """Our cost reductions beside the paper's; empty where one of both gives none."""
        if self.case.published is None or not self.plan.terms:
            return ()
        rows = []
        for name, (factor, iterations) in self.case.published.reductions.items():
            term = self.plan.terms[name]
            history = term.history or (term.initial, term.final)
            ends = history[min(iterations, len(history) - 1)], history[-1], term.final
            same, final, kept = (_factor(history[0], end) for end in ends)
            rows.append(
                Reduction(name, term.stage, factor, iterations, same, final, len(history) - 1,
                          kept, self.plan.valid)
            )  # fmt: skip
        return tuple(rows)

    def to_dict(self) -> dict[str, Any]:
        """The plan's document with the paper's figures beside it."""
        paper = None
        if (published := self.case.published) is not None:
            falls = published.reductions.items()
            factors = {name: {"factor": by, "iterations": count} for name, (by, count) in falls}
            paper = vars(published) | {"reductions": factors}
        return {
            "case": self.case.key,
            "title": self.case.title,
            **self.plan.to_dict(),
            "as_expected": self.as_expected,
            "start": self.plan.scene.start,
            "M_c_joints": self.M_c_joints,
            "thresholds": self.thresholds,
            "paper": paper,
            "reductions": [vars(item) for item in self.reductions],
        }


_III = Published(
    M_c=0.157,
    M_c_above=0.1,
    M_p={"n1": -0.01, "n2": 0.001968},
    reductions={"push": (15.5, 10), "avoid": (9.5, 15)},
)
_IV = Published(
    M_c=0.0352,
    M_c_above=0.03,
    M_p={"n1": -0.0084, "n2": 0.03379},
    reductions={"static": (4.2, 3), "push": (2.2, 15)},
)
_OURS, _JOINT = OptiProMP(), Paper(strategy="joint")
_AUTHORS = Paper(strategy="sequential", constraints="push-model")
_FAILS, _HARMS, _SUCCEEDS = Code.INVALID_PLAN, Code.HARM_PREDICTED, Code.SUCCESS
NONE = "—"  # in place of a figure

CASES: tuple[Case, ...] = (
    Case("1-plain", "scenario-1", "ProMP on start and target",
         ConditionedProMP(camera_point=False), _FAILS),
    Case("1-camera", "scenario-1", "ProMP also on a point below the cluster",
         ConditionedProMP(camera_point=True), _FAILS),
    Case("2", "scenario-2", "I-ProMP pushes", IProMP(), _FAILS),
    Case("3-joint", "scenario-3", "side clusters", _OURS, _SUCCEEDS, _III),
    Case("3-kept", "scenario-3", "side clusters, the paper's constraints", _JOINT, _HARMS, _III),
    Case("3-sequential", "scenario-3", "side clusters", _AUTHORS, _HARMS, _III),
    Case("4-joint", "scenario-4", "table-top", _OURS, _SUCCEEDS, _IV),
    Case("4-kept", "scenario-4", "table-top, the paper's constraints", _JOINT, _HARMS, _IV),
    Case("4-sequential", "scenario-4", "table-top", _AUTHORS, _HARMS, _IV),
    Case("4-near", "scenario-4", "table-top, from a start whose ProMP comes near it", _AUTHORS,
         None, _IV, start=(-0.21, -0.8, 0.52, -2.19, 0.08, 2.59, 1.51)),
    *(
        Case(key, key, f"{title}, with the hand, start and distances of the paper", Paper(),
             _HARMS, published)
        for key, title, published in (
            ("paper-3", "side clusters", _III), ("paper-4", "table-top", _IV),
        )
    ),
)  # fmt: skip


def run_scenarios(
    *,
    seed: int = 0,
    demonstrations: "str | Path | ProMP | None" = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[ScenarioRow, ...]:
    """Run every case of the paper's scenarios I to IV.

    ``demonstrations``: of the Panda's primitive in scenarios III and IV. ``progress``: called with
    a line about the case that begins.
    """
    rows = []
    for case in CASES:
        if progress is not None:
            progress(f"scenario {case.key}: {case.title}")
        scene = load_scene(case.scene)
        if case.start is not None:
            scene = replace(scene, start=np.array(case.start))
        panda = isinstance(case.planner, OptiProMP | Paper)
        made = plan(
            scene, planner=case.planner, seed=seed,
            demonstrations=demonstrations if panda else None, progress=progress,
        )  # fmt: skip
        rows.append(ScenarioRow(case, made))
    return tuple(rows)


def beside(plan: Plan) -> list[tuple[str, str, str, str]]:
    """The paper's figures of the same scene beside the plan's: which, its, ours, its test."""
    cases = (case for case in CASES if case.scene == plan.scene.name and case.published)
    case = next(cases, None)
    if case is None or case.published is None:
        return []
    row, published, metrics = ScenarioRow(case, plan), case.published, plan.metrics
    holds = {None: NONE, True: "holds", False: "fails"}
    rows = [("M_c", _mm(published.M_c), _mm(metrics.M_c), holds[row.thresholds.get("M_c")])]
    rows += [
        (f"M_p {name}", _mm(value), _mm(metrics.M_p.get(name)),
         holds[row.thresholds.get(f"M_p {name}")])
        for name, value in published.M_p.items()
    ]  # fmt: skip
    rows += [
        (f"cost {item.term}, before ÷ after", f"{item.paper:g} in {item.paper_iterations}",
         f"{item.final:.3g} in {item.iterations}" if math.isfinite(item.final) else NONE, NONE)
        for item in row.reductions
    ]  # fmt: skip
    return rows


def _mm(value: float | None) -> str:
    return NONE if value is None or not math.isfinite(value) else f"{1e3 * value:+.1f} mm"


def core_distances(item: SceneObject, points: FloatArray) -> FloatArray:
    """Distances (M,) of points (M, 3) to the core of a ball or of a box."""
    off = (points - item.position) @ item.rotation
    if isinstance(item.shape, Box):
        half = 0.5 * np.array(item.shape.size)
        longest = int(np.argmax(half))
        off[:, longest] -= np.clip(off[:, longest], -half[longest], half[longest])
    elif not isinstance(item.shape, Sphere):
        raise InvalidRequestError(f"{item.id}: only a ball or a box has a core here")
    return np.asarray(np.linalg.norm(off, axis=1))


def _factor(before: float, after: float) -> float:
    if after > 0.0:
        return before / after
    return math.inf if before > 0.0 else math.nan
