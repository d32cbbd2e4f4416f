"""Cycles of the closed loop, steps of the guard and frames of the eyes, on one core."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.registry import RATIO, SUITE, Context, Measured, Metric, Value, Values
from benchmarks.timing import median, percentile, reference
from optipromp.core.geometry import Sphere
from optipromp.core.scenes import Pose, Scene, SceneObject
from optipromp.core.trajectory import State
from optipromp_sim.generate import NOISES, Preset, generate, noisy

if TYPE_CHECKING:
    from optipromp_loop.control import Look

CONDITIONS = "still plant", "swaying plant"
PRESETS: tuple[Preset, ...] = ("cluster", "mixed", "field")
FIRST, COUNT = 61_000, 5_000  # seed of the first scene, cycles of a condition
SWAY = 0.01  # [m] of the roots
DEADLINE = 20.0  # [ms] of a cycle at 50 Hz
STEP, STEPS = 5.0, 1_000  # [ms] of a step of the guard, and how many are taken
FRAME, FRAMES = 100.0, 120  # [ms] of a look at a picture, and how many pictures there are
FINDERS, SEEN, SHOWN = ("geometry", "network"), ("cluster", "field", "wild"), ("plain", "rich")
FEW, MANY = 10, 400  # false fruits of a look
LOW, HIGH = [0.2, -0.4, 0.6], [0.7, 0.4, 1.1]  # [m] where false fruits are


def metrics() -> list[Metric]:
    """Median, 99 % and the share of cycles over the deadline."""
    about = f"{COUNT} cycles of picks in fresh scenes, detections off by 5 mm and 5 degrees"
    out = []
    for condition in CONDITIONS:
        name = f"cycles/{condition}"
        out += [
            Metric(f"{name}/median", "ms", target=8.0, about=about),
            Metric(f"{name}/99th percentile", "ms", target=DEADLINE),
            Metric(f"{name}/late", "%", target=0.0, about="over 20 ms, the period at 50 Hz"),
        ]
    told = [("guard", STEP, f"{STEPS} steps in front of a policy that pushes aside")]
    told += [(f"frame, {name}", FRAME, f"{FRAMES} looks at 640 × 480 pixels") for name in FINDERS]
    of = "the 95 % in fixed work in Python and NumPy"
    for subject, target, about in told:
        name = f"cycles/{subject}/95th percentile"
        out.append(Metric(name, "ms", target=target, about=about))
        out.append(Metric(f"{name} by fixed work", RATIO, tolerance=0.5, about=of))
    about = f"cycles that only look, among {MANY} false fruits by those among {FEW}"
    out.append(Metric("cycles/false fruits/many by few", RATIO, tolerance=0.5, about=about))
    return out


@SUITE.benchmark("cycles", metrics(), timeout=1800)
def cycles(context: Context) -> Values:
    """The wall time of every cycle of the controller, the first of a process left out."""
    from optipromp_loop.control import Controller
    from optipromp_sim.simulation import (
        DETECTORS,
        Detector,
        DisturbanceParameters,
        Eye,
        Simulation,
        SimulationParameters,
        closed_loop,
    )

    out: dict[str, Value] = {}
    eyes = DETECTORS["zero-mean"]
    for condition, sway in zip(CONDITIONS, (0.0, SWAY), strict=True):
        context.say(condition)
        parameters = SimulationParameters(disturbance=DisturbanceParameters(sway=sway))
        times: list[float] = []
        seed, wanted = FIRST, context.repeats(COUNT)
        while len(times) < wanted:
            scene = generate(PRESETS[seed % len(PRESETS)], seed)
            controller = Controller(noisy(scene, seed, NOISES["zero-mean"]))
            eye = Eye(Detector(scene, controller.robot, eyes, seed))
            closed_loop(Simulation(scene, seed, parameters), controller, eye)
            if seed > FIRST:  # kernels are read from the cache in the first
                times += (1e3 * np.array(controller.cycles)).tolist()
            seed += 1
        name = f"cycles/{condition}"
        quantiles = {f"{p} %": percentile(times, p / 100) for p in (5, 25, 75, 90, 99.9, 100)}
        out[f"{name}/median"] = Measured(median(times), quantiles)
        out[f"{name}/99th percentile"] = percentile(times, 0.99)
        out[f"{name}/late"] = 100.0 * float(np.mean(np.array(times) > DEADLINE))
    context.say("guard")
    out |= _guarded(context.repeats(STEPS))
    context.say("frames")
    out |= _frames(context.repeats(FRAMES))
    spent = {false: _looking(false) for false in (FEW, MANY, FEW, MANY)}  # the first time compiles
    out["cycles/false fruits/many by few"] = spent[MANY] / spent[FEW]
    return out


def _guarded(count: int) -> dict[str, Value]:
    """Process times of the guard's steps, in ms and in fixed work between its picks."""
    from scripts.studies.guard import driven

    ask = {"entry": "push-aside", "engine": "arm", "condition": "none", "way": "guarded"}
    spent, fixed, seed = list[float](), list[float](), FIRST
    while len(spent) < count:
        row, _ = driven({**ask, "preset": "cluster", "seed": seed})
        fixed.append(_fixed())
        if seed > FIRST:  # the first reads kernels from the cache
            spent += np.repeat(row["spent"], max(row["steps"] // len(row["spent"]), 1)).tolist()
        seed += 1
    return _late("guard", spent, fixed)


def _frames(count: int) -> dict[str, Value]:
    """Process times of looks at pictures, in ms and in fixed work between the pictures."""
    from scripts.studies.eyes import Sees

    seeds = FIRST, FIRST + max(count // (len(SEEN) * len(SHOWN)), 1)
    study = Sees(SEEN, seeds, looks=SHOWN, finders=FINDERS)
    fixed, rows = zip(*((_fixed(), study.trial(ask)["seen"]) for ask in study.asks()), strict=True)
    out: dict[str, Value] = {}
    for name in FINDERS:
        out |= _late(f"frame, {name}", [1e3 * row[name]["seconds"] for row in rows], fixed)
    return out


def _fixed() -> float:
    """Milliseconds of the process that the fixed work takes."""
    began = time.process_time()
    reference()
    return 1e3 * (time.process_time() - began)


def _late(subject: str, spent: list[float], fixed: Sequence[float]) -> dict[str, Value]:
    late, name = percentile(spent, 0.95), f"cycles/{subject}/95th percentile"
    return {
        name: Measured(late, {"50 %": median(spent)}), f"{name} by fixed work": late / median(fixed)
    }  # fmt: skip


def _looking(false: int) -> float:
    """Seconds of the process that a cycle takes while the arm stands, the median of 0.4 s."""
    from optipromp_loop.control import Controller

    scene, rng = generate("cluster", FIRST), np.random.default_rng(FIRST)
    controller, times = Controller(scene), []
    state = State(np.asarray(scene.start))
    for k in range(21):
        if k % 3 == 0:
            controller.see(_cluttered(0.02 * k, scene, rng, false))
        began = time.process_time()
        controller(0.02 * k, state, state)
        times.append(time.process_time() - began)
    return median(times)


def _cluttered(when: float, scene: Scene, rng: np.random.Generator, false: int) -> "Look":
    """A look at the scene's fruits among false ones."""
    from optipromp_loop.control import Look

    true = [
        replace(item, position=item.position + rng.normal(0.0, 0.001, 3),
                covariance=1e-6 * np.eye(3), stem=None)
        for item in scene.objects if item.role in ("target", "pushable")
    ]  # fmt: skip
    ball, places = Sphere(0.015), rng.uniform(LOW, HIGH, (false, 3))
    wrong = (SceneObject(f"f{k}", "pushable", ball, places[k], sigma=0.003) for k in range(false))
    return Look(when, Pose(), (*true, *wrong), view=3.1)
