"""Results as tables of Markdown, for the terminal and for the documentation."""

from collections.abc import Iterable, Sequence
from typing import Any

from benchmarks.registry import Benchmark, Row
from optipromp_bench.experiments.statistics import Table


def listing(selected: Sequence[tuple[Benchmark, list[str]]]) -> str:
    """Every benchmark with its metrics."""
    lines = []
    for benchmark, names in selected:
        lines.append(f"{benchmark.name}: {benchmark.about}")
        for m in benchmark.metrics:
            if m.name in names:
                goal = f", target {m.target:g}" if m.target is not None else ""
                gated = f", gated at {100 * m.tolerance:.0f} %" if m.gated else ""
                about = f"  ({m.about})" if m.about else ""
                lines.append(
                    f"    {m.name} [{m.unit}], {m.direction} is better{goal}{gated}{about}"
                )
    return "\n".join(lines)


def number(value: float) -> str:
    """Three significant digits, thousands in groups, never in powers of ten."""
    if value == 0:
        return "0"
    if abs(value) >= 100:
        return f"{value:,.0f}"
    digits = 2 if abs(value) < 10 else 1
    return f"{value:.{digits}f}" if abs(value) >= 0.01 else f"{value:.1g}"


def cell(row: Row | None) -> str:
    """A value with its unit, and its target where there is one."""
    if row is None:
        return ""
    if row.value is None:
        return row.status
    out = f"{number(row.value)} {row.metric.unit}"
    if row.metric.target is not None:
        sign = "≤" if row.metric.direction == "lower" else "≥"
        missed = "" if row.metric.reaches(row.value) else ", **not reached**"
        out += f" ({sign} {row.metric.target:g}{missed})"
    return out


def families(rows: Iterable[Row]) -> dict[str, dict[str, dict[str, Row]]]:
    """Rows by family, subject and quantity, in the order they were measured."""
    out: dict[str, dict[str, dict[str, Row]]] = {}
    for row in rows:
        family, subject, quantity = row.metric.name.split("/")
        out.setdefault(family, {}).setdefault(subject, {})[quantity] = row
    return out


def reasons(subjects: dict[str, dict[str, Row]]) -> list[str]:
    """Why cells are empty, one line for each reason of each subject."""
    out = dict.fromkeys(
        f"{subject}: {row.status}, {row.reason}"
        for subject, line in subjects.items()
        for row in line.values()
        if row.value is None
    )
    return list(out)


def text(rows: Iterable[Row]) -> str:
    """A table for each family, with why cells are empty below it, as Markdown."""
    parts = []
    for family, subjects in families(rows).items():
        quantities = list(dict.fromkeys(q for row in subjects.values() for q in row))
        lines = [[s, *(cell(row.get(q)) for q in quantities)] for s, row in subjects.items()]
        parts.append(str(Table(family[0].upper() + family[1:], ["", *quantities], lines)))
        parts += ["".join(f"- {note}\n" for note in notes)] if (notes := reasons(subjects)) else []
    return "\n".join(parts)


def markdown(results: dict[str, Any]) -> str:
    """The tables for the documentation, with where and with what they were made."""
    machine, versions = results["machine"], results["versions"]
    packages = ", ".join(f"{name} {v}" for name, v in versions.items() if v is not None)
    missing = [name for name, v in versions.items() if v is None]
    told = (
        f"{machine['cpu']}, {machine['cores']} cores, {machine['system']}; "
        f"{results['date'][:10]}, commit {results['commit']}. {packages}. {results['compiler']}."
        + (f" Not installed: {', '.join(missing)}." if missing else "")
    )
    return f"{told}\n\n{text(Row.from_dict(r) for r in results['rows'])}"
