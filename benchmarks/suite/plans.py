"""Whole plans: our planners over perturbed scenes, and the two strategies beside each other."""

import os
import time
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.registry import (
    RATIO,
    SUITE,
    Absent,
    Context,
    Measured,
    Metric,
    Value,
    Values,
    stopwatch,
)
from benchmarks.scenes import many
from benchmarks.timing import median, paired_ratio, percentile, reference
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Plan, Planner, plan, plan_many, warm_up
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import PoseGoal, Scene
from optipromp_paper.paper import Paper
from optipromp_paper.paper_costs import functional_values

SCENES = ("scenario-3", "scenario-4")
COUNT = 200
TURNS = 2  # of a scene; the faster counts, so that other work on the machine counts less
GROUP = 20  # scenes between pieces of fixed work, after each of which nothing is warm for a while
CASES: dict[str, dict[str, Any]] = {
    "joint": {"planner": "opti-promp"},
    "i-promp": {"planner": "i-promp"},
    "promp": {"planner": "promp"},
}
STRATEGIES: dict[str, Planner | str] = {
    "joint": "opti-promp",
    "sequential": Paper(constraints="push-model"),
}
TARGETS = {"joint": (10.0, 30.0), "i-promp": (1.0, None), "promp": (None, None)}


def metrics() -> list[Metric]:
    """Median, 99th percentile, share that hold, and the ratio to a fixed piece of work."""
    about = f"{COUNT} scenes, fruit centres moved by N(0, 5 mm); goals, starts and check included"
    out = []
    for scene in SCENES:
        for case, (typical, late) in TARGETS.items():
            name = f"whole plans/{scene}, {case}"
            out += [
                Metric(f"{name}/median", "ms", target=typical, about=about),
                Metric(f"{name}/99th percentile", "ms", target=late),
                Metric(f"{name}/success", "%", "higher"),
                Metric(f"{name}/by fixed work", RATIO, tolerance=0.4, about="in Python and NumPy"),
            ]
    return out


@SUITE.benchmark("plans", metrics())
def plans(context: Context) -> Values:
    """Whole warm plans in perturbed scenes: goals, all starts, and the independent check."""
    warm_up()
    out: dict[str, Value] = {}
    for name in SCENES:
        scenes = many(name, context.repeats(COUNT))
        for case, options in CASES.items():
            context.say(f"{name}, {case}")
            out |= _over(f"whole plans/{name}, {case}", scenes, options)
    return out


def _over(name: str, scenes: list[Scene], options: dict[str, Any]) -> dict[str, Value]:
    times, work, held, faults = [], [], 0, []
    for i, scene in enumerate(scenes):
        if i % GROUP == 0:
            base = min(1e3 * stopwatch(reference) for _ in range(TURNS))
            plan(scene, **options)
        took = []
        for _ in range(TURNS):
            fresh = replace(scene)  # a scene remembers what was computed of it
            began = time.perf_counter()
            try:
                made = plan(fresh, **options)
                fault = "" if made.success else f"{made.status}: {made.message}"
            except OptiPrompError as error:
                fault = f"{error.code}: {error.message}"
            took.append(1e3 * (time.perf_counter() - began))
        held += not fault
        faults += [fault] if fault else []
        times.append(min(took))
        work.append(base)
    detail = {"minimum": min(times), "90th percentile": percentile(times, 0.9), "max": max(times)}
    return {
        f"{name}/median": Measured(median(times), detail),
        f"{name}/99th percentile": percentile(times, 0.99),
        f"{name}/success": Measured(100.0 * held / len(scenes), {"faults": faults[:5]}),
        f"{name}/by fixed work": Measured(paired_ratio(times, work), {"fixed work": median(work)}),
    }


def strategy_metrics() -> list[Metric]:
    """Time and result of our planner and of the paper's, and the quotient of the times."""
    out = []
    for scene in SCENES:
        for strategy in STRATEGIES:
            name = f"strategies/{scene}, {strategy}"
            out += [
                Metric(f"{name}/time", "ms"),
                Metric(f"{name}/success", "%", "higher"),
                Metric(f"{name}/static cost", "mm", about="F_s, summed over body points"),
                Metric(f"{name}/avoid cost", "mm", about="F_d, summed over body points"),
                Metric(f"{name}/off the line", "mm", about="mean distance of the tool point from "
                       "the approach line, over the height from camera point to target"),
            ]  # fmt: skip
        name = f"strategies/{scene}, joint/by sequential"
        out.append(Metric(name, RATIO, target=1 / 20, about="times taken in turn"))
    return out


