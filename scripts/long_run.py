"""Many plans in one process: memory, time, and the same results as in fresh processes and threads.

    python scripts/long_run.py --plans 10000

The same scenes are planned over and over, by turns. Memory is the resident set after the first
tenth, which fills every cache, and at the end. Time is the process's own, the median of a round in
the second and in the last tenth. Every trajectory must have the hash of the one that a fresh
process makes of its scene; so must those of eight threads at once.
"""

import argparse
import hashlib
import multiprocessing
import statistics
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from optipromp.core.planning import plan, warm_up
from optipromp.core.scenes import load_scene
from optipromp_sim.generate import generate

NAMES = (
    "scenario-3", "scenario-4", *(f"cluster {seed}" for seed in range(12)),
    *(f"table-top {seed}" for seed in range(3)), "mixed 3",
)  # fmt: skip
FLAT = 0.05  # share by which memory may grow
THREADS = 8


def digest(name: str) -> str:
    """Hash of the plan of a built-in scene, or of a generated one (preset and seed)."""
    preset, _, seed = name.partition(" ")
    made = plan(generate(preset, int(seed)) if seed else load_scene(preset))
    rows = made.trajectory.positions, made.trajectory.velocities, made.trajectory.times
    told = f"{made.status} {made.message}".encode()
    return hashlib.sha256(b"".join(row.tobytes() for row in rows) + told).hexdigest()[:16]


def resident() -> float:
    """Resident set of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def main() -> None:
    """Run, and print the figures; exit with 1 where one is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=10_000)
    rounds = max(parser.parse_args().plans // len(NAMES), 20)
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as fresh:
        wanted = dict(zip(NAMES, fresh.map(digest, NAMES, chunksize=1), strict=True))
    warm_up()
    tenth, memory, times, other = rounds // 10, list[float](), list[float](), 0
    for k in range(rounds):
        began = time.process_time()
        other += sum(digest(name) != wanted[name] for name in NAMES)
        times.append(time.process_time() - began)
        memory.append(resident())
        if (k + 1) % tenth == 0:
            print(f"{(k + 1) * len(NAMES)} plans, {memory[-1]:.1f} MB, {other} other", flush=True)
    growth = memory[-1] / memory[tenth] - 1.0
    early, late = statistics.median(times[tenth : 2 * tenth]), statistics.median(times[-tenth:])
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(digest, NAMES * 5))
    apart = sum(one != wanted[name] for one, name in zip(found, NAMES * 5, strict=True))
    print(f"{rounds * len(NAMES)} plans of {len(NAMES)} scenes in one process")
    print(f"memory: {memory[tenth]:.1f} MB after a tenth, {memory[-1]:.1f} MB, {growth:+.2%}")
    print(f"time of a round: the last tenth by the second {late / early:.3f}")
    print(f"other than in a fresh process: {other}")
    print(f"{THREADS} threads, {len(found)} plans, other than in a fresh process: {apart}")
    sys.exit(bool(growth > FLAT or other or apart))


if __name__ == "__main__":
    main()
