"""Whole processes: how long a user waits, and how much memory it takes."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence

from benchmarks.registry import RATIO, SUITE, Context, Measured, Metric, Value, Values
from benchmarks.timing import median, paired_ratio

HELP, ONE_SHOT = "optipromp --help", "optipromp plan scenario-3 --reach --json"
METRICS = [
    Metric(f"start/{HELP}/time", "s", target=0.3, about="a whole process"),
    Metric(f"start/{HELP}/by import numpy", RATIO, about="python -c 'import numpy', in turn"),
    Metric(f"start/{ONE_SHOT}/time", "s", target=1.2, about="kernels cached"),
    Metric(f"start/{ONE_SHOT}/by import numpy", RATIO),
    Metric(f"start/{ONE_SHOT}/peak memory", "MB", target=300.0, about="resident, of one process"),
    Metric(f"start/{ONE_SHOT}, first use/time", "s", target=30.0, about="nothing compiled yet"),
]


@SUITE.benchmark("start", METRICS)
def start(context: Context) -> Values:
    """Processes from their start to their end."""
    numpy = [sys.executable, "-c", "import numpy"]
    commands = {name: [sys.executable, "-m", *name.split()] for name in (HELP, ONE_SHOT)}
    out: dict[str, Value] = {}
    memory = []
    process(commands[ONE_SHOT])
    for name, command in commands.items():
        context.say(name)
        times, base = [], []
        for _ in range(context.repeats(15)):
            seconds, peak = process(command)
            times.append(seconds)
            memory += [peak] if name == ONE_SHOT else []
            base.append(process(numpy)[0])
        out[f"start/{name}/time"] = Measured(median(times), {"minimum": min(times)})
        out[f"start/{name}/by import numpy"] = Measured(
            paired_ratio(times, base), {"import numpy": median(base)}
        )
    out[f"start/{ONE_SHOT}/peak memory"] = max(memory)
    context.say("first use")
    with tempfile.TemporaryDirectory() as folder:
        fresh = {"NUMBA_CACHE_DIR": folder, "OPTIPROMP_CACHE": folder}
        seconds, peak = process(commands[ONE_SHOT], fresh)
    out[f"start/{ONE_SHOT}, first use/time"] = Measured(seconds, {"peak memory [MB]": peak})
    return out


def process(
    command: Sequence[str], environment: Mapping[str, str] | None = None
) -> tuple[float, float]:
    """Wall time [s] and peak resident memory [MB] of a process.

    Raises:
        RuntimeError: it ended with an error.
    """
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        child = subprocess.Popen(
            command, cwd=folder, env={**os.environ, **(environment or {})},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        _, status, usage = os.wait4(child.pid, 0)
        seconds = time.perf_counter() - began
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise RuntimeError(f"{' '.join(command[1:])} ended with {child.returncode}")
    return seconds, usage.ru_maxrss / 1e3
