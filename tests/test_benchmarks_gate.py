"""The gate: what it compares, what it lets pass, and its exit code."""

from pathlib import Path

import pytest

from benchmarks import cli, gate
from benchmarks.registry import RATIO, Context, Metric, Row

LOWER = Metric("a/lower/ratio", RATIO, tolerance=0.2)
HIGHER = Metric("a/higher/ratio", RATIO, "higher", tolerance=0.2)
TIME = Metric("a/time/time", "ms")
BASE = {LOWER.name: 1.0, HIGHER.name: 1.0}


def verdict(row: Row, baseline: dict[str, float] | None = None) -> str:
    (found,) = gate.compare([row], BASE if baseline is None else baseline)
    return found.verdict


@pytest.mark.parametrize(
    ("metric", "value", "expected"),
    [
        (LOWER, 1.0, "same"),
        (LOWER, 1.19, "same"),
        (LOWER, 1.21, "regression"),
        (LOWER, 0.5, "better"),
        (HIGHER, 1.0, "same"),
        (HIGHER, 0.84, "same"),
        (HIGHER, 0.82, "regression"),
        (HIGHER, 2.0, "better"),
    ],
)
def test_direction_and_tolerance(metric: Metric, value: float, expected: str) -> None:
    assert verdict(Row(metric, "ok", value)) == expected


def test_a_ratio_that_failed_is_a_regression() -> None:
    assert verdict(Row(LOWER, "failed", reason="it broke")) == "regression"
    assert verdict(Row(LOWER, "failed", reason="it broke"), {}) == "not compared"


def test_a_new_ratio_is_said_to_be_new() -> None:
    assert verdict(Row(LOWER, "ok", 1.0), {}) == "new"


def test_update_keeps_what_was_not_measured(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    assert gate.update([Row(LOWER, "ok", 1.0), Row(TIME, "ok", 3.0)], {}, path) == 1
    gate.update([Row(HIGHER, "ok", 2.0), Row(LOWER, "failed", reason="broke")], {}, path)
    assert gate.load(path) == {LOWER.name: 1.0, HIGHER.name: 2.0}


@pytest.mark.parametrize("text", ["", "[]", '{"ratios": {"a": "fast"}}', '{"other": 1}'])
def test_a_broken_baseline_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"baseline\.json is not a baseline"):
        gate.load(path)


def test_the_committed_baseline_holds_known_ratios() -> None:
    from benchmarks.registry import SUITE
    from benchmarks.run import load_suite

    load_suite()
    known = {m.name: m for b in SUITE for m in b.metrics}
    for name, value in gate.load().items():
        assert known[name].gated, name
        assert value > 0.0, name


def test_the_exit_code_names_the_regression(monkeypatch, tmp_path, capsys):
    rows = [Row(LOWER, "ok", 1.0), Row(TIME, "ok", 12.3), Row(HIGHER, "not available", reason="no")]
    about = dict.fromkeys(("date", "commit", "machine", "versions"), "")
    told = {**about, "rows": [row.to_dict() for row in rows]}
    monkeypatch.setattr(cli, "run", lambda selected, context: told)
    monkeypatch.setattr(cli.SUITE, "select", lambda names: names)
    base = tmp_path / "baseline.json"
    gate.update([Row(LOWER, "ok", 0.5)], {}, base)
    arguments = ["--baseline", str(base)]
    assert cli.main([*arguments, "--gate"]) == 1
    assert LOWER.name in capsys.readouterr().err.splitlines()[-1]
    assert cli.main([*arguments, "--update-baseline"]) == 0
    assert cli.main([*arguments, "--gate"]) == 0


def test_a_regression_is_measured_again(monkeypatch: pytest.MonkeyPatch) -> None:
    first = {"rows": [Row(LOWER, "ok", 5.0).to_dict(), Row(HIGHER, "ok", 0.1).to_dict()]}
    second = {"rows": [Row(LOWER, "ok", 1.1).to_dict(), Row(HIGHER, "ok", 0.2).to_dict()]}
    monkeypatch.setattr(cli, "run", lambda selected, context: second)
    monkeypatch.setattr(cli.SUITE, "select", lambda names: names)
    results = cli.again(first, dict(BASE), Context())
    rows = {row["name"]: row["value"] for row in results["rows"]}
    assert rows == {LOWER.name: 1.1, HIGHER.name: 0.1}
    assert gate.regressions(map(Row.from_dict, results["rows"]), BASE) == [HIGHER.name]


def test_wrong_arguments_end_with_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--only", "nothing-like-it"]) == 2
    assert "evaluation" in capsys.readouterr().err
