"""Shared by the commands: options, consoles, tables, and the display of progress."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TextIO

import typer

from optipromp.core.errors import InvalidRequestError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

_PATIENCE = 2.0  # [s] before a wait shows itself
_TICK = 0.2  # [s] between two looks at what is being done
_REPEAT = 10.0  # [s] after which a step is told again

Preset = Literal[
    "cluster", "side-clusters", "table-top", "mixed", "tight", "limp", "elongated", "truss",
    "field", "shelf", "wild", "standing", "vine", "trusses",
]  # fmt: skip

Seed = Annotated[int, typer.Option(min=0, help="Same seed, same outcome.")]
Progress = Annotated[
    bool | None,
    typer.Option(
        "--progress/--no-progress",
        help="On standard error, what takes longer than 2 s; by default on a terminal, without "
        "--json.",
        show_default=False,
    ),
]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a core if left out.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--ray", metavar="ADDRESS",
        help="Work on a Ray cluster in place of this machine's cores: auto, HOST:PORT or local.",
    ),
]  # fmt: skip
Recorded = Annotated[
    Path | None,
    typer.Option(help="NPZ, CSV or a folder of CSVs to learn from, or what 'learn' wrote."),
]


def seeds_of(text: str) -> tuple[int, int]:
    """The first seed, and the last plus one, of A:B."""
    begin, colon, end = text.partition(":")
    if not (begin.isdigit() and end.isdigit() and colon and int(begin) < int(end)):
        raise InvalidRequestError(f"seeds are {text!r}; write them as 0:10")
    return int(begin), int(end)


def stdout() -> "Console":
    """The console of answers, on standard output; text that looks like markup stays as it is."""
    return _console(sys.stdout, soft_wrap=not sys.stdout.isatty())


def stderr() -> "Console":
    """The console of everything but answers, on standard error."""
    return _console(sys.stderr, soft_wrap=True)


def _console(file: TextIO, *, soft_wrap: bool) -> "Console":
    from rich.console import Console

    return Console(file=file, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)


def headline(*parts: tuple[str, str] | str) -> "Text":
    """A line of parts: words, or words with their style."""
    from rich.text import Text

    return Text.assemble(*parts)


def grid(
    left: Sequence[str],
    right: Sequence[str] = (),
    *,
    title: str | None = None,
    padding: tuple[int, ...] = (0, 1),
) -> "Table":
    """An empty table: columns of words (``left``), then columns of figures (``right``)."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    padded: Any = padding
    out = Table(box=SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False, padding=padded)
    for name in left:
        out.add_column(name, no_wrap=True)
    for name in right:
        out.add_column(name, no_wrap=True, justify="right")
    return out


@contextmanager
def waiting(message: str, progress: bool | None = None) -> Iterator[Callable[[str], None]]:
    """Tell on standard error what is being done, and for how long, after two seconds. A terminal
    shows a spinner; elsewhere each step that has begun is a line, and so are ten seconds more of
    the same step. Yields a function that changes the message. ``progress``: whether anything is
    told; None: on a terminal only."""
    if not (sys.stderr.isatty() if progress is None else progress):
        yield lambda _: None
        return
    step = [message]
    done = threading.Event()
    ticker = threading.Thread(target=_tell, args=(step, done, time.monotonic()), daemon=True)
    ticker.start()
    try:
        yield lambda words: step.__setitem__(0, words)
    finally:
        done.set()
        ticker.join()


def _tell(step: Sequence[str], done: threading.Event, began: float) -> None:
    """Show the step and the seconds since it all began, until ``done``."""
    if done.wait(_PATIENCE):
        return
    if sys.stderr.isatty():
        from rich.status import Status

        with Status("", console=stderr()) as status:
            while not done.wait(_TICK):
                status.update(headline(f"{step[0]} {time.monotonic() - began:.0f} s"))
        return
    told, last = "", -math.inf
    while True:
        words, now = step[0], time.monotonic()
        if words != told or now - last >= _REPEAT:
            print(f"{now - began:3.0f} s  {words}", file=sys.stderr, flush=True)
            told, last = words, now
        if done.wait(_TICK):
            return


@contextmanager
def progress_bar(
    lines: int, progress: bool | None = None
) -> Iterator[Callable[[int, int, str], None]]:
    """Show progress on standard error: a bar on a terminal, elsewhere about ``lines`` lines. Yields
    a function of the number done, the number of all, and a line of words. ``progress``: False for
    no progress at all."""
    if progress is False:
        yield lambda *_: None
        return
    if not sys.stderr.isatty():

        def say(done: int, total: int, words: str) -> None:
            if done % max(1, total // lines) == 0 or done == total:
                print(words, file=sys.stderr, flush=True)

        yield say
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn()
    with Progress(*columns, console=stderr(), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, words: bar.update(
            task, completed=done, total=total, description=words
        )


def say_if_compiling(progress: bool | None = None) -> None:
    """Compile the kernels now, and say so, where Numba's cache lacks them. ``progress``: as for
    :func:`waiting`."""
    from optipromp.core.compiled import in_cache
    from optipromp.core.optimization.kernels import add_stiffness

    if not in_cache(add_stiffness):
        sys.stderr.write("compiling kernels, once (about half a minute) ...\n")
        sys.stderr.flush()
        from optipromp.core.planning.warming import compile_kernels

        with waiting("compiling kernels", progress) as say:
            compile_kernels(say)
