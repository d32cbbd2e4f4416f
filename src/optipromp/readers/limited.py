"""Readers that a file could make endless or crash, run in a process of their own with limits."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import is_there, read_bytes
from optipromp.core.parameters import parameter
from optipromp.core.processes import THREADS

SHOWN = 500  # letters of an error that are shown, chosen


@dataclass(frozen=True)
class Limits:
    """Limits of a process that reads a robot description."""

    time: float = parameter(60.0, "s", "choice", "an arm takes 1 s")
    memory: float = parameter(4e9, "bytes", "choice", "of addresses; MuJoCo and an arm take 0.2e9")
    output: float = parameter(256e6, "bytes", "choice", "as other files, optipromp.core.files")


LIMITS = Limits()


def run_limited(
    program: str, path: Path, given: Mapping[str, Any], limits: Limits = LIMITS
) -> bytes:
    """The output of a function of :mod:`optipromp.readers.programs`, run in a process of its own.

    The process reads JSON from standard input: ``given``, and the keys ``program``, ``path``
    (absolute), ``out`` (the file to write), ``memory`` and ``output`` [bytes]. If it refuses the
    file, it prints why to standard error and exits with 3.
    """
    with tempfile.TemporaryDirectory(prefix="optipromp-") as folder:
        out = Path(folder) / "out"
        told = {
            "program": program,
            "path": str(path.absolute()),
            "out": str(out),
            "memory": int(limits.memory),
            "output": int(limits.output),
        }
        command = [sys.executable, "-P", str(Path(__file__).with_name("programs.py"))]
        try:
            done = subprocess.run(
                command,
                input=json.dumps({**given, **told}).encode(),
                capture_output=True,
                timeout=limits.time,
                env=os.environ | THREADS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise InvalidRobotError(
                f"{path}: cannot be read within {limits.time:g} s: endless?"
            ) from None
        except OSError as error:
            raise InvalidRobotError(f"{path}: no process can start to read it: {error}") from None
        if done.returncode == 0 and is_there(out):
            return read_bytes(out, InvalidRobotError, int(limits.output))
    words = " ".join(done.stderr.decode(errors="replace").split())
    if done.returncode < 0:
        words = f"reading it ended with {signal.Signals(-done.returncode).name}: too large?"
    elif done.returncode != 3:
        words = f"reading it ended with {done.returncode}: {words[-SHOWN:]}"
    raise InvalidRobotError(f"{path}: {words[:SHOWN]}")
