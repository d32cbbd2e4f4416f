"""Give the library mutated input, each in a process with limits, and count what comes of it.

    python scripts/fuzz.py --minutes 60 --seed 1 --state fuzz.json
    python scripts/fuzz.py --doors --count 10000 --seed 1 --state doors.json

The second is of the doors of cameras, networks, calibrations, messages, meshes and the benchmark
(tests/fuzzing/doors.py); ``--kinds camera mesh`` makes inputs of some kinds alone. An input is the
mutant of ``random.Random(f"{seed}:{index}")`` (tests/fuzzing/mutants.py). A typed error, a plan
that failed and a success that the judge confirms are right. Wrong are: an exception of another type
or a false success, more than 10 s of processor time, more than 1 GB of memory beyond what the
process began with, and the death of the process. The state is written after each batch, and a later
run goes on from it; ``--again INDEX`` runs one input here, with its traceback.
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

BATCH = 250  # inputs of one process, after which the state is written
SECONDS = 10.0  # [s] of processor time
HUNG, ASLEEP = 60.0, 900.0  # [s] of processor time, of the clock: until the process is ended
POSTURES = 200  # at which self-collision is looked at, not 20,000: nine tenths of all the time
MEMORY = 1 << 30  # [bytes]
WRONG = ("untyped", "over 10 s", "over 1 GB", "death")


def made_of(seed: int, index: int, kinds: list[str]) -> Any:
    """The input of a seed and an index, of one of some kinds."""
    from tests.fuzzing.doors import DOORS
    from tests.fuzzing.mutants import KINDS, mutant

    chosen = [pair for pair in (*KINDS, *DOORS) if pair[1].__name__ in kinds]
    return mutant(random.Random(f"{seed}:{index}"), chosen)


def one(
    seed: int, index: int, kinds: list[str], folder: Path, begun: Callable[[str], None]
) -> tuple[str, str, str]:
    """Kind, outcome, and details of what is wrong, of one input."""
    made = made_of(seed, index, kinds)
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


def batch(seed: int, indices: range, kinds: list[str], pipe: int) -> None:
    """In a process of its own: run a batch, telling each input's begin and end."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with os.fdopen(pipe, "w") as told, open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), 2)
        for index in indices:
            with tempfile.TemporaryDirectory() as name:
                os.chdir(name)

                def begun(kind: str, index: int = index) -> None:
                    signal.setitimer(signal.ITIMER_PROF, HUNG)
                    print(json.dumps([index, kind]), file=told, flush=True)

                result = one(seed, index, kinds, Path(name), begun)
                os.chdir("/")
            print(json.dumps([index, *result]), file=told, flush=True)


def run_batch(seed: int, indices: range, kinds: list[str]) -> list[tuple[int, str, str, str]]:
    """The results of a batch, up to a death or its end."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            batch(seed, indices, kinds, writing)
        finally:
            os._exit(0)
    os.close(writing)
    results, current, kind, buffer = [], indices[0], "?", b""
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
    if len(results) < len(indices):
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
            again = f"--seed {state['seed']} --kinds {' '.join(state['kinds'])} --again {index}"
            print(f"{index} {kind}: {outcome}\n{details}  {again}", flush=True)


def main() -> None:
    """Run until time is over, from where the state ended."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--state", type=Path, default=None)
    parser.add_argument("--again", type=int, default=None, metavar="INDEX")
    parser.add_argument("--count", type=int, default=None, help="inputs, in place of --minutes")
    parser.add_argument("--doors", action="store_true", help="all kinds of the doors")
    parser.add_argument("--kinds", nargs="+", default=[], metavar="NAME")
    options = parser.parse_args()
    from tests.fuzzing.doors import DOORS, warm_doors
    from tests.fuzzing.mutants import KINDS, warm

    doors = [make.__name__ for _, make in DOORS]
    every = [make.__name__ for _, make in KINDS]
    kinds = options.kinds or (doors if options.doors else every)
    if unknown := set(kinds) - {*every, *doors}:
        parser.error(f"unknown kinds {', '.join(unknown)}; valid are {', '.join(every + doors)}")
    if options.again is not None:
        with tempfile.TemporaryDirectory() as name:
            os.chdir(name)
            print(made_of(options.seed, options.again, kinds).run(Path(name)))
        return

    from optipromp import plan
    from optipromp.readers import self_collision

    self_collision.SORTING_POSTURES = POSTURES
    cache = tempfile.TemporaryDirectory(prefix="fuzz-")  # where no robot is known already
    if set(kinds) & set(every):
        os.environ |= {"OPTIPROMP_CACHE": "", "XDG_CACHE_HOME": cache.name}
        plan("scenario-3")  # loads and compiles before the processes fork
        warm()
    if set(kinds) & set(doors):
        warm_doors(kinds)
    state: dict[str, Any] = {
        "seed": options.seed, "kinds": kinds, "next": 0, "counts": {}, "commits": {},
        "outcomes": {}, "wrong": [],
    }  # fmt: skip
    if options.state is not None and options.state.exists():
        state = json.loads(options.state.read_text())
    git = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    state.setdefault("kinds", kinds)
    end = time.monotonic() + 60.0 * options.minutes
    most = sys.maxsize if options.count is None else options.count
    while state["next"] < most and (options.count is not None or time.monotonic() < end):
        indices = range(state["next"], min(state["next"] + BATCH, most))
        results = run_batch(state["seed"], indices, state["kinds"])
        count(state, commit, results)
        state["next"] += len(results)
        if options.state is not None:
            options.state.write_text(json.dumps(state, indent=1))
    print(table(state))
    print("inputs by commit:", state["commits"])
    sys.exit(bool(state["wrong"]))


if __name__ == "__main__":
    main()
