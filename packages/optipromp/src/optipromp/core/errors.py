"""The errors of the library, one root, one code each, and the words of refusals.

Wrong input raises one of these; a plan that fails is a returned value that carries the code
(:class:`optipromp.core.planning.Plan`).
"""

import difflib
import reprlib
import traceback
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path


def installed_by(what: str) -> str:
    """The command that installs a package of ours, or its extra; it is run in a clone."""
    return f"pip install -e 'packages/{what}' in the clone of OptI-ProMP"


class Code(StrEnum):
    """The outcome of a request, as a word for programs to compare."""

    SUCCESS = "success"
    INVALID_ROBOT = "INVALID_ROBOT"
    INVALID_SCENE = "INVALID_SCENE"
    INVALID_DEMONSTRATION = "INVALID_DEMONSTRATION"
    INVALID_REQUEST = "INVALID_REQUEST"
    START_INVALID = "START_INVALID"
    START_IN_COLLISION = "START_IN_COLLISION"
    GOAL_IN_COLLISION = "GOAL_IN_COLLISION"
    GOAL_UNREACHABLE = "GOAL_UNREACHABLE"
    NO_PLAN = "NO_PLAN"
    INVALID_PLAN = "INVALID_PLAN"
    HARM_PREDICTED = "HARM_PREDICTED"
    TIMEOUT = "TIMEOUT"
    EXECUTION_FAILED = "EXECUTION_FAILED"


LONGEST_MESSAGE = 2000  # most letters of a message; the middle of a longer message is cut out


class OptiPrompError(Exception):
    """Root of every error raised on purpose, with its ``code`` and its ``message``."""

    code: Code = Code.INVALID_REQUEST

    def __init__(self, message: str) -> None:
        if len(message) > LONGEST_MESSAGE:
            half = LONGEST_MESSAGE // 2 - 3
            message = f"{message[:half]} ... {message[-half:]}"
        super().__init__(message)
        self.message = message


class InvalidRobotError(OptiPrompError):
    """A robot description that cannot be used."""

    code = Code.INVALID_ROBOT


class InvalidSceneError(OptiPrompError):
    """A scene that cannot be used."""

    code = Code.INVALID_SCENE


class InvalidDemonstrationError(OptiPrompError):
    """Demonstrations that cannot be read or learnt from."""

    code = Code.INVALID_DEMONSTRATION


class InvalidRequestError(OptiPrompError):
    """An argument or option that is not allowed."""


@contextmanager
def others_code(what: str) -> Iterator[None]:
    """Raise what the code of somebody else raises as InvalidRequestError, which begins ``what``."""
    try:
        yield
    except OptiPrompError:
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}, line {last.lineno}"
        raise InvalidRequestError(f"{what}: {type(error).__name__}: {error} ({where})") from error


class InvalidPlanError(OptiPrompError):
    """A plan's file whose status is better than the judge's status of its trajectory."""

    code = Code.INVALID_PLAN


class StartInvalidError(OptiPrompError):
    """The start configuration breaks a joint limit or has the wrong size."""

    code = Code.START_INVALID


class NoPlanError(OptiPrompError):
    """Planning ended without a trajectory to judge."""

    code = Code.NO_PLAN


class ExecutionError(OptiPrompError):
    """A motion that failed: reading the arm's state, its controller, or ``watch``.

    ``executed``: the motion until then (:class:`optipromp.core.execution.Executed`), or None.
    """

    code = Code.EXECUTION_FAILED

    def __init__(self, message: str, executed: object = None) -> None:
        super().__init__(message)
        self.executed = executed


LONGEST_NAME = 1000  # most letters of a name

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60


def is_name(text: str) -> bool:
    """Whether ``text`` can name something: 1 to :data:`LONGEST_NAME` letters, all printable."""
    return 0 < len(text) <= LONGEST_NAME and printable(text) == text


def no_name(text: str) -> str:
    """The words of a refusal of ``text``, which is no name."""
    return (
        f"'{printable(text)[:60]}': must have 1 to {LONGEST_NAME} letters and no control characters"
    )


def short(value: object) -> str:
    """A value in at most some 60 letters."""
    return _SHORT.repr(value)


def suggest(name: object, valid: Iterable[str]) -> str:
    """``valid are ...``, and ``did you mean ...?`` if a valid name is close to ``name``."""
    names = list(valid)
    near = difflib.get_close_matches(str(name), names, n=1)
    question = f"; did you mean {near[0]!r}?" if near else ""
    return f"valid are {', '.join(names)}{question}"


PAPERS = "strategy", "constraints", "paper"  # settings of the paper's planner, to version 0.3.0


def unknown(setting: str, valid: Iterable[str]) -> str:
    """What to write in place of a name that is no setting; of :data:`PAPERS`, where they are."""
    if setting.partition(".")[0] not in PAPERS:
        return suggest(setting, valid)
    key = setting.removeprefix("paper.").replace("paper", "NAME")
    return (
        f"a setting of the paper's planner: write planner=optipromp.Paper({key}=...), or --planner "
        f"paper --set {key}=...; those of promp and i-promp likewise"
    )


def check_one_of(what: str, value: object, valid: Collection[str]) -> None:
    """Refuse a value that is none of the valid names."""
    if not (isinstance(value, str) and value in valid):
        raise InvalidRequestError(f"{what} is {value!r}: {suggest(value, valid)}")


def printable(text: str) -> str:
    """``text`` with characters escaped that control a terminal or the direction of writing."""
    if text.isprintable():
        return text
    joiners = "\u200c\u200d"  # which some scripts need
    return "".join(
        letter
        if letter.isprintable() or letter in joiners or letter == "\u00a0"
        else letter.encode("unicode_escape").decode()
        for letter in text
    )
