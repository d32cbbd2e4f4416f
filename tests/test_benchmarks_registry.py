"""The registry: names, selection, and that no metric ever goes missing."""

import math

import pytest

from benchmarks.registry import (
    RATIO,
    Absent,
    Context,
    Measured,
    Metric,
    NotAvailableError,
    Registry,
    Row,
    Values,
)

A, B = Metric("family/one/time", "ms", target=2.0), Metric("family/two/ratio", RATIO, "higher")


def registry(function) -> Registry:  # type: ignore[no-untyped-def]
    out = Registry()
    out.benchmark("both", [A, B])(function)
    return out


def rows(function) -> dict[str, Row]:  # type: ignore[no-untyped-def]
    return {row.metric.name: row for row in registry(function)["both"].run(Context())}


@pytest.mark.parametrize("name", ["", "time", "a/b", "a/b/c/d", "a//c"])
def test_a_name_has_three_parts(name: str) -> None:
    with pytest.raises(ValueError, match="family/subject/quantity"):
        Metric(name, "ms")


def test_direction_and_tolerance_are_checked() -> None:
    with pytest.raises(ValueError, match="lower or higher"):
        Metric("a/b/c", "ms", "up")  # type: ignore[arg-type]
    for tolerance in (-0.1, math.inf, math.nan):
        with pytest.raises(ValueError, match="tolerance"):
            Metric("a/b/c", "ms", tolerance=tolerance)


def test_only_ratios_are_gated() -> None:
    assert not A.gated
    assert B.gated


def test_targets_know_their_direction() -> None:
    assert A.reaches(1.0)
    assert not A.reaches(3.0)
    assert B.reaches(1.0) is None
    high = Metric("a/b/c", "%", "higher", target=85.0)
    assert high.reaches(90.0)
    assert not high.reaches(80.0)


def test_values_become_rows() -> None:
    def measure(_: Context) -> Values:
        return {A.name: 1.5, B.name: Measured(2.0, {"minimum": 1.9})}

    found = rows(measure)
    assert (found[A.name].status, found[A.name].value) == ("ok", 1.5)
    assert found[B.name].details == {"minimum": 1.9}


def test_what_is_missing_is_a_row() -> None:
    found = rows(lambda _: {A.name: 1.0})
    assert found[B.name].status == "failed"
    assert "no value" in found[B.name].reason


def test_what_is_absent_keeps_its_reason() -> None:
    found = rows(lambda _: {A.name: 1.0, B.name: Absent("one core only")})
    assert (found[B.name].status, found[B.name].reason) == ("not available", "one core only")


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_value_that_is_not_finite_has_failed(value: float) -> None:
    found = rows(lambda _: {A.name: value, B.name: 1.0})
    assert found[A.name].status == "failed"
    assert found[A.name].value is None


def test_an_exception_fails_every_metric_with_its_reason() -> None:
    def measure(_: Context) -> Values:
        raise RuntimeError("the arm fell off")

    for row in rows(measure).values():
        assert row.status == "failed"
        assert "the arm fell off" in row.reason


def test_not_installed_is_not_a_failure() -> None:
    def measure(_: Context) -> Values:
        raise NotAvailableError("peer is not installed")

    assert {row.status for row in rows(measure).values()} == {"not available"}


def test_a_value_that_was_not_announced_fails() -> None:
    found = rows(lambda _: {A.name: 1.0, "family/three/time": 1.0})
    assert "family/three/time" in found[A.name].reason


def test_names_are_taken_once() -> None:
    known = registry(lambda _: {})
    with pytest.raises(ValueError, match="twice"):
        known.benchmark("other", [A])(lambda _: {})
    with pytest.raises(ValueError, match="twice"):
        known.benchmark("both", [Metric("a/b/c", "ms")])(lambda _: {})


@pytest.mark.parametrize(
    ("pattern", "count"),
    [("both", 2), ("family", 2), ("family/one", 1), ("*/ratio", 1), ("bot?", 2), (A.name, 1)],
)
def test_selection(pattern: str, count: int) -> None:
    ((_, names),) = registry(lambda _: {}).select([pattern])
    assert len(names) == count


def test_everything_is_selected_by_nothing() -> None:
    ((_, names),) = registry(lambda _: {}).select()
    assert names == [A.name, B.name]


def test_a_pattern_without_match_names_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"famly.*both"):
        registry(lambda _: {}).select(["both", "famly"])


def test_rows_survive_json() -> None:
    row = Row(A, "failed", reason="it broke", details={"minimum": 1.0})
    back = Row.from_dict(row.to_dict())
    assert back.to_dict() == row.to_dict()
