"""Movement primitives: learning, conditioning, sampling, beside two other libraries."""

import importlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks.registry import RATIO, SUITE, Absent, Context, Measured, Metric, Value, Values
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
PEERS = ("movement_primitives", "mp_pytorch")
Jobs = dict[str, Callable[[], object] | Absent]


def metrics() -> list[Metric]:
    """Time of every job for every library, and ours by each peer's."""
    about = {"fit": f"{DEMONSTRATIONS} demonstrations × {JOINTS} joints × {STEPS}, {BASES} bases"}
    out = [
        Metric(f"movement primitives/optipromp/{job}", "ms", target=TARGETS.get(job),
               about=about.get(job, ""))
        for job in JOBS
    ]  # fmt: skip
    for peer in PEERS:
        out += [Metric(f"movement primitives/{peer}/{job}", "ms") for job in JOBS]
        name = f"movement primitives/ours by {peer}"
        out += [Metric(f"{name}/{job}", RATIO, tolerance=0.4) for job in JOBS]
    return out


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


def with_mp_pytorch(data: FloatArray, y: FloatArray) -> Jobs:
    """The jobs with mp_pytorch, which leaves the spread of the weights to its user."""
    torch = importlib.import_module("torch")
    library = importlib.import_module("mp_pytorch.mp")
    torch.set_num_threads(1)
    promp = library.MPFactory.init_mp(
        "promp", {"num_basis": BASES, "basis_bandwidth_factor": 2, "num_basis_outside": 0},
        num_dof=JOINTS, tau=1.0, dtype=torch.float64,
    )  # fmt: skip
    times = torch.linspace(0.0, 1.0, STEPS, dtype=torch.float64)
    many, motions = times.repeat(DEMONSTRATIONS, 1), torch.as_tensor(data)

    def learn() -> tuple[Any, Any]:
        weights = promp.learn_mp_params_from_trajs(many, motions)["params"]
        spread = torch.cov(weights.T) + 1e-6 * torch.eye(weights.shape[1], dtype=torch.float64)
        return weights.mean(dim=0), torch.linalg.cholesky(spread)

    mean, factor = learn()

    def sample() -> Any:
        promp.update_inputs(times=times, params=mean, params_L=factor)
        return promp.sample_trajectories(num_smp=20)

    nothing = Absent("the library has no conditioning")
    return {
        "fit": learn,
        "condition on one point": nothing,
        "condition on five points": nothing,
        "sample 20": sample,
        "mean trajectory": lambda: promp.get_traj_pos(times=times, params=mean),
    }


MAKERS: Mapping[str, Callable[[FloatArray, FloatArray], Jobs]] = {
    "movement_primitives": with_movement_primitives,
    "mp_pytorch": with_mp_pytorch,
}


@SUITE.benchmark("movement-primitives", metrics(), timeout=600)
def movement_primitives(context: Context) -> Values:
    """Learning, conditioning and sampling, each library in turn."""
    data = demonstrations()
    y = data[:, STEPS // 2].mean(axis=0) + 0.1
    own = ours(data, y)
    out: dict[str, Value] = {}
    for peer, make in MAKERS.items():
        try:
            theirs = make(data, y)
        except ImportError as error:
            theirs = dict.fromkeys(JOBS, Absent(f"not installed ({error})"))
        for job in JOBS:
            context.say(f"{peer}: {job}")
            out |= _beside(peer, job, own[job], theirs[job], context)
    return out


def _beside(
    peer: str, job: str, mine: Any, other: Callable[[], object] | Absent, context: Context
) -> dict[str, Value]:
    family = "movement primitives"
    slow = peer == "movement_primitives" and job == "fit"
    rounds = context.repeats(10 if slow else 60)
    both = {"ours": mine} if isinstance(other, Absent) else {"ours": mine, "peer": other}
    times = in_turn(both, rounds, WARM)
    detail = {"minimum": 1e3 * min(times["ours"])}
    out: dict[str, Value] = {
        f"{family}/optipromp/{job}": Measured(1e3 * median(times["ours"]), detail)
    }
    if isinstance(other, Absent):
        return out | {f"{family}/{peer}/{job}": other, f"{family}/ours by {peer}/{job}": other}
    out[f"{family}/{peer}/{job}"] = 1e3 * median(times["peer"])
    out[f"{family}/ours by {peer}/{job}"] = paired_ratio(times["ours"], times["peer"])
    return out
