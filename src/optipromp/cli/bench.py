"""``optipromp bench``: the benchmark of reaching in hanging clutter."""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optipromp.cli.command import FAILED, OK, Report, Shown, command
from optipromp.cli.console import Cluster, Workers, grid, progress_bar, say_if_compiling
from optipromp.core.errors import InvalidRequestError

if TYPE_CHECKING:
    from optipromp.bench.running import BenchRow
    from optipromp.bench.table import Leaderboard

bench = typer.Typer(
    name="bench", no_args_is_help=True, rich_markup_mode="rich",
    help="Compare pickers on frozen scenes, in two physics engines (docs/benchmark.md).",
)  # fmt: skip


@bench.command("run")
@command()
def run(
    entry: Annotated[
        str, typer.Option(metavar="NAME", help="Of 'optipromp bench list', or MODULE:CLASS.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Of the results; goes on where it was.")],
    track: Annotated[
        str, typer.Option(metavar="NAME", help="plan, policy or picture; see 'bench list'.")
    ] = "",
    scenes: Annotated[
        str,
        typer.Option(
            "--set",
            metavar="WORD",
            help="development, or a word that draws a test set; without one, a new word is drawn.",
        ),
    ] = "development",
    draw: Annotated[bool, typer.Option("--draw", help="Draw a new test set.")] = False,
    preset: Annotated[
        str, typer.Option(metavar="NAMES", help="Presets, separated by commas.")
    ] = "cluster,mixed,field,wild",
    count: Annotated[int, typer.Option(help="Scenes of each preset.")] = 200,
    condition: Annotated[
        str | None, typer.Option(metavar="NAME", help="What moves and is seen wrongly.")
    ] = None,
    variation: Annotated[
        str, typer.Option(metavar="NAME", help="Of the physics; see 'study --vary'.")
    ] = "",
    workers: Workers = None,
    ray: Cluster = None,
) -> Report:
    """Run an entry on every scene of a set, and leave a submission.

    An entry is a class of at most 40 lines; examples/12_bench_entry.py has one.
    Harm counts before success: a scene is clean only if the target alone was
    picked and nothing was harmed.

    [bold]Examples[/bold]

    \b
    optipromp bench run --entry opti-promp --count 5 --out mine
    optipromp bench run --entry mine:Picker --track plan --out mine
    optipromp bench run --entry mine:Policy --track policy --draw --out test
    """
    from optipromp.bench.entries import ENTRIES
    from optipromp.bench.results import BenchRun, run_bench
    from optipromp.bench.sets import SceneSet
    from optipromp.bench.tracks import TRACKS
    from optipromp.core.scenes.values import suggest

    asked = track or (ENTRIES[entry].track if entry in ENTRIES else "plan")
    if asked not in TRACKS:
        raise InvalidRequestError(f"track is {asked!r}: {suggest(asked, TRACKS)}")
    word = secrets.token_hex(6) if draw else scenes
    chosen = SceneSet(word, tuple(filter(None, preset.split(","))), count)
    made = BenchRun.of(entry, asked, chosen, condition, variation)
    say_if_compiling()
    with progress_bar(20) as say:
        rows = run_bench(made, out, workers=workers, ray=ray, progress=_told(say))
    from optipromp.bench.table import leaderboard

    board = leaderboard([out])
    document = {"set": word, "out": str(out), "rows": len(rows), **board.to_dict()}
    return Report(document, _shown(board, f"set {word}; wrote {out / 'submission.zip'}"))


@bench.command("verify")
@command()
def verify(
    submission: Annotated[Path, typer.Argument(metavar="ZIP", help="Of 'bench run'.")],
    workers: Workers = None,
    ray: Cluster = None,
) -> Report:
    """Execute a submission's motions once more, and compare every row.

    The entry itself is not needed. The exit code is 1 where a row differs.

    [bold]Example[/bold]

    \b
    optipromp bench verify mine/submission.zip
    """
    from optipromp.bench.results import verify as again

    say_if_compiling()
    with progress_bar(20) as say:
        told = again(submission, workers=workers, ray=ray, progress=_told(say))
    changed = [
        {"preset": a.preset, "seed": a.seed, "engine": a.engine, "told": a.judged(),
         "now": b.judged()} for a, b in told.changed
    ]  # fmt: skip
    lines = [
        f"{a.preset} {a.seed} {a.engine}: {a.result} {a.cause} | now {b.result} {b.cause}"
        for a, b in told.changed[:20]
    ]
    words = f"{len(told.rows)} rows, {len(changed)} of which differ"
    document = {"rows": len(told.rows), "changed": changed}
    return Report(document, [words, *lines], FAILED if changed else OK)


@bench.command("table")
@command()
def table(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULTS...", help="Folders or submissions.")
    ],
    out: Annotated[
        Path | None, typer.Option("--markdown", metavar="FILE", help="Leave the page here.")
    ] = None,
) -> Report:
    """Make the leaderboard of submissions on one set.

    [bold]Example[/bold]

    \b
    optipromp bench table ours straight theirs.zip --markdown leaderboard.md
    """
    from optipromp.bench.table import leaderboard, markdown
    from optipromp.core.files import write_atomically

    board = leaderboard(results)
    if out is not None:
        write_atomically(out, markdown(board).encode())
    return Report(board.to_dict(), _shown(board, "" if out is None else f"wrote {out}"))


@bench.command("list")
@command()
def entries() -> Report:
    """List the entries of this library and the tracks.

    [bold]Example[/bold]

    \b
    optipromp bench list
    """
    from optipromp.bench.entries import ENTRIES
    from optipromp.bench.tracks import CONDITION

    document = {
        "tracks": dict(CONDITION),
        "entries": {name: each._asdict() for name, each in ENTRIES.items()},
    }
    shown = grid(("entry", "track", "what it does"))
    for name, each in ENTRIES.items():
        shown.add_row(name, each.track, each.text)
    words = ", ".join(f"{name} (condition {value})" for name, value in CONDITION.items())
    return Report(document, [f"tracks: {words}", shown])


def _told(
    say: Callable[[int, int, str], None],
) -> Callable[[int, int, "BenchRow | None"], None]:
    def tell(done: int, total: int, row: "BenchRow | None") -> None:
        newest = "" if row is None else f": {row.preset} {row.seed} {row.result}"
        say(done, total, f"{done} of {total} scenes{newest}")

    return tell


def _shown(board: "Leaderboard", words: str) -> Shown:
    shown = grid(("entry", "engine", "clean (95 %)", "harmed", "missed", "refused", "score", "p"))
    for entry in board.order:
        for engine in board.run.engines:
            s = board.of(entry, engine)
            clean = f"{s.clean}/{s.runs} ({100 * s.low:.0f}–{100 * s.high:.0f})"
            shown.add_row(
                entry.rpartition(":")[2], engine, clean, str(s.harmed), str(s.missed),
                str(s.refused + s.errors), f"{100 * s.score:.0f}",
                "–" if s.p is None else f"{s.p:.3f}",
            )  # fmt: skip
    yield shown
    if words:
        yield words
