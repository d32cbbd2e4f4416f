"""Entries in other processes: Python classes apart from the judge, and policies of any language.

A policy at an address is sent a line of JSON for each call over a socket, and answers with a line.

===================================================================  =============================
``{"call": "reset", "scene": {…}, "seed": 7}``                       ``{}``; ``{"leaves": true}``
``{"call": "act", "time": 0.02, "q": […], "velocity": […],           ``{"velocity": […]}`` of the
"tool_point": […], "tool_axis": […], "force": […], "age": 0.06,      joints [rad/s or m/s]
"holding": false, "objects": […]}``
===================================================================  =============================

A scene is a scene file's document (docs/scene-format.md), and so are objects: the fruits as last
seen. A policy that ``leaves`` acts until its target is out of the plant
(:class:`optipromp_bench.tracks.Acting`). An answer ``{"error": "…"}`` ends the episode, and so does
one that is late (:class:`optipromp_bench.tracks.Patience`) or longer than 100,000 bytes.
``optipromp bench run --entry tcp:HOST:PORT --track policy`` asks such a policy; :func:`serve` makes
one of a Python class.
"""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.processes import THREADS, pickled
from optipromp.core.scenes.io import scene_from_dict, scene_to_dict
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory
from optipromp_bench.entrant import (
    DUMPABLE,
    IS_DUMPABLE,
    SERVED,
    SUBREAPER,
    Motion,
    Refused,
    prctl,
)
from optipromp_bench.episode import Observation
from optipromp_bench.experiments.eyes import without_fruits
from optipromp_bench.sets import entry_digest
from optipromp_bench.tracks import (
    ACTION,
    LINE,
    MOTION_FILE,
    PATIENCE,
    ROWS,
    Acting,
    EntryError,
    Patience,
)

T = TypeVar("T")
PLAIN: dict[str, Any] = {"target": "pushable"}  # for scenes of what is seen, with or without one
PLACES = "PWD", "OLDPWD", "_"  # variables that tell where the judge was started, and by what
VECTORS = "q", "velocity", "tool_point", "tool_axis", "force"  # of an observation


def velocity_of(answer: dict[str, Any]) -> FloatArray:
    """The joint velocities (n,) of an answer; raises EntryError where there are none."""
    told = answer.get("velocity")
    try:
        if isinstance(told, list) and len(told) <= ACTION:
            return np.array([float(value) for value in told])
    except (TypeError, ValueError, OverflowError):
        pass
    raise EntryError(f"the answer was {str(answer)[:200]}; must be {{'velocity': [...]}}")


