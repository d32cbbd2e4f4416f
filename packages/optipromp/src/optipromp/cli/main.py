"""``optipromp``: the command and its sub-commands. Nothing heavy is imported here: each command
imports what it needs when it runs."""

import atexit
import gc
import io
import os
import signal
import sys
import threading
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from optipromp.cli import catalogue, check, export, learn, plan
from optipromp.cli.command import show_warning
from optipromp.core.budget import check_memory
from optipromp.core.errors import PAPERS, InvalidRequestError, unknown
from optipromp.parts import lacking

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


GROUP = "optipromp.commands"
"""The entry points of commands that packages add: a name, and a function that is decorated with
:func:`optipromp.cli.command.command`. Packages are searched only for the list of commands, and for
a name that is not built in."""


FURTHER = {
    "simulate": "sim", "generate": "sim", "render": "sim", "measure-crop": "sim",
    "see": "eyes", "calibrate": "eyes",
    "ros-node": "ros", "shadow": "loop",
    "view": "page",
    "scenarios": "paper",
    "bench": "bench", "episodes": "bench",
}  # fmt: skip
"""The package of this project that adds each further command."""
MOVED = {"study": "bench study presets=NAMES planners=NAMES seeds=A:B"}
"""What is written now, by the names of commands until 0.3.0."""


class Commands(TyperGroup):
    """The built-in commands, then those of packages; of two with one name, the first."""

    @cached_property
    def _points(self) -> dict[str, "EntryPoint"]:
        if not _named():
            return {}
        from importlib.metadata import entry_points

        found = list(entry_points(group=GROUP))  # what is returned cannot be reversed since 3.12
        return {point.name: point for point in reversed(found)}

    def list_commands(self, ctx: Any) -> list[str]:
        """The names of all commands."""
        for name in sorted(self._points):
            self.get_command(ctx, name)
        return super().list_commands(ctx)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name; a package's command that cannot be loaded gives a warning."""
        if cmd_name not in self.commands and cmd_name in self._points:
            point = self._points[cmd_name]
            try:
                self.commands[cmd_name] = _loaded(point)
            except (Exception, SystemExit) as error:  # whatever the package raises
                package = point.value if point.dist is None else point.dist.name
                told = f"{type(error).__name__}: {error}"
                show_warning(f"{package}: its command {cmd_name} is left out ({told})")
        if cmd_name in FURTHER and cmd_name not in self.commands:
            sys.stderr.write(f"error INVALID_REQUEST: {cmd_name} {lacking(FURTHER[cmd_name])}\n")
            raise typer.Exit(2)
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is named; of one that has moved, the error says what is written now."""
        if args[0] in MOVED:
            sys.stderr.write(
                f"error INVALID_REQUEST: {args[0]} is now: optipromp {MOVED[args[0]]}\n"
            )
            raise typer.Exit(2)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that is named; of an option that has moved, the error says where to."""
        try:
            return super().invoke(ctx)
        except Exception as error:
            name = str(getattr(error, "option_name", "")).removeprefix("--")
            if name in PAPERS:
                vars(error).update(message=f"--{name}: {unknown(name, ())}", possibilities=None)
            raise


def _named() -> bool:
    """Whether a package on the path names the group; 2 ms, where ``entry_points`` takes 15."""
    files = (file for place in sys.path for file in Path(place).glob("*-info/entry_points.txt"))
    return any(GROUP in file.read_text("utf-8", "replace") for file in files)


def _loaded(point: "EntryPoint") -> Any:
    """The command of an entry point, as Typer makes it."""
    function = point.load()
    if isinstance(function, typer.Typer):  # a command with sub-commands
        return typer.main.get_command(function)
    if not hasattr(function, "__signature__"):  # set by the decorator
        raise TypeError(f"{point.value} is not decorated with optipromp.cli.command.command")
    alone = typer.Typer(add_completion=False, rich_markup_mode="rich")
    alone.command(point.name)(function)
    return typer.main.get_command(alone)


