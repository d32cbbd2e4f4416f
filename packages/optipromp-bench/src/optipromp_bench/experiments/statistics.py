"""Statistics of rows: rates with intervals, causes, times, forces, calibration."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy.stats

from optipromp.core.errors import Code
from optipromp_bench.experiments.eyes import NOT_SEEN
from optipromp_bench.experiments.rows import ERROR, Row
from optipromp_sim.situations import AS_CROP

STATIC_FORCE = 0.5  # [N] a harder touch of a static object counts as contact, as in the simulation
EDGES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)  # of the bins of predicted probability
ALL = "all presets"


def wilson(successes: int, runs: int) -> tuple[float, float]:
    """Wilson's score interval of a rate, 95 % (Wilson 1927); (0, 1) where there are no runs."""
    if runs == 0:
        return 0.0, 1.0
    low, high = scipy.stats.binomtest(successes, runs).proportion_ci(method="wilson")
    return float(low), float(high)


def percent(low: float, high: float) -> str:
    """An interval of a rate in words, in whole percent."""
    return f"{100 * low:.0f}–{100 * high:.0f}"


def share(count: int, of: int, digits: int = 0) -> str:
    """A share in percent with its interval."""
    return f"{100.0 * count / max(of, 1):.{digits}f} ({percent(*wilson(count, of))})"


