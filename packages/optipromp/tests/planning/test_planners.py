"""Planners as values, and planners of strangers that join by a name."""

import json
import sys
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from annotated_types import Gt, Unit
from tests.cli.fixtures import invoke

from optipromp.core.budget import Budget
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.output import load_plan, write_plan
from optipromp.core.planning import Failed, IProMP, OptiProMP, Planned, PlanOptions, plan, plan_many
from optipromp.core.planning import planners as planner
from optipromp.core.planning.planners import goal_configurations
from optipromp.core.planning.result import Answer, Proposal
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import shortest
from optipromp.core.scenes import Scene
from optipromp_bench.experiments.study import Study, run_study
from optipromp_paper.paper import Paper


@dataclass(frozen=True)
class Line:
    """Straight in the joints.

    Attributes:
        speed: of the tool [m/s].
    """

    speed: Annotated[float, Gt(0.0), Unit("m/s")] = 0.1

    def solve(self, task: Task, budget: Budget) -> Planned | Failed:
        share = np.linspace(0.0, 1.0, 50)[:, None]
        goal = goal_configurations(task, budget).q[0]
        return Planned(
            shortest(task.robot, task.start + share * (goal - task.start), 0, self.speed)
        )


class Lost:
    def solve(self, task: Task, budget: Budget) -> Failed:
        return Failed(Code.NO_PLAN, "it is too far")


