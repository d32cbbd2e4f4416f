"""An entry in a process of its own, which knows neither the judge nor the run.

``python -m optipromp_bench.entrant FD`` answers :class:`optipromp_bench.serve.Apart` over the
socket FD: pickled calls come in, lines of JSON go out, and after the line of a motion its numbers.
"""

import ctypes
import importlib
import json
import os
import pickle
import socket
import sys
import sysconfig
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.errors import InvalidRequestError, suggest
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.result import RETREAT
from optipromp.core.trajectory import Trajectory

SERVED = "tcp:"
"""Beginning of the name of an entry that another process serves (:mod:`optipromp_bench.serve`)."""
IS_DUMPABLE, DUMPABLE, SUBREAPER, NO_NEW_PRIVS = 3, 4, 36, 38  # PR_GET_ and PR_SET_ of prctl(2)
CAPSET = 0x20080522  # version of capset(2) with two words a set


def prctl(option: int, value: int = 0) -> int:
    """Change, or get, what Linux lets a process do; elsewhere nothing happens."""
    return ctypes.CDLL(None).prctl(option, value, 0, 0, 0) if sys.platform == "linux" else 0


def confined() -> None:
    """Give up the rights of root that read another process's memory, for good."""
    prctl(NO_NEW_PRIVS, 1)
    if sys.platform == "linux":
        header, nothing = (ctypes.c_uint32 * 2)(CAPSET, 0), (ctypes.c_uint32 * 6)()
        ctypes.CDLL(None).capset(header, nothing)


def installed(place: str) -> bool:
    """Whether a folder of Python's path holds what is installed, or the packages of this library.

    An entry imports nothing else but what its digest covers.
    """
    path = Path(place).absolute()
    return (
        path.name in ("site-packages", "dist-packages")
        or any(path.is_relative_to(sysconfig.get_path(n)) for n in ("stdlib", "platstdlib"))
        or any(path.glob("optipromp*/py.typed"))
    )


class Refused(NamedTuple):
    """An answer without a motion, and why."""

    why: str = "refused"


class Motion(NamedTuple):
    """What an entry does in a scene."""

    reach: Trajectory
    back: Trajectory | None = None  # out of the plant with the target; None: as the tool came


def parts(spec: str) -> tuple[str, str]:
    """Module and class of a name in :data:`optipromp_bench.entries.ENTRIES`, or of MODULE:CLASS."""
    from optipromp_bench.entries import ENTRIES

    known = ENTRIES.get(spec)
    module, colon, attribute = (known.spec if known else spec).partition(":")
    if not (colon and all(part.isidentifier() or known for part in attribute.split("."))):
        raise InvalidRequestError(
            f"entry is {spec!r}: {suggest(spec, tuple(ENTRIES))}, MODULE:CLASS or tcp:HOST:PORT"
        )
    return module, attribute


def loaded(spec: str, track: str) -> Any:
    """The entry of :func:`parts`, made anew."""
    module, attribute = parts(spec)
    try:
        entry: Any = importlib.import_module(module)
        for name in attribute.split("."):
            entry = getattr(entry, name)
        entry = entry()
    except BaseException as error:  # whatever a module does while it is imported
        raise InvalidRequestError(
            f"entry {spec!r} cannot be made ({type(error).__name__}: {error}); an entry is "
            "MODULE:CLASS, of a class without arguments, and imports its own package and what is "
            "installed, nothing beside them"
        ) from None
    for name in ("reset", "act") if track == "policy" else ("plan",):
        if not callable(getattr(entry, name, None)):
            raise InvalidRequestError(
                f"{type(entry).__name__} has no method {name}; the track {track} asks for it"
            )
    return entry


def motion_of(answer: object) -> Motion | Refused:
    """The motion of an entry's answer."""
    if isinstance(answer, Plan | Picked) and not answer.success:
        return Refused(f"{answer.status}: {answer.message}")
    if isinstance(answer, Picked):
        back = answer.legs.get(RETREAT)
        return Motion(answer.reach.trajectory, None if back is None else back.trajectory)
    if isinstance(answer, Plan):
        return Motion(answer.trajectory)
    if isinstance(answer, Trajectory):
        return Motion(answer)
    if answer is None:
        return Refused()
    if not isinstance(answer, Motion | Refused):
        raise InvalidRequestError(
            f"the entry gave a {type(answer).__name__}; must be a Trajectory, a Plan, a Picked or "
            "None"
        )
    return answer


def answered(entry: Any, call: str, given: list[Any]) -> tuple[Any, Mapping[str, Any], bytes]:
    """The entry, made by ``make``; the line of its answer; and the numbers after that."""
    if call == "make":
        entry = loaded(*given)
        return entry, {"leaves": getattr(entry, "leaves", False) is True}, b""
    if call == "plan":
        made = motion_of(entry.plan(*given))
        if isinstance(made, Refused):
            return entry, {"refused": made.why[:2000]}, b""
        curves = [each for each in made if each is not None]
        tables = [np.column_stack([each.times, *each.rows()]).astype("<f8") for each in curves]
        line = {"rows": [len(table) for table in tables], "names": made.reach.joint_names}
        return entry, line, b"".join(table.tobytes() for table in tables)
    told = getattr(entry, call)(*given)
    velocity = np.array(told, dtype=np.float64).tolist() if call == "act" else []
    return entry, {"velocity": velocity}, b""


def main(number: int, source: str) -> None:
    """Answer over a socket until the caller hangs up; entries are imported from ``source``."""
    caller = os.getppid()
    confined()

    def watch() -> None:
        while os.getppid() == caller:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    from optipromp.core import ready  # noqa: F401  (compiles now, not while an entry thinks)

    sys.path[:] = [source, *filter(installed, sys.path)]
    entry: Any = None
    with socket.socket(fileno=number) as own, own.makefile("rwb") as stream:
        while stream.peek(1):
            call, *given = pickle.load(stream)
            try:
                entry, line, numbers = answered(entry, call, given)
            except InvalidRequestError as error:
                line, numbers = {"error": error.message}, b""
            except BaseException as error:  # SystemExit, too: this scene's row tells of it
                line, numbers = {"error": f"{type(error).__name__}: {error}"[:2000]}, b""
            stream.write(json.dumps(line).encode() + b"\n" + numbers)
            stream.flush()


if __name__ == "__main__":  # by the name of the module, whose classes are those of entries
    importlib.import_module("optipromp_bench.entrant").main(int(sys.argv[1]), sys.argv[2])
