"""The leaderboard: entries by what they picked and what they harmed, with intervals and tests."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import scipy.stats

from optipromp.bench.results import BenchRun, Means, recorded, submission, zip_of
from optipromp.bench.running import BenchRow
from optipromp.core.errors import InvalidRequestError
from optipromp.laboratory.experiments.statistics import wilson


@dataclass(frozen=True)
class Ranked:
    """One entry in one engine, over all presets or one.

    Attributes:
        entry, engine: names.
        preset: empty: over all.
        runs: number of scenes.
        clean, harmed, missed, refused, errors: number of scenes that ended so.
        low, high: 95 % interval (Wilson) of the share that is clean.
        score: share that is clean less share that is harmed: harm outweighs what is not picked.
        thought: median wall time of the entry [s].
        duration: median duration of clean motions [s]; None: there are none.
        p: of an exact paired test (McNemar) that the entry is clean as often as the first of the
            table, on the same scenes; None: the first itself.
    """

    entry: str
    engine: str
    preset: str
    runs: int
    clean: int
    harmed: int
    missed: int
    refused: int
    errors: int
    low: float
    high: float
    score: float
    thought: float
    duration: float | None
    p: float | None = None


@dataclass(frozen=True)
class Leaderboard:
    """Entries on one set of scenes, the best first.

    Attributes:
        run: of the first entry: track, set, condition, variation are those of all.
        order: names of the entries; by the smaller of their scores in the engines.
        standings: of every entry, engine, and preset (empty: all).
        verified: by entry: ``entry``, ``motions`` or ``no``; see ``bench verify``.
    """

    run: BenchRun
    order: tuple[str, ...]
    standings: tuple[Ranked, ...]
    verified: Mapping[str, Means]

    def of(self, entry: str, engine: str, preset: str = "") -> Ranked:
        """One standing."""
        return next(
            s for s in self.standings if (s.entry, s.engine, s.preset) == (entry, engine, preset)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def leaderboard(files: Iterable[Path]) -> Leaderboard:
    """The leaderboard of submissions, or of folders that hold one."""
    held: dict[str, tuple[BenchRun, Sequence[BenchRow]]] = {}
    verified: dict[str, Means] = {}
    for path in map(zip_of, files):
        run, rows, _, sha256 = submission(path)
        if run.entry in held:
            raise InvalidRequestError(f"two submissions of {run.entry}: the second is {path}")
        first = next(iter(held.values()), (run,))[0]
        for name in ("track", "scenes", "condition", "variation", "engines", "version", "round"):
            if getattr(run, name) != getattr(first, name):
                raise InvalidRequestError(
                    f"{path} has {name} {getattr(run, name)}, {first.entry} has "
                    f"{getattr(first, name)}: a table is of one set under one condition"
                )
        held[run.entry] = run, rows
        verified[run.entry] = recorded(path, sha256, run)
    if not held:
        raise InvalidRequestError("a table needs at least one submission")
    rows_of = {entry: rows for entry, (_, rows) in held.items()}
    run = next(iter(held.values()))[0]
    order = sorted(
        rows_of,
        key=lambda e: -min(_standing(e, g, "", rows_of[e]).score for g in run.engines),
    )
    standings = [
        _standing(entry, engine, preset, rows_of[entry], rows_of[order[0]])
        for preset in ("", *run.scenes.presets)
        for engine in run.engines
        for entry in order
    ]
    return Leaderboard(run, tuple(order), tuple(standings), {e: verified[e] for e in order})


def _standing(
    entry: str, engine: str, preset: str, rows: Sequence[BenchRow],
    first: Sequence[BenchRow] | None = None,
) -> Ranked:  # fmt: skip
    own = _picked(rows, engine, preset)
    count = {
        name: sum(row.result == name for row in own.values())
        for name in ("clean", "harmed", "missed", "refused", "error")
    }
    runs = len(own)
    low, high = wilson(count["clean"], runs)
    times = [row.duration for row in own.values() if row.result == "clean" and row.duration]
    p = None
    if first is not None and first is not rows:
        other = _picked(first, engine, preset)
        p = paired([(own[key].result == "clean", other[key].result == "clean") for key in own])
    return Ranked(
        entry, engine, preset, runs, count["clean"], count["harmed"], count["missed"],
        count["refused"], count["error"], low, high,
        (count["clean"] - count["harmed"]) / max(runs, 1),
        median(row.thought for row in own.values()), median(times) if times else None, p,
    )  # fmt: skip


def _picked(
    rows: Sequence[BenchRow], engine: str, preset: str
) -> Mapping[tuple[str, int], BenchRow]:
    return {
        (row.preset, row.seed): row
        for row in rows
        if row.engine == engine and preset in ("", row.preset)
    }


def paired(pairs: Sequence[tuple[bool, bool]]) -> float:
    """p of McNemar's exact test on pairs of outcomes; 1 where no pair differs."""
    one = sum(a and not b for a, b in pairs)
    other = sum(b and not a for a, b in pairs)
    if one + other == 0:
        return 1.0
    return float(scipy.stats.binomtest(one, one + other).pvalue)


def markdown(board: Leaderboard) -> str:
    """The leaderboard as a page's tables."""
    run, engines = board.run, board.run.engines
    lines = [
        f"Track `{run.track}`, set `{run.scenes.word}`, {run.scenes.count} scenes each of "
        f"{', '.join(run.scenes.presets)}; condition `{run.condition}`"
        + (f", variation `{run.variation}`" if run.variation else "")
        + f"; version `{run.version}`"
        + (f"; drawn {run.round.drawn}, after the entries' digests." if run.round else "."),
        "",
        "| | entry | " + " | ".join(
            f"{e}: clean (95 %) | harmed | missed | refused | p" for e in engines
        ) + " | score | think | verified |",
        "|---|---|" + "---|" * (5 * len(engines) + 3),
    ]  # fmt: skip
    for rank, entry in enumerate(board.order, 1):
        all_ = [board.of(entry, engine) for engine in engines]
        cells = " | ".join(
            f"**{_share(s.clean, s.runs)}** ({100 * s.low:.0f}–{100 * s.high:.0f}) | "
            f"{_share(s.harmed, s.runs)} | {_share(s.missed, s.runs)} | "
            f"{_share(s.refused + s.errors, s.runs)} | {told_p(s.p)}"
            for s in all_
        )
        score = min(s.score for s in all_)
        lines.append(
            f"| {rank} | `{entry}` | {cells} | {100 * score:.1f} | {_time(all_[0].thought)} | "
            f"{board.verified[entry]} |"
        )
    lines += ["", "Clean, harmed by preset, in %:", ""]
    heads = [f"{preset}: {engine}" for preset in run.scenes.presets for engine in engines]
    lines += ["| entry | " + " | ".join(heads) + " |", "|---|" + "---|" * len(heads)]
    for entry in board.order:
        told = [
            board.of(entry, engine, preset)
            for preset in run.scenes.presets for engine in engines
        ]  # fmt: skip
        cells = " | ".join(f"{_share(s.clean, s.runs)}, {_share(s.harmed, s.runs)}" for s in told)
        lines.append(f"| `{entry}` | {cells} |")
    return "\n".join([*lines, ""])


def _share(count: int, runs: int) -> str:
    return f"{100 * count / max(runs, 1):.1f}"


def told_p(value: float | None) -> str:
    """A p of a paired test in words."""
    return "–" if value is None else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.1 else f"{seconds:.2g} s"
