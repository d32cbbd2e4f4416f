"""Statistics of a study of loops: what became of the picks under each condition."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np

from optipromp.laboratory.experiments.eyes import NOT_SEEN
from optipromp.laboratory.experiments.runs import Row
from optipromp.laboratory.experiments.statistics import wilson

ALL = "all presets"


@dataclass(frozen=True)
class LoopCell:
    """One loop under one condition, on one preset or on all.

    Attributes:
        preset: of the scenes, or :data:`ALL`.
        condition, loop: their names.
        runs: number of runs.
        clean, harmed, gave_up, refused, missed, error: number of runs with that result.
        rate: ``clean`` over ``runs``, with its 95 % interval (``low``, ``high``).
        causes: number of runs by cause of failure, most frequent first; a run may have several.
        duration: median over executed runs [s]; None where there are none, as below.
        retreats: of all runs.
        cycle_median: median of the runs' medians of a controller's cycle [s].
        cycle_p99: largest of the runs' 99 % quantiles [s].
        nis: mean normalised innovation squared over the runs, with a seen fruit; 3 is true.
        worst_jump, worst_limit: largest of the rows'.
        seen, planned, picked: number of runs in which a ripe fruit was seen, a plan executed, and
            the fruit in the tool at the end.
        picked_interval: 95 % interval of the rate of ``picked``.
        visible, found, false: fruits and detections in the pictures before a plan.
        see_time: median processor time of seeing [s].
    """

    preset: str
    condition: str
    loop: str
    runs: int
    clean: int
    harmed: int
    gave_up: int
    refused: int
    missed: int
    error: int
    rate: float
    low: float
    high: float
    causes: Mapping[str, int]
    duration: float | None
    retreats: int
    cycle_median: float | None
    cycle_p99: float | None
    nis: float | None
    worst_jump: float | None
    worst_limit: float | None
    seen: int
    planned: int
    picked: int
    picked_interval: tuple[float, float]
    visible: int
    found: int
    false: int
    see_time: float | None

    @property
    def failed_by(self) -> str:
        """The number of failures and the cause, for each cause; a dash where no run failed."""
        words = (f"{count} {cause.replace('_', ' ')}" for cause, count in self.causes.items())
        return ", ".join(words) or "–"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def loop_summary(rows: Iterable[Row]) -> tuple[LoopCell, ...]:
    """One cell for each preset, condition and loop, in the order in which they first appear.

    Where there are several presets, cells over all of them come last.
    """
    groups: dict[tuple[str, str, str], list[Row]] = {}
    pooled: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.preset, row.condition, row.loop), []).append(row)
        pooled.setdefault((ALL, row.condition, row.loop), []).append(row)
    if len({preset for preset, _, _ in groups}) > 1:
        groups |= pooled
    ranks = [_ranks(key[k] for key in groups) for k in range(3)]
    keys = sorted(groups, key=lambda key: tuple(ranks[k][key[k]] for k in range(3)))
    return tuple(_cell(*key, groups[key]) for key in keys)


def _ranks(names: Iterable[str]) -> dict[str, int]:
    return {name: i for i, name in enumerate(dict.fromkeys(names))}


def _cell(preset: str, condition: str, loop: str, rows: Sequence[Row]) -> LoopCell:
    counts = Counter(row.result for row in rows)
    low, high = wilson(counts["clean"], len(rows))
    failed = (row for row in rows if row.result != "clean")
    causes = Counter(cause for row in failed for cause in row.causes.split() or [row.cause])
    return LoopCell(
        preset=preset,
        condition=condition,
        loop=loop,
        runs=len(rows),
        clean=counts["clean"],
        harmed=counts["harmed"],
        gave_up=counts["gave_up"],
        refused=counts["refused"],
        missed=counts["missed"],
        error=counts["error"],
        rate=counts["clean"] / len(rows),
        low=low,
        high=high,
        causes=dict(causes.most_common()),
        duration=_of(median, (row.duration for row in rows)),
        retreats=sum(row.retreats or 0 for row in rows),
        cycle_median=_of(median, (row.cycle_median for row in rows)),
        cycle_p99=_of(max, (row.cycle_p99 for row in rows)),
        nis=_of(np.mean, (row.nis for row in rows)),
        worst_jump=_of(max, (row.worst_jump for row in rows)),
        worst_limit=_of(max, (row.worst_limit for row in rows)),
        seen=sum(row.cause not in (NOT_SEEN, "error") for row in rows),
        planned=sum(row.duration is not None for row in rows),
        picked=(picked := sum(bool(row.picked) for row in rows)),
        picked_interval=wilson(picked, len(rows)),
        visible=sum(row.visible or 0 for row in rows),
        found=sum(row.found or 0 for row in rows),
        false=sum(row.false or 0 for row in rows),
        see_time=_of(median, (row.see_time for row in rows)),
    )


def _of(function: Callable[[list[float]], Any], values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(function(known)) if known else None
