"""Fill disks under commands, and compile in two processes at once into one empty cache.

    python scripts/full_disk.py             # as root on Linux: disks are small tmpfs
    python scripts/full_disk.py --compile   # takes minutes

Each command ends with 0, or with 2 and words that tell why; every file that is left is whole, and
none is temporary. The plans of processes that compile at once, and of one whose cache
lies on a full disk, are the plan of this process.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from scripts.interrupt import RUN, faults  # noqa: E402

SIZES = (4, 16, 64, 256, 512, 1024, 2048, 4096)  # [KB]


@contextmanager
def disk(size: int) -> Iterator[Path]:
    """A disk of so many KB."""
    folder = Path(tempfile.mkdtemp(prefix="disk-"))
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(folder)]
    subprocess.run(mount, check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
        folder.rmdir()


def full(work: Path) -> tuple[Counter[str], list[str]]:
    """How commands on small disks ended, and what was wrong with them."""
    demos = ROOT / "packages/optipromp/src/optipromp/core/promp/data/panda.npz"
    commands = {
        "plan": ["plan", "scenario-3", "--reach", "--figures", "--out", "out"],
        "learn": ["learn", str(demos), "--out", "out/learnt.npz"],
        "report": ["report", str(work / "plan"), "--out", "out/report.html"],
        "generate": ["generate", "--preset", "cluster", "--count", "3", "--out", "out"],
        "study": ["study", "--preset", "cluster", "--planners", "straight", "--seeds", "0:2",
                  "--workers", "1", "--out", "out"],
    }  # fmt: skip
    ends, wrong = Counter[str](), list[str]()
    for size in SIZES:
        for name, command in commands.items():
            with disk(size) as folder:
                done = subprocess.run([*RUN, *command], cwd=folder, capture_output=True, text=True)
                ends[f"{name} {'whole' if done.returncode == 0 else 'told'}"] += 1
                found = faults(folder, True)
                told = "No space left" in done.stderr and "Traceback" not in done.stderr
                if done.returncode not in (0, 2) or (done.returncode == 2 and not told):
                    found.append(f"ended with {done.returncode}: {done.stderr[-600:]}")
                wrong += [f"{name} on {size} KB: {fault}" for fault in found]
    return ends, wrong


def start(out: Path, cache: Path) -> subprocess.Popen[bytes]:
    """A process that plans, its kernels kept in ``cache``."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "OPTIPROMP_CACHE": str(out / "own")}
    return subprocess.Popen(
        [*RUN, "plan", "scenario-3", "--reach", "--out", str(out)],
        env=environment,
        stdout=subprocess.DEVNULL,
    )


def compiled(work: Path) -> list[str]:
    """What is wrong with plans of processes that compile; the kernels are in ``work`` after."""
    right = (work / "plan" / "trajectory.csv").read_bytes()

    def differ(*names: str) -> list[str]:
        made = [work / name / "trajectory.csv" for name in names]
        return [str(p) for p in made if not p.exists() or p.read_bytes() != right]

    cache = work / "cache"
    cache.mkdir(mode=0o700)
    both = [start(work / name, cache) for name in ("one", "two")]
    wrong = [f"compiling at once ended with {p.returncode}" for p in both if p.wait()]
    before = len(list(cache.rglob("*.nbc")))
    wrong += ["the cache was not used"] if start(work / "three", cache).wait() else []
    if len(list(cache.rglob("*.nbc"))) != before or not before:
        wrong.append(f"{before} kernels, then others")
    with disk(256) as small:
        small.chmod(0o700)
        wrong += ["the cache's disk is full"] if start(work / "four", small).wait() else []
    return wrong + [f"{name}: another plan" for name in differ("one", "two", "three", "four")]


def main() -> None:
    """Run, and tell."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--compile", action="store_true")
    asked = options.parse_args()
    work = Path(tempfile.mkdtemp(prefix="full-"))
    plan = [*RUN, "plan", "scenario-3", "--reach", "--out", str(work / "plan")]
    subprocess.run(plan, check=True, stdout=subprocess.DEVNULL)
    ends, wrong = (Counter[str](), compiled(work)) if asked.compile else full(work)
    print(dict(sorted(ends.items())), *wrong, f"faults: {len(wrong)}", sep="\n")
    shutil.rmtree(work)
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
