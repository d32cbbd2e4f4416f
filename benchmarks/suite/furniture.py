"""Goals in joints among furniture: whole plans, and their length by that of OMPL's simplified path.

The families are generated (``optipromp generate --preset bookshelf``).
"""

import time

import numpy as np

from benchmarks.peers.ompl import rrt_connect
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
BESIDE = 25  # scenes of a family that OMPL gets too


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
            Metric(
                f"{name}/path by OMPL's", RATIO, tolerance=0.1, target=1.15,
                about=f"median of {BESIDE} scenes a family; RRT-Connect on our checker, simplified",
            ),
            Metric(f"{name}/time by OMPL's", RATIO, tolerance=0.5, about="in turn; its checker "
                   "is our kernels, called from Python"),
        ]  # fmt: skip
    return out


@SUITE.benchmark("furniture", metrics(), timeout=1800)
def furniture(context: Context) -> Values:
    """Whole plans to goals in joints among furniture, with OMPL in turn on a part of the scenes."""
    warm_up()
    try:
        peer, absent = rrt_connect(False), None
    except NotAvailableError as error:
        peer, absent = None, Absent(str(error))
    out: dict[str, Value] = {}
    rows: dict[str, list[tuple[float, bool, float, float]]] = {}
    for family in FURNITURE:
        context.say(family)
        found = rows[family] = []
        for i in range(context.repeats(COUNT)):
            scene = generate(family, FIRST + i)
            began = time.perf_counter()
            made = plan(scene)
            took, longer, slower = time.perf_counter() - began, np.nan, np.nan
            if peer is not None and i < context.repeats(BESIDE):
                began = time.perf_counter()
                answer = peer(scene, i)
                slower = took / (time.perf_counter() - began)
                if made.success and answer.trajectory is not None:
                    theirs = np.diff(answer.trajectory.positions, axis=0)
                    ours = made.metrics.path_length
                    longer = ours / float(np.linalg.norm(theirs, axis=1).sum())
            found.append((1e3 * took, made.success, longer, slower))
    rows["all"] = [row for found in rows.values() for row in found]
    for group, found in rows.items():
        took_all, success, longer_all, slower_all = zip(*found, strict=True)
        name = f"furniture/{group}"
        out[f"{name}/median"] = Measured(median(took_all), {"max": max(took_all)})
        out[f"{name}/95th percentile"] = percentile(took_all, 0.95)
        out[f"{name}/success"] = 100.0 * float(np.mean(success))
        for what, values in (("path", longer_all), ("time", slower_all)):
            kept = [value for value in values if np.isfinite(value)]
            detail = {"95 %": percentile(kept, 0.95)} if kept else {}
            out[f"{name}/{what} by OMPL's"] = absent or Measured(median(kept), detail)
    return out
