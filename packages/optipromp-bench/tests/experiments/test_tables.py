"""Studies as rows of one file, and their tables."""

from pathlib import Path

import pytest
from scripts import publish
from tests.cli.fixtures import call

from optipromp_bench.experiments.rows import Row
from optipromp_bench.experiments.tables import studies_of, tables_of


def found(folder: Path) -> list[list[list[str]]]:
    """The rows of the tables, as they are published."""
    return [table["rows"] for table in publish.tables_in(folder).values()]


def told(**rows: list[Row]) -> list[list[list[str]]]:
    """The rows of the tables of some studies."""
    return [[[str(cell) for cell in line] for line in each.lines] for each in tables_of(rows)]


def test_plans_are_told_by_part_and_by_preset() -> None:
    rows = [
        Row(
            preset, seed, planner="opti-promp", plan_status="success", success=seed > 0,
            cause="" if seed else "torn", picked=True, unripe_force=1.0, plan_time=0.03,
            predicted_failure=0.015, noise_position=0.0, noise_angle=0.0, pushables=2, redraws=0,
        )
        for preset, count in (("cluster", 10), ("mixed", 5))
        for seed in range(count)
    ]  # fmt: skip
    (line,), presets, bins = told(hanging=rows)
    assert line[1:4] == ["15", "86.7 (62–96)", "13.3 (4–38)"]
    assert line[-1] == "30 ms / 30 ms"
    assert presets[0][:5] == ["`cluster`", "exactly", "9 of 10", "90.0 (60–98)", "1 of 10"]
    assert bins == [["hanging", "1 to 2 %", "15", "1.5", "13.3 (4–38)"]]


def test_loops_are_told_by_condition_by_preset_and_in_pairs() -> None:
    studies = dict[str, list[Row]]()
    ends = {"open": ("clean", "harmed", "missed"), "closed": ("clean", "clean", "gave_up")}
    for part, results in ends.items():
        studies[part] = [
            Row(
                preset, seed, planner="opti-promp", loop=part, condition=condition, result=result,
                success=result == "clean", plan_status="success", duration=5.0,
                noise_position=0.0, noise_angle=0.0, pushables=2, redraws=0,
            )
            for condition in ("none", "sway")
            for preset in ("cluster", "mixed")
            for seed, result in enumerate(results if condition == "none" else results[:2])
        ]  # fmt: skip
    by, presets, pairs = told(**studies)
    assert by[1][:8] == ["`none`", "closed", "6", "67 (30–90)", "0 (0–39)", "2", "0", "0"]
    assert presets[0] == ["`cluster`", "open", "5", "40.0", "40.0", "0", "1", "0"]
    assert pairs[0] == ["`none`", "clean", "6", "0", "2", "0.500"]


FILE = """
[[study]]
name = "near"
presets = ["cluster"]
planners = ["straight"]
seeds = [0, 1]
[[study]]
name = "noisy"
presets = ["cluster", "mixed"]
planners = ["straight"]
noise = "zero-mean"
seeds = [3, 4]
"""


def ran(tmp_path: Path, text: str) -> tuple[int, str]:
    (tmp_path / "my.toml").write_text(text)
    words = "bench", "study", tmp_path / "my.toml", "--out", tmp_path / "out", "--workers", 1
    code, out, error = call(*words)
    return code, error if code else out


def test_the_studies_of_a_file_run_and_go_on_and_are_told(tmp_path: Path) -> None:
    assert ran(tmp_path, FILE)[0] == 0
    overview, presets, _ = found(tmp_path / "out")
    assert [line[:2] for line in overview] == [["near", "1"], ["noisy", "2"]]
    assert [line[0] for line in presets] == ["`cluster`", "`cluster`", "`mixed`"]
    rows = {part: (tmp_path / "out" / part / "rows.csv").read_bytes() for part in ("near", "noisy")}
    kept = (tmp_path / "out" / "tables.md").read_bytes()
    assert ran(tmp_path, FILE)[0] == 0
    assert (tmp_path / "out" / "tables.md").read_bytes() == kept
    assert rows == {part: (tmp_path / "out" / part / "rows.csv").read_bytes() for part in rows}


KIND = """
from dataclasses import dataclass
from optipromp_bench.experiments.statistics import Table
@dataclass(frozen=True)
class Doubles:
    def asks(self):
        return [{"preset": "none", "seed": seed} for seed in range(3)]
    def trial(self, ask):
        return {"result": str(2 * ask["seed"])}
    @staticmethod
    def told(parts):
        rows = [[row["seed"], row["result"]] for row in parts["two"]]
        return [Table("Doubles", ["seed", "twice"], rows)]
"""


def test_a_kind_of_its_own_goes_on_after_a_line_that_was_cut_short(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "doubles.py").write_text(KIND)
    rows = tmp_path / "out" / "two" / "rows.jsonl"
    file = 'table = "doubles:Doubles"\n[[study]]\nname = "two"'
    for _ in range(2):
        assert ran(tmp_path, file)[0] == 0
        assert found(tmp_path / "out") == [[["0", "0"], ["1", "2"], ["2", "4"]]]
        assert rows.read_bytes().count(b"\n") == 3
        rows.write_bytes(rows.read_bytes()[:-5])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[[", 'table = "both"\n[[', "table is 'both'"),
        ("noise =", "nose =", "study.1.nose: no such field: valid are presets"),
        ("[0, 1]", "[0]", "study.0.seeds.1: Field required"),
        ('"near"', '"../x"', "study.0.name: String should match pattern"),
        ('"near"', '"noisy"', "two studies are noisy"),
        ('"mixed"', '"mixd"', "preset is 'mixd'"),
        ("[[study]]", "[[study]", "is no TOML"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, old: str, new: str, words: str) -> None:
    code, told = ran(tmp_path, FILE.replace(old, new, 1))
    assert code == 2
    assert words in " ".join(told.split())


def test_published_studies_can_be_read() -> None:
    files = sorted((Path(__file__).parents[4] / "scripts/studies").glob("*.toml"))
    kinds = [studies_of([str(file)])[0].__name__ for file in files]
    assert {"Study", "Guards"} <= set(kinds)
