"""How predicted harm compares with what happened: a reliability table and the AUC."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.errors import Code
from optipromp.experiments.runs import Row
from optipromp.experiments.statistics import wilson

EDGES = (0.0, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.5, np.inf)  # of the bins of harm


@dataclass(frozen=True)
class Bin:
    """Runs whose predicted harm lies in one interval.

    Attributes:
        low, high: the interval [low, high).
        runs: how many.
        failures: of them, by the physics.
        rate: of failure, with its 95 % interval (``rate_low``, ``rate_high``).
    """

    low: float
    high: float
    runs: int
    failures: int
    rate: float
    rate_low: float
    rate_high: float


@dataclass(frozen=True)
class Calibration:
    """Predicted harm against outcomes.

    Attributes:
        bins: the reliability table; bins without runs are left out.
        auc: probability that a failed run was predicted more harm than one that succeeded (0.5:
            the prediction says nothing); NaN where all ended alike.
        successes: plans whose status was ``success``.
        failed: of them, those that failed in the simulation.
    """

    bins: tuple[Bin, ...]
    auc: float
    successes: int
    failed: int


def calibration(rows: Iterable[Row]) -> Calibration | None:
    """The calibration of executed runs whose harm was predicted; None where there are none."""
    known = [row for row in rows if row.predicted_harm is not None and row.picked is not None]
    if not known:
        return None
    harm = np.array([row.predicted_harm for row in known], dtype=np.float64)
    failed = np.array([not row.success for row in known])
    bins = []
    for low, high in itertools.pairwise(EDGES):
        inside = (harm >= low) & (harm < high)
        runs, failures = int(inside.sum()), int(failed[inside].sum())
        if runs:
            bins.append(Bin(low, high, runs, failures, failures / runs, *wilson(failures, runs)))
    good = [row for row in known if row.plan_status == Code.SUCCESS]
    return Calibration(
        tuple(bins), auc(harm[failed], harm[~failed]), len(good),
        sum(not row.success for row in good),
    )  # fmt: skip


def auc(above: Sequence[float] | np.ndarray, below: Sequence[float] | np.ndarray) -> float:
    """Share of pairs in which a value of ``above`` is larger than one of ``below``; ties half."""
    if not len(above) or not len(below):
        return float("nan")
    one, other = np.asarray(above)[:, None], np.asarray(below)[None]
    return float(np.mean((one > other) + 0.5 * (one == other)))
