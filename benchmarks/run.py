"""Running the suite: each benchmark in a process of its own, so that one that crashes is a row."""

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks import machine
from benchmarks.registry import SUITE, Absent, Benchmark, Context, Row

MODULES = (
    "kernel",
    "promp",
    "plans",
    "clutter",
    "cycles",
    "growth",
    "startup",
    "planners",
    "furniture",
)
SINGLE = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def load_suite() -> None:
    """Register every benchmark."""
    for name in MODULES:
        importlib.import_module(f"benchmarks.suite.{name}")


def run(
    selected: Sequence[tuple[Benchmark, list[str]]], context: Context, isolated: bool = True
) -> dict[str, Any]:
    """Run benchmarks and return what JSON holds: where, with what, and a row for every metric."""
    results: list[Row] = []
    for index, (benchmark, names) in enumerate(selected, 1):
        context.say(f"[{index}/{len(selected)}] {benchmark.name}: {benchmark.about}")
        rows = apart(benchmark, names, context) if isolated else benchmark.run(context, names)
        results += rows
        for row in rows:
            value = f"{row.value:.4g} {row.metric.unit}" if row.value is not None else row.status
            reason = f" ({row.reason})" if row.reason else ""
            context.say(f"      {row.metric.name}: {value}{reason}")
    return {**machine.describe(), "quick": context.quick, "rows": [r.to_dict() for r in results]}


def apart(benchmark: Benchmark, names: Sequence[str], context: Context) -> list[Row]:
    """Run one benchmark in a child process; its crash or its time-out becomes rows."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "rows.json"
        command = [sys.executable, "-m", "benchmarks", "--child", benchmark.name]
        command += ["--out", str(output), *(["--quick"] if context.quick else [])]
        path = os.pathsep.join(filter(None, [str(machine.ROOT), os.environ.get("PYTHONPATH")]))
        environment = {**os.environ, **SINGLE, "PYTHONPATH": path}
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=benchmark.timeout
            )
        except subprocess.TimeoutExpired:
            late = Absent(f"not done within {benchmark.timeout:.0f} s", "failed")
            return benchmark.rows_for(late, names)
        if not output.exists():
            last = (done.stderr.strip().splitlines() or ["nothing on standard error"])[-1]
            word = f"its process ended with {done.returncode}: {last}"
            return benchmark.rows_for(Absent(word, "failed"), names)
        rows = [Row.from_dict(r) for r in json.loads(output.read_text(encoding="utf-8"))]
    return [row for row in rows if row.metric.name in set(names)]


def child(name: str, quick: bool, output: Path, say: Callable[[str], None]) -> None:
    """What the child process does: run one benchmark and write its rows."""
    rows = SUITE[name].run(Context(quick, say))
    output.write_text(json.dumps([row.to_dict() for row in rows]), encoding="utf-8")