@SUITE.benchmark("strategies", strategy_metrics())
def strategies(context: Context) -> Values:
    """Our one solve beside the paper's two stages (SciPy's optimisers) on the same scene."""
    warm_up()
    out: dict[str, Value] = {}
    for name in SCENES:
        scene = load_scene(name)
        times: dict[str, list[float]] = {strategy: [] for strategy in STRATEGIES}
        made: dict[str, Plan] = {}
        for turn in range(context.repeats(7, 2) + 1):
            context.say(f"{name}: turn {turn}")
            for strategy, seen in times.items():
                fresh = replace(scene)
                began = time.perf_counter()
                made[strategy] = plan(fresh, planner=STRATEGIES[strategy])
                if turn:  # the first turn warms up
                    seen.append(1e3 * (time.perf_counter() - began))
        for strategy, result in made.items():
            row = f"strategies/{name}, {strategy}"
            out[f"{row}/time"] = median(times[strategy])
            out[f"{row}/success"] = Measured(
                100.0 * result.success, {"status": str(result.status), "message": result.message}
            )
            out |= {f"{row}/{key}": value for key, value in _costs(result).items()}
        ratio = paired_ratio(times["joint"], times["sequential"])
        out[f"strategies/{name}, joint/by sequential"] = ratio
    return out


def _costs(result: Plan) -> dict[str, float]:
    """The same functionals of any plan, whatever it minimised; lengths in mm."""
    setup, q = resolve(result.scene), result.trajectory.positions
    values = functional_values(setup, Paper(strategy="joint"), len(q) // 2, q)
    tips, _ = setup.robot.tool_pose(q)
    assert isinstance(setup.goal, PoseGoal)
    return {
        "static cost": 1e3 * values["static"],
        "avoid cost": 1e3 * values["avoid"],
        "off the line": 1e3 * _off_line(tips - setup.goal.position, setup.scene.frame[2],
                                        float((setup.camera - setup.goal.position)
                                              @ setup.scene.frame[2])),
    }  # fmt: skip


def _off_line(off: FloatArray, up: FloatArray, lowest: float) -> float:
    """Mean over the heights ``lowest`` … 0 of the distance from the line (last passage) [m]."""
    height = off @ up
    aside = np.linalg.norm(off - height[:, None] * up, axis=1)
    below = np.flatnonzero(height < lowest)
    first = int(below[-1]) if len(below) else 0
    climb = np.maximum.accumulate(height[first:])
    levels = np.linspace(lowest, 0.0, 200)
    return float(np.mean(np.interp(levels, climb, aside[first:])))


MANY = [
    Metric("many plans/plan_many/efficiency", RATIO, "higher", target=0.85,
           about="time with one worker by (cores × time with all of them)"),
    Metric("many plans/plan_many/plans", "1/s", "higher"),
]  # fmt: skip


@SUITE.benchmark("many-plans", MANY)
def many_plans(context: Context) -> Values:
    """Many scenes through one call, on one core and on all."""
    cores = len(os.sched_getaffinity(0))
    scenes = [each for name in SCENES for each in many(name, context.repeats(500, 40))]
    plan_many(scenes[: 4 * cores], workers=cores)
    one, all_ = [], []
    for _ in range(context.repeats(3, 1)):
        one.append(stopwatch(lambda: plan_many(scenes, workers=1)))
        all_.append(cores * stopwatch(lambda: plan_many(scenes, workers=cores)))
    detail = {"cores": cores, "scenes": len(scenes)}
    efficiency: Value = Measured(paired_ratio(one, all_), detail)
    if cores == 1:
        efficiency = Absent("one core only: nothing to share")
    return {
        "many plans/plan_many/efficiency": efficiency,
        "many plans/plan_many/plans": len(scenes) * cores / median(all_),
    }
