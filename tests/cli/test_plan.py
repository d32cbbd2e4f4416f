"""``plan`` and ``scenarios`` from end to end."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.planning import plan

RUN = [sys.executable, "-m", "optipromp"]
RECORDED = (
    Path(__file__).resolve().parents[2] / "../shared/data/panda_demonstrations/demonstrations.npz"
)
KEYS = {"scene", "planner", "strategy", "status", "message", "metrics", "terms", "time"}
METRICS = {
    "M_c",
    "M_p",
    "stem_projection",
    "clearance_static",
    "clearance_avoid",
    "clearance_avoid_tool",
    "clearance_self",
    "goal_error",
    "goal_axis_error",
    "limit_violation",
    "max_step",
    "path_length",
    "smoothness",
    "duration",
    "velocity_ratio",
    "acceleration_ratio",
}


def read(text: str) -> Any:
    return json.loads(text, parse_constant=pytest.fail)


def call(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def test_plan_prints_one_document_and_leaves_its_files(tmp_path: Path) -> None:
    out = tmp_path / "reach"
    done = subprocess.run(
        [*RUN, "plan", "scenario-3", "--json", "--out", str(out)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    document = read(done.stdout)
    assert document.keys() >= KEYS
    assert document["metrics"].keys() >= METRICS
    assert set(document["terms"]) == {"static", "avoid", "push", "velocity"}
    for term in document["terms"].values():
        assert term.keys() >= {"initial", "final", "history"}
    assert document["status"] == "success"
    assert document["time"]["total"] > 0
    assert {path.name for path in out.iterdir()} == {
        "plan.json",
        "trajectory.csv",
        "trajectory.npz",
        "reach.png",
        "joints.png",
        "cost.png",
    }
    kept = read((out / "plan.json").read_text(encoding="utf-8"))
    assert {key: kept[key] for key in document} == document
    with np.load(out / "trajectory.npz") as archive, (out / "trajectory.csv").open() as file:
        rows = list(csv.reader(file))
        assert rows[0] == ["time", *archive["joint_names"]]
        np.testing.assert_allclose(np.array(rows[1:], dtype=float)[:, 1:], archive["positions"])


def test_a_plan_that_fails_ends_with_one_and_is_still_a_document() -> None:
    code, stdout, stderr = call("plan", "scenario-1", "--planner", "promp", "--json")
    document = read(stdout)
    assert code == 1
    assert stderr == ""
    assert document["status"] == "INVALID_PLAN"
    assert "table-top" in document["message"]
    assert document["strategy"] is None


def test_the_report_for_people_says_whether_the_plan_holds() -> None:
    code, stdout, _ = call("plan", "scenario-4")
    assert code == 0
    assert "success" in stdout
    assert "away from its stem" in stdout
    assert "clearance, static" in stdout


def test_the_command_plans_what_the_library_plans() -> None:
    code, stdout, _ = call("plan", "scenario-3", "--seed", "5", "--knots", "60", "--json")
    assert code == 0
    from optipromp import PlanOptions

    result = plan("scenario-3", seed=5, options=PlanOptions(knots=60))
    assert read(stdout)["metrics"] == read(json.dumps(result.metrics.to_dict()))


def test_a_duration_that_is_asked_for_is_kept() -> None:
    code, stdout, _ = call("plan", "scenario-3", "--duration", "6", "--json")
    metrics = read(stdout)["metrics"]
    assert code == 0
    assert metrics["duration"] == pytest.approx(6.0)
    assert metrics["velocity_ratio"] < 1.0


@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded demonstrations are not here")
def test_learnt_and_raw_demonstrations_plan_alike(tmp_path: Path) -> None:
    learnt = tmp_path / "learnt.npz"
    assert call("learn", str(RECORDED), "--out", str(learnt))[0] == 0
    for path in (RECORDED, learnt):
        code, stdout, stderr = call("plan", "scenario-3", "--demonstrations", str(path), "--json")
        assert code == 0, stderr or stdout
        assert read(stdout)["status"] == "success"


def test_demonstrations_of_another_robot_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.npz"
    np.savez(path, positions=np.random.default_rng(0).normal(size=(4, 30, 2)))
    code, stdout, stderr = call("plan", "scenario-3", "--demonstrations", str(path), "--json")
    assert code == 2
    assert read(stdout)["status"] in ("INVALID_DEMONSTRATION", "INVALID_REQUEST")
    assert stderr.count("\n") == 1


def test_scenarios_end_as_in_the_paper(tmp_path: Path) -> None:
    code, stdout, _ = call("scenarios", "--json", "--out", str(tmp_path))
    rows = {row["case"]: row for row in read(stdout)["scenarios"]}
    assert code == 0
    assert set(rows) == {
        "1-plain", "1-camera", "2", "3-joint", "3-sequential", "4-joint", "4-sequential",
        "4-near",
    }  # fmt: skip
    for key in ("1-plain", "1-camera", "2"):
        assert rows[key]["status"] == "INVALID_PLAN"
        assert "table-top" in rows[key]["message"]
        assert rows[key]["metrics"]["clearance_static"] < 0
    for key, least in (("3-joint", 0.1), ("4-joint", 0.03)):
        assert rows[key]["status"] == "success"
        assert rows[key]["metrics"]["M_c"] > least
    assert rows["3-joint"]["paper"]["M_c"] == 0.157
    assert {item["term"] for item in rows["4-sequential"]["reductions"]} == {"static", "push"}
    assert {path.name for path in tmp_path.iterdir()} == {f"scenario-{key}" for key in rows}


def test_the_table_of_scenarios_fits_eighty_columns() -> None:
    from optipromp.cli.scenarios import reductions, table_one
    from optipromp.experiments.scenarios import CASES, Row

    case = next(case for case in CASES if case.key == "3-joint")
    rows = [Row(case, plan(case.scene))]
    from rich.console import Console

    console = Console(width=80, record=True, file=open(os.devnull, "w"))  # noqa: PTH123, SIM115
    console.print(table_one(rows))
    console.print(reductions(rows))
    text = console.export_text()
    console.file.close()
    assert "…" not in text
    assert "157 | " in text


def test_the_first_use_compiles_every_kernel_of_a_plan_and_says_so(tmp_path: Path) -> None:
    code = "from optipromp.cli.console import say_if_compiling as say; say()"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout == ""
    assert done.stderr.startswith("compiling kernels, once")
    compiled = set(tmp_path.rglob("*.nbc"))
    assert any("mean_score" in file.name for file in compiled)  # the other process's share
    command = [sys.executable, "-m", "optipromp", "plan", "scenario-4", "--json"]
    later = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert later.stderr == ""
    assert set(tmp_path.rglob("*.nbc")) == compiled
