"""Movement primitives: learning, conditioning, sampling, beside the library movement_primitives."""

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.registry import (
    RATIO,
    SUITE,
    Context,
    Measured,
    Metric,
    NotAvailableError,
    Value,
    Values,
)
from benchmarks.timing import in_turn, median, paired_ratio
from optipromp.core.arrays import FloatArray
from optipromp.core.promp import Basis, JointPoint, condition, fit

DEMONSTRATIONS, JOINTS, STEPS, BASES = 20, 7, 100, 10
PHASE = 0.5
WARM = 5e-3  # [s] of one library's calls before the other's turn: warm, as in a loop of its user
TARGETS = {"fit": 0.5, "condition on one point": 0.05}  # [ms]
JOBS = (
    "fit", "condition on one point", "condition on five points", "sample 20", "mean trajectory",
)  # fmt: skip
FAMILY, PEER = "movement primitives", "movement_primitives"
Jobs = dict[str, Callable[[], object]]


def metrics() -> list[Metric]:
    """Time of every job for either library, and ours by the peer's."""
    about = {"fit": f"{DEMONSTRATIONS} demonstrations × {JOINTS} joints × {STEPS}, {BASES} bases"}
    out = [
        Metric(f"{FAMILY}/optipromp/{job}", "ms", target=TARGETS.get(job),
               about=about.get(job, ""))
        for job in JOBS
    ]  # fmt: skip
    out += [Metric(f"{FAMILY}/{PEER}/{job}", "ms") for job in JOBS]
    ratios = [Metric(f"{FAMILY}/ours by {PEER}/{job}", RATIO, tolerance=0.4) for job in JOBS]
    return out + ratios


def demonstrations() -> FloatArray:
    """Smooth, varied motions (N, T, n) [rad]."""
    rng = np.random.default_rng(0)
    z = np.linspace(0.0, 1.0, STEPS)[None, :, None]
    a, b, c = rng.normal(0.0, 0.3, (3, DEMONSTRATIONS, 1, JOINTS))
    return np.asarray(0.5 + a + (0.8 + b) * (3 * z**2 - 2 * z**3) + c * np.sin(2 * np.pi * z) / 4)


def ours(data: FloatArray, y: FloatArray) -> Jobs:
    """The jobs as a user of this library writes them."""
    basis, phases = Basis(BASES), np.linspace(0.0, 1.0, STEPS)
    motions = list(data)
    promp = fit(motions, basis)
    rng = np.random.default_rng(1)
    five = [JointPoint(z, y, 1e-6) for z in np.linspace(0.1, 0.9, 5)]
    return {
        "fit": lambda: fit(motions, basis),
        "condition on one point": lambda: condition(promp, JointPoint(PHASE, y, 1e-6)),
        "condition on five points": lambda: condition(promp, five),
        "sample 20": lambda: promp.sample(rng, 20, phases),
        "mean trajectory": lambda: promp.mean_trajectory(phases),
    }


def with_movement_primitives(data: FloatArray, y: FloatArray) -> Jobs:
    """The jobs with movement_primitives (expectation–maximisation as it comes)."""
    library = importlib.import_module("movement_primitives.promp")
    times = np.linspace(0.0, 1.0, STEPS)
    many, noise = np.tile(times, (DEMONSTRATIONS, 1)), 1e-6 * np.eye(JOINTS)
    rng = np.random.RandomState(1)

    def learn() -> Any:
        promp = library.ProMP(JOINTS, BASES)
        promp.imitate(many, data)
        return promp

    promp = learn()

    def five() -> Any:
        found = promp
        for t in np.linspace(0.1, 0.9, 5):
            found = found.condition_position(y, noise, t)
        return found

    return {
        "fit": learn,
        "condition on one point": lambda: promp.condition_position(y, noise, PHASE),
        "condition on five points": five,
        "sample 20": lambda: promp.sample_trajectories(times, 20, rng),
        "mean trajectory": lambda: promp.mean_trajectory(times),
    }


@SUITE.benchmark("movement-primitives", metrics(), timeout=600)
def movement_primitives(context: Context) -> Values:
    """Learning, conditioning and sampling, either library in turn."""
    data = demonstrations()
    y = data[:, STEPS // 2].mean(axis=0) + 0.1
    try:
        theirs = with_movement_primitives(data, y)
    except ImportError as error:
        raise NotAvailableError(f"movement_primitives is not installed ({error})") from None
    own, out = ours(data, y), dict[str, Value]()
    for job in JOBS:
        context.say(job)
        rounds = context.repeats(10 if job == "fit" else 60)
        times = in_turn({"ours": own[job], "peer": theirs[job]}, rounds, WARM)
        detail = {"minimum": 1e3 * min(times["ours"])}
        out[f"{FAMILY}/optipromp/{job}"] = Measured(1e3 * median(times["ours"]), detail)
        out[f"{FAMILY}/{PEER}/{job}"] = 1e3 * median(times["peer"])
        out[f"{FAMILY}/ours by {PEER}/{job}"] = paired_ratio(times["ours"], times["peer"])
    return out