class Table(NamedTuple):
    """A table; as a text it is Markdown under its heading, as ``scripts/publish.py`` reads it."""

    title: str
    heads: Sequence[str]
    lines: Sequence[Sequence[Any]]

    def __str__(self) -> str:
        rows = (self.heads, ["---"] * len(self.heads), *self.lines)
        lines = (" | ".join(map(str, each)) for each in rows)
        return "\n".join([f"### {self.title}", "", *(f"| {line} |" for line in lines), ""])


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The rows of one group in figures."""

    runs: int
    low: float  # 95 % interval (Wilson) of the share that ended well
    high: float
    clean_seconds: float | None  # all seconds spent, over the clean ends; None: there is none

    @property
    def interval(self) -> str:
        """The 95 % interval of the rate, in percent."""
        return percent(self.low, self.high)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return dict(vars(self))


@dataclass(frozen=True, kw_only=True)
class StudyCell(Cell):
    """The rows of a group of a study."""

    preset: str
    kept_before: int  # good ends by the definition of 0.3.0; its own rows have no other
    rate: float  # of good ends
    causes: Mapping[str, int]  # the number of failures by cause, most frequent first

    @property
    def failed_by(self) -> str:
        """The number of failures and the cause, for each cause; a dash where no run failed."""
        words = (f"{count} {cause.replace('_', ' ')}" for cause, count in self.causes.items())
        return ", ".join(words) or "–"


@dataclass(frozen=True, kw_only=True)
class PlanCell(StudyCell):
    """What became of the plans of one planner; a good end: promised and picked."""

    planner: str  # or a loop
    plans: int  # runs whose plan promised a success
    kept: int  # promised and picked: of a robot that executes no refused plan
    broken: int  # promised and not picked
    broken_rate: float  # of the promises
    broken_low: float
    broken_high: float
    successes: int  # where refused plans are executed, too
    static_contacts: int
    torn: int  # runs in which a fruit came off
    unripe_force: float | None  # [N] of executed runs; None: there are none
    unripe_force_90: float | None
    plan_time: float
    cycle: float | None  # [s] of the motion, way out too
    simulation_time: float | None
    redraws: int
    changed: int | None = None  # runs that end otherwise than as the crop; None: no guess varies


@dataclass(frozen=True, kw_only=True)
class LoopCell(StudyCell):
    """What became of the picks of one loop under one condition; a good end: a clean pick.

    Figures of time are medians over the runs that have them, jumps and shares of limits the worst.
    """

    condition: str
    loop: str
    clean: int
    harmed: int
    gave_up: int
    refused: int
    missed: int
    error: int
    duration: float | None
    retreats: int
    cycle_median: float | None
    cycle_p99: float | None
    nis: float | None
    worst_jump: float | None
    worst_limit: float | None
    seen: int  # a ripe fruit was
    planned: int  # and executed
    picked: int  # whether or not something was harmed
    picked_interval: tuple[float, float]
    visible: int  # in pictures before plans, as the next two
    found: int
    false: int
    see_time: float | None


C = TypeVar("C", bound=StudyCell)


def cells_of(
    rows: Iterable[Row], group: Callable[[Row], tuple[str, ...]],
    cell: Callable[[Sequence[Row], Sequence[str]], C], pooled: str = "",
) -> tuple[C, ...]:  # fmt: skip
    """A cell for each group of rows, in the order in which the parts of names first appear.

    ``pooled``: name of the first part of further groups that stand for all its values, last, where
    there are several; empty: there are none.
    """
    groups: dict[tuple[str, ...], list[Row]] = {}
    rows = list(rows)
    for row in rows:
        groups.setdefault(group(row), []).append(row)
    if pooled and len({first for first, *_ in groups}) > 1:
        for row in rows:
            groups.setdefault((pooled, *group(row)[1:]), []).append(row)
    ranks = [list(dict.fromkeys(parts)) for parts in zip(*groups, strict=True)]

    def order(key: tuple[str, ...]) -> list[int]:
        return [rank.index(part) for rank, part in zip(ranks, key, strict=True)]

    return tuple(cell(groups[key], key) for key in sorted(groups, key=order))


def summary(rows: Sequence[Row]) -> tuple[PlanCell, ...]:
    """One cell for each preset and planner, in the order in which they first appear.

    In a study of variations, one cell for each variation (over all presets) and planner. In a study
    of loops, one for each condition (over all presets) and loop, named in place of the planner.
    """
    by_crop = {(*r.key[:3], r.success, r.causes) for r in rows if r.variation == AS_CROP}

    def group(row: Row) -> tuple[str, str]:
        return row.condition or row.variation or row.preset, row.loop or row.planner

    def cell(own: Sequence[Row], names: Sequence[str]) -> PlanCell:
        preset, planner = names
        changed = sum((*r.key[:3], r.success, r.causes) not in by_crop for r in own)
        return plan_cell(own, preset, planner, changed if by_crop else None)

    return cells_of(rows, group, cell)


def loop_summary(rows: Iterable[Row]) -> tuple[LoopCell, ...]:
    """One cell for each preset, condition and loop, and those of :data:`ALL` presets."""

    def cell(own: Sequence[Row], names: Sequence[str]) -> LoopCell:
        return loop_cell(own, *names)

    return cells_of(rows, lambda r: (r.preset, r.condition, r.loop), cell, ALL)


def cells_in(rows: Sequence[Row]) -> Sequence[PlanCell | LoopCell]:
    """The figures of a study of loops, else of one of plans."""
    return loop_summary(rows) if any(row.loop for row in rows) else summary(rows)


def plan_cell(
    rows: Sequence[Row], preset: str, planner: str, changed: int | None = None
) -> PlanCell:
    """The figures of one planner's rows."""
    runs, promised = len(rows), [row for row in rows if row.plan_status == Code.SUCCESS]
    plans, kept = len(promised), sum(row.success for row in promised)
    executed = [row for row in rows if row.unripe_force is not None]
    forces = sorted(row.unripe_force or 0.0 for row in executed)
    low, high = wilson(kept, runs)
    broken_low, broken_high = wilson(plans - kept, plans)
    spent = [row.plan_time for row in rows] + [row.duration or 0.0 for row in promised]
    return PlanCell(
        preset=preset, planner=planner, runs=runs, plans=plans, kept=kept,
        kept_before=sum(row.success and row.success_before is not False for row in promised),
        rate=kept / runs, low=low, high=high, broken=plans - kept,
        broken_rate=(plans - kept) / max(plans, 1), broken_low=broken_low, broken_high=broken_high,
        successes=sum(row.success for row in rows),
        causes=causes_of(row for row in rows if not row.success),
        static_contacts=sum((row.static_force or 0.0) > STATIC_FORCE for row in rows),
        torn=sum(bool(row.torn) for row in rows),
        unripe_force=_of(median, forces),
        unripe_force_90=forces[math.ceil(0.9 * len(forces)) - 1] if forces else None,
        plan_time=median(row.plan_time for row in rows),
        cycle=_of(median, [row.duration for row in promised]),
        clean_seconds=seconds_a_clean(spent, kept),  # by a robot that heeds refusals
        simulation_time=_of(median, [row.simulation_time for row in executed]),
        redraws=sum(row.redraws for row in rows), changed=changed,
    )  # fmt: skip


