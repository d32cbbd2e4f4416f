"""Pages show what the result files give, and a result goes on where its run was stopped."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from scripts import publish

from benchmarks.machine import describe
from benchmarks.registry import Metric
from benchmarks.registry import Row as Measured
from optipromp.laboratory.experiments.rows import STUDY, Row, lines_of, source_version

ROOT = Path(__file__).resolve().parents[1]
BOOK = publish.book_of(ROOT)


def test_pages_show_what_the_results_give() -> None:
    texts, words = publish.texts_of(ROOT), publish.words_of(ROOT, BOOK)
    assert sum(len(publish.MARK.findall(text)) for text in texts.values()) > 30
    assert publish.differences(ROOT, BOOK) == [], "run scripts/publish.py --pages"
    for page, text in texts.items():
        assert publish.written(text, words, page == "README.md") == text, page


@pytest.mark.parametrize(
    ("page", "shown"),
    [
        ("README.md", "promised"),
        ("docs/index.md", "promised"),
        ("docs/benchmark.md", "board:board"),
        ("docs/studies.md", "noisy:reliability"),
        ("docs/robots-tried.md", "robots:right"),
    ],
)
def test_a_figure_changed_by_hand_is_named(page: str, shown: str) -> None:
    text = publish.texts_of(ROOT)[page]
    begin = text.index(f"<!-- result {shown} -->")
    end = text.index("<!-- end -->", begin)
    (*_, last) = re.finditer(r"\d", text[begin:end])
    at = begin + last.start()
    changed = text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :]
    found = publish.differences(ROOT, BOOK, {page: changed})
    assert found == [f"{page}: <!-- result {shown} --> has other figures than the result"]


def test_every_table_with_figures_is_of_a_result_or_is_listed() -> None:
    assert publish.unlisted(ROOT, BOOK) == [], "mark it, or list it in scripts/publish.toml"
    listed = {page: dict(begins) for page, begins in BOOK["unmarked"].items()}
    del listed["docs/learners.md"]["entry | learns from"]
    (found,) = publish.unlisted(ROOT, {"unmarked": listed})
    assert found.startswith("docs/learners.md: | entry | learns from")


def test_every_share_in_a_sentence_is_of_a_result_or_is_listed() -> None:
    assert publish.unsaid(ROOT, BOOK) == [], "mark it, or list it in scripts/publish.toml"
    assert publish.dead(ROOT, BOOK) == []
    page = "docs/closed-loop.md"
    text = publish.texts_of(ROOT)[page] + "\nIt picks 94 % of all scenes.\n\n```\n3 of 4\n```\n"
    found = publish.unsaid(ROOT, BOOK, {page: text})
    (told,) = found
    assert "It picks 94 % of all scenes." in told
    listed = {"prose": {page: {"no such words": "why"}}}
    assert publish.dead(ROOT, listed) == [
        f"scripts/publish.toml: {page} does not say 'no such words'"
    ]


def test_a_sentence_can_show_what_cells_are_worked_out_to() -> None:
    rows = [
        ["a", "x", "50", "60 (46–72)"],
        ["b", "x", "50", "7.5 (1–9)"],
        ["c", "y", "20", "5 of 9"],
    ]
    cells = [{"who": "a", "causes": {"torn": 3}}, {"who": "b", "causes": {"torn": 1200}}]
    table = {"columns": ["arm", "cell", "n", "clean % (95 %)"], "rows": rows}
    words = publish.tables.shown("printed", {"tables": {"arms": table}, "cells": cells})
    assert words["arms/^., x/clean/range"] == "7.5 to 60"
    assert words["arms/^c/4/range"] == "5"
    assert words["arms/, x/clean/count"] == "34"  # 30 and 3.75 of 50
    assert words["arms/./n/sum"] == "120"
    assert words["arms/^a/cell/cell"] == "x"
    assert words["cells/./causes.torn/sum"] == "1,203"
    for none in ("arms/^d/n/sum", "arms/./n/cell", "arms/./none/sum", "arms/./n/most", "nothing"):
        with pytest.raises(KeyError, match=re.escape(none)):
            words[none]


def test_a_table_of_figures_is_told_from_one_of_words() -> None:
    rows = "| a | b |\n|---|---|\n"
    assert list(publish.figured(f"{rows}| one | 93 % |\n")) == ["| a | b |"]
    assert not list(publish.figured(f"{rows}| one | two |\n| three | `f4` |\n"))
    assert not list(publish.figured(f"<!-- result x:y -->\n\n{rows}| 1 | 2 |\n\n<!-- end -->\n"))


def test_each_row_has_a_kind_and_each_result_a_row() -> None:
    names = [row["name"] for row in BOOK["result"]]
    assert len(set(names) | BOOK["tables"].keys()) == len(names) + len(BOOK["tables"])
    assert {path.stem for path in (ROOT / "docs/results").glob("*.json")} <= set(names)
    assert {row["kind"] for row in BOOK["result"]} <= publish.tables.KINDS.keys()


def test_the_seeds_that_are_told_are_those_of_the_commands() -> None:
    """All are of the block that this list keeps, and no two results but ``quiet`` share one."""
    for row in BOOK["result"]:
        spans = re.findall(r"--seeds (\d+):(\d+)", " ".join(row["commands"]))
        if spans:
            first, last = min(int(a) for a, _ in spans), max(int(b) for _, b in spans) - 1
            assert row["seeds"] == f"{first} to {last}", row["name"]
        for first in re.findall(r"--(?:seeds|first) (\d+)", " ".join(row["commands"])):
            assert 600_000 <= int(first) < 620_000, row["name"]


def test_a_rate_of_the_readme_stands_in_the_table_alone() -> None:
    text = (ROOT / "README.md").read_text("utf-8").partition("## Six doors")[2]
    assert len(text) > 1000
    assert not re.search(r"\d %", text)


# kinds: what a folder holds, and what is told of it


def rows_in(folder: Path, rows: list[Row]) -> None:
    folder.mkdir(parents=True)
    (folder / "rows.csv").write_bytes(lines_of(rows, STUDY, header=True))


def test_a_study_is_told_by_preset_and_in_all(tmp_path: Path) -> None:
    rows_in(
        tmp_path / "rows",
        [
            Row.of(
                preset, seed, planner="opti-promp", plan_status="success", success=seed > 0,
                cause="" if seed else "torn", picked=True, unripe_force=1.0, plan_time=0.03,
                predicted_failure=0.015, noise_position=0.0, noise_angle=0.0, pushables=2,
                redraws=0,
            )
            for preset, count in (("cluster", 10), ("mixed", 5))
            for seed in range(count)
        ],
    )  # fmt: skip
    words = publish.tables.shown("study", publish.tables.study(tmp_path, {}))
    assert words["best"] == "`cluster` 90.0 (60–98)"
    assert words["worst"] == "`mixed` 80.0 (38–96)"
    assert words["all"] == "86.7 (62–96) of 15"
    assert words["broken"] == "2 of 15 promises broken"
    assert words["times"] == "30 ms / 30 ms"
    assert "| cluster | 9 of 10 | 90.0 (60–98) | 1 of 10 |" in words["rates"]
    assert "| 1 to 2 % | 15 | 1.5 | 2 | 13.3 (4–38) |" in words["reliability"]


def test_loops_are_told_by_condition(tmp_path: Path) -> None:
    ends = {"open": ("clean", "harmed", "missed"), "closed": ("clean", "clean", "gave_up")}
    for part, results in ends.items():
        rows = [
            Row.of(
                preset, seed, planner="opti-promp", loop=part, condition=condition, result=result,
                success=result == "clean", plan_status="success", duration=5.0,
                noise_position=0.0, noise_angle=0.0, pushables=2, redraws=0,
            )
            for condition in ("none", "sway")
            for preset in ("cluster", "mixed")
            for seed, result in enumerate(results if condition == "none" else results[:2])
        ]  # fmt: skip
        rows_in(tmp_path / part, rows)
    found = publish.tables.loops(tmp_path, {"parts": ["open", "closed"]})
    words = publish.tables.shown("loops", found)
    assert words["best"] == "`sway` 100 (51–100)"
    assert words["closed.all.none"] == "67 (30–90)"
    assert words["closed.cluster.none.told"] == "67 (21–94), 0, 33"
    assert words["open.all.sway.harmed"] == "50"
    row = "| as seen (`none`) | 6 | 33 (10–70) | 33.3 | 6 | 67 (30–90) | 0.0 | 33.3 |"
    assert row in words["conditions"]
    assert words["worst"] == "`none` 67 (30–90)"
    first = words["pairs/^clean.*, none/first alone/cell"], words["pairs/^clean.*, none/p/cell"]
    assert first == ("0", "= 0.5")  # of two scenes of each kind one more by the second
    assert "| `mixed` | 5 | 40.0 | 40.0 | 5 | 80.0 | 0.0 | 20.0 |" in words["presets"]
    assert "| all | 10 | 40.0 | 40.0 | 10 | 80.0 | 0.0 | 20.0 |" in words["presets"]


def test_the_guard_is_told_beside_the_policy_alone(tmp_path: Path) -> None:
    lines = []
    for guarded, results in ((False, ("clean", "harmed")), (True, ("clean", "missed"))):
        for seed, result in enumerate(results):
            asked = {"entry": "clone", "guarded": guarded, "engine": "arm", "noise": "none",
                     "preset": "cluster", "seed": seed}  # fmt: skip
            steps = {"steps": 100, "acted": 10, "spent": [2.0] * 20 + [9.0]} if guarded else {}
            lines.append(json.dumps({"asked": asked, "result": result, **steps}))
    (tmp_path / "guard.jsonl").write_text("\n".join(lines) + "\n")
    words = publish.tables.shown("guard", publish.tables.guard(tmp_path, {}))
    told = "2 | 50 (9–91) | 50 (9–91) | 50 (9–91) | 0 (0–66) | 10 % | 2.0 ms, 2.0 ms |"
    assert words["guard"].splitlines()[-2:] == [
        f"| `clone` | `cluster` | arm | {told}",
        f"| all | | | {told}",
    ]


def test_the_judge_is_told_where_every_case_was_run(tmp_path: Path) -> None:
    cases = list(publish.tables.CASES)
    text = "".join(
        f"{name}, 1000 cases: in contact by more than 1 mm: 300; called a contact: 400; missed: 0\n"
        "  ours minus theirs [mm]: percentiles 1, 5, 50, 95, 99: -3.00, -2.00, -1.00, 0.00, 0.00; "
        "largest 0.000\n"
        for name in cases
    )
    (tmp_path / "1.out").write_text(text)
    found = publish.tables.judged(tmp_path, {"words": {"faults": "all seen"}})
    words = publish.tables.shown("judged", found)
    assert words["missed"] == "0 of 1,500"
    assert "| still, makers' bodies | 300 of 1,000 | 0 | -3.00, -2.00, -1.00" in words["judged"]
    (tmp_path / "1.out").write_text(text.partition("self,")[0])
    with pytest.raises(ValueError, match="holds the cases"):
        publish.tables.judged(tmp_path, {"words": {}})


def test_what_the_eyes_see_is_told_with_intervals(tmp_path: Path) -> None:
    seen = {
        "preset": "wild", "mount": "beside", "looks": "rich", "finder": "network", "pictures": 2,
        "visible": 10, "recall": 0.9, "false": 1, "false_share": 0.1, "center_median_mm": 2.04,
        "center_90_mm": 4.0, "normalised_mean": 1.0, "normalised_beyond_99": 0.05,
        "ripe_right": float("nan"), "stems_found": 3, "stems_visible": 4, "angle_mean_deg": 2.0,
        "angle_90_deg": 3.0, "angle_over_deviation": 1.0, "ms": 50.0,
    }  # fmt: skip
    (tmp_path / "1.out").write_text(f"words\n{json.dumps(seen)}\n")
    words = publish.tables.shown("eyes", publish.tables.eyes(tmp_path, {}))
    assert words["eyes"].splitlines()[2] == (
        "| `wild`, beside, rich | network | 2 | 10 | 90.0 (60–98) | 1 (10.0) | 2.0, 4.0 | 1.0 (5.0)"
        " | – | 3 of 4 | 2.0, 3.0 (1.0) | 50 |"
    )


def test_the_suite_is_told_by_table_and_by_value(tmp_path: Path) -> None:
    metric = Metric("cycles/still plant/median", "ms", target=8.0)
    results = describe() | {"rows": [Measured(metric, "measured", 2.25).to_dict()]}
    (tmp_path / "results.json").write_text(json.dumps(results))
    words = publish.tables.shown("benchmarks", publish.tables.benchmarks(tmp_path, {}))
    assert words["cycles"] == "| | median |\n|---|---|\n| still plant | 2.25 ms (≤ 8) |"
    assert words["cycles/still plant/median"] == "2.25 ms"
    assert words["page"].endswith("| still plant | 2.25 ms (≤ 8) |")


# running

ROWS = """
[[result]]
name = "first"
kind = "printed"
commands = [
  '''python -c 'open("a.txt")' ''',
  '''WORD=7 python -c 'import os; print(open("a.txt").read(), os.environ["WORD"], "passed")' ''',
]
tables = ["counts"]
told = {passed = '(\\d+) passed'}
seeds = "none"
size = "one"
minutes = 1

