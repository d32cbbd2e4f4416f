"""Give the library mutated input, each in a process with limits, and count what comes of it.

    python scripts/fuzz.py --minutes 60 --seed 1 --state fuzz.json

An input is the mutant of ``random.Random(f"{seed}:{index}")`` (tests/fuzzing/mutants.py). A typed
error, a plan that failed and a success that the judge confirms are right. Wrong are: an exception
of another type or a false success, more than 10 s of processor time, more than 1 GB of memory
beyond what the process began with, and the death of the process. The state is written after each
batch, and a later run goes on from it; ``--again INDEX`` runs one input here, with its traceback.
"""

import argparse
import json
import os
import random
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

BATCH = 500  # inputs of one process: each imports what it needs, 1.3 s
SECONDS = 10.0  # [s] of processor time
HUNG, ASLEEP = 60.0, 900.0  # [s] of processor time, of the clock: until the process is ended
POSTURES = 200  # at which self-collision is looked at, not 20,000: nine tenths of all the time
MEMORY = 1 << 30  # [bytes]
WRONG = ("untyped", "over 10 s", "over 1 GB", "death")


def one(seed: int, index: int, folder: Path, begun: Callable[[str], None]) -> tuple[str, str, str]:
    """Kind, outcome, and details of what is wrong, of one input."""
    from tests.fuzzing.mutants import mutant

    made = mutant(random.Random(f"{seed}:{index}"))
    begun(made.kind)
    began = time.process_time()
    try:
        with warnings.catch_warnings(record=True):
            warnings.simplefilter("always")
            outcome, details = made.run(folder), ""
    except MemoryError:
        outcome, details = "over 1 GB", traceback.format_exc(limit=-3)
    except Exception:
        outcome, details = "untyped", traceback.format_exc(limit=-4)
    took = time.process_time() - began
    if took > SECONDS and outcome not in WRONG:
        outcome, details = "over 10 s", f"{took:.1f} s, then {outcome}"
    return made.kind, outcome, details


def batch(seed: int, start: int, pipe: int) -> None:
    """In a process of its own: run a batch, telling each input's begin and end."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with os.fdopen(pipe, "w") as told, open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), 2)
        for index in range(start, start + BATCH):
            with tempfile.TemporaryDirectory() as name:
                os.chdir(name)

                def begun(kind: str, index: int = index) -> None:
                    signal.setitimer(signal.ITIMER_PROF, HUNG)
                    print(json.dumps([index, kind]), file=told, flush=True)

                result = one(seed, index, Path(name), begun)
                os.chdir("/")
            print(json.dumps([index, *result]), file=told, flush=True)


def run_batch(seed: int, start: int) -> list[tuple[int, str, str, str]]:
    """The results of a batch, up to a death or its end."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            batch(seed, start, writing)
        finally:
            os._exit(0)
    os.close(writing)
    results, current, kind, buffer = [], start, "?", b""
    deadline, why = time.monotonic() + ASLEEP, "death"
    while True:
        ready, _, _ = select.select([reading], [], [], max(0.0, deadline - time.monotonic()))
        if not ready:
            why = "over 10 s"
            os.kill(child, signal.SIGKILL)
        chunk = os.read(reading, 65536)
        if not chunk:
            break
        *lines, buffer = (buffer + chunk).split(b"\n")
        for line in lines:
            current, kind, *result = json.loads(line)
            deadline = time.monotonic() + ASLEEP
            if result:
                results.append((current, kind, *result))
    os.close(reading)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF:
        why = "over 10 s"
    if len(results) < BATCH:
        results.append((current, kind, why, f"status {status}"))
    return results


def table(state: dict[str, Any]) -> str:
    """The counts by kind of input, as Markdown."""
    columns = ("inputs", "typed errors", "no plan", "successes", *WRONG)
    lines = ["| input | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    total: Counter[str] = Counter()
    for kind, counts in [*sorted(state["counts"].items()), ("all", None)]:
        row = Counter(counts) if counts is not None else total
        if counts is not None:
            total.update(row)
        lines.append(f"| {kind} | " + " | ".join(str(row[name]) for name in columns) + " |")
    return "\n".join(lines)


def count(state: dict[str, Any], commit: str, results: list[tuple[int, str, str, str]]) -> None:
    """Add results to the state."""
    for index, kind, outcome, details in results:
        group = {"error": "typed errors", "no": "no plan", "success": "successes"}
        name = outcome if outcome in WRONG else group[outcome.split()[0]]
        row = state["counts"].setdefault(kind, {})
        for column in ("inputs", name):
            row[column] = row.get(column, 0) + 1
        state["commits"][commit] = state["commits"].get(commit, 0) + 1
        state["outcomes"][outcome] = state["outcomes"].get(outcome, 0) + 1
        if outcome in WRONG:
            state["wrong"].append([index, kind, outcome, details, commit])
            print(f"{index} {kind}: {outcome}\n{details}", flush=True)


def main() -> None:
    """Run until time is over, from where the state ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path, default=None)
    parser.add_argument("--again", type=int, default=None)
    options = parser.parse_args()
    if options.again is not None:
        from tests.fuzzing.mutants import mutant

        with tempfile.TemporaryDirectory() as name:
            os.chdir(name)
            print(mutant(random.Random(f"{options.seed}:{options.again}")).run(Path(name)))
        return
    from tests.fuzzing.mutants import warm

    from optipromp import plan
    from optipromp.readers import self_collision

    self_collision.SORTING_POSTURES = POSTURES
    cache = tempfile.TemporaryDirectory(prefix="fuzz-")  # where no robot is known already
    os.environ["OPTIPROMP_CACHE"] = cache.name
    plan("scenario-3")  # loads and compiles before the processes fork
    warm()
    state: dict[str, Any] = {
        "seed": options.seed, "next": 0, "counts": {}, "commits": {}, "outcomes": {}, "wrong": [],
    }  # fmt: skip
    if options.state is not None and options.state.exists():
        state = json.loads(options.state.read_text())
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    end = time.monotonic() + 60.0 * options.minutes
    while time.monotonic() < end:
        results = run_batch(state["seed"], state["next"])
        count(state, commit, results)
        state["next"] += len(results)
        if options.state is not None:
            options.state.write_text(json.dumps(state, indent=1))
    print(table(state))
    print("inputs by commit:", state["commits"])


if __name__ == "__main__":
    main()