@pytest.fixture
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package whose planner is ``line``, and one that cannot be loaded."""
    folder = tmp_path / "stranger-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(
        "[optipromp.planners]\nline = stranger:Line\nbroken = nowhere_at_all:Planner\n"
    )
    module = type(sys)("stranger")
    module.Line = Line  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "stranger", module)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(planner, "_known", dict(planner._known))


def same(one: Any, other: Any) -> None:
    np.testing.assert_array_equal(one.trajectory.positions, other.trajectory.positions)
    assert one.planner == other.planner
    assert (one.status, one.message) == (other.status, other.message)


def test_a_value_plans_as_the_words_that_mean_it(three: Scene) -> None:
    options = PlanOptions(corridor=0.004, duration=9.0)
    same(plan(three, planner=OptiProMP(corridor=0.004, duration=9.0)), plan(three, options=options))
    coarse = PlanOptions(waypoints=60)
    same(plan(three, planner=Paper(waypoints=60)), plan(three, planner="paper", options=coarse))
    same(plan(three, planner=IProMP(waypoints=60)), plan(three, planner="i-promp", options=coarse))


def test_a_value_has_its_own_settings(three: Scene) -> None:
    with pytest.raises(InvalidRequestError, match="speeed is no setting of opti-promp"):
        planner.make("opti-promp", speeed=1.0)
    with pytest.raises(InvalidRequestError, match="max_step: must be settings of the planner"):
        plan(three, planner=OptiProMP(), options=PlanOptions(max_step=0.03, timeout=5.0))
    with pytest.raises(InvalidRequestError, match=r"an object with solve\(task, budget\)"):
        plan(three, planner=OptiProMP)  # type: ignore[arg-type]


def test_a_plan_keeps_its_task(three: Scene, tmp_path: Path) -> None:
    made = plan(three, planner=Line(0.15), seed=3)
    assert made.task.scene is made.scene
    assert made.push_model is made.task.push_model(made.trajectory.positions[-1])
    write_plan(made, tmp_path / "kept")
    kept = load_plan(tmp_path / "kept")
    assert (kept.planner, kept.seed) == ("Line", 3)
    assert kept.prediction == made.prediction
    (other,) = plan_many([three], planner=Line(0.15), seed=3, workers=1)
    same(other, made)


def test_a_failure_is_a_value(three: Scene) -> None:
    made = plan(three, planner=Lost())
    assert (made.status, made.message, made.planner) == (Code.NO_PLAN, "it is too far", "Lost")
    assert np.ptp(made.trajectory.positions, axis=0).max() == 0.0


def test_an_answer_of_another_kind_is_refused(three: Scene) -> None:
    class Silent:
        def solve(self, task: Task, budget: Budget) -> None: ...

    with pytest.raises(InvalidRequestError, match="planner Silent returned NoneType: solve must"):
        plan(three, planner=Silent())  # type: ignore[arg-type]


def test_an_error_of_a_strangers_planner_names_the_planner_and_the_line(three: Scene) -> None:
    """Also where it follows its proposal."""

    class Wrong:
        def solve(self, task: Task, budget: Budget) -> Answer:
            return Planned(task.no_such_thing)  # type: ignore[attr-defined]

    class Later:
        def solve(self, task: Task, budget: Budget) -> Answer:
            return Proposal(0.0, lambda: {}["missing"])

    for kind, error in ((Wrong, "AttributeError: "), (Later, "KeyError: 'missing'")):
        told = rf"^planner {kind.__name__} failed: {error}.* \(\w+\.py, line \d+\)$"
        with pytest.raises(InvalidRequestError, match=told):
            plan(three, planner=kind())


def test_the_least_harmful_path_is_followed_where_all_do_harm(three: Scene) -> None:
    followed: list[float] = []

    class Timid:
        def solve(self, task: Task, budget: Budget) -> Answer:
            def follow() -> Answer:
                followed.append(0.7)
                return Line().solve(task, budget)

            return Proposal(0.7, follow)

    one, other = plan(three, planner=Timid()), plan(three, planner=Line())
    same(one, replace(other, planner="Timid"))
    assert followed == [0.7]


def test_a_registered_name_is_known(three: Scene, strangers: None) -> None:
    planner.register("mine", Line)
    same(plan(three, planner="mine"), plan(three, planner=Line()))


@pytest.mark.filterwarnings("ignore:planner 'broken'")
def test_a_strangers_planner_is_planned_with_studied_and_listed(three, strangers, tmp_path):
    same(plan(three, planner="line"), plan(three, planner=Line()))
    rows = run_study(Study(("cluster",), ("line",), (0, 1)), tmp_path / "study", workers=1)
    assert [(row.planner, row.cause != "error") for row in rows] == [("line", True)]
    listed = json.loads(invoke("list", "--json").stdout)
    assert "line" in listed["planners"]
    assert listed["planner_settings"]["line"]["speed"]["meaning"] == "of the tool [m/s]."
    words = ["plan", "scenario-3", "--planner", "line", "--set", "speed=0.2", "--json"]
    made = json.loads(invoke(*words).stdout)
    assert made["planner"] == "Line"
    slow = plan("scenario-3", planner="line").trajectory.duration
    assert made["metrics"]["duration"] < slow
    for pair, told in (
        ("corridor=0.2", "no such setting; valid are speed"),
        ("speed=fast", "speed is 'fast': must be a number"),
        ("speed=-1.0", "speed is -1.0: must be above 0 [m/s]"),
    ):
        wrong = invoke(*words[:4], "--set", pair)
        assert (wrong.exit_code, told in wrong.stderr) == (2, True)


def test_what_cannot_be_loaded_is_said(three: Scene, strangers: None) -> None:
    with pytest.raises(InvalidRequestError, match="'broken' cannot be loaded: stranger: nowhere"):
        plan(three, planner="broken")
    with pytest.warns(UserWarning, match="'broken' cannot be loaded"):
        assert "broken" not in planner.planner_names()


def test_the_core_names_no_planner_of_the_laboratory() -> None:
    names = {entry.name for entry in metadata.entry_points(group=planner.GROUP)}
    assert names >= {"straight", "drift", "obstacles", "chomp", "i-promp-guard", "paper"}
    core = Path(planner.__file__).parent
    text = "".join(path.read_text() for path in core.glob("*.py"))
    assert not [name for name in names - {"paper"} if f'"{name}"' in text]
    assert replace(Line(), speed=0.3).speed == 0.3


def test_without_the_paper_s_package_ours_plan_and_paper_is_no_planner(monkeypatch):
    monkeypatch.setattr(planner, "_joined", dict)
    monkeypatch.setattr(
        planner, "_known", {name: planner.factory(name) for name in planner.PLANNERS}
    )
    assert plan("scenario-3").success
    with pytest.raises(InvalidRequestError, match="planner is 'paper'; valid: promp, i-promp"):
        plan("scenario-3", planner="paper")