class Remote:
    """An entry at the other end of a socket: each call is answered by a line of JSON within a time.

    The time is of the whole answer, so that one byte at a time gains nothing. The socket is closed
    when an answer fails.
    """

    def __init__(self, patience: Patience = PATIENCE) -> None:
        self.patience = patience
        self._socket: socket.socket | None = None

    def _ask(self, message: bytes, seconds: float, read: Callable[[dict[str, Any]], T]) -> T:
        """What ``read`` makes of the answer to a message. Raises EntryError where there is none."""
        assert self._socket is not None, "call begin first"
        self._until, self._rest = time.monotonic() + seconds, bytearray()
        try:
            self._socket.settimeout(seconds)
            self._socket.sendall(message)
            answer = self._line()
            if "error" not in answer:
                return read(answer)
        except TimeoutError:
            cause = f"no answer within {seconds:g} s"
        except (OSError, EOFError):
            cause = self._ended()
        except (ValueError, InvalidRequestError) as error:
            cause = str(error)
        else:
            raise EntryError(str(answer["error"]))
        self.close()
        raise EntryError(cause)

    def _line(self) -> dict[str, Any]:
        while (end := self._rest.find(b"\n")) < 0:
            if len(self._rest) > LINE:
                raise ValueError(f"an answer of more than {LINE} bytes without the end of its line")
            self._hear()
        line = bytes(self._rest[:end])
        del self._rest[: end + 1]
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            told = line[:200].decode("utf-8", "replace")
            raise ValueError(f"the answer was {told!r}; must be a JSON object")
        return answer

    def _bytes(self, count: int) -> bytes:
        """The next bytes after the line of an answer."""
        while len(self._rest) < count:
            self._hear()
        out = bytes(self._rest[:count])
        del self._rest[:count]
        return out

    def _hear(self) -> None:
        left = self._until - time.monotonic()
        if left <= 0.0 or self._socket is None:
            raise TimeoutError
        self._socket.settimeout(left)
        got = self._socket.recv(1 << 16)
        if not got:
            raise EOFError
        self._rest += got

    def _ended(self) -> str:
        """Why the other side is gone."""
        return "the policy hung up"

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class Served(Remote):
    """A policy at ``HOST:PORT`` (without a host: of this machine), as an entry."""

    def __init__(self, address: str, patience: Patience = PATIENCE) -> None:
        super().__init__(patience)
        self.address = address
        self._scene: Scene | None = None

    def begin(self) -> None:
        """Connect, anew for each episode. Raises EntryError where nobody listens."""
        self.close()
        host, _, port = self.address.rpartition(":")
        try:
            place = host or "127.0.0.1", int(port)
            self._socket = socket.create_connection(place, self.patience.reset)
        except (OSError, ValueError, OverflowError) as error:
            raise EntryError(
                f"no policy answers at {self.address!r} ({error}): start it, then give "
                "tcp:HOST:PORT"
            ) from None

    def reset(self, scene: Scene, seed: int) -> None:
        self._scene = scene
        told = {"call": "reset", "scene": scene_to_dict(scene), "seed": seed}
        self.leaves = self._ask(_packed(told), self.patience.reset, _leaves)

    def act(self, seen: Observation) -> FloatArray:
        assert self._scene is not None
        told = {
            "call": "act", "time": seen.time, "age": seen.age, "holding": seen.holding,
            **{name: getattr(seen, name).tolist() for name in VECTORS},
            "objects": _objects((*seen.fruits, *self._scene.static), self._scene),
        }  # fmt: skip
        return self._ask(_packed(told), self.patience.act, velocity_of)


def _leaves(answer: dict[str, Any]) -> bool:
    return answer.get("leaves") is True


def _objects(items: Sequence[SceneObject], scene: Scene) -> list[dict[str, Any]]:
    """The objects of a scene's document, among which there may be no target."""
    plain = tuple(replace(item, role=PLAIN.get(item.role, item.role)) for item in items)
    told = scene_to_dict(replace(without_fruits(scene), objects=plain))["objects"]
    return [{**each, "role": item.role} for each, item in zip(told, items, strict=True)]


def _packed(message: dict[str, Any]) -> bytes:
    return json.dumps(message).encode() + b"\n"


def serve(policy: Acting, port: int = 0, host: str = "127.0.0.1", calls: int | None = None) -> None:
    """Serve a Python policy, one caller after the other; prints the address first.

    ``port``: to listen at; 0: any free one. ``calls``: number of callers, after which it ends;
    None: it never ends.
    """
    with socket.create_server((host, port)) as listening:
        print(f"tcp:{host}:{listening.getsockname()[1]}", flush=True)  # noqa: T201 (for the caller)
        while calls is None or calls > 0:
            calls = None if calls is None else calls - 1
            caller, _ = listening.accept()
            with suppress(OSError), caller, caller.makefile("rwb") as stream:
                scene: Scene | None = None
                for line in stream:
                    try:
                        message = json.loads(line)
                        if message["call"] == "reset":
                            scene = scene_from_dict(message["scene"])
                            policy.reset(scene, message["seed"])
                            told = _packed({"leaves": getattr(policy, "leaves", False) is True})
                        else:
                            assert scene is not None, "act came before reset"
                            acted = policy.act(_seen(message, scene))
                            told = _packed({"velocity": acted.tolist()})
                    except Exception as error:  # the caller tells of it
                        told = _packed({"error": f"{type(error).__name__}: {error}"})
                    stream.write(told)
                    stream.flush()


