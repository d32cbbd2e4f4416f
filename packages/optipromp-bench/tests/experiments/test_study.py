import multiprocessing
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu
from tests.experiments.rows import ROW

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.experiments import rows, study, trials
from optipromp_bench.experiments.forest import Share
from optipromp_bench.experiments.rows import STUDY, Row, locked, row_of, rows_of, source_version
from optipromp_bench.experiments.statistics import auc, calibration, summary, wilson
from optipromp_bench.experiments.study import Study, row_file, run_study
from optipromp_bench.experiments.trials import run_trials


def small(**changes) -> Study:
    given = {"presets": ("cluster",), "planners": ("straight", "promp"), "seeds": (0, 3)}
    return Study(**{**given, **changes})


@pytest.fixture
def quick(monkeypatch):
    """Runs that cost nothing, and a list of the scenes that were run."""
    asked: list[tuple[str, int, tuple[str, ...]]] = []

    def run_trials(_, preset, seed, condition, planners, version):
        asked.append((preset, seed, tuple(planners)))
        return [
            replace(ROW, preset=preset, seed=seed, planner=planner, success=planner == "promp")
            for planner in planners
        ]

    monkeypatch.setattr(study, "run_trials", run_trials)
    monkeypatch.setattr(study, "warm_up", lambda *_: None)
    return asked


# --- statistics ---------------------------------------------------------------------------------


def test_wilson_against_published_values() -> None:
    # Newcombe 1998, table I, method 3: 81 of 263, 15 of 148, 0 of 20, 1 of 29
    for (k, n), (low, high) in {
        (81, 263): (0.2553, 0.3662),
        (15, 148): (0.0624, 0.1605),
        (0, 20): (0.0, 0.1611),
        (1, 29): (0.0061, 0.1718),
    }.items():
        assert wilson(k, n) == pytest.approx((low, high), abs=5e-5)
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(7, 7)[1] == 1.0


def test_summary_counts() -> None:
    rows = [
        replace(ROW, seed=0, success=True, cause="", success_before=None),
        replace(ROW, seed=1, static_force=3.0, cause="static_contact", unripe_force=2.5,
                causes="static_contact crushed not_picked"),
        replace(ROW, seed=2, cause="no_plan", plan_status="INVALID_PLAN", unripe_force=None),
        replace(ROW, seed=3, torn="n1 n2"),
    ]  # fmt: skip
    (cell,) = summary(rows)
    assert (cell.runs, cell.successes, cell.plans, cell.kept, cell.broken) == (4, 1, 3, 1, 2)
    assert cell.broken_low < cell.broken_rate == 2.0 / 3.0 < cell.broken_high
    assert cell.causes == {"crushed": 2, "static_contact": 1, "not_picked": 1, "no_plan": 1}
    assert (cell.static_contacts, cell.torn, cell.redraws) == (1, 1, 20)
    assert cell.unripe_force == 12.5
    assert cell.low < cell.rate == 0.25 < cell.high
    assert cell.kept_before == 1  # rows of 0.3.0 have success alone
    (cell,) = summary([replace(rows[0], success_before=before) for before in (True, False, False)])
    assert (cell.kept, cell.kept_before) == (3, 1)


# --- the rows file ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row",
    [
        ROW,
        replace(ROW, picked=None, unripe_force=None, duration=None, predicted_harm=None,
                predicted_failure=None, success=True),
    ],
)  # fmt: skip
def test_a_row_outlives_its_file(row: Row, tmp_path: Path) -> None:
    row_file(small(), tmp_path).append(row)
    assert row_file(small(), tmp_path).rows == [row]
    assert row_of({name: str(getattr(ROW, name)) for name in STUDY}) == ROW


def test_a_row_cut_short_is_dropped_and_the_rest_kept(tmp_path: Path) -> None:
    file = row_file(small(), tmp_path)
    file.append(ROW)
    whole = file.path.read_bytes()
    file.append(replace(ROW, seed=1))
    file.path.write_bytes(file.path.read_bytes()[:-7])
    again = row_file(small(), tmp_path)
    assert again.rows == [ROW]
    assert file.path.read_bytes() == whole


