"""Many plans in one process: memory, time, and the same results as in fresh processes and threads.

    python scripts/long_run.py --plans 10000

The same scenes are planned over and over, by turns. Memory is the resident set after the first
tenth, which fills every cache, and at the end. Time is the process's own, the median of a round in
the second and in the last tenth. Every trajectory must have the hash of the one that a fresh
process makes of its scene; so must those of eight threads at once.
"""

import argparse
import hashlib
import statistics
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from optipromp.core.planning import plan, warm_up
from optipromp.core.scenes import Scene, load_scene
from optipromp_sim.generate import generate

NAMES = (
    "scenario-3", "scenario-4", *(f"cluster {seed}" for seed in range(12)),
    *(f"table-top {seed}" for seed in range(3)), "mixed 3",
)  # fmt: skip
FLAT = 0.05  # share by which memory may grow
THREADS = 8


def scene_of(name: str) -> Scene:
    """A built-in scene, or a generated one: preset and seed."""
    preset, _, seed = name.partition(" ")
    return generate(preset, int(seed)) if seed else load_scene(preset)


def digest(scene: Scene) -> str:
    """Hash of the planned trajectory, its status and its message."""
    made = plan(scene)
    rows = made.trajectory.positions, made.trajectory.velocities, made.trajectory.times
    told = f"{made.status} {made.message}".encode()
    return hashlib.sha256(b"".join(row.tobytes() for row in rows) + told).hexdigest()[:16]


def resident() -> float:
    """Resident set of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def fresh(name: str) -> str:
    """The digest that a process of its own makes."""
    run = subprocess.run(
        [sys.executable, __file__, "--one", name], capture_output=True, text=True, check=True
    )
    return run.stdout.split()[-1]


def main() -> None:
    """Run, and print the figures; exit with 1 where one is not as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plans", type=int, default=10_000)
    parser.add_argument("--one", help="print the digest of one scene's plan")
    asked = parser.parse_args()
    if asked.one:
        print(digest(scene_of(asked.one)))
        return
    warm_up()
    wanted = {name: fresh(name) for name in NAMES}
    rounds = max(asked.plans // len(NAMES), 20)
    tenth = rounds // 10
    memory, times, other = [], [], 0
    for k in range(rounds):
        began = time.process_time()
        other += sum(digest(scene_of(name)) != wanted[name] for name in NAMES)
        times.append(time.process_time() - began)
        memory.append(resident())
        if (k + 1) % tenth == 0:
            print(f"{(k + 1) * len(NAMES)} plans, {memory[-1]:.1f} MB, {other} other", flush=True)
    growth = memory[-1] / memory[tenth] - 1.0
    early, late = (
        statistics.median(times[part])
        for part in (slice(tenth, 2 * tenth), slice(rounds - tenth, rounds))
    )
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda name: digest(scene_of(name)), NAMES * 5))
    apart = sum(one != wanted[name] for one, name in zip(found, NAMES * 5, strict=True))
    print(f"{rounds * len(NAMES)} plans of {len(NAMES)} scenes in one process")
    print(f"memory: {memory[tenth]:.1f} MB after a tenth, {memory[-1]:.1f} MB, {growth:+.2%}")
    print(f"time of a round: the last tenth by the second {late / early:.3f}")
    print(f"other than in a fresh process: {other}")
    print(f"{THREADS} threads, {len(found)} plans, other than in a fresh process: {apart}")
    sys.exit(bool(growth > FLAT or other or apart))


if __name__ == "__main__":
    main()
