"""``scenarios``, and the tables that compare with the paper: a page holds what it makes."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import invoke, told

from optipromp.core.planning import plan
from optipromp.core.scenes import load_scene
from optipromp_paper import scenarios
from optipromp_paper.commands.scenarios import (
    BEGIN,
    END,
    SHORT,
    markdown,
    reductions,
    renew,
    table_one,
)
from optipromp_paper.paper import Paper
from optipromp_paper.scenarios import CASES, ScenarioRow, core_distances, run_scenarios

Rows = tuple[ScenarioRow, ...]
PAGE = Path(__file__).resolve().parents[4] / "docs" / "paper.md"
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]\d+)?(?![\w-])")


@pytest.fixture(scope="session")
def scenario_rows() -> Rows:
    return run_scenarios()


def tables(page: str) -> str:
    return page.split(BEGIN)[1].split(END)[0].strip()


def structure(text: str) -> list[str]:
    """The tables with a sign in place of each number of ours; how many are swallowed may differ."""
    lines = [NUMBER.sub("#", line) for line in text.strip().splitlines()]
    return [line.replace("n# and n# are swallowed", "n# is swallowed") for line in lines]


def test_the_page_holds_the_tables_that_the_command_makes(scenario_rows):
    """Header, cases, statuses, which tests of the paper hold, causes; the numbers may differ."""
    kept, made = tables(PAGE.read_text(encoding="utf-8")), markdown(scenario_rows)
    assert structure(kept) == structure(made)
    firsts = [line.split(" | ")[0].strip("| ") for line in kept.splitlines()[2:]]
    assert firsts[: len(CASES)] == [case.key for case in CASES]


def test_the_paper_s_figures_are_those_of_the_cases(scenario_rows: Rows) -> None:
    """The first number of a cell is the paper's, in millimetres."""
    lines = {
        line.split(" | ")[0].strip("| "): line
        for line in markdown(scenario_rows).splitlines()[2:14]
    }
    for case in CASES:
        cells = lines[case.key].split(" | ")
        told = [cells[column].split(" / ")[0] for column in (2, 4, 5)]
        paper = case.published
        wanted = ["–"] * 3
        if paper is not None:
            wanted = [str(round(1e3 * x)) for x in (paper.M_c, paper.M_p["n1"], paper.M_p["n2"])]
        assert told == wanted


def test_a_page_keeps_what_is_beside_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    renew(page, "new")
    assert page.read_text(encoding="utf-8") == f"before\n{BEGIN}\n\nnew\n{END}\nafter\n"
    plain = tmp_path / "plain.md"
    renew(plain, "new")
    assert plain.read_text(encoding="utf-8") == "new"


def test_scenarios_end_as_in_the_paper(scenario_rows, tmp_path, monkeypatch):
    """The rows are those of the session: the command would make the same."""
    monkeypatch.setattr(scenarios, "run_scenarios", lambda **_: scenario_rows)
    rows = {row["case"]: row for row in told("scenarios")["scenarios"]}
    assert set(rows) == {
        "1-plain", "1-camera", "2", "3-joint", "3-kept", "3-sequential", "4-joint", "4-kept",
        "4-sequential", "4-near", "paper-3", "paper-4",
    }  # fmt: skip
    for key in ("1-plain", "1-camera", "2"):
        assert rows[key]["status"] == "INVALID_PLAN"
        assert "table-top" in rows[key]["message"]
        assert rows[key]["metrics"]["clearance_static"] < 0
        assert rows[key]["thresholds"] == {}
    for key, least in (
        ("3-joint", 0.1), ("3-sequential", 0.1), ("paper-3", 0.1),
        ("4-joint", 0.03), ("4-sequential", 0.03), ("paper-4", 0.03),
    ):  # fmt: skip
        said = "success" if "joint" in key else "HARM_PREDICTED"  # the paper's plans swallow fruit
        assert rows[key]["status"] == said
        assert rows[key]["metrics"]["M_c"] > least
        assert rows[key]["M_c_joints"] > least
        assert rows[key]["paper"]["M_c_above"] == least
        holds = rows[key]["thresholds"]
        assert holds["M_c"]
        assert holds["M_c_joints"]
        if "joint" not in key:  # where pushes are predicted, a tool may pass on a stem's side
            assert all(holds.values())
    assert rows["3-joint"]["paper"]["M_c"] == 0.157
    for key in ("paper-3", "paper-4"):
        assert rows[key]["scene"] == key
        assert rows[key]["start"][:5] == [0.0, 0.0, 0.0, -0.1, 0.0]
    assert rows["paper-4"]["M_c_joints"] >= rows["paper-4"]["paper"]["M_c"]
    assert {item["term"] for item in rows["4-sequential"]["reductions"]} == {"static", "push"}
    monkeypatch.setattr(scenarios, "run_scenarios", lambda **_: scenario_rows[:1])
    invoke("scenarios", "--json", "--out", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["scenario-1-plain"]
    assert (tmp_path / "scenario-1-plain" / "reach.png").is_file()


def printed(*tables: Any) -> str:
    from rich.console import Console

    file = open(os.devnull, "w")  # noqa: PTH123, SIM115
    console = Console(width=80, record=True, file=file, markup=False)
    for table in tables:
        console.print(table)
    text = console.export_text()
    console.file.close()
    return str(text)


def test_no_cost_of_an_invalid_plan_is_said_to_have_fallen() -> None:
    """A plan that enters the table-top may lower its push as much as it likes."""
    case = next(case for case in CASES if case.key == "4-sequential")
    made = plan(case.scene, planner=Paper(drift_offset=0.9), timeout=1.0)
    row = ScenarioRow(case, made)
    assert not row.plan.success
    assert {item.valid for item in row.reductions} == {False}
    lines = [line for line in printed(reductions([row])).splitlines() if "4-seq" in line]
    assert len(lines) == 2
    for line in lines:
        assert " invalid " in line
        assert line.count("÷") == 1  # the paper's own
    assert SHORT[row.plan.status] in printed(table_one([row]))


def test_m_c_over_joint_origins_is_to_the_core(scenario_rows: tuple[Any, ...]) -> None:
    """Of a ball its centre, of a bar its long axis; wider than over spheres, their centres too."""
    three, four = load_scene("scenario-3"), load_scene("scenario-4")
    (bar,) = (o for o in four.objects if o.role == "static")
    ball = next(o for o in three.objects if o.role == "avoid")
    off = np.array([[0.2, 0.03, 0.04], [-0.7, 0.0, 0.0]])
    np.testing.assert_allclose(core_distances(bar, bar.position + off), [0.05, 0.2])
    np.testing.assert_allclose(
        core_distances(ball, ball.position + off), np.linalg.norm(off, axis=1)
    )
    row = next(row for row in scenario_rows if row.case.key == "4-joint")
    tools = row.plan.robot.tool_pose(row.plan.trajectory.positions)[0]
    assert row.M_c_joints <= core_distances(bar, tools).min()