[[result]]
name = "second"
kind = "printed"
commands = ["python -c 'open(r\\"{out}/{entry}.txt\\", \\"x\\"); print(1)'"]
entries = ["a", "b"]
seeds = "none"
size = "two"
minutes = 2
needs = []

[tables.both]
columns = ["what", "n"]
rows = [["[first](docs/x.md)", "{first:passed}"], ["second", "{second:version}"]]
"""
PAGE = """# Page

<!-- result first:counts -->
<!-- end -->

It is <!-- result first:passed --><!-- end -->.
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    (tmp_path / "scripts").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "scripts/publish.toml").write_text(ROWS)
    (tmp_path / "docs/x.md").write_text(PAGE)
    (tmp_path / "README.md").write_text("<!-- result both -->\n<!-- end -->\n")
    return tmp_path


def test_a_run_goes_on_after_a_failure_and_its_result_is_shown(
    house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert publish.main(["--check"], house) == 1
    assert "first: no result" in capsys.readouterr().out
    assert publish.main(["--run"], house) == 1  # there is no a.txt
    told = capsys.readouterr().out
    assert "first: command 1 ended with 1" in told
    assert "FileNotFoundError" in told
    assert "second: done" in told  # nothing waits for what failed
    publish.main([], house)
    assert "no result, begun" in capsys.readouterr().out
    (house / "a.txt").write_text("| n |\n|---|\n| 3 |\n")
    # the files of the second result may be made once: what is done is not run again
    assert publish.main(["--run"], house) == 0
    found = json.loads((house / "docs/results/first.json").read_text())
    assert found["figures"]["tables"] == {"counts": {"columns": ["n"], "rows": [["3"]]}}
    assert found["figures"]["told"] == {"passed": "7"}
    assert found["version"] == source_version()
    assert found["machine"]["cores"] >= 1
    assert publish.main(["--pages"], house) == 0
    assert "| n |\n|---|\n| 3 |\n\n<!-- end -->" in (house / "docs/x.md").read_text()
    assert "<!-- result first:passed -->7<!-- end -->." in (house / "docs/x.md").read_text()
    assert "| [first](docs/x.md) | 7 |" in (house / "README.md").read_text()
    assert publish.main(["--check"], house) == 0


def test_a_result_of_another_version_is_stale(
    house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (house / "a.txt").write_text("| n |\n|---|\n| 3 |\n")
    publish.main(["--run"], house)
    path = house / "docs/results/first.json"
    found = json.loads(path.read_text())
    path.write_text(json.dumps({**found, "version": "before"}))
    publish.main(["--pages"], house)
    capsys.readouterr()
    assert publish.main(["--check"], house) == 1
    assert capsys.readouterr().out == "first: of before; shown in README, x\n"
    publish.main([], house)
    assert "stale: 0.0 hours of one core" in capsys.readouterr().out
    book = house / "scripts/publish.toml"
    same = f'[same."{source_version()}"]\nbefore = "a comment was mended"\n'
    book.write_text(book.read_text() + same)
    assert publish.main(["--check"], house) == 0
    book.write_text(book.read_text().replace(source_version(), "another"))
    assert publish.main(["--check"], house) == 1


def test_nothing_is_begun_after_the_minutes(
    house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert publish.main(["--run", "--minutes", "0"], house) == 1
    assert "first: command 1 of 2 was not begun" in capsys.readouterr().out
    assert not (house / "docs/results").exists()


WAITS = """
import pathlib, time
try:
    pathlib.Path("began").touch()
    time.sleep(600)
except KeyboardInterrupt:
    pathlib.Path("ended").touch()
"""


def test_an_interrupted_run_ends_what_runs(house: Path) -> None:
    (house / "waits.py").write_text(WAITS)
    row = 'name = "waits"\nkind = "printed"\ncommands = ["python waits.py"]\n'
    row += 'seeds = "none"\nsize = "one"\nminutes = 1\n'
    (house / "scripts/publish.toml").write_text(f"[[result]]\n{row}")
    code = "import pathlib, sys; from scripts import publish; "
    code += "sys.exit(publish.main(['--run'], pathlib.Path(sys.argv[1])))"
    run = subprocess.Popen([sys.executable, "-c", code, house], cwd=ROOT)
    late = time.monotonic() + 120.0
    while not (house / "began").exists() and time.monotonic() < late and run.poll() is None:
        time.sleep(0.05)
    run.send_signal(signal.SIGTERM)
    assert run.wait(60.0) == 130
    assert (house / "ended").exists()
    assert not (house / "docs/results").exists()


def test_a_name_that_is_no_result_is_refused(house: Path) -> None:
    with pytest.raises(SystemExit, match="third is no result: choose from first, second"):
        publish.main(["--run", "third"], house)
