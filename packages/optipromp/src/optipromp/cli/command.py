"""A command: a function that returns a report, printed once: as JSON, or for people."""

import inspect
import json
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, wraps
from typing import Annotated, Any, get_origin, get_type_hints

import typer

from optipromp.cli.console import stdout
from optipromp.core.errors import Code, OptiPrompError, printable
from optipromp.core.files import json_text

Shown = Iterable[Any]
"""Lines and rich's renderables, for people; a generator does not run under ``--json``."""

OK, FAILED, WRONG_INPUT = 0, 1, 2
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
_KEYWORD, _ARGUMENT = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_ONLY
_JSON = typer.Option("--json", help="Print one JSON document and nothing else.")
_AS_JSON = inspect.Parameter("as_json", _KEYWORD, default=False, annotation=Annotated[bool, _JSON])


@dataclass(frozen=True)
class Report:
    """The answer of a command."""

    document: object  # printed under ``--json``
    shown: Shown  # lines and tables for people
    code: int = OK  # the exit code

    def print(self, as_json: bool) -> None:
        """Print the report on standard output."""
        if as_json:
            print_json(self.document)
            return
        console = stdout()
        for part in self.shown:
            console.print(part, soft_wrap=getattr(part, "no_wrap", None))  # of a Text


def exit_code(code: Code) -> int:
    """0 for success, 1 for right input without a valid plan, 2 for wrong input."""
    if code is Code.SUCCESS:
        return OK
    return FAILED if code in _OUTCOMES else WRONG_INPUT


def print_json(document: object) -> None:
    """Print one JSON document on standard output; NaN and infinities become null."""
    text = json_text(document)
    if (sys.stdout.encoding or "utf-8").lower() != "utf-8":
        text = json.dumps(json.loads(text), indent=2) + "\n"  # in ASCII
    sys.stdout.write(text)


def command(
    failure: Callable[[Mapping[str, Any]], dict[str, Any]] = lambda _: {}, *, reports: bool = True
) -> Callable[[Callable[..., Report | None]], Callable[..., None]]:
    """Turn a function that returns a :class:`Report` into a command for Typer.

    A parameter whose annotation is a dataclass stands for a group of options: one for each field.
    What ``Args:`` or ``Attributes:`` in the docstring say of a parameter is its help, and is left
    out of the command's own help; see :func:`entries`. A positional-only parameter is an argument.
    The option ``--json`` comes before the function's keyword-only parameters.

    A typed error becomes one line on standard error and its exit code; under ``--json`` standard
    output still gets one document.

    ``failure``: what the document of an error says besides its status and message, by the
    arguments. ``reports``: False for a command that serves until it is stopped, without ``--json``.
    """

    def decorate(function: Callable[..., Report | None]) -> Callable[..., None]:
        signature = inspect.signature(function, eval_str=True)
        asked, said = signature.parameters.values(), entries(function, "Args")
        if unknown := said.keys() - signature.parameters.keys():
            raise TypeError(f"{function.__name__}: no parameter {', '.join(sorted(unknown))}")
        parameters = [
            *_flat([each for each in asked if each.kind is not _KEYWORD], said),
            *([_AS_JSON] if reports else []),
            *_flat([each for each in asked if each.kind is _KEYWORD], said),
        ]
        groups: dict[str, Any] = {
            each.name: each.annotation for each in asked if is_dataclass(each.annotation)
        }

        @wraps(function)
        def run(**given: Any) -> None:
            as_json = given.get("as_json", False)
            if as_json and given.get("progress", False) is None:
                given["progress"] = False
            arguments = {name: given[name] for name in signature.parameters if name in given}
            for name, group in groups.items():
                arguments[name] = group(**{one.name: given[one.name] for one in fields(group)})
            first = [arguments.pop(each.name) for each in asked if each.kind is _ARGUMENT]
            code = OK
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("default", UserWarning)
                    tell = cache(show_warning)  # the same words once a command
                    warnings.showwarning = lambda message, *_, **__: tell(str(message))
                    report = function(*first, **arguments)
                    if report is not None:
                        report.print(as_json)
                        code = report.code
            except OptiPrompError as error:
                if as_json:
                    print_json({**failure(given), "status": error.code, "message": error.message})
                sys.stderr.write(f"error {error.code}: {_one_line(error.message)}\n")
                raise typer.Exit(exit_code(error.code)) from None
            raise typer.Exit(code)

        run.__doc__ = _help(inspect.cleandoc(function.__doc__ or ""))
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        vars(run)["__signature__"] = inspect.Signature(parameters)  # what Typer reads
        return run

    return decorate


