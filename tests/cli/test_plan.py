"""``plan`` and ``scenarios`` from end to end."""

import csv
import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.core.output import load_plan
from optipromp.core.planning import plan
from optipromp.core.scenes.io import save_scene
from optipromp.laboratory.generate import generate

RUN = [sys.executable, "-m", "optipromp"]
RECORDED = (
    Path(__file__).resolve().parents[2] / "../shared/data/panda_demonstrations/demonstrations.npz"
)
METRICS = """
M_c M_p stem_projection drift_shortfall stem_gap clearance_static clearance_avoid
clearance_avoid_tool clearance_self goal_error goal_axis_error limit_violation max_step path_length
smoothness duration velocity_ratio acceleration_ratio
"""
KEYS = {"scene", "planner", "strategy", "status", "message", "metrics", "terms", "time"}


def read(text: str) -> Any:
    return json.loads(text, parse_constant=pytest.fail)


def call(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def test_plan_prints_one_document_and_leaves_its_files(tmp_path: Path) -> None:
    out = tmp_path / "reach"
    done = subprocess.run(
        [*RUN, "plan", "scenario-3", "--reach", "--json", "--out", str(out)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    document = read(done.stdout)
    assert document.keys() >= KEYS
    assert document["metrics"].keys() >= set(METRICS.split())
    assert set(document["terms"]) == {"static", "avoid", "push", "velocity"}
    for term in document["terms"].values():
        assert term.keys() >= {"initial", "followed", "final", "history"}
    assert document["status"] == "success"
    assert document["predicted_harm"].keys() == {
        "harm", "threshold", "object", "cause", "forces", "probability",
    }  # fmt: skip
    assert document["predicted_harm"]["harm"] <= document["predicted_harm"]["threshold"]
    assert document["time"]["total"] > 0
    assert {path.name for path in out.iterdir()} == {
        "plan.json",
        "trajectory.csv",
        "trajectory.npz",
        "waypoints.npz",
        "reach.png",
        "joints.png",
    }
    kept = read((out / "plan.json").read_text(encoding="utf-8"))
    assert {key: kept[key] for key in document} == document
    with np.load(out / "trajectory.npz") as archive, (out / "trajectory.csv").open() as file:
        rows = list(csv.reader(file))
        names = list(archive["joint_names"])
        kinds = [name + kind for kind in ("_velocity", "_acceleration") for name in names]
        assert rows[0] == ["time", *names, *kinds]
        table = np.array(rows[1:], dtype=float)
        np.testing.assert_allclose(np.diff(table[:-1, 0]), 1e-3, atol=1e-9)
        assert table[-1, 0] == pytest.approx(document["metrics"]["duration"])
        np.testing.assert_allclose(table[:, 1:8], archive["positions"], rtol=1e-8, atol=1e-9)


def test_the_report_for_people_says_whether_the_plan_holds() -> None:
    code, stdout, _ = call("plan", "scenario-4")
    assert code == 0
    assert "success" in stdout
    way = r"M_p n1 +[+-]\d+\.\d mm \(x_g [+-]\d+\.\d\); its stem leans by [+-]\d"
    assert re.search(way, stdout)
    assert "clearance, static" in stdout


def test_the_command_plans_what_the_library_plans() -> None:
    words = [
        "plan",
        "scenario-3",
        "--reach",
        "--seed",
        "5",
        "--set",
        "waypoints=60",
        "--duration",
        "6",
    ]
    code, stdout, _ = call(*words, "--json")
    assert code == 0
    from optipromp import PlanOptions

    result = plan("scenario-3", seed=5, options=PlanOptions(waypoints=60, duration=6.0))
    assert read(stdout)["metrics"] == read(json.dumps(result.metrics.to_dict()))


@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded demonstrations are not here")
def test_learnt_and_raw_demonstrations_plan_alike(tmp_path: Path) -> None:
    learnt = tmp_path / "learnt.npz"
    assert (
        call("learn", str(RECORDED), "--out", str(learnt), "--robot", "panda", "--no-figure")[0]
        == 0
    )
    named = tmp_path / "named.npz"
    joints = np.array([f"joint{j}" for j in range(1, 8)])
    np.savez(named, **np.load(RECORDED), joint_names=joints)
    for path in (named, learnt):
        code, stdout, stderr = call(
            "plan", "scenario-3", "--reach", "--demonstrations", str(path), "--json"
        )
        assert code == 0, stderr or stdout
        assert read(stdout)["status"] == "success"


def test_scenarios_end_as_in_the_paper(
    scenario_rows: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The rows are those of the session: the command would make the same."""
    from optipromp.laboratory.experiments import scenarios

    monkeypatch.setattr(scenarios, "run_scenarios", lambda **_: scenario_rows)
    code, stdout, _ = call("scenarios", "--json")
    rows = {row["case"]: row for row in read(stdout)["scenarios"]}
    assert code == 0
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
        told = "success" if "joint" in key else "HARM_PREDICTED"  # the paper's plans swallow fruit
        assert rows[key]["status"] == told
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
    call("scenarios", "--json", "--out", str(tmp_path))
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


def test_the_table_of_scenarios_fits_eighty_columns(scenario_rows: tuple[Any, ...]) -> None:
    from optipromp.cli.scenarios import reductions, table_one

    rows = [row for row in scenario_rows if row.case.key in ("3-joint", "3-sequential")]
    text = printed(table_one(rows), reductions(rows))
    assert "…" not in text
    assert "[" not in text  # no markup: the commands print text as it is
    assert "157 | " in text
    assert " valid" in text


def test_no_cost_of_an_invalid_plan_is_said_to_have_fallen() -> None:
    """A plan that enters the table-top may lower its push as much as it likes."""
    from optipromp.cli.scenarios import SHORT, reductions, table_one
    from optipromp.core.planning import PlanOptions
    from optipromp.laboratory.experiments.scenarios import CASES, ScenarioRow
    from optipromp.laboratory.planners.paper import PaperOptions

    case = next(case for case in CASES if case.key == "4-sequential")
    options = PlanOptions(constraints="paper", paper=PaperOptions(drift_offset=0.9), timeout=1.0)
    row = ScenarioRow(case, plan(case.scene, strategy="sequential", options=options))
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
    from optipromp.core.scenes import load_scene
    from optipromp.laboratory.experiments.scenarios import core_distances

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


@pytest.mark.slow  # compiles for a minute
def test_the_first_use_compiles_every_kernel_of_a_plan_and_says_so(tmp_path: Path) -> None:
    code = "from optipromp.cli.console import say_if_compiling as say; say(True)"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout == ""
    first, *steps = done.stderr.splitlines()
    assert first.startswith("compiling kernels, once")
    assert re.fullmatch(r" +\d+ s  compiling the kernels of arm and obstacles", steps[0])
    assert steps[-1].endswith("compiling the last kernels") or len(steps) > 1
    compiled = set(tmp_path.rglob("*.nbc"))
    assert any("summed_score" in file.name for file in compiled)  # the other process's share
    command = [sys.executable, "-m", "optipromp", "plan", "scenario-4", "--json"]
    later = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert later.stderr == ""
    assert set(tmp_path.rglob("*.nbc")) == compiled


def test_a_plan_goes_on_from_one_that_runs(reach: Path, tmp_path: Path) -> None:
    running = load_plan(reach)
    code, stdout, _ = call(
        "plan", "scenario-3", "--previous", str(reach), "--at", "3", "--no-figures",
        "--out", str(tmp_path / "b"), "--json",
    )  # fmt: skip
    assert code == 0
    assert read(stdout)["metrics"]["duration"] == pytest.approx(running.trajectory.duration - 3)
    first = load_plan(tmp_path / "b").trajectory.at(0.0)
    np.testing.assert_allclose(first.q, running.trajectory.at(3.0).q, atol=1e-9)
    code, _, stderr = call("plan", "scenario-3", "--at", "3")
    assert code == 2
    assert "previous and at go together" in stderr


def test_a_failed_plan_prints_why_and_nothing_else(tmp_path: Path) -> None:
    code, stdout, stderr = call("plan", "scenario-1")
    assert code == 1
    status, why = stdout.splitlines()
    assert "GOAL_IN_COLLISION" in status
    assert "table-top" in why
    assert stderr == ""
    code, stdout, _ = call("plan", "scenario-1", "--out", str(tmp_path), "--no-figures")
    assert (code, len(stdout.splitlines())) == (1, 3)
    assert stdout.splitlines()[-1].startswith("wrote trajectory.csv")
    assert "clearance, static" in call("plan", "scenario-4")[1]  # a success has its figures


def test_progress_is_told_where_it_is_asked_for(tmp_path: Path) -> None:
    """Of a plan whose robot takes long to read."""
    slow = (
        "import sys, time; from optipromp.core.planning import planners;"
        "import optipromp.core.planning.plan;"
        "plan = sys.modules['optipromp.core.planning.plan'];"
        "usual = plan.resolve;"
        "plan.resolve = lambda *given: (time.sleep(2.6), usual(*given))[1];"
        "from optipromp.cli.main import main; main()"
    )
    found = {}
    for name, options in {
        "both": ("--json", "--progress"),
        "pipe": (),
    }.items():
        words = [sys.executable, "-c", slow, "plan", "scenario-4", *options]
        done = subprocess.run(words, capture_output=True, text=True, check=True)
        found[name] = done.stderr
        if "--json" in options:
            assert read(done.stdout)["status"] == "success"
    first, *rest = found["both"].splitlines()
    assert re.fullmatch(r" +\d s  reading scene and robot", first)
    assert all(re.fullmatch(r" +\d+ s  [a-z ()]+", line) for line in rest)
    assert found["pipe"] == ""


@pytest.mark.parametrize(("deviation", "helps"), [(0.0085, True), (0.02, False)])
def test_a_second_picture_is_asked_for_where_it_would_help(
    deviation: float, helps: bool, tmp_path: Path
) -> None:
    """Places known to 8.5 mm allow no promise, to 6 mm one; 20 mm and 14 mm none."""
    scene = generate("cluster", 5).each(
        lambda item: (
            item if item.role == "static" else replace(item, covariance=deviation**2 * np.eye(3))
        )
    )
    save_scene(scene, tmp_path / "seen.yaml")
    done = CliRunner().invoke(app, ["plan", str(tmp_path / "seen.yaml"), "--json"])
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert document["status"] == "HARM_PREDICTED"
    assert ("--together" in document.get("advice", "")) == helps
