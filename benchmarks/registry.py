"""What is measured: metrics with their unit, direction and tolerance, and the functions behind.

A metric's name has three parts, ``family/subject/quantity``: one table a family, one row a subject,
one column a quantity. A benchmark is a function that measures several metrics at once. It returns a
value for each, or says why one is absent; what it says nothing of, or fails at, becomes a row with
the reason. No metric that was asked for is ever left out.
"""

import fnmatch
import math
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

Direction = Literal["lower", "higher"]
Status = Literal["ok", "failed", "not available"]
RATIO = "×"  # unit of the ratio of two figures measured in the same run: what the gate compares


@dataclass(frozen=True)
class Metric:
    """What one number of the suite means.

    Attributes:
        name: ``family/subject/quantity``.
        unit: ``ms``, ``µs``, ``%`` …; :data:`RATIO` for what the gate compares.
        direction: which way is better.
        tolerance: relative change for the worse that the gate lets pass.
        target: the figure to be reached, where one was set.
        about: one line on how it is measured.
    """

    name: str
    unit: str
    direction: Direction = "lower"
    tolerance: float = 0.25
    target: float | None = None
    about: str = ""

    def __post_init__(self) -> None:
        if self.name.count("/") != 2 or not all(self.name.split("/")):
            raise ValueError(f"metric {self.name!r}: a name is family/subject/quantity")
        if self.direction not in ("lower", "higher"):
            raise ValueError(f"{self.name}: direction is {self.direction!r}; lower or higher")
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0.0):
            raise ValueError(f"{self.name}: tolerance is {self.tolerance}; not below 0")

    @property
    def gated(self) -> bool:
        """Whether the gate compares it: ratios only, absolute times differ by machine."""
        return self.unit == RATIO

    def reaches(self, value: float) -> bool | None:
        """Whether a value reaches the target; None where there is none."""
        if self.target is None:
            return None
        return value <= self.target if self.direction == "lower" else value >= self.target


@dataclass(frozen=True)
class Absent:
    """Why a metric has no value: ``failed``, or what is ``not available`` here."""

    reason: str
    status: Status = "not available"


@dataclass(frozen=True)
class Measured:
    """A value with what else is worth keeping beside it."""

    value: float
    details: Mapping[str, Any] = field(default_factory=dict)


Value = float | Measured | Absent
Values = Mapping[str, Value]


class NotAvailableError(Exception):
    """Raised by a benchmark whose subject is not installed or cannot run here."""


@dataclass(frozen=True)
class Row:
    """One metric of one run, whatever became of it."""

    metric: Metric
    status: Status
    value: float | None = None
    reason: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """As plain values for JSON, those of the metric too."""
        return asdict(self.metric) | {k: v for k, v in vars(self).items() if k != "metric"}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Row":
        """The inverse of :meth:`to_dict`."""
        own = {each.name: data[each.name] for each in fields(Metric) if each.name in data}
        return Row(Metric(**own), **{k: v for k, v in data.items() if k not in own})