app = typer.Typer(
    name="optipromp",
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"optipromp {version('optipromp')}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version and end."
        ),
    ] = False,
) -> None:
    """Reach a ripe fruit past its unripe neighbours. Start with [bold]optipromp plan scenario-4
    --out pick[/bold] and look into the folder pick."""


app.command("plan")(plan.plan)
app.command("validate")(check.validate)
app.command("export")(export.export)
app.command("report")(export.report)
app.command("learn")(learn.learn)
app.command("check")(check.check)
app.command("list")(catalogue.catalogue)


class _Interrupted(KeyboardInterrupt):
    """Ctrl-C. Of a plain one raised within ``exec`` of a text, CPython kills the process later."""


class _Signals:
    """What asks the process to end: the first signal's number, and whether it is ending."""

    asked: int | None = None
    ending = False

    @classmethod
    def raise_in_main(cls, number: int, frame: FrameType | None) -> None:
        """The handler: ``KeyboardInterrupt`` for Ctrl-C, ``SystemExit`` for the others."""
        if cls.ending:
            return
        cls.asked = cls.asked or number
        if _imports(frame):
            cls.send_later(number)
            return
        if number == signal.SIGINT:
            raise _Interrupted
        raise SystemExit(128 + number)

    @classmethod
    def send_later(cls, number: int) -> None:
        """Send the signal again in a moment, from another thread, unless the process is ending."""

        def send() -> None:
            if not cls.ending:
                os.kill(os.getpid(), number)

        threading.Timer(0.05, send).start()


def _imports(frame: FrameType | None) -> bool:
    """Whether a module is being imported: of an exception within, some from C fail or crash."""
    while frame is not None and frame.f_code.co_filename != "<frozen importlib._bootstrap>":
        frame = frame.f_back
    return frame is not None


def _send_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again whose exception was lost: callbacks from C (LLVM's) raise none."""
    number = {SystemExit: signal.SIGTERM, _Interrupted: signal.SIGINT}.get(lost.exc_type)
    if number is None:
        if _Signals.asked is None:  # else: of objects that are half-made
            sys.__unraisablehook__(lost)
    else:  # once the callback has returned
        _Signals.send_later(number)


def _ready_streams() -> None:
    """Make the standard streams accept all text: ``?`` for unknown letters; if closed, drop it."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() != "utf-8":
            stream.reconfigure(errors="replace")


def _run() -> None:
    try:
        try:
            further = sys.argv.index("--ros-args") if "--ros-args" in sys.argv else 0
            app(*([sys.argv[1:further]] if further else []))  # what follows is read by rclpy
        finally:
            sys.stdout.flush()
    except OSError as error:  # files raise typed errors: this is standard output
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for what is flushed at the end
        reason = error.strerror or str(error)
        sys.stderr.write(f"error INVALID_REQUEST: cannot write standard output: {reason}\n")
        raise SystemExit(2) from None
    except MemoryError:
        sys.stderr.write("error INVALID_REQUEST: out of memory\n")
        raise SystemExit(2) from None


def main() -> None:
    """Run the command line and end the process with its exit code. A process that a signal asked to
    end ends with 128 + the signal's number, whatever its exception became on the way."""
    _ready_streams()
    os.environ["MPLBACKEND"] = "agg"  # a terminal of Jupyter names one that need not be installed
    try:
        check_memory()
    except InvalidRequestError as error:
        sys.stderr.write(f"error {error.code}: {error}\n")
        raise SystemExit(2) from None
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:  # as shells do for what runs behind
            signal.signal(number, _Signals.raise_in_main)
    sys.unraisablehook = _send_again
    try:
        _run()
    except BaseException as error:
        _Signals.ending = True
        if _Signals.asked is None or (isinstance(error, SystemExit) and not error.code):
            raise
        word = "interrupted" if _Signals.asked == signal.SIGINT else "terminated"
        sys.stderr.write(f"{word}; nothing half-written was left\n")
        atexit._run_exitfuncs()
        sys.stderr.flush()
        os._exit(128 + _Signals.asked)  # LLVM's objects, half-made, can crash when they go
    finally:
        _Signals.ending = True
        gc.freeze()


if __name__ == "__main__":
    main()
