"""Is a plan slower than before? Process times of 40 scenes, of two installations in turn.

``python scripts/plan_times.py BEFORE AFTER [PRESETS]`` takes the Python of an environment that
holds the project as it was, and that of one that holds the project as it is. BEFORE writes 40
scenes, or those of some presets; both read and plan them in processes of their own, in turn,
``ROUNDS`` times or more. The figure of a scene is its least process time, so work beside this
script hardly counts. The script exits with 1 where the ratio after : before is over ``MEDIAN`` in
the median, or over ``TAIL`` at 95 %; of some presets it only tells. ``.ci/speed`` makes the
environment of the last release, or of a commit.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROUNDS = 3
MOST_ROUNDS = 9  # a ratio over the limit after ROUNDS is measured on: noise falls, slowness stays
MEDIAN = 1.10  # ratio of process times, after to before, over which a plan counts as slower
TAIL = 1.25  # the same at 95 % of the scenes
PRESETS = {"cluster": 10, "mixed": 10, "field": 9, "wild": 9}  # and scenarios 3 and 4
FIRST = 300_000  # seed of the first scene of each preset: of no study and no benchmark

TIME = """
import json, sys, time
from pathlib import Path
from optipromp import load_scene, plan
scenes = [load_scene(name) for name in ("scenario-3", "scenario-4")]
scenes += [load_scene(path) for path in sorted(Path(sys.argv[1]).rglob("*.yaml"))]
for scene in scenes[:4]:
    plan(scene, seed=0)
times = []
for scene in scenes:
    least = float("inf")
    for _ in range(4):
        begin = time.process_time()
        plan(scene, seed=0)
        least = min(least, time.process_time() - begin)
    times.append(least)
print(json.dumps(times))
"""


def run(*command: str) -> str:
    """Standard output of a command that works outside the source tree."""
    done = subprocess.run(command, cwd=tempfile.gettempdir(), capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{command[0]} failed ({done.returncode}):\n{done.stderr[-3000:]}")
    return done.stdout


def compared(least: dict[str, list[float]]) -> list[float]:
    """The ratios of process times of all scenes, after to before, ascending."""
    return sorted(new / old for new, old in zip(least["after"], least["before"], strict=True))


def slower(least: dict[str, list[float]]) -> bool:
    """Whether plans are slower than is allowed, by the least process times so far."""
    ratios = compared(least)
    return ratios[len(ratios) // 2] > MEDIAN or ratios[int(0.95 * len(ratios))] > TAIL


def main(before: str, after: str, presets: str = "") -> int:
    """Print the ratio of process times; 1 where plans are slower."""
    before, after = (str(Path(python).absolute()) for python in (before, after))
    with tempfile.TemporaryDirectory() as folder:
        for preset in presets.split(",") if presets else PRESETS:
            words = ["--preset", preset, "--seed", str(FIRST), "--count", str(PRESETS[preset])]
            words += ["--out", str(Path(folder, preset))]
            run(before, "-m", "optipromp", "generate", *words)
        least: dict[str, list[float]] = {}
        for turn in range(MOST_ROUNDS):
            if turn >= ROUNDS and not slower(least):
                break
            for name, python in (("before", before), ("after", after)):
                times = json.loads(run(python, "-c", TIME, folder))
                least[name] = list(map(min, times, least.get(name, times)))
    ratios = compared(least)
    median, tail = ratios[len(ratios) // 2], ratios[int(0.95 * len(ratios))]
    old, new = (1e3 * sorted(least[name])[len(ratios) // 2] for name in ("before", "after"))
    print(
        "### Process times\n\n"
        "| scenes | a plan then | now | ratio of process times, median | 95 % |\n"
        "|---|---|---|---|---|\n"
        f"| {len(ratios)} | {old:.1f} ms | {new:.1f} ms | {median:.2f} | {tail:.2f} |\n"
        f"at most {MEDIAN} in the median, {TAIL} at 95 %"
    )
    print("plans are SLOWER" if slower(least) else "plans are not slower")
    return int(slower(least) and not presets)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