@dataclass(frozen=True)
class Context:
    """What a benchmark is told.

    Attributes:
        quick: far fewer repeats; for trying the suite out, not for figures.
        say: called with a word on what is being measured.
    """

    quick: bool = False
    say: Callable[[str], None] = lambda _: None

    def repeats(self, full: int, quick: int | None = None) -> int:
        """``full`` repeats, or a tenth of them (at least 3) in a quick run."""
        return full if not self.quick else (quick or max(3, full // 10))


@dataclass(frozen=True)
class Benchmark:
    """A function and the metrics that it measures."""

    name: str
    function: Callable[[Context], Values]
    metrics: tuple[Metric, ...]
    timeout: float

    @property
    def about(self) -> str:
        """First line of the function's docstring."""
        return (self.function.__doc__ or "").strip().splitlines()[0]

    def run(self, context: Context, wanted: Iterable[str] | None = None) -> list[Row]:
        """Measure, and make a row of each (wanted) metric whatever happens."""
        try:
            values = dict(self.function(context))
        except NotAvailableError as error:
            return self.rows_for(Absent(str(error)), wanted)
        except Exception as error:
            trace = traceback.extract_tb(error.__traceback__)[-1]
            reason = f"{type(error).__name__}: {error} ({trace.name}, line {trace.lineno})"
            return self.rows_for(Absent(reason, "failed"), wanted)
        unknown = sorted(set(values) - {metric.name for metric in self.metrics})
        if unknown:
            reason = f"{self.name} returned what it had not announced: {', '.join(unknown)}"
            return self.rows_for(Absent(reason, "failed"), wanted)
        absent = Absent("the benchmark gave no value", "failed")
        return [row(m, values.get(m.name, absent)) for m in self._wanted(wanted)]

    def rows_for(self, absent: Absent, wanted: Iterable[str] | None = None) -> list[Row]:
        """A row with the same reason for every (wanted) metric."""
        return [row(metric, absent) for metric in self._wanted(wanted)]

    def _wanted(self, names: Iterable[str] | None) -> Iterator[Metric]:
        chosen = None if names is None else set(names)
        return (m for m in self.metrics if chosen is None or m.name in chosen)


def row(metric: Metric, value: Value) -> Row:
    """The row of a metric and its value; a value that is not finite has failed."""
    if isinstance(value, Absent):
        return Row(metric, value.status, reason=value.reason)
    measured = value if isinstance(value, Measured) else Measured(float(value))
    if not math.isfinite(measured.value):
        return Row(metric, "failed", reason=f"the value is {measured.value}")
    return Row(metric, "ok", float(measured.value), details=measured.details)


class Registry:
    """All benchmarks, in the order they were registered."""

    def __init__(self) -> None:
        self._benchmarks: dict[str, Benchmark] = {}

    def benchmark(
        self, name: str, metrics: Sequence[Metric], *, timeout: float = 900.0
    ) -> Callable[[Callable[[Context], Values]], Callable[[Context], Values]]:
        """Decorator: register a function under a name with the metrics that it measures.

        Raises:
            ValueError: a benchmark or metric of that name is there already.
        """

        def register(function: Callable[[Context], Values]) -> Callable[[Context], Values]:
            taken = {m.name for b in self._benchmarks.values() for m in b.metrics}
            for metric in metrics:
                if metric.name in taken:
                    raise ValueError(f"metric {metric.name} is registered twice")
                taken.add(metric.name)
            if name in self._benchmarks:
                raise ValueError(f"benchmark {name} is registered twice")
            self._benchmarks[name] = Benchmark(name, function, tuple(metrics), timeout)
            return function

        return register

    def __iter__(self) -> Iterator[Benchmark]:
        return iter(self._benchmarks.values())

    def __getitem__(self, name: str) -> Benchmark:
        return self._benchmarks[name]

    def select(self, patterns: Sequence[str] = ()) -> list[tuple[Benchmark, list[str]]]:
        """Benchmarks with the names of their metrics that match.

        Args:
            patterns: name of a benchmark, beginning of a metric's name, or a shell pattern for
                either; none: everything.

        Raises:
            ValueError: a pattern that matches nothing, with the valid names.
        """
        used: set[str] = set()

        def matches(benchmark: Benchmark, metric: Metric) -> bool:
            hits = [
                p
                for p in patterns
                if fnmatch.fnmatchcase(benchmark.name, p)
                or fnmatch.fnmatchcase(metric.name, p)
                or metric.name.startswith(p.rstrip("/") + "/")
            ]
            used.update(hits)
            return bool(hits) or not patterns

        chosen = [(b, [m.name for m in b.metrics if matches(b, m)]) for b in self]
        idle = [p for p in patterns if p not in used]
        if idle:
            raise ValueError(
                f"nothing is called {', '.join(idle)}; benchmarks are "
                f"{', '.join(b.name for b in self)} (metrics: --list)"
            )
        return [(b, names) for b, names in chosen if names]


def stopwatch(function: Callable[[], object]) -> float:
    """Seconds that one call takes."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


SUITE = Registry()
