"""The second engine's word on closed loops: their executed curves, flown by its cup.

    python scripts/second_loop.py [--conditions none,zero-mean,missed]
        [--preset cluster,mixed,field] [--seeds 52000:52034]

The loop runs in the main simulation. The configurations that it commanded are then executed by
:mod:`optipromp_bench.flight` in the true scene. Conditions in which the plant moves by itself are
refused, because the second engine cannot move it.
"""

import argparse
from collections import Counter

import numpy as np

from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.trajectory import State
from optipromp_bench.flight import execute
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Loop
from optipromp_sim.situations import CONDITIONS, picked

STILL = "none", "zero-mean", "detector", "missed", "calibration"  # the plant stays where it is


def commanded(done: Loop) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) [s] and configurations (T, n), 1,000 in a second."""
    times = np.arange(0.0, float(done.run.outcome.duration), 0.001)
    stretches = done.trace.stretches
    begins = np.array([one.begins for one in stretches])
    rows = np.searchsorted(begins, times, side="right") - 1
    states: list[State] = [stretches[max(k, 0)].at(t) for k, t in zip(rows, times, strict=True)]
    return times, np.array([state.q for state in states])


def main() -> None:
    """Run loops in both engines, and print how often they agree."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--conditions", default="none,zero-mean,missed")
    ask.add_argument("--preset", default="cluster,mixed,field")
    ask.add_argument("--seeds", default="52000:52034")
    told = ask.parse_args()
    first, end = map(int, told.seeds.split(":"))
    for condition in told.conditions.split(","):
        if condition not in STILL:
            ask.error(f"condition is {condition!r}: must be one of {', '.join(STILL)}")
        both: Counter[tuple[str, str]] = Counter()
        for preset in told.preset.split(","):
            for seed in range(first, end):
                scene = generate(preset, seed)
                setting = CONDITIONS[condition](scene, seed)
                done = picked(setting, seed)
                word = execute(scene_to_dict(setting.scene), commanded(done), seed)
                harmed = bool(word.harm or word.swallowed)
                second = "clean" if word.success else "harmed" if harmed else "not picked"
                both[done.result, second] += 1
                if (done.result == "clean") != word.success:
                    print(f"    {preset} {seed}: {done.result} | second: {word}", flush=True)
        counts = "; ".join(f"{a} / {b}: {n}" for (a, b), n in sorted(both.items()))
        print(f"| {condition} | {both.total()} | {counts} |", flush=True)


if __name__ == "__main__":
    main()
