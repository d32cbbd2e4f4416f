"""Goals in joints among furniture: whole plans, and their length by that of RRT-Connect's paths.

The families are generated (``optipromp generate --preset bookshelf``).
"""

import time
from collections.abc import Callable

import numpy as np

from benchmarks.peers import mplib, ompl
from benchmarks.peers.common import Planner
from benchmarks.registry import (
    RATIO,
    SUITE,
    Absent,
    Context,
    Measured,
    Metric,
    NotAvailableError,
    Value,
    Values,
)
from benchmarks.timing import median, percentile
from optipromp.planning import plan, warm_up
from optipromp.scenes.generate import FURNITURE, generate

FIRST, COUNT = 80_000, 100  # seed of the first scene, scenes of a family
BESIDE = 25  # scenes of a family that the peers get too
PEERS: dict[
    str, tuple[Callable[[], Planner], str, str]
] = {  # a planner, what it is, and what its time means
    "OMPL": (
        lambda: ompl.rrt_connect(False),
        "on our checker, simplified",
        "its checker is our kernels, called from Python",
    ),
    "MPlib": (mplib.rrt_connect, "with FCL, timed by TOPP-RA", "model and timing included"),
}


def metrics() -> list[Metric]:
    """Time, share of valid plans and path length of each family."""
    about = f"{COUNT} fresh scenes; every second start is among the furniture too"
    out = []
    for family in (*FURNITURE, "all"):
        name = f"furniture/{family}"
        out += [
            Metric(f"{name}/median", "ms", target=50.0, about=about),
            Metric(f"{name}/95th percentile", "ms", target=500.0),
            Metric(f"{name}/success", "%", "higher", target=98.0),
        ]
        for peer, (_, path, seconds) in PEERS.items():
            about = f"median of {BESIDE} scenes a family; RRT-Connect {path}"
            out += [
                Metric(f"{name}/path by {peer}'s", RATIO, tolerance=0.1, target=1.15, about=about),
                Metric(
                    f"{name}/time by {peer}'s", RATIO, tolerance=0.5, about=f"in turn; {seconds}"
                ),
            ]
    return out


@SUITE.benchmark("furniture", metrics(), timeout=1800)
def furniture(context: Context) -> Values:
    """Whole plans to goals in joints among furniture; the peers in turn on a part of the scenes."""
    warm_up()
    peers: dict[str, Planner] = {}
    absent: dict[str, Value] = {}
    for peer, (made_by, *_) in PEERS.items():
        try:
            peers[peer] = made_by()
        except NotAvailableError as error:
            absent[peer] = Absent(str(error))
    out: dict[str, Value] = {}
    rows: dict[str, list[tuple[float, bool, dict[str, tuple[float, float]]]]] = {}
    for family in FURNITURE:
        context.say(family)
        found = rows[family] = []
        for i in range(context.repeats(COUNT)):
            scene = generate(family, FIRST + i)
            began = time.perf_counter()
            made = plan(scene)
            took, by = time.perf_counter() - began, dict[str, tuple[float, float]]()
            for peer, solve in peers.items() if i < context.repeats(BESIDE) else ():
                began = time.perf_counter()
                answer = solve(scene, i)
                slower, longer = took / (time.perf_counter() - began), np.nan
                if made.success and answer.trajectory is not None:
                    theirs = np.diff(answer.trajectory.positions, axis=0)
                    ours = made.metrics.path_length
                    longer = ours / float(np.linalg.norm(theirs, axis=1).sum())
                by[peer] = longer, slower
            found.append((1e3 * took, made.success, by))
    rows["all"] = [row for found in rows.values() for row in found]
    for group, found in rows.items():
        took_all, success, by_all = zip(*found, strict=True)
        name = f"furniture/{group}"
        out[f"{name}/median"] = Measured(median(took_all), {"max": max(took_all)})
        out[f"{name}/95th percentile"] = percentile(took_all, 0.95)
        out[f"{name}/success"] = 100.0 * float(np.mean(success))
        for peer in PEERS:
            both = [by[peer] for by in by_all if peer in by]
            for k, what in enumerate(("path", "time")):
                kept = [ratios[k] for ratios in both if np.isfinite(ratios[k])]
                detail = {"95 %": percentile(kept, 0.95)} if kept else {}
                detail |= {"solved": float(len(kept))} if what == "path" else {}
                value = Measured(median(kept), detail) if kept else Absent("solved nothing")
                out[f"{name}/{what} by {peer}'s"] = absent.get(peer, value)
    return out