def _help(text: str) -> str:
    """A docstring as Typer reads it: without ``Args:``, the lines of ``Examples:`` as they are."""
    told, *found = re.split(
        r"^(Examples?):\n", text.partition("\n\nArgs:\n")[0], flags=re.MULTILINE
    )
    return told + (f"[bold]{found[0]}[/bold]\n\n\b\n{textwrap.dedent(found[1])}" if found else "")


def entries(of: Any, section: str) -> dict[str, tuple[str, str]]:
    """The last ``section`` of a docstring, by name: what stands in brackets, and the text. In the
    brackets of an option are its declarations (by default the name), its bounds as ``A..B``,
    ``A..`` or ``..B``, and the word in place of its value: ``port (--port NUMBER 0..65535): Of the
    page.``"""
    text = inspect.cleandoc(of.__doc__ or "").rpartition(f"{section}:\n")[2]
    parts = re.split(r"^    (?=\w+(?: \(.*?\))?: )", text, flags=re.MULTILINE)[1:]
    found = [re.match(r"(\w+)(?: \((.*?)\))?: (.*)", " ".join(part.split())) for part in parts]
    return {each[1]: (each[2] or "", each[3]) for each in found if each}


def _flat(
    parameters: Sequence[inspect.Parameter], said: Mapping[str, tuple[str, str]]
) -> list[inspect.Parameter]:
    """The parameters, by keyword and with their options; a group's fields in its place."""
    out = []
    for each in parameters:
        if is_dataclass(each.annotation):
            hints = get_type_hints(each.annotation, include_extras=True)
            of_group = [
                inspect.Parameter(
                    one.name, _KEYWORD, default=one.default, annotation=hints[one.name]
                )
                for one in fields(each.annotation)
            ]
            out += _flat(of_group, entries(each.annotation, "Attributes"))
        else:
            stated = _stated(each, *said[each.name]) if each.name in said else each.annotation
            out.append(each.replace(kind=_KEYWORD, annotation=stated))
    return out


def _stated(each: inspect.Parameter, brackets: str, text: str) -> Any:
    """The annotation of a parameter of which a docstring says ``brackets`` and ``text``."""
    if get_origin(each.annotation) is Annotated:
        return each.annotation
    declared, shown, bounds = list[str](), list[str](), ("", "")
    for word in brackets.split():
        if found := re.fullmatch(r"(\d*)\.\.(\d*)", word):
            bounds = found[1], found[2]
        else:
            (declared if word.startswith("--") else shown).append(word)
    least, most = (int(bound) if bound else None for bound in bounds)
    metavar = " ".join(shown) or None
    if each.kind is _ARGUMENT:
        return Annotated[each.annotation, typer.Argument(metavar=metavar, help=text)]
    if each.annotation is bool and not each.default and not declared:
        declared = [f"--{each.name.replace('_', '-')}"]  # without a --no-
    shows = not (each.default is None or each.default is False)
    option = typer.Option(
        *declared, metavar=metavar, help=text, min=least, max=most, show_default=shows
    )
    return Annotated[each.annotation, option]


def show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Show a warning as one line on standard error."""
    sys.stderr.write(f"warning: {_one_line(str(message))}\n")


def _one_line(message: str) -> str:
    return printable(" ".join(message.split()))
