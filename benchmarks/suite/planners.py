"""Whole planners beside ours: time, success by the independent check, path length, smoothness.

Each planner runs in a process of its own, in turn with ours on the same scenes.
"""

import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from benchmarks.peers import Answer, Planner, rrt_connect
from benchmarks.registry import RATIO, SUITE, Absent, Context, Measured, Metric, Value, Values
from benchmarks.scenes import groups
from benchmarks.timing import median, paired_ratio
from optipromp.core.errors import Code, OptiPrompError
from optipromp.core.planning import judge, plan, warm_up
from optipromp.core.scenes.scene import Scene

GROUPS = ("scenario-3", "scenario-4", "generated")
SEEDS = 7  # a single scene is planned as often, each time with another seed
TURNS = 2  # with the same seed; the faster counts, so that other work on the machine counts less


def ours(name: str = "opti-promp") -> Planner:
    """A planner of ours, by default the default, as far as the target: no peer plans a way out."""

    def answer(scene: Scene, seed: int) -> Answer:
        made = plan(scene, planner=name, seed=seed)
        moves = bool(np.ptp(made.trajectory.positions, axis=0).max() > 0.0)
        return Answer(made.trajectory if moves else None, made.message, scene=made.scene)

    return answer


PEERS: dict[str, tuple[str, Planner]] = {
    "obstacles": (
        "a baseline of our studies: our optimiser, every fruit is avoided by cost",
        ours("obstacles"),
    ),
    "chomp": (
        "another one: covariant gradient descent from a ProMP, fruits are obstacles",
        ours("chomp"),
    ),
    "OMPL RRT-Connect": (
        "our collision checker and goals; the tool may push", rrt_connect
    ),
}  # fmt: skip


@dataclass
class Score:
    """What a planner did on a group of scenes."""

    seconds: list[float] = field(default_factory=list)
    success: list[bool] = field(default_factory=list)
    valid: list[bool] = field(default_factory=list)
    length: list[float] = field(default_factory=list)
    smoothness: list[float] = field(default_factory=list)
    faults: Counter[str] = field(default_factory=Counter)

    def add(self, planner: Planner, scene: Scene, seed: int) -> None:
        """Plan, and have the answer judged between its waypoints too."""
        passed = []
        for _ in range(TURNS):
            began = time.perf_counter()
            try:
                answer = planner(scene, seed)
            except OptiPrompError as error:
                answer = Answer(None, f"{error.code}: {error.message}")
            took = time.perf_counter() - began
            passed.append(took)
        self.seconds.append(min(passed))
        if answer.trajectory is None:
            self.faults[answer.reason] += 1
            self.success.append(False)
            self.valid.append(False)
            return
        found = judge(answer.scene or scene, answer.trajectory)
        said = [str(violation) for violation in found.judgement.violations]
        self.success.append(found.status is Code.SUCCESS)
        self.valid.append(not said)
        self.length.append(found.judgement.metrics.path_length)
        self.smoothness.append(found.judgement.metrics.smoothness)
        self.faults.update(said or [found.message] * (found.status is not Code.SUCCESS))

    def values(self, name: str) -> dict[str, Value]:
        """The metrics of this group."""
        none = Absent(f"no trajectory: {', '.join(self.faults)}")
        count = len(self.valid)
        detail = {"scenes": count, "faults": dict(self.faults.most_common(8))}
        return {
            f"{name}/time": Measured(1e3 * median(self.seconds), {"max": 1e3 * max(self.seconds)}),
            f"{name}/success": Measured(100.0 * sum(self.success) / count, detail),
            f"{name}/valid": 100.0 * sum(self.valid) / count,
            f"{name}/path length": median(self.length) if self.length else none,
            f"{name}/smoothness": median(self.smoothness) if self.length else none,
        }


def metrics_of(planner: str, about: str = "", ratio: bool = True) -> list[Metric]:
    """A planner's metrics in every group of scenes."""
    out = []
    for group in GROUPS:
        name = f"planners, {group}/{planner}"
        out += [
            Metric(f"{name}/time", "ms", about=about),
            Metric(f"{name}/success", "%", "higher", about="valid, and little harm is predicted"),
            Metric(f"{name}/valid", "%", "higher", about="whatever the push does to the fruits"),
            Metric(f"{name}/path length", "rad", about="of all trajectories, valid or not"),
            Metric(f"{name}/smoothness", "rad/s²", about="root mean square acceleration"),
        ]  # fmt: skip
        if ratio:
            out.append(Metric(f"{name}/ours by it", RATIO, tolerance=0.5, about="times in turn"))
    return out


def beside(label: str, peer: Planner | None, context: Context) -> Values:
    """Run a planner (None: ours alone) in turn with ours on every group."""
    default = ours()
    warm_up()
    out: dict[str, Value] = {}
    for group, scenes in groups(context.quick).items():
        jobs = [(scenes[0], seed) for seed in range(context.repeats(SEEDS, 3))]
        jobs = jobs if len(scenes) == 1 else [(scene, 0) for scene in scenes]
        mine, theirs = Score(), Score()
        Score().add(peer or default, *jobs[0])  # what is made once is not timed
        for scene, seed in jobs:
            context.say(f"{label}: {scene.name}, seed {seed}")
            mine.add(default, scene, seed)
            theirs.add(peer or default, scene, seed)
        name = f"planners, {group}/{label}"
        out |= theirs.values(name)
        if peer is not None:
            ratio = paired_ratio(mine.seconds, theirs.seconds)
            detail = {"ours [ms]": 1e3 * median(mine.seconds)}
            gone = Absent("it gave no trajectory")
            out[f"{name}/ours by it"] = Measured(ratio, detail) if theirs.length else gone
    return out


@SUITE.benchmark("planner-optipromp", metrics_of("optipromp", "all defaults", ratio=False))
def alone(context: Context) -> Values:
    """Our planner on the scenes that every planner gets."""
    return beside("optipromp", None, context)


def _register(label: str, about: str, peer: Planner) -> None:
    def run(context: Context) -> Values:
        return beside(label, peer, context)

    run.__doc__ = f"{label}: {about}."
    name = "planner-" + label.lower().replace(" ", "-")
    SUITE.benchmark(name, metrics_of(label, about))(run)


for _label, (_about, _peer) in PEERS.items():
    _register(_label, _about, _peer)
