"""The leaderboard: entries by what they picked and what they harmed, with intervals and tests."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import scipy.stats

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.experiments.forest import Panels, Share, forest
from optipromp_bench.experiments.rows import Row
from optipromp_bench.experiments.statistics import Cell, Table, seconds_a_clean, wilson
from optipromp_bench.results import BenchRun, Means, recorded, submission, zip_of


@dataclass(frozen=True, kw_only=True)
class Standing(Cell):
    """What became of an entry's scenes in one engine, and how it compares with the best."""

    entry: str
    engine: str
    preset: str  # empty: all
    clean: int
    harmed: int
    missed: int
    refused: int
    errors: int
    torn: int  # a fruit came off, or was pulled too hard
    score: float  # harm outweighs a miss
    thought: float
    duration: float | None  # [s] of clean motions, way out too
    p: float | None  # that it is clean as often as the best, see paired; None: the best itself


@dataclass(frozen=True)
class Leaderboard:
    """Entries on one set of scenes, the best first."""

    run: BenchRun  # of the first entry: track, set, condition, variation are those of all
    order: tuple[str, ...]  # names of the entries; by the smaller of their scores in the engines
    standings: tuple[Standing, ...]  # of every entry, engine and preset
    # by entry: ``entry``, ``motions`` or ``no``; see ``bench verify``
    verified: Mapping[str, Means]

    def of(self, entry: str, engine: str, preset: str = "") -> Standing:
        """One standing."""
        return next(
            s for s in self.standings if (s.entry, s.engine, s.preset) == (entry, engine, preset)
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        standings = [cell.to_dict() for cell in self.standings]
        return {**asdict(replace(self, standings=())), "standings": standings}


def leaderboard(files: Iterable[Path]) -> Leaderboard:
    """The leaderboard of submissions, or of folders that hold one."""
    held: dict[str, tuple[BenchRun, Sequence[Row]]] = {}
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
    engines = run.engines
    worst = {
        entry: min(standing(_chosen(rows, engine), entry, engine).score for engine in engines)
        for entry, rows in rows_of.items()
    }
    order = sorted(rows_of, key=lambda entry: -worst[entry])
    standings = []
    for preset in ("", *run.scenes.presets):
        for engine in engines:
            best = _chosen(rows_of[order[0]], engine, preset)
            for entry in order:
                own = _chosen(rows_of[entry], engine, preset)
                other = None if entry == order[0] else best
                standings.append(standing(own, entry, engine, preset, other))
    return Leaderboard(run, tuple(order), tuple(standings), {e: verified[e] for e in order})


def standing(
    rows: Sequence[Row], entry: str, engine: str, preset: str = "",
    best: Sequence[Row] | None = None,
) -> Standing:  # fmt: skip
    """The figures of an entry's rows, beside those of the ``best`` of a table."""
    count, runs = Counter(row.result for row in rows), len(rows)
    low, high = wilson(count["clean"], runs)
    times = [row.duration for row in rows if row.result == "clean" and row.duration]
    p = None
    if best is not None:
        other = {row.key: row.result == "clean" for row in best}
        p = paired([(row.result == "clean", other[row.key]) for row in rows])
    return Standing(
        entry=entry, engine=engine, preset=preset, runs=runs, low=low, high=high,
        clean=count["clean"], harmed=count["harmed"], missed=count["missed"],
        refused=count["refused"], errors=count["error"],
        torn=sum(
            r.result == "harmed" and ("torn" in r.cause or "pulled" in r.cause) for r in rows
        ),
        score=(count["clean"] - count["harmed"]) / max(runs, 1),
        thought=median(row.thought for row in rows),
        duration=median(times) if times else None,
        clean_seconds=seconds_a_clean((row.duration or 0.0 for row in rows), count["clean"]),
        p=p,
    )  # fmt: skip


def _chosen(rows: Sequence[Row], engine: str, preset: str = "") -> list[Row]:
    return [row for row in rows if row.engine == engine and preset in ("", row.preset)]


def paired(pairs: Sequence[tuple[bool, bool]]) -> float:
    """p of McNemar's exact test on pairs of outcomes; 1 where no pair differs."""
    one = sum(a and not b for a, b in pairs)
    other = sum(b and not a for a, b in pairs)
    if one + other == 0:
        return 1.0
    return float(scipy.stats.binomtest(one, one + other).pvalue)


def markdown(board: Leaderboard) -> str:
    """The leaderboard as a page's tables, each under its heading."""
    run, engines = board.run, board.run.engines
    where = f"Track `{run.track}`, condition `{run.condition}`"
    where += f", variation `{run.variation}`" if run.variation else ""
    drawn = f"; drawn {run.round.drawn}, after the entries' digests." if run.round else "."
    each = [f"{e}: {name}" for e in engines
            for name in ("clean (95 %)", "harmed", "missed", "refused", "p")]  # fmt: skip
    heads = ["", "entry", *each, "score", "think", "cycle", "a clean", "verified"]
    rows, presets, torn = [], [], []
    for rank, entry in enumerate(board.order, 1):
        all_ = [board.of(entry, engine) for engine in engines]
        shares: list[str] = []
        for s in all_:
            lost = (_share(count, s.runs) for count in (s.harmed, s.missed, s.refused + s.errors))
            shares += [f"**{_share(s.clean, s.runs)}** ({s.interval})", *lost, told_p(s.p)]
        times = (_time(t) for t in (all_[0].thought, all_[0].duration, all_[0].clean_seconds))
        score = f"{100 * min(s.score for s in all_):.1f}"
        rows.append([rank, f"`{entry}`", *shares, score, *times, board.verified[entry]])
        told = [board.of(entry, engine, p) for p in run.scenes.presets for engine in engines]
        pairs = (f"{_share(s.clean, s.runs)}, {_share(s.harmed, s.runs)}" for s in told)
        presets.append([f"`{entry}`", *pairs])
        torn.append([f"`{entry}`", *(s.torn for s in all_)])
    by = [f"{preset}: {engine}" for preset in run.scenes.presets for engine in engines]
    title = f"Torn or pulled too hard: `{board.order[0]}` and those beside it"
    tables = (
        Table(f"{where}: {run.scenes.count} scenes of each preset", heads, rows),
        Table(f"{where}: clean, harmed by preset, %", ["entry", *by], presets),
        Table(title, ["entry", *(f"{engine}: torn" for engine in engines)], torn),
    )
    head = f"Set `{run.scenes.word}`, version `{run.version}`{drawn}\n"
    return "\n".join([head, *map(str, tables)])


def picture(board: Leaderboard) -> str:
    """The leaderboard as SVG: shares that are clean and harmed, with their 95 % intervals."""
    shares: Panels = {"clean": {}, "harmed": {}}
    for panel, lines in shares.items():
        for entry in board.order:
            told = {engine: board.of(entry, engine) for engine in board.run.engines}
            lines[entry] = {e: Share.of(getattr(s, panel), s.runs) for e, s in told.items()}
    return forest(shares)


def _share(count: int, runs: int) -> str:
    return f"{100 * count / max(runs, 1):.1f}"


def told_p(value: float | None) -> str:
    """A p of a paired test in words."""
    return "–" if value is None else "< 0.001" if value < 0.001 else f"{value:.3f}"


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.1 else f"{seconds:.2g} s"
