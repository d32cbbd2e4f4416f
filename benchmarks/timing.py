"""Timing that other work on the machine disturbs little: many short runs, taken in turn."""

import statistics
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

BATCH = 5e-4  # [s] that a batch of calls lasts at least, so that the clock's grain does not count


def in_turn(
    functions: Mapping[str, Callable[[], object]], rounds: int, batch: float = BATCH
) -> dict[str, list[float]]:
    """Seconds per call of each function, ``rounds`` values each, one after another in turn.

    What slows the machine down for a while then slows all of them, and their ratio stays.
    """
    calls = {}
    for name, function in functions.items():
        function()
        once = min(_timed(function, 1) for _ in range(3))
        calls[name] = max(1, int(np.ceil(batch / max(once, 1e-9))))
    out: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            out[name].append(_timed(function, calls[name]))
    return out


def _timed(function: Callable[[], object], calls: int) -> float:
    began = time.perf_counter()
    for _ in range(calls):
        function()
    return (time.perf_counter() - began) / calls


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value that at least ``share`` (0 to 1) of them do not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, int(np.ceil(share * len(ordered))) - 1))]


def median(values: Sequence[float]) -> float:
    """The median; ``nan`` of nothing."""
    return statistics.median(values) if values else float("nan")


def paired_ratio(ours: Sequence[float], others: Sequence[float]) -> float:
    """Median of the quotients of runs taken in turn."""
    return median([a / b for a, b in zip(ours, others, strict=True)])


_MATRIX = np.random.default_rng(0).normal(size=(96, 96)) / 10.0


def reference() -> float:
    """A fixed piece of work in Python and NumPy, a few ms: the unit of speed of the machine.

    Ours divided by this, measured in turn, is a ratio that a committed baseline can hold on
    another machine, where no peer does the same job.
    """
    total, square = 0.0, _MATRIX @ _MATRIX.T + np.eye(96)
    for i in range(12):
        total += float(np.linalg.solve(square + i * np.eye(96), _MATRIX[:, i]).sum())
    for i in range(20_000):
        total += (i % 7) * 1e-9
    return total