def _seen(message: dict[str, Any], scene: Scene) -> Observation:
    bare, told = scene_to_dict(without_fruits(scene)), message["objects"]
    roles = [each["role"] for each in told]
    plain = [{**each, "role": PLAIN.get(each["role"], each["role"])} for each in told]
    found = scene_from_dict({**bare, "objects": plain}).objects
    items = [replace(item, role=role) for item, role in zip(found, roles, strict=True)]
    values: dict[str, Any] = {name: np.array(message[name]) for name in VECTORS}
    values |= {name: message[name] for name in ("time", "age", "holding")}
    fruits = tuple(item for item in items if item.role != "static")
    return Observation(fruits=fruits, **values)


LAST = 2.0  # [s] for a process that hung up to end by itself, and for orphans: a choice


class Apart(Remote):
    """An entry of a track in a process of its own, which begins anew after it died or overran.

    The process gets scenes and seeds, by pickles. What comes back is never unpickled: a line of
    JSON, and the numbers of a motion. The entry's working folder is empty and its own; neither the
    word of the set nor the folder of the run is among its arguments or in its environment. What it
    imports is a copy of what its ``digest`` covers; empty: any digest will do.
    """

    def __init__(
        self, spec: str, track: str, patience: Patience = PATIENCE, digest: str = ""
    ) -> None:
        super().__init__(patience)
        self.spec, self.track, self.digest = spec, track, digest
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def begin(self) -> None:
        """Make the entry anew for a scene or an episode. Raises EntryError where it cannot."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._start()
        told = pickled(("make", self.spec, self.track))
        self.leaves = self._ask(told, self.patience.start, _leaves)

    def plan(self, *given: Any) -> Motion | Refused:
        """The answer of the entry's ``plan``. Raises EntryError where there is none."""
        return self._ask(pickled(("plan", *given)), self.patience.plan, self._motion)

    def _motion(self, answer: dict[str, Any]) -> Motion | Refused:
        if isinstance(answer.get("refused"), str):
            return Refused(answer["refused"])
        counts, names = answer.get("rows"), answer.get("names")
        if not (isinstance(counts, list) and 1 <= len(counts) <= 2 and isinstance(names, list)):
            raise ValueError(f"rows are {counts}; must be one count or two, with names of joints")
        wide = 3 * len(names) + 1
        for rows in counts:
            if type(rows) is not int or not 2 <= rows <= ROWS:
                raise ValueError(f"the motion has {rows} rows; must have 2 to {ROWS}")
        if 8 * sum(counts) * wide > MOTION_FILE:
            raise ValueError(f"the motion has {sum(counts)} rows of {len(names)} joints: too large")
        return Motion(*(self._curve(rows, wide, tuple(map(str, names))) for rows in counts))

    def _curve(self, rows: int, wide: int, names: tuple[str, ...]) -> Trajectory:
        table = np.frombuffer(self._bytes(8 * rows * wide), dtype="<f8").reshape(rows, wide)
        q, velocities, accelerations = np.split(table[:, 1:], 3, axis=1)
        return Trajectory(table[:, 0], q, velocities, accelerations, names)

    def reset(self, scene: Scene, seed: int) -> None:
        self._ask(pickled(("reset", scene, seed)), self.patience.reset, bool)

    def act(self, seen: Observation) -> FloatArray:
        return self._ask(pickled(("act", seen)), self.patience.act, velocity_of)

    def _start(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="entry-", ignore_cleanup_errors=True)
        source, work = (Path(self._folder.name, name) for name in ("source", "work"))
        source.mkdir()
        work.mkdir()
        found = entry_digest(self.spec, source)
        if self.digest not in ("", found):
            raise EntryError(f"the source of {self.spec!r} changed during the run: begin anew")
        ours, theirs = socket.socketpair()
        theirs.set_inheritable(True)
        number, posix = theirs.fileno(), os.name == "posix"
        path = os.pathsep.join(str(Path(each).absolute()) for each in sys.path if each)
        _running.add(id(self))
        prctl(SUBREAPER, 1)  # what outlives the entry's process becomes a child of this one
        _known.update(_children())
        self._process = subprocess.Popen(
            [sys.executable, "-m", "optipromp_bench.entrant", str(number), str(source)],
            stdin=subprocess.DEVNULL, stdout=2, cwd=work,
            env={k: v for k, v in os.environ.items() if k not in PLACES}
            | {**THREADS, "PYTHONPATH": path},
            close_fds=posix, pass_fds=(number,) if posix else (), start_new_session=posix,
        )  # fmt: skip
        _known.add(self._process.pid)
        theirs.close()
        self._socket = ours

    def _ended(self) -> str:
        assert self._process is not None
        try:
            code = self._process.wait(LAST)
        except subprocess.TimeoutExpired:
            return "its process hung up"
        return f"its process ended ({f'signal {-code}' if code < 0 else f'exit code {code}'})"

    def close(self) -> None:
        """End the process, and all that it started, and remove its folder."""
        super().close()
        if self._process is not None:
            with suppress(ProcessLookupError):
                if os.name == "posix":
                    os.killpg(self._process.pid, signal.SIGKILL)
                else:
                    self._process.kill()
            self._process.wait()
            _bury()
            _running.discard(id(self))
            prctl(SUBREAPER, int(bool(_running)))  # orphans of others are not for this process
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._folder = None


