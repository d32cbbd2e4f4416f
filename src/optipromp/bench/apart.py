"""The judge's side of an entry in a process of its own.

The process gets scenes and seeds, by pickles. What comes back is never unpickled: a line of JSON,
and the numbers of a motion. The entry's working folder is empty and its own; neither the word of
the set nor the folder of the run is among its arguments or in its environment.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.bench.entrant import Refused
from optipromp.bench.episode import Observation
from optipromp.bench.limits import MOTION_FILE, PATIENCE, ROWS, Patience
from optipromp.bench.serve import Remote, Served, velocity_of
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.processes import THREADS, pickled
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory

SERVED = "tcp:"
"""Beginning of the name of an entry that another process serves (:mod:`optipromp.bench.serve`)."""
LAST = 2.0  # [s] for a process that hung up to end by itself: a choice


class Apart(Remote):
    """An entry of a track in a process of its own, which begins anew after it died or overran."""

    def __init__(self, spec: str, track: str, patience: Patience = PATIENCE) -> None:
        super().__init__(patience)
        self.spec, self.track = spec, track
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def begin(self) -> None:
        """Make the entry anew for a scene or an episode. Raises EntryError where it cannot."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._start()
        told = pickled(("make", str(Path.cwd()), self.spec, self.track))
        self._ask(told, self.patience.start, bool)

    def plan(self, *given: Any) -> Trajectory | Refused:
        """The answer of the entry's ``plan``. Raises EntryError where there is none."""
        return self._ask(pickled(("plan", *given)), self.patience.plan, self._motion)

    def _motion(self, answer: dict[str, Any]) -> Trajectory | Refused:
        if isinstance(answer.get("refused"), str):
            return Refused(answer["refused"])
        rows, names = answer.get("rows"), answer.get("names")
        if type(rows) is not int or not isinstance(names, list) or not 2 <= rows <= ROWS:
            raise ValueError(f"the motion has {rows} rows; must have 2 to {ROWS}")
        wide = 3 * len(names) + 1
        if 8 * rows * wide > MOTION_FILE:
            raise ValueError(f"the motion has {rows} rows of {len(names)} joints: too large")
        table = np.frombuffer(self._bytes(8 * rows * wide), dtype="<f8").reshape(rows, wide)
        q, velocities, accelerations = np.split(table[:, 1:], 3, axis=1)
        return Trajectory(table[:, 0], q, velocities, accelerations, tuple(map(str, names)))

    def reset(self, scene: Scene, seed: int) -> None:
        """See :class:`optipromp.bench.tracks.Acting`."""
        self._ask(pickled(("reset", scene, seed)), self.patience.reset, bool)

    def act(self, seen: Observation) -> FloatArray:
        """See :class:`optipromp.bench.tracks.Acting`."""
        return self._ask(pickled(("act", seen)), self.patience.act, velocity_of)

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        theirs.set_inheritable(True)
        self._folder = tempfile.TemporaryDirectory(prefix="entry-", ignore_cleanup_errors=True)
        number, posix = theirs.fileno(), os.name == "posix"
        path = os.pathsep.join(str(Path(each).absolute()) for each in sys.path if each)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "optipromp.bench.entrant", str(number)],
            stdin=subprocess.DEVNULL, stdout=2, cwd=self._folder.name,
            env={**os.environ, **THREADS, "PYTHONPATH": path},
            close_fds=posix, pass_fds=(number,) if posix else (), start_new_session=posix,
        )  # fmt: skip
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
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._folder = None


Entry = Apart | Served
_staff: dict[tuple[str, str, Patience], Entry] = {}  # one process an entry, for all scenes


def hired(spec: str, track: str, patience: Patience = PATIENCE) -> Entry:
    """The entry of a name, MODULE:CLASS or tcp:HOST:PORT, in the one process that is for it."""
    if spec.startswith(SERVED) and track != "policy":
        raise InvalidRequestError(f"entry {spec!r} is of the track policy; this one is {track}")
    key = spec, track, patience
    if not _staff:
        Finalize(None, dismissed, exitpriority=10)  # also in a worker, which ends without atexit
    if key not in _staff:
        if spec.startswith(SERVED):
            _staff[key] = Served(spec.removeprefix(SERVED), patience)
        else:
            _staff[key] = Apart(spec, track, patience)
    return _staff[key]


def dismissed() -> None:
    """End the processes of all entries."""
    while _staff:
        _staff.popitem()[1].close()
