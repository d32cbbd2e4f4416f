"""Statistics of a study's rows: rates with intervals, causes, times, forces, calibration."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np

from optipromp.core.errors import Code
from optipromp.laboratory.experiments.runs import Row

STATIC_FORCE = 0.5  # [N] a harder touch of a static object counts as contact, as in the simulation
EDGES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)  # of the bins of predicted probability


def wilson(successes: int, runs: int) -> tuple[float, float]:
    """Wilson's score interval of a rate, 95 % (Wilson 1927); (0, 1) where there are no runs."""
    z = 1.959963984540054  # 97.5 % quantile of the standard normal distribution
    if runs == 0:
        return 0.0, 1.0
    rate = successes / runs
    middle = rate + z * z / (2 * runs)
    half = z * math.sqrt(rate * (1.0 - rate) / runs + z * z / (4 * runs * runs))
    scale = 1.0 + z * z / runs
    low = 0.0 if successes == 0 else (middle - half) / scale
    high = 1.0 if successes == runs else (middle + half) / scale
    return low, high


@dataclass(frozen=True)
class Cell:
    """One planner on one preset.

    Attributes:
        preset: of the scenes, or the variation of the physics.
        planner: its name.
        runs: number of runs.
        plans: number of runs whose plan promised a success.
        kept: number of these runs that succeeded in the simulation: promised and picked.
        rate: ``kept`` over ``runs``: the rate of a robot that executes no refused plan. ``low`` and
            ``high`` are the ends of its 95 % interval.
        broken_rate: share of the promises that are broken, with ``broken_low`` and ``broken_high``.
        successes: number of runs that succeeded where every plan is executed, also a refused one.
        causes: number of failures by cause, most frequent first; a run may have several causes.
        static_contacts: number of runs in which arm or tool pressed a static object.
        torn: number of runs in which a fruit came off.
        unripe_force: largest force on any object but the target, median over executed runs [N];
            None where no run was executed.
        unripe_force_90: 90 % quantile of that force [N].
        plan_time: median wall time of planning [s].
        simulation_time: median wall time of execution over executed runs [s].
        redraws: number of impossible scenes sampled before the scenes of these runs.
    """

    preset: str
    planner: str
    runs: int
    plans: int
    kept: int
    rate: float
    low: float
    high: float
    broken_rate: float
    broken_low: float
    broken_high: float
    successes: int
    causes: Mapping[str, int]
    static_contacts: int
    torn: int
    unripe_force: float | None
    unripe_force_90: float | None
    plan_time: float
    simulation_time: float | None
    redraws: int

    @property
    def broken(self) -> int:
        """Number of broken promises."""
        return self.plans - self.kept

    @property
    def failed_by(self) -> str:
        """The number of failures and the cause, for each cause; a dash where no run failed."""
        words = (f"{count} {cause.replace('_', ' ')}" for cause, count in self.causes.items())
        return ", ".join(words) or "–"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"broken": self.broken}


def summary(rows: Iterable[Row]) -> tuple[Cell, ...]:
    """One cell for each preset and planner, in the order in which they first appear.

    In a study of variations, one cell for each variation (over all presets) and planner. In a study
    of loops, one for each condition (over all presets) and loop, named in place of the planner.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        name = row.condition or row.variation or row.preset
        groups.setdefault((name, row.loop or row.planner), []).append(row)
    presets = {preset: i for i, preset in enumerate(dict.fromkeys(p for p, _ in groups))}
    planners = {planner: i for i, planner in enumerate(dict.fromkeys(p for _, p in groups))}
    keys = sorted(groups, key=lambda key: (presets[key[0]], planners[key[1]]))
    return tuple(_cell(*key, groups[key]) for key in keys)


def _cell(preset: str, planner: str, rows: Sequence[Row]) -> Cell:
    plans = sum(row.plan_status == Code.SUCCESS for row in rows)
    kept = sum(row.success and row.plan_status == Code.SUCCESS for row in rows)
    low, high = wilson(kept, len(rows))
    broken_low, broken_high = wilson(plans - kept, plans)
    failed = (row for row in rows if not row.success)
    causes = Counter(cause for row in failed for cause in row.causes.split() or [row.cause])
    executed = [row for row in rows if row.unripe_force is not None]
    forces = sorted(row.unripe_force for row in executed if row.unripe_force is not None)
    seconds = [row.simulation_time for row in executed]
    return Cell(
        preset=preset,
        planner=planner,
        runs=len(rows),
        plans=plans,
        kept=kept,
        rate=kept / len(rows),
        low=low,
        high=high,
        broken_rate=(plans - kept) / max(plans, 1),
        broken_low=broken_low,
        broken_high=broken_high,
        successes=sum(row.success for row in rows),
        causes=dict(causes.most_common()),
        static_contacts=sum((row.static_force or 0.0) > STATIC_FORCE for row in rows),
        torn=sum(bool(row.torn) for row in rows),
        unripe_force=median(forces) if forces else None,
        unripe_force_90=forces[math.ceil(0.9 * len(forces)) - 1] if forces else None,
        plan_time=median(row.plan_time for row in rows),
        simulation_time=median(seconds) if seconds else None,
        redraws=sum(row.redraws for row in rows),
    )


@dataclass(frozen=True)
class Bin:
    """Runs whose predicted probability of failure lies in one interval.

    Attributes:
        low, high: the interval [low, high).
        runs: number of runs.
        predicted: mean of their predicted probabilities.
        failures: number of runs that failed in the simulation.
        rate: ``failures`` over ``runs``, with its 95 % interval (``rate_low``, ``rate_high``).
    """

    low: float
    high: float
    runs: int
    predicted: float
    failures: int
    rate: float
    rate_low: float
    rate_high: float


@dataclass(frozen=True)
class Reliability:
    """Predicted probabilities of failure against outcomes.

    Attributes:
        bins: the reliability table; bins without runs are left out.
        auc: probability that a failed run had a larger prediction than a run that succeeded (0.5:
            the prediction is worth nothing); NaN where all runs ended alike.
        successes: number of plans whose status was ``success``.
        failed: number of these that failed in the simulation.
    """

    bins: tuple[Bin, ...]
    auc: float
    successes: int
    failed: int


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
            mean, rate = float(told[inside].mean()), failures / runs
            bins.append(Bin(low, high, runs, mean, failures, rate, *wilson(failures, runs)))
    good = [row for row in known if row.plan_status == Code.SUCCESS]
    return Reliability(
        tuple(bins),
        auc(told[failed], told[~failed]),
        len(good),
        sum(not row.success for row in good),
    )


def auc(above: Sequence[float] | np.ndarray, below: Sequence[float] | np.ndarray) -> float:
    """Share of pairs in which a value of ``above`` is larger than one of ``below``; ties half."""
    if not len(above) or not len(below):
        return float("nan")
    one, other = np.asarray(above)[:, None], np.asarray(below)[None]
    return float(np.mean((one > other) + 0.5 * (one == other)))
