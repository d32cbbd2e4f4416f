"""Studies and submissions as tables."""

from pathlib import Path

from scripts import publish, study_tables

from optipromp_bench.experiments.rows import STUDY, Row, lines_of


def found(folder: Path, text: str) -> list[list[list[str]]]:
    """The rows of the tables, as they are published."""
    (folder / "1.out").write_text(text)
    return [table["rows"] for table in publish.tables_in(folder).values()]


def rows_in(folder: Path, rows: list[Row]) -> None:
    folder.mkdir(parents=True)
    (folder / "rows.csv").write_bytes(lines_of(rows, STUDY, header=True))


def test_plans_are_told_by_part_and_by_preset(tmp_path: Path) -> None:
    rows = [
        Row(
            preset, seed, planner="opti-promp", plan_status="success", success=seed > 0,
            cause="" if seed else "torn", picked=True, unripe_force=1.0, plan_time=0.03,
            predicted_failure=0.015, noise_position=0.0, noise_angle=0.0, pushables=2, redraws=0,
        )
        for preset, count in (("cluster", 10), ("mixed", 5))
        for seed in range(count)
    ]  # fmt: skip
    rows_in(tmp_path / "hanging", rows)
    (line,), presets, bins = found(tmp_path, study_tables.plans(tmp_path, ["hanging"]))
    assert line[1:4] == ["15", "86.7 (62–96)", "13.3 (4–38)"]
    assert line[-1] == "30 ms / 30 ms"
    assert presets[0][:5] == ["`cluster`", "exactly", "9 of 10", "90.0 (60–98)", "1 of 10"]
    assert bins == [["hanging", "1 to 2 %", "15", "1.5", "13.3 (4–38)"]]


def test_loops_are_told_by_condition_by_preset_and_in_pairs(tmp_path: Path) -> None:
    ends = {"open": ("clean", "harmed", "missed"), "closed": ("clean", "clean", "gave_up")}
    for part, results in ends.items():
        rows = [
            Row(
                preset, seed, planner="opti-promp", loop=part, condition=condition, result=result,
                success=result == "clean", plan_status="success", duration=5.0,
                noise_position=0.0, noise_angle=0.0, pushables=2, redraws=0,
            )
            for condition in ("none", "sway")
            for preset in ("cluster", "mixed")
            for seed, result in enumerate(results if condition == "none" else results[:2])
        ]  # fmt: skip
        rows_in(tmp_path / part, rows)
    by, presets, pairs = found(tmp_path, study_tables.loops(tmp_path, ["open", "closed"]))
    assert by[1][:8] == ["`none`", "closed", "6", "67 (30–90)", "0 (0–39)", "2", "0", "0"]
    assert presets[0] == ["`cluster`", "open", "5", "40.0", "40.0", "0", "1", "0"]
    assert pairs[0] == ["`none`", "clean", "6", "0", "2", "0.500"]
