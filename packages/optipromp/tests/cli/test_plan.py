"""``plan`` from end to end."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import RUN, call, ran, read, told
from tests.folders import FILES

from optipromp import PlanOptions
from optipromp.core.output import load_plan
from optipromp.core.planning import plan
from optipromp.core.scenes.io import save_scene
from optipromp_sim.generate import generate

RECORDED = (
    Path(__file__).resolve().parents[4] / "../shared/data/panda_demonstrations/demonstrations.npz"
)
METRICS = """
M_c M_p stem_projection drift_shortfall stem_gap clearance_static clearance_avoid
clearance_avoid_tool clearance_self goal_error goal_axis_error limit_violation max_step path_length
smoothness duration velocity_ratio acceleration_ratio
"""
KEYS = {"scene", "planner", "status", "message", "metrics", "terms", "time"}


def test_plan_prints_one_document_and_leaves_its_files(tmp_path: Path) -> None:
    out = tmp_path / "reach"
    done = ran([*RUN, "plan", "scenario-3", "--reach", "--json", "--out", str(out)])
    assert done.returncode == 0, done.stderr
    document = read(done.stdout)
    assert document.keys() >= KEYS
    assert document["metrics"].keys() >= set(METRICS.split())
    assert document["terms"] == {}
    assert {"static", "avoid"} <= set(document["stages"][0]["history"][0])
    assert document["status"] == "success"
    assert document["predicted_harm"].keys() == {
        "harm", "threshold", "object", "cause", "forces", "probability",
    }  # fmt: skip
    assert document["predicted_harm"]["harm"] <= document["predicted_harm"]["threshold"]
    assert document["time"]["total"] > 0
    assert {path.name for path in out.iterdir()} == {"plan.json", *FILES, "reach.png", "joints.png"}
    kept = read((out / "plan.json").read_text(encoding="utf-8"))
    assert {key: kept[key] for key in document} == document


def test_the_report_for_people_says_whether_the_plan_holds() -> None:
    code, stdout, _ = call("plan", "scenario-4", "--details")
    assert code == 0
    assert "success" in stdout
    assert re.search(r"Passes n\d at \d+ mm, pushes it \d+ mm aside, no harm\.", stdout)
    assert "Then leaves the plant with it" in stdout
    way = r"M_p n1 +[+-]\d+\.\d mm \(x_g [+-]\d+\.\d\); its stem leans by [+-]\d"
    assert re.search(way, stdout)
    assert "clearance, static" in stdout


def test_the_command_plans_what_the_library_plans() -> None:
    words = "plan scenario-3 --reach --seed 5 --set waypoints=60 --duration 6 --json"
    code, stdout, _ = call(*words.split())
    assert code == 0

    result = plan("scenario-3", seed=5, options=PlanOptions(waypoints=60, duration=6.0))
    assert read(stdout)["metrics"] == read(json.dumps(result.metrics.to_dict()))


@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded demonstrations are not here")
def test_learnt_and_raw_demonstrations_plan_alike(tmp_path: Path) -> None:
    learnt = tmp_path / "learnt.npz"
    learn = "learn", RECORDED, "--out", learnt, "--robot", "panda", "--no-figure"
    assert call(*learn)[0] == 0
    named = tmp_path / "named.npz"
    joints = np.array([f"joint{j}" for j in range(1, 8)])
    np.savez(named, **np.load(RECORDED), joint_names=joints)
    for path in (named, learnt):
        code, stdout, stderr = call(
            "plan", "scenario-3", "--reach", "--demonstrations", str(path), "--json"
        )
        assert code == 0, stderr or stdout
        assert read(stdout)["status"] == "success"


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
    stdout = call("plan", "scenario-4")[1]
    assert "Reaches the target in" in stdout
    assert "M_c" not in stdout  # figures are details


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
    for name, options in {"both": ("--json", "--progress"), "pipe": ()}.items():
        words = [sys.executable, "-c", slow, "plan", "scenario-4", *options]
        done = ran(words)
        found[name] = done.stderr
        if "--json" in options:
            assert read(done.stdout)["status"] == "success"
    first, *rest = found["both"].splitlines()
    assert re.fullmatch(r" +\d s  reading scene and robot", first)
    assert all(re.fullmatch(r" +\d+ s  [a-z ()]+", line) for line in rest)
    assert found["pipe"] == ""


@pytest.mark.parametrize(("deviation", "helps"), [(0.0085, True), (0.02, False)])
def test_a_second_picture_is_asked_for_where_it_would_help(deviation, helps, tmp_path):
    """Places known to 8.5 mm allow no promise, to 6 mm one; 20 mm and 14 mm none."""
    scene = generate("cluster", 5).each(
        lambda item: (
            item if item.role == "static" else replace(item, covariance=deviation**2 * np.eye(3))
        )
    )
    save_scene(scene, tmp_path / "seen.yaml")
    document = told("plan", str(tmp_path / "seen.yaml"), code=1)
    assert document["status"] == "HARM_PREDICTED"
    assert ("--together" in document.get("advice", "")) == helps
