"""The tables of docs/studies.md, from the folders that `optipromp study` left.

    python scripts/study_tables.py FOLDER [FOLDER ...]

Rows of several folders are taken together: a row for each preset, one for all, the reliability
table, and times to plan.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp.laboratory.experiments.runs import Row
from optipromp.laboratory.experiments.statistics import calibration, summary
from optipromp.laboratory.experiments.study import rows_of


def rates(rows: Sequence[Row]) -> list[str]:
    """Promised and picked by preset, the broken promises beside it."""
    out = [
        "| preset | promised and picked | % (95 %) | broken promises | % (95 %) | executed "
        "although refused | force on unripe, median / 90 % [N] | failed by |",
        "|---|---|---|---|---|---|---|---|",
    ]
    together = [replace(row, preset="all", seed=k) for k, row in enumerate(rows)]
    cells = [*summary(rows), *summary(together)]
    for c in cells[: 1 if len(cells) == 2 else None]:
        out.append(
            f"| {c.preset} | {c.kept} of {c.runs} | {100 * c.rate:.1f} ({100 * c.low:.0f}–"
            f"{100 * c.high:.0f}) | {c.broken} of {c.plans} | {100 * c.broken_rate:.1f} "
            f"({100 * c.broken_low:.0f}–{100 * c.broken_high:.0f}) | {c.successes} | "
            f"{c.unripe_force:.1f} / {c.unripe_force_90:.1f} | {c.failed_by} |"
        )
    return out


def reliability(rows: Sequence[Row]) -> list[str]:
    """Predicted probabilities and what happened."""
    found = calibration(rows)
    if found is None:
        return []
    out = [
        f"AUC {found.auc:.2f}", "",
        "| not clean, predicted | runs | mean | failed | % (95 %) |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for b in found.bins:
        out.append(
            f"| {100 * b.low:g} to {100 * b.high:g} % | {b.runs} | {100 * b.predicted:.1f} | "
            f"{b.failures} | {100 * b.rate:.1f} ({100 * b.rate_low:.0f}–{100 * b.rate_high:.0f}) |"
        )
    return out


def main() -> None:
    """Print the tables."""
    rows = [row for folder in sys.argv[1:] for row in rows_of(Path(folder))]
    times = 1e3 * np.quantile([row.plan_time for row in rows], [0.5, 0.95])
    tilted = sum(row.tilt > 0.1 for row in rows)
    print("\n".join([*rates(rows), "", *reliability(rows), ""]))
    print(f"time to plan, 50 and 95 %: {times[0]:.0f} and {times[1]:.0f} ms; "
          f"{tilted} of {len(rows)} plans come at an angle")  # fmt: skip


if __name__ == "__main__":
    main()