def test_a_run_that_stands_twice_is_refused(tmp_path: Path) -> None:
    file = row_file(small(), tmp_path)
    file.append(ROW)
    file.append(replace(ROW, seed=1))
    head, first, _ = file.path.read_bytes().splitlines(keepends=True)
    with file.path.open("ab") as stream:
        stream.write(first.replace(b"True", b"False"))
    for read in (lambda: rows_of(tmp_path), lambda: row_file(small(), tmp_path)):
        with pytest.raises(InvalidRequestError, match=r"rows\.csv holds 2 rows of .*must hold one"):
            read()
    file.path.write_bytes(head + first)
    assert rows_of(tmp_path) == [ROW]


def test_a_message_of_many_lines_is_one_line(tmp_path: Path) -> None:
    file = row_file(small(), tmp_path)
    file.append(replace(ROW, message="one\ntwo\r\n three"))
    assert row_file(small(), tmp_path).rows[0].message == "one two three"
    assert file.path.read_bytes().count(b"\n") == 2


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"noise_angle": 5.0}, "noise_angle"),
        ({"only_valid": True}, "only_valid"),
        ({"noise": "low"}, "noise"),
        ({"robot": "ur5.urdf"}, "robot"),
        ({"risk": 0.01}, "risk"),
    ],
)
def test_rows_of_another_study_are_not_mixed(change, named, tmp_path: Path) -> None:
    """Whether the folder or the study states what the other leaves at its default."""
    for k, (held, asked) in enumerate(((small(), small(**change)), (small(**change), small()))):
        row_file(held, tmp_path / str(k))
        with pytest.raises(InvalidRequestError, match=f"holds rows with {named}"):
            row_file(asked, tmp_path / str(k))


def test_the_version_of_rows_follows_the_code_of_all_packages(tmp_path: Path, monkeypatch) -> None:
    """But of what only shows: commands and looks."""
    homes = {"optipromp": ("core", "cli", "looks"), "optipromp_sim": ("simulation", "commands")}
    for package, names in homes.items():
        for name in names:
            (tmp_path / package / name).mkdir(parents=True)
            (tmp_path / package / name / "code.py").write_text("")

    def found(package: str) -> SimpleNamespace | None:
        file = tmp_path / package / "__init__.py"
        return SimpleNamespace(origin=str(file)) if package in homes else None

    monkeypatch.setattr(rows, "find_spec", found)
    whole = source_version.__wrapped__()
    shown = {"cli", "looks", "commands"}
    for package, names in homes.items():
        for name in names:
            file = tmp_path / package / name / "code.py"
            file.write_text("changed")
            assert (source_version.__wrapped__() == whole) is (name in shown)
            file.write_text("")


def test_rows_of_other_code_are_not_mixed(tmp_path: Path, monkeypatch) -> None:
    row_file(small(), tmp_path)
    monkeypatch.setattr(trials, "source_version", lambda: "other")
    with pytest.raises(InvalidRequestError, match="version"):
        row_file(small(), tmp_path)


def test_what_is_no_row_is_refused(tmp_path: Path) -> None:
    file = row_file(small(), tmp_path)
    with file.path.open("a") as stream:
        stream.write("cluster,zero,straight\n")
    with pytest.raises(InvalidRequestError, match=r"rows\.csv"):
        row_file(small(), tmp_path)


# --- running ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"presets": ("clusters",)}, "did you mean 'cluster'"),
        ({"planners": ("rrt",)}, "planner is 'rrt'"),
        ({"planners": ()}, "no planner"),
        ({"planners": ("promp", "promp")}, "twice"),
        ({"seeds": (3, 3)}, "3:3"),
        ({"seeds": (-1, 3)}, "-1:3"),
        ({"noise_position": float("nan")}, "noise_position"),
        ({"noise": "lower"}, "did you mean 'low'"),
        ({"noise": "low", "noise_angle": 5.0}, "one of them"),
        ({"risk": 1.0}, "risk"),
    ],
)
def test_wrong_studies_are_refused(change, named) -> None:
    with pytest.raises(InvalidRequestError, match=named):
        small(**change)


