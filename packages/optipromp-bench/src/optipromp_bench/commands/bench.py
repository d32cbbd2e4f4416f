"""``optipromp bench``: the benchmark of reaching in hanging clutter."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from optipromp.cli.command import FAILED, OK, Report, Shown, command
from optipromp.cli.console import Cluster, Workers, grid, progress_bar, say_if_compiling
from optipromp.cli.robot import ArmOptions, Whose
from optipromp.core.errors import InvalidRequestError, suggest
from optipromp.core.files import is_there, json_text, write_atomically

if TYPE_CHECKING:
    from rich.table import Table as Rich

    from optipromp_bench.experiments.rows import Row
    from optipromp_bench.table import Leaderboard

bench = typer.Typer(
    name="bench", no_args_is_help=True, rich_markup_mode="rich",
    help="Compare pickers on frozen scenes, in two physics engines (docs/benchmark.md).",
)  # fmt: skip


@bench.command("run")
@command()
def run(
    entry: str,
    out: Path,
    track: str = "",
    scenes: str = "development",
    draw: bool = False,
    round_: Path | None = None,
    preset: str = "cluster,mixed,field,wild",
    count: int = 200,
    condition: str | None = None,
    variation: str = "",
    workers: Workers = None,
    ray: Cluster = None,
) -> Report:
    """Run an entry on every scene of a set, and leave a submission.

    An entry is a class of at most 40 lines; examples/12_bench_entry.py has one.
    It works in a process of its own and sees scenes only. A scene in which it
    raises, exits, hangs (60 s a plan, 1 s an action) or moves for more than
    60 s is a row, and the run goes on. Harm counts before success: a scene is
    clean only if the target alone was picked and nothing was harmed.

    Examples:
        optipromp bench run --entry opti-promp --count 5 --out mine
        optipromp bench run --entry mine:Picker --track plan --out mine
        optipromp bench run --entry mine:Policy --track policy --draw --out test
        optipromp bench run --entry mine:Picker --round round.json --out mine

    Args:
        entry (NAME): Of 'optipromp bench list', or MODULE:CLASS.
        out (DIR): Of the results; goes on where it was.
        track (NAME): plan, policy or picture; see 'bench list'.
        scenes (--set WORD): development, or a word that draws a test set.
        draw: A round of this entry alone: its digest, then a word. One that was cut short goes on.
        round_ (--round FILE): Of 'bench draw': its word, its entries. -: of standard input, so that
            the file may lie where the entry cannot read it.
        preset (NAMES): Presets, separated by commas.
        count: Scenes of each preset.
        condition (NAME): What moves and is seen wrongly.
        variation (NAME): Of the physics; see 'bench study'.
    """
    from optipromp_bench.entries import ENTRIES
    from optipromp_bench.results import LEFT, BenchRun, run_bench
    from optipromp_bench.sets import SceneSet, draw_round, read_round
    from optipromp_bench.tracks import TRACKS

    asked = track or (ENTRIES[entry].track if entry in ENTRIES else "plan")
    if asked not in TRACKS:
        raise InvalidRequestError(f"track is {asked!r}: {suggest(asked, TRACKS)}")
    if draw + (round_ is not None) + (scenes != "development") > 1:
        raise InvalidRequestError("--set, --draw and --round name three sets: give one of them")
    if draw and is_there(out / LEFT):  # it was cut short
        round_ = out / LEFT
    drawn = read_round(round_) if round_ is not None else draw_round([entry]) if draw else None
    word = scenes if drawn is None else drawn.word
    chosen = SceneSet(word, tuple(filter(None, preset.split(","))), count)
    made = BenchRun.of(entry, asked, chosen, condition, variation, drawn)
    say_if_compiling()
    with progress_bar(20) as say:
        rows = run_bench(made, out, workers=workers, ray=ray, progress=_told(say))
    from optipromp_bench.table import leaderboard

    board = leaderboard([out])
    document = {"set": word, "out": str(out), "rows": len(rows), **board.to_dict()}
    return Report(document, _shown(board, f"set {word}; wrote {out / 'submission.zip'}"))


@bench.command("verify")
@command()
def verify(
    submission: Path, /, entry: str | None = None, workers: Workers = None, ray: Cluster = None
) -> Report:
    """Execute a submission once more, and compare every row.

    With --entry, the entry is asked for every scene again: its rows, refusals
    and errors must come again. Without it, the motions in the file are executed:
    they do what the rows say, but whether the entry made them is not known, and
    a refusal has no motion. A success leaves a record beside the zip, which
    'bench table' reads. The exit code is 1 where a row
    differs or is not confirmed.

    Examples:
        optipromp bench verify mine/submission.zip --entry mine:Picker
        optipromp bench verify theirs.zip

    Args:
        submission (ZIP): Of 'bench run'.
        entry (NAME): The submitted entry, which is asked again.
    """
    from optipromp_bench.results import verify as again

    say_if_compiling()
    with progress_bar(20) as say:
        told = again(submission, entry=entry, workers=workers, ray=ray, progress=_told(say))
    changed = [
        {"preset": a.preset, "seed": a.seed, "engine": a.engine, "told": a.judged(),
         "now": b.judged()} for a, b in told.changed
    ]  # fmt: skip
    words = [f"{len(told.rows)} rows, {len(changed)} of which differ"]
    if told.unconfirmed:
        words.append(
            f"not verified: {len(told.unconfirmed)} rows are refusals or errors without a motion; "
            f"give --entry {told.run.entry}"
        )
    elif not changed:
        words.append(f"verified by {'the entry' if told.by == 'entry' else 'its motions alone'}")
    words += [
        f"{a.preset} {a.seed} {a.engine}: {a.result} {a.cause} | now {b.result} {b.cause}"
        for a, b in told.changed[:20]
    ]
    document = {
        "rows": len(told.rows), "changed": changed, "unconfirmed": len(told.unconfirmed),
        "verified": told.by if told.confirmed else "no",
    }  # fmt: skip
    return Report(document, words, OK if told.confirmed else FAILED)


@bench.command("draw")
@command()
def draw_(entry: list[str], out: Path) -> Report:
    """Draw a test set for entries that are handed in: their digests first, then the word.

    'bench run --round FILE' refuses an entry whose source has changed since. A
    package counts with all its files; a single module with its own file only.
    An entry imports nothing else but what is installed.

    Example:
        optipromp bench draw --entry opti-promp --entry mine:Picker --out round.json

    Args:
        entry (NAME): Of 'bench list', or MODULE:CLASS; several times.
        out (FILE): Of the round; is not written over.
    """
    from dataclasses import asdict

    from optipromp_bench.sets import draw_round

    if is_there(out):
        raise InvalidRequestError(f"{out} is there: a round is drawn once; name another file")
    made = draw_round(entry)
    write_atomically(out, json_text(asdict(made)).encode())
    lines = [f"{name}: {digest[:16]}" for name, digest in made.entries.items()]
    return Report(asdict(made), [*lines, f"word {made.word}; wrote {out}"])


@bench.command("table")
@command()
def table(results: list[Path], /, out: Path | None = None, plot: Path | None = None) -> Report:
    """Make the leaderboard of submissions on one set.

    The column verified says what 'bench verify' confirmed: entry, motions or no.

    Example:
        optipromp bench table ours straight theirs.zip --markdown board.md --plot board.svg

    Args:
        results (RESULTS...): Folders or submissions.
        out (--markdown FILE): Leave the page here.
        plot (FILE.svg): Leave a picture here: clean and harmed with 95 % intervals.
    """
    from optipromp_bench.table import leaderboard, markdown, picture

    board, files = leaderboard(results), [file for file in (out, plot) if file is not None]
    for file in files:
        write_atomically(file, (markdown if file is out else picture)(board).encode())
    return Report(board.to_dict(), _shown(board, " ".join(f"wrote {file}" for file in files)))


@bench.command("study")
@command()
def study(
    what: list[str],
    /,
    *,
    out: Path,
    scenes: Path | None = None,
    crop: str | None = None,
    workers: Workers = None,
    ray: Cluster = None,
    robot: Whose = None,
    arm: ArmOptions,
) -> Report:
    """Run studies in the simulation, and print their tables: shares with 95 % intervals.

    A study runs planners on random scenes, or on yours, and executes their
    plans. It is said in words FIELD=VALUE, or several are in a file. Fields are
    presets, planners, seeds (A:B, to before B), noise, noise_position in m,
    noise_angle in degrees, only_valid, vary (true or crop), risk; of loops, in
    place of planners: loops (open, closed), conditions, eyes (rendered, fitted),
    finder, views. docs/studies.md tells of each.

    Every run is a row of rows.csv in DIR, of a file in DIR/NAME. Ctrl-C keeps
    what is done; the same command goes on from there.

    Examples:
        optipromp bench study presets=cluster,shelf seeds=1000:1200 --out fresh
        optipromp bench study presets=cluster planners=opti-promp --robot ur5.urdf --out ur5
        optipromp bench study planners=opti-promp noise=zero-mean --scenes mine --out own
        optipromp bench study presets=cluster planners=opti-promp,drift vary=true --out varied
        optipromp bench study presets=cluster vary=crop --crop tomato --out guesses
        optipromp bench study presets=field loops=open,closed conditions=sway --out two
        optipromp bench study presets=cluster loops=open,closed eyes=fitted --out circle
        optipromp bench study scripts/studies/loops.toml --out loops

    Args:
        what (FIELD=VALUE...|FILE.toml): A study, or a file of them: of 'table', MODULE:CLASS of
            another kind (none: plans and loops), and a row of 'study' for each.
        out (DIR): Where rows go; rows that are there are kept.
        scenes (DIR): Your scenes in place of presets: the scene files of a folder. The seed is then
            of noise, planner and physics.
        crop (CROP): Of the scenes' fruits: strawberry, tomato, apple or a file; harm is judged in
            its units.
    """
    from optipromp.cli.plan import scene_files
    from optipromp.core.scenes.crops import load_crop
    from optipromp_bench.experiments.kinds import run_kind
    from optipromp_bench.experiments.statistics import cells_in
    from optipromp_bench.experiments.study import Study, run_study, write_results
    from optipromp_bench.experiments.tables import studies_of, tables_of

    named = arm.of(robot)
    given: dict[str, Any] = {} if crop is None else {"crop": load_crop(crop)}
    if named:
        given |= {"choice": named.choice} | ({} if robot is None else {"robot": robot})
    kind, studies = studies_of(what, scene_files(scenes) if scenes else (), **given)
    say_if_compiling()
    rows: dict[str, Sequence[Any]] = {}
    for name, each in studies.items():
        with progress_bar(20) as say:
            if isinstance(each, Study):
                rows[name] = run_study(
                    each, out / name, workers=workers, ray=ray, progress=_told(say)
                )
                write_results(rows[name], out / name)
            else:
                rows[name] = run_kind(each, out / name, workers, _told(say))
    tables = tables_of(rows) if kind is Study else kind.told(rows)
    write_atomically(out / "tables.md", "\n".join(map(str, tables)).encode())
    cells = [
        {"study": name, **cell.to_dict()}
        for name, own in rows.items() if kind is Study for cell in cells_in(own)
    ]  # fmt: skip
    document = {
        "runs": sum(map(len, rows.values())),
        "cells": cells,
        "tables": [t._asdict() for t in tables],
    }
    last = f"wrote rows, tables.md and, of each study, summary.json and study.svg to {out}"
    shown = (_table(each.heads, each.lines, each.title) for each in tables)
    return Report(document, [*shown, last])


@bench.command("list")
@command()
def entries() -> Report:
    """List the entries of this library, where they run, and the tracks.

    Example:
        optipromp bench list
    """
    from optipromp_bench.entries import ENTRIES
    from optipromp_bench.sets import is_found
    from optipromp_bench.tracks import CONDITION

    runs = {name: "here" if is_found(name) else "in the clone" for name in ENTRIES}
    document = {
        "tracks": dict(CONDITION),
        "entries": {name: {**e._asdict(), "runs": runs[name]} for name, e in ENTRIES.items()},
    }
    lines = [[name, e.track, runs[name], e.text] for name, e in ENTRIES.items()]
    shown = _table(("entry", "track", "runs", "what it does"), lines, left=4)
    words = ", ".join(f"{name} (condition {value})" for name, value in CONDITION.items())
    return Report(document, [f"tracks: {words}", shown])


def _told(say: Callable[[int, int, str], None]) -> Callable[[int, int, "Row | None"], None]:
    def tell(done: int, total: int, row: "Row | None") -> None:
        newest = "" if row is None else f": {row.preset} {row.seed} {row.result or row.cause}"
        say(done, total, f"{done} of {total} rows{newest}")

    return tell


def _shown(board: "Leaderboard", words: str) -> Shown:
    heads = "entry", "engine", "clean (95 %)", "harmed", "missed", "refused", "score", "p"
    lines = list[list[Any]]()
    for entry in board.order:
        for k, engine in enumerate(board.run.engines):
            s = board.of(entry, engine)
            lines.append([
                "" if k else entry, engine, f"{s.clean}/{s.runs} ({s.interval})", s.harmed,
                s.missed, s.refused + s.errors, f"{100 * s.score:.0f}",
                "–" if s.p is None else f"{s.p:.3f}", "" if k else board.verified[entry],
            ])  # fmt: skip
    yield _table((*heads, "verified"), lines, left=9)
    if words:
        yield words


def _table(
    heads: Sequence[str], lines: Sequence[Sequence[Any]], title: str = "", left: int = 1
) -> "Rich":
    """A table for a terminal; a cell but the first of a line may take several lines."""
    out = grid(heads[:left], heads[left:], title=title or None, padding=(0, 0))
    for column in out.columns[1:]:
        column.no_wrap, column.overflow = False, "fold"
    for line in lines:
        out.add_row(*(str(cell).replace("`", "") for cell in line))
    return out
