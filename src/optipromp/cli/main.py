"""``optipromp``: the command and its sub-commands.

Nothing heavy is imported here: each command imports what it needs when it runs.
"""

import gc
import io
import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Annotated, NoReturn

import typer

from optipromp.cli import (
    bench,
    calibrate,
    catalogue,
    check,
    episodes,
    export,
    generate,
    learn,
    plan,
    render,
    report,
    ros_node,
    scenarios,
    see,
    simulate,
    study,
    validate,
    view,
)
from optipromp.cli.registry import Commands
from optipromp.core.budget import check_memory
from optipromp.core.errors import InvalidRequestError

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
    """Reach a ripe fruit past its unripe neighbours.

    Start with [bold]optipromp plan scenario-3 --out reach[/bold] and look into the folder reach.
    """


app.command("plan")(plan.plan)
app.command("scenarios")(scenarios.scenarios)
app.command("simulate")(simulate.simulate)
app.command("validate")(validate.validate)
app.command("view")(view.view)
app.command("export")(export.export)
app.command("generate")(generate.generate)
app.command("render")(render.render)
app.command("see")(see.see)
app.command("calibrate")(calibrate.calibrate)
app.command("study")(study.study)
app.add_typer(bench.bench)
app.command("episodes")(episodes.episodes)
app.command("report")(report.report)
app.command("learn")(learn.learn)
app.command("check")(check.check)
app.command("list")(catalogue.catalogue)
app.command("ros-node")(ros_node.ros_node)


def _terminate(number: int, frame: FrameType | None) -> NoReturn:
    sys.stderr.write("terminated; nothing half-written was left\n")
    raise SystemExit(128 + number)


def _send_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again whose exception was lost: callbacks from C (LLVM's) raise none."""
    number = {SystemExit: signal.SIGTERM, KeyboardInterrupt: signal.SIGINT}.get(lost.exc_type)
    if number is None:
        sys.__unraisablehook__(lost)
    else:  # from another thread, once the callback has returned
        threading.Timer(0.05, os.kill, (os.getpid(), number)).start()


def _ready_streams() -> None:
    """Make the standard streams accept all text: ``?`` for unknown letters; if closed, drop it."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        elif isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() != "utf-8":
            stream.reconfigure(errors="replace")


def main() -> None:
    """Run the command line and end the process with its exit code."""
    _ready_streams()
    try:
        check_memory()
    except InvalidRequestError as error:
        sys.stderr.write(f"error {error.code}: {error}\n")
        raise SystemExit(2) from None
    signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = _send_again
    try:
        try:
            app()
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
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        raise SystemExit(130) from None
    finally:
        gc.freeze()


if __name__ == "__main__":
    main()