def test_a_study_goes_on_where_it_was_left(quick, tmp_path: Path) -> None:
    first = run_study(small(seeds=(0, 2)), tmp_path, workers=1)
    assert len(first) == 4
    quick.clear()
    steps = []
    rows = run_study(
        small(planners=("straight", "promp", "chomp")), tmp_path, workers=1,
        progress=lambda done, total, row: steps.append((done, total)),
    )  # fmt: skip
    assert quick == [
        ("cluster", 0, ("chomp",)),
        ("cluster", 1, ("chomp",)),
        ("cluster", 2, ("straight", "promp", "chomp")),
    ]
    assert steps[0] == (4, 9)
    assert steps[-1] == (9, 9)
    assert [row.key for row in rows] == [
        ("cluster", seed, planner, "", "", "", "")
        for seed in range(3)
        for planner in ("straight", "promp", "chomp")
    ]


def test_the_picture_has_promised_and_picked_and_what_is_executed_although_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: dict[str, dict[str, dict[str, Share]]] = {}
    monkeypatch.setattr(study, "forest", lambda shares: drawn.update(shares) or "")
    refused = replace(ROW, success=True, plan_status="HARM_PREDICTED")
    rows = [replace(ROW, success=True), *(replace(refused, seed=k) for k in (1, 2)),
            replace(ROW, seed=3)]  # fmt: skip
    study.study_picture(summary(rows))
    assert [
        (panel, [round(each) for each in share])
        for panel, lines in drawn.items() for (share,) in map(dict.values, lines.values())
    ] == [
        ("promised and picked", [25, 5, 70]), ("broken promises", [50, 9, 91]),
        ("picked, if refusals are not heeded", [75, 30, 95]),
    ]  # fmt: skip


@pytest.mark.parametrize("loop", ["", "closed"])
def test_a_run_that_breaks_off_is_a_row_too(monkeypatch, loop: str) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("of all objects")

    monkeypatch.setattr(trials, "picked" if loop else "attempt", broken)
    of = small(planners=("opti-promp",), loops=(loop,)) if loop else small()
    (row,) = run_trials(of, "cluster", 0, "none" if loop else "", (loop or "straight",), "x")
    assert (row.success, row.cause, row.result) == (False, "error", "error" if loop else "")
    assert "of all objects" in row.message


def test_the_risk_of_a_study_sets_what_its_rows_promise(tmp_path: Path) -> None:
    """The reach is the same; the probability that the pick fails is told by the row."""
    pytest.importorskip("mujoco")
    rows = []
    for risk in (0.01, 0.1):
        chosen = Study(("table-top",), ("straight",), (7, 8), risk=risk)
        rows += run_study(chosen, tmp_path / str(risk), workers=1)
    assert [row.plan_status for row in rows] == ["HARM_PREDICTED", "success"]
    assert rows[0].predicted_harm == rows[1].predicted_harm
    assert all(0.0 < row.predicted_failure < 1.0 for row in rows)


def test_plans_that_are_refused_are_not_executed_where_so_asked() -> None:
    pytest.importorskip("mujoco")
    for seed in range(20):
        chosen = Study(("table-top",), ("straight",), only_valid=True)
        (row,) = run_trials(chosen, "table-top", seed, "", ("straight",), "x")
        if row.plan_status != "success":
            assert row.cause == "no_plan"
            assert row.unripe_force is None
            return
    pytest.fail("twenty table-tops that a straight approach does not mind")