def loop_cell(rows: Sequence[Row], preset: str, condition: str, loop: str) -> LoopCell:
    """The figures of one loop's rows."""
    counts, runs = Counter(row.result for row in rows), len(rows)
    low, high = wilson(counts["clean"], runs)
    picked = sum(bool(row.picked) for row in rows)

    def over(function: Callable[[list[float]], Any], name: str) -> float | None:
        return _of(function, (getattr(row, name) for row in rows))

    def total(name: str) -> int:
        return sum(getattr(row, name) or 0 for row in rows)

    return LoopCell(
        preset=preset, condition=condition, loop=loop, runs=runs, low=low, high=high,
        clean=counts["clean"], harmed=counts["harmed"], gave_up=counts["gave_up"],
        refused=counts["refused"], missed=counts["missed"], error=counts["error"],
        kept_before=sum(r.result == "clean" and r.success_before is not False for r in rows),
        rate=counts["clean"] / runs,
        causes=causes_of(row for row in rows if row.result != "clean"),
        duration=over(median, "duration"),
        clean_seconds=seconds_a_clean((row.duration or 0.0 for row in rows), counts["clean"]),
        retreats=total("retreats"), cycle_median=over(median, "cycle_median"),
        cycle_p99=over(max, "cycle_p99"), nis=over(np.mean, "nis"),
        worst_jump=over(max, "worst_jump"), worst_limit=over(max, "worst_limit"),
        seen=sum(row.cause not in (NOT_SEEN, ERROR) for row in rows),
        planned=sum(row.duration is not None for row in rows),
        picked=picked, picked_interval=wilson(picked, runs), visible=total("visible"),
        found=total("found"), false=total("false"), see_time=over(median, "see_time"),
    )  # fmt: skip


def seconds_a_clean(spent: Iterable[float], clean: int) -> float | None:
    """All seconds that were ``spent``, over the number of clean picks; None: there is none."""
    return sum(spent) / clean if clean else None


def causes_of(failed: Iterable[Row]) -> dict[str, int]:
    """The number of failures by cause, most frequent first; a run may have several causes."""
    causes = Counter(cause for row in failed for cause in row.causes.split() or [row.cause])
    return dict(causes.most_common())


def _of(function: Callable[[list[float]], Any], values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return float(function(known)) if known else None


@dataclass(frozen=True)
class Bin:
    """Runs whose predicted probability of failure is in an interval [low, high)."""

    low: float
    high: float
    runs: int
    predicted: float  # mean
    failures: int
    rate: float
    rate_low: float
    rate_high: float


@dataclass(frozen=True)
class Reliability:
    """Predicted probabilities of failure against outcomes."""

    bins: tuple[Bin, ...]  # those that hold runs
    # probability that a failed run had a larger prediction than a run that succeeded (0.5: the
    # prediction is worth nothing); NaN where all runs ended alike
    auc: float
    successes: int  # number of plans whose status was success
    failed: int  # number of these that failed in the simulation

    def rows(self) -> list[list[Any]]:
        """Of each bin its bounds, runs, mean prediction, and share of failures [%]."""
        return [
            [f"{100 * b.low:g} to {100 * b.high:g} %", b.runs, f"{100 * b.predicted:.1f}",
             share(b.failures, b.runs, 1)]
            for b in self.bins
        ]  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"bins": [asdict(each) for each in self.bins]}


def calibration(rows: Iterable[Row]) -> Reliability | None:
    """The reliability of the predictions of executed runs; None where there are none."""
    known = [row for row in rows if row.predicted_failure is not None and row.picked is not None]
    if not known:
        return None
    told = np.array([row.predicted_failure for row in known], dtype=np.float64)
    failed = np.array([not row.success for row in known])
    bins = []
    for low, high in itertools.pairwise(EDGES):
        inside = (told >= low) & ((told < high) | (high == EDGES[-1]))
        runs, failures = int(inside.sum()), int(failed[inside].sum())
        if runs:
            mean = float(told[inside].mean())
            rate = failures / runs, *wilson(failures, runs)
            bins.append(Bin(low, high, runs, mean, failures, *rate))
    good = [row for row in known if row.plan_status == Code.SUCCESS]
    return Reliability(
        tuple(bins),
        auc(told[failed], told[~failed]),
        len(good),
        sum(not row.success for row in good),
    )


def auc(above: Sequence[float] | np.ndarray, below: Sequence[float] | np.ndarray) -> float:
    """Share of pairs in which a value of ``above`` is larger than one of ``below``; ties half."""
    pairs = len(above) * len(below)
    return float(scipy.stats.mannwhitneyu(above, below).statistic) / pairs if pairs else math.nan