def hide() -> None:
    """Let no process of the same user read this one's memory, where the word of a set is."""
    prctl(DUMPABLE, 0)


@contextmanager
def unread() -> Iterator[None]:
    """Within it, no process of the same user reads this one's memory, and none its arguments: of
    Linux alone. The arguments of what this process was started by stay."""
    before, start, told = prctl(IS_DUMPABLE), 0, b""
    if sys.platform == "linux":
        place = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        start, end = int(place[45]), int(place[46])  # fields 48 and 49 of proc(5)
        told = ctypes.string_at(start, end - start) if 0 < start < end else b""
    hide()
    ctypes.memmove(start, told.partition(b"\0")[0].ljust(len(told), b"\0"), len(told))
    try:
        yield
    finally:
        ctypes.memmove(start, told, len(told))
        prctl(DUMPABLE, before)


_known = set[int]()  # children of this process that no entry left behind
_running = set[int]()  # entries that have a process, by id()


def _children() -> set[int]:
    """The children of this process in other sessions, of Linux alone: no entry can join ours."""
    out = set[int]()
    for each in Path("/proc/self/task").glob("*/children"):
        with suppress(OSError):  # a thread or a child ended
            out |= {k for k in map(int, each.read_text().split()) if os.getsid(k) != os.getsid(0)}
    return out


def _bury() -> None:
    """End what an entry left behind, each of which is a child of this process by now."""
    until = time.monotonic() + LAST
    while (orphans := _children() - _known) and time.monotonic() < until:
        for number in orphans:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(number, signal.SIGKILL)
                os.waitpid(number, 0)


Entry = Apart | Served
_staff: dict[tuple[str, str, Patience, str], Entry] = {}  # one process an entry, for all scenes


def hired(spec: str, track: str, patience: Patience = PATIENCE, digest: str = "") -> Entry:
    """The entry of a name, MODULE:CLASS or tcp:HOST:PORT, in the one process that is for it."""
    if spec.startswith(SERVED) and track != "policy":
        raise InvalidRequestError(f"entry {spec!r} is of the track policy; this one is {track}")
    key = spec, track, patience, digest
    if not _staff:
        Finalize(None, dismissed, exitpriority=10)  # also in a worker, which ends without atexit
    if key not in _staff:
        if spec.startswith(SERVED):
            _staff[key] = Served(spec.removeprefix(SERVED), patience)
        else:
            _staff[key] = Apart(spec, track, patience, digest)
    return _staff[key]


def dismissed() -> None:
    """End the processes of all entries."""
    while _staff:
        _staff.popitem()[1].close()
