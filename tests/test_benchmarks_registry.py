"""The registry: names, selection, and that no metric ever goes missing."""

import math

import pytest

from benchmarks.registry import (
    RATIO,
    Absent,
    Context,
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


def test_a_pattern_without_match_names_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"famly.*both"):
        registry(lambda _: {}).select(["both", "famly"])
