"""Whole plans in generated clutter, in units of a plan of scenario III in the same run."""

import time
from dataclasses import replace

import numpy as np

from benchmarks.registry import RATIO, SUITE, Context, Measured, Metric, Value, Values
from benchmarks.timing import median, percentile
from optipromp.core.planning import plan, warm_up
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp_sim.generate import NOISES, Preset, generate, perceived

HANGING: tuple[Preset, ...] = ("cluster", "side-clusters", "table-top", "mixed")
FIRST, COUNT = 60_000, 100  # seed of the first scene, scenes of a kind
GROUP = 10  # scenes between plans of scenario III
KINDS = {  # targets: median and 95th percentile
    "known fruits": (1.5, 3.0),
    "detected fruits": (4.0, 10.0),
    "shelf": (20.0, 60.0),
}


def metrics() -> list[Metric]:
    """Median and 95th percentile in plans of scenario III, and the share that succeed."""
    about = f"{COUNT} fresh scenes, each with a cup of its own; detected: 5 mm and 5 degrees"
    out = []
    for kind, (typical, late) in KINDS.items():
        name = f"clutter/{kind}"
        out += [
            Metric(f"{name}/median by scenario-3", RATIO, target=typical, about=about),
            Metric(f"{name}/95th percentile by scenario-3", RATIO, tolerance=0.5, target=late),
            Metric(f"{name}/median", "ms"),
            Metric(f"{name}/success", "%", "higher"),
        ]
    return out


@SUITE.benchmark("clutter", metrics(), timeout=900)
def clutter(context: Context) -> Values:
    """Plans in fresh generated scenes, by plans of scenario III between them."""
    warm_up()
    out: dict[str, Value] = {}
    for kind in KINDS:
        context.say(kind)
        times, shares, held = [], [], 0
        for i, scene in enumerate(_scenes(kind, context.repeats(COUNT))):
            if i % GROUP == 0:
                usual = min(_seconds(load_scene("scenario-3"))[0] for _ in range(5))
            took, success = _seconds(scene)
            times.append(1e3 * took)
            shares.append(took / usual)
            held += success
        quantiles = {f"{p} %": percentile(shares, p / 100) for p in (5, 25, 75, 90, 99)}
        name = f"clutter/{kind}"
        out[f"{name}/median by scenario-3"] = Measured(median(shares), quantiles)
        out[f"{name}/95th percentile by scenario-3"] = percentile(shares, 0.95)
        out[f"{name}/median"] = median(times)
        out[f"{name}/success"] = 100.0 * held / len(times)
    return out


def _seconds(scene: Scene) -> tuple[float, bool]:
    """Time of a plan [s], with nothing remembered of the scene, and whether it is a success."""
    fresh = replace(scene)
    began = time.perf_counter()
    made = plan(fresh)
    return time.perf_counter() - began, made.success


def _scenes(kind: str, count: int) -> list[Scene]:
    presets: tuple[Preset, ...] = ("shelf",) if kind == "shelf" else HANGING
    out = []
    for i in range(count):
        scene = generate(presets[i % len(presets)], FIRST + i)
        if kind == "detected fruits":
            scene = perceived(scene, np.random.default_rng(FIRST + i), NOISES["zero-mean"])
        out.append(scene)
    return out
