"""What the commands share: options, where they print, how they wait, how they fail."""

import json
import math
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, ParamSpec, TextIO

import typer

from optipromp.errors import Code, OptiPrompError
from optipromp.files import json_text
from optipromp.shown import printable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table
    from rich.text import Text

    from optipromp.planning import Plan

OK, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
_OUTCOMES = frozenset(
    {
        Code.START_IN_COLLISION,
        Code.GOAL_IN_COLLISION,
        Code.GOAL_UNREACHABLE,
        Code.NO_PLAN,
        Code.INVALID_PLAN,
        Code.HARM_PREDICTED,
        Code.TIMEOUT,
    }
)
_PATIENCE = 2.0  # [s] before a wait shows itself

P = ParamSpec("P")

Strategy = Literal["joint", "sequential"]
Preset = Literal[
    "cluster", "side-clusters", "table-top", "mixed", "tight", "limp", "elongated", "truss",
    "field", "shelf",
]  # fmt: skip
Generated = Literal[Preset, "bookshelf", "box", "cage", "table-pick", "under-table"]

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]
Seed = Annotated[int, typer.Option(min=0, help="Same seed, same outcome.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes; one a core if left out.")]
ChosenStrategy = Annotated[
    Strategy,
    typer.Option(help="Of opti-promp. joint: one solve; sequential: the paper's two stages."),
]
Recorded = Annotated[
    Path | None,
    typer.Option(help="NPZ, CSV or a folder of CSVs to learn from, or what 'learn' wrote."),
]


def exit_code(code: Code) -> int:
    """0 for success, 1 where the input was right and no plan came of it, 2 for wrong input."""
    if code is Code.SUCCESS:
        return OK
    return FAILED if code in _OUTCOMES else WRONG_INPUT


def stdout() -> "Console":
    """A console for the answer. Text is printed as it is, also where it looks like markup."""
    return _console(sys.stdout, soft_wrap=not sys.stdout.isatty())


def stderr() -> "Console":
    """The same for everything that is not the answer."""
    return _console(sys.stderr, soft_wrap=True)


def _console(file: TextIO, *, soft_wrap: bool) -> "Console":
    from rich.console import Console

    return Console(file=file, highlight=False, markup=False, emoji=False, soft_wrap=soft_wrap)


def headline(*parts: tuple[str, str] | str) -> "Text":
    """A line of words, and of words with their style."""
    from rich.text import Text

    return Text.assemble(*parts)


def grid(
    left: Sequence[str],
    right: Sequence[str] = (),
    *,
    title: str | None = None,
    padding: tuple[int, ...] = (0, 1),
) -> "Table":
    """An empty table with columns of words, then columns of figures."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    padded: Any = padding
    out = Table(box=SIMPLE_HEAD, title=title, title_justify="left", pad_edge=False, padding=padded)
    for name in left:
        out.add_column(name, no_wrap=True)
    for name in right:
        out.add_column(name, no_wrap=True, justify="right")
    return out


def print_json(document: object) -> None:
    """Print one JSON document on standard output; NaN and infinities become null."""
    text = json_text(document)
    if (sys.stdout.encoding or "utf-8").lower() != "utf-8":
        text = json.dumps(json.loads(text), indent=2) + "\n"  # in ASCII, which all encodings hold
    sys.stdout.write(text)


def command(
    failure: Callable[[OptiPrompError, Mapping[str, Any]], object] | None = None,
) -> Callable[[Callable[P, int]], Callable[P, None]]:
    """Turn a function that returns an exit code into a command.

    A typed error becomes one line on standard error and its exit code; under ``--json`` standard
    output still gets one document, from ``failure(error, arguments)``.
    """

    def decorate(function: Callable[P, int]) -> Callable[P, None]:
        @wraps(function)
        def run(*args: P.args, **kwargs: P.kwargs) -> None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("default", UserWarning)
                    warnings.showwarning = _show_warning
                    code = function(*args, **kwargs)
            except OptiPrompError as error:
                if kwargs.get("as_json"):
                    bare = {"status": error.code, "message": error.message}
                    print_json(failure(error, kwargs) if failure else bare)
                sys.stderr.write(f"error {error.code}: {_one_line(error.message)}\n")
                raise typer.Exit(exit_code(error.code)) from None
            except KeyboardInterrupt:
                sys.stderr.write("interrupted; nothing half-written was left\n")
                raise typer.Exit(INTERRUPTED) from None
            raise typer.Exit(code)

        return run

    return decorate


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"warning: {_one_line(str(message))}\n")


def _one_line(message: str) -> str:
    return printable(" ".join(message.split()))


@contextmanager
def waiting(message: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner on standard error after two seconds of waiting, on a terminal only.

    Yields a function that changes its message.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.status import Status

    status = Status(headline(message), console=stderr())
    timer = threading.Timer(_PATIENCE, status.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda words: status.update(headline(words))
    finally:
        timer.cancel()
        timer.join()
        status.stop()


@contextmanager
def progress_bar(lines: int) -> Iterator[Callable[[int, int, str], None]]:
    """A bar on a terminal; elsewhere at most so many lines (and the first) on standard error.

    Yields a function of how many are done, of how many, and words that say so.
    """
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


def say_if_compiling() -> None:
    """Compile the kernels before the first plan, and say so, when Numba's cache lacks them."""
    from optipromp.compiled import in_cache
    from optipromp.optimization.kernels import add_stiffness

    if not in_cache(add_stiffness):
        sys.stderr.write("compiling kernels, once (about half a minute) ...\n")
        sys.stderr.flush()
        from optipromp.planning.plan import compile_kernels

        compile_kernels()


def plan_report(plan: "Plan") -> "RenderableType":
    """What the plan is, whether it holds, and the figures it is judged by."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from optipromp.viewer.words import plan_rows, seconds

    strategy = f", {plan.strategy}" if plan.strategy else ""
    colour = "green" if plan.success else "red"
    total = plan.time.get("total", math.nan)
    head = headline(
        (plan.scene.name, "bold"), f"  {plan.planner}{strategy}  ",
        (plan.status, f"bold {colour}"), f" in {seconds(total)}",
    )  # fmt: skip
    table = Table(box=None, show_header=False, padding=(0, 2))
    for label, value in plan_rows(plan):
        table.add_row(label, value)
    parts: list[RenderableType] = [head]
    if plan.message:
        parts.append(Text(plan.message))
    return Group(*parts, table)
