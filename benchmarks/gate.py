"""The gate: ratios of this run beside those of a committed baseline."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from benchmarks.registry import Row

BASELINE = Path(__file__).with_name("baseline.json")
Verdict = Literal["regression", "better", "same", "new", "not compared"]


@dataclass(frozen=True)
class Comparison:
    """One ratio against the baseline."""

    name: str
    verdict: Verdict
    message: str


def compare(rows: Iterable[Row], baseline: Mapping[str, float]) -> list[Comparison]:
    """Compare every ratio of a run.

    A ratio that has a baseline and failed in this run is a regression. One that is not available
    here (a peer not installed, no compiler) is not compared, and said to be so.
    """
    return [_compare(row, baseline.get(row.metric.name)) for row in rows if row.metric.gated]


def regressions(rows: Iterable[Row], baseline: Mapping[str, float]) -> list[str]:
    """Names of the ratios that are worse than the baseline allows."""
    return [c.name for c in compare(rows, baseline) if c.verdict == "regression"]


def _compare(row: Row, before: float | None) -> Comparison:
    metric = row.metric
    if row.status == "not available":
        return Comparison(metric.name, "not compared", f"not available: {row.reason}")
    if row.value is None:
        verdict: Verdict = "not compared" if before is None else "regression"
        return Comparison(metric.name, verdict, f"failed: {row.reason}")
    if before is None:
        return Comparison(metric.name, "new", f"{row.value:.4g}, not in the baseline")
    allowed = 1.0 + metric.tolerance
    worse = row.value / before if metric.direction == "lower" else before / row.value
    word = f"{row.value:.4g} against {before:.4g} in the baseline ({metric.direction} is better"
    word += f", {100 * metric.tolerance:.0f} % allowed)"
    if worse > allowed:
        return Comparison(metric.name, "regression", word)
    return Comparison(metric.name, "better" if worse * allowed < 1.0 else "same", word)


def load(path: Path = BASELINE) -> dict[str, float]:
    """Ratios of a baseline by metric.

    Raises:
        ValueError: no such file, or not a baseline.
    """
    if not path.exists():
        raise ValueError(f"there is no baseline {path}; write one with --update-baseline")
    try:
        ratios = json.loads(path.read_text(encoding="utf-8"))["ratios"]
        return {str(name): float(value) for name, value in ratios.items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path} is not a baseline: {error!r}") from error


def update(rows: Iterable[Row], about: Mapping[str, Any], path: Path = BASELINE) -> int:
    """Write a run's ratios into the baseline and return how many; those not measured stay."""
    ratios = load(path) if path.exists() else {}
    measured = {r.metric.name: r.value for r in rows if r.metric.gated and r.value is not None}
    ratios |= {name: float(f"{value:.4g}") for name, value in measured.items()}
    content = {"about": dict(about), "ratios": dict(sorted(ratios.items()))}
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return len(measured)