def test_a_real_run_is_the_same_in_another_process(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    wanted = small(planners=("straight",), seeds=(0, 2), noise_position=0.005, noise_angle=5.0)
    alone = run_study(wanted, tmp_path / "alone", workers=1)
    together = run_study(wanted, tmp_path / "together", workers=2)
    assert len(alone) == len(together) == 2
    for one, other in zip(alone, together, strict=True):
        times = {"plan_time": 0.0, "simulation_time": 0.0}
        assert replace(one, **times) == replace(other, **times)
        assert one.plan_status in ("success", "INVALID_PLAN", "HARM_PREDICTED")
        assert one.unripe_force is not None
    assert not multiprocessing.active_children()
    assert np.ptp([row.seed for row in alone]) == 1


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_leaves_whole_rows_and_no_process(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    command = [
        sys.executable, "-m", "optipromp", "bench", "study", "presets=cluster", "planners=straight",
        "seeds=0:400", "--workers", "2", "--out", str(tmp_path),
    ]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    rows = tmp_path / "rows.csv"
    until = time.monotonic() + 120
    while time.monotonic() < until and process.poll() is None:
        if rows.exists() and rows.read_bytes().count(b"\n") >= 3:
            break
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to every process of the group
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert b"Traceback" not in errors
    content = rows.read_bytes()
    assert content.endswith(b"\n")
    kept = row_file(Study(("cluster",), ("straight",), (0, 400)), tmp_path).rows
    assert 2 <= len(kept) < 400
    until = time.monotonic() + 10
    while group_lives(process.pid) and time.monotonic() < until:
        time.sleep(0.1)  # multiprocessing's own helper ends when it sees the others gone
    assert not group_lives(process.pid)


def group_lives(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_two_studies_cannot_write_into_one_folder(tmp_path: Path) -> None:
    wanted = Study(("cluster",), ("straight",), (0, 1))
    with locked(tmp_path), pytest.raises(InvalidRequestError, match="study writes into"):
        run_study(wanted, tmp_path, workers=1)
    assert len(run_study(wanted, tmp_path, workers=1)) == 1


values = st.lists(st.integers(0, 6).map(lambda k: 0.25 * k), min_size=1, max_size=20)


@given(values, values)
def test_the_auc_is_that_of_mann_and_whitney(above: list[float], below: list[float]) -> None:
    u = mannwhitneyu(above, below, method="asymptotic").statistic
    assert auc(above, below) == pytest.approx(u / (len(above) * len(below)))


def test_without_pairs_there_is_no_auc() -> None:
    assert np.isnan(auc([], [1.0]))
    assert np.isnan(auc([1.0], []))


def test_runs_are_counted_in_the_bin_of_their_probability() -> None:
    outcomes = [(0.0, True), (0.004, True), (0.01, False), (0.3, True), (0.1, False), (1.0, False)]
    rows = [
        replace(
            ROW, predicted_failure=told, success=ok,
            plan_status="HARM_PREDICTED" if told > 0.5 else "success",
        )
        for told, ok in outcomes
    ]  # fmt: skip
    rows += [
        replace(ROW, predicted_failure=None),  # no model
        replace(ROW, predicted_failure=0.1, picked=None),  # not executed
    ]
    found = calibration(rows)
    counted = [(b.low, b.high, b.runs, b.failures) for b in found.bins]
    assert counted == [
        (0.0, 0.01, 2, 0), (0.01, 0.02, 1, 1), (0.1, 0.2, 1, 1), (0.2, 0.4, 1, 0), (0.4, 1.0, 1, 1),
    ]  # fmt: skip
    assert [b.predicted for b in found.bins] == pytest.approx([0.002, 0.01, 0.1, 0.3, 1.0])
    assert sum(b.runs for b in found.bins) == 6
    for b in found.bins:
        assert b.rate == b.failures / b.runs
        assert (b.rate_low, b.rate_high) == wilson(b.failures, b.runs)
    assert (found.successes, found.failed) == (5, 2)
    assert found.auc == pytest.approx(7.0 / 9.0)


def test_without_predictions_there_is_no_calibration() -> None:
    assert calibration([replace(ROW, predicted_failure=None)]) is None
