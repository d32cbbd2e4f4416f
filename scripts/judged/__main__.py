"""Judge the judge: its contacts and distances against Coal's and MuJoCo's.

    python -m scripts.judged --still 10000 --moving 2000 --own 10000 --own-moving 2000 \
        --self 10000 --seed 0

Kinematics are Pinocchio's, curves SciPy's, distances Coal's, and in still cases MuJoCo's too. No
code is shared with the judge. Bodies are the makers' meshes (package example-robot-data, extra
``models``) and the solids of the tool; of the SCARA, which has no meshes, its spheres. A case is
one robot, one tool, one object near its surface, and one configuration (``still``) or one random
curve (``moving``). In ``own`` and ``own-moving`` the bodies are the spheres that the judge knows.
``self`` compares contacts between links. A case is missed if the judge calls free what is in
contact by more than 1 mm.
"""

import argparse
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import coal
import numpy as np
from scipy.interpolate import BPoly
from scripts.judged.bodies import Arm, arms
from scripts.judged.things import MuJoCo, Thing, distance, thing

from optipromp.core import judging
from optipromp.core.scenes import JointGoal, Scene
from optipromp.core.trajectory import Trajectory

DEEP = 1e-3  # [m] a contact beyond it must be seen
CASES = {  # in words
    "still": "still, makers' bodies", "moving": "along random curves, makers' bodies",
    "own": "still, the judge's own spheres", "own-moving": "along random curves, its own spheres",
    "self": "links against links",
}  # fmt: skip
BOTTOM = 2e-4  # [m] least advance of the oracle along a curve


class Curve:
    """A trajectory's quintics by SciPy, and the speed of the robot's surface at most."""

    def __init__(self, arm: Arm, trajectory: Trajectory) -> None:
        rows = np.stack(
            [trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1
        )
        self.times = np.array(trajectory.times)
        self.curve = BPoly.from_derivatives(self.times, rows)
        cells = np.linspace(self.times[0], self.times[-1], 20 * (len(self.times) - 1) + 1)
        inside = np.linspace(cells[:-1], cells[1:], 9)
        speed = 1.2 * np.abs(self.curve.derivative()(inside)).max(axis=0) @ arm.levers
        self.cells, self.speed = cells, np.maximum(speed, 1e-6)

    def __call__(self, t: float) -> Any:
        """Configuration at a time."""
        return self.curve(t)

    def after(self, t: float, free: float) -> float:
        """The first time after ``t`` at which the surface may have moved by ``free`` [m]."""
        cell = min(int(np.searchsorted(self.cells, t, side="right")) - 1, len(self.speed) - 1)
        while cell < len(self.speed):
            end = self.cells[cell + 1]
            if free < self.speed[cell] * (end - t):
                return t + free / self.speed[cell]
            free -= self.speed[cell] * (end - t)
            t, cell = end, cell + 1
        return np.inf


def deepest(arm: Arm, curve: Curve, what: Thing) -> tuple[float, float]:
    """A distance [m] along a curve, and when: the first below -DEEP, or the least seen.

    Between two looks the surface moves no farther than it must to be in contact by DEEP, or than
    :data:`BOTTOM`.
    """
    t, best, when = 0.0, np.inf, 0.0
    while t <= curve.times[-1] and best >= -DEEP:
        d = distance(arm, curve(t), what)
        if d < best:
            best, when = d, t
        t = curve.after(t, max(abs(d + DEEP), BOTTOM))
    return best, when


def said(what: Thing, found: dict[str, float | None]) -> float:
    """The judge's distance for the role [m]."""
    value = found[f"clearance_{what.role}"]
    return np.inf if value is None else value


@dataclass
class Tally:
    """What was found: both distances of every case, and the cases that were missed."""

    ours: list[float] = field(default_factory=list)
    theirs: list[float] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    touching: int = 0

    def add(self, free: bool, ours: float, theirs: float, case: str, measured: bool = True) -> None:
        """One case: whether the judge calls it free, and both distances [m], if measured."""
        self.touching += theirs < -DEEP
        if free and theirs < -DEEP:
            self.missed.append(f"{case}: theirs {theirs * 1e3:.2f} mm, ours {ours * 1e3:.2f} mm")
        if measured and (ours > 0.0 or theirs > 0.0):
            self.ours.append(ours)
            self.theirs.append(theirs)

    def cells(self) -> tuple[str, str, str]:
        """In contact by more than 1 mm, missed, quantiles of our distance minus theirs [mm]."""
        both = 1e3 * (np.array(self.ours) - np.array(self.theirs))
        both = both[np.isfinite(both)]
        shown = np.percentile(both, [1, 5, 50, 95, 99]) if len(both) else ()
        off = ", ".join(f"{each:.2f}" for each in shown)
        return f"{self.touching:,}", f"{len(self.missed)}", off


def still(cases: int, seed: int, own: bool = False, mujocos: bool = True) -> Tally:
    """Random configurations with one object each."""
    tally, every, other = Tally(), arms(own), MuJoCo()
    for k in range(cases):
        rng = np.random.default_rng([seed, 1, k])
        arm = every[k % len(every)]
        q = rng.uniform(arm.low, arm.high)
        what = thing(rng, arm, q, rng.choice([-0.005, 0.02, 0.2]) * rng.random())
        found, contacts = judging.clearances(_scene(q, what), arm.robot, q[None])
        theirs = [distance(arm, q, what)]
        if mujocos and what.kind != "half-space":
            theirs.append(other.distance(arm, q, what))
        free = not any(c.other == "it" for c in contacts)
        # the libraries' depths differ; what either finds counts
        tally.add(free, said(what, found), min(theirs), f"still {k}: {arm.name}, {what}")
    return tally


def moving(cases: int, seed: int, own: bool = False) -> Tally:
    """Random curves with one object near the way of the robot, mostly between its waypoints."""
    tally, every = Tally(), arms(own)
    for k in range(cases):
        rng = np.random.default_rng([seed, 2, k])
        arm = every[k % len(every)]
        trajectory = curve_of(rng, arm)
        curve = Curve(arm, trajectory)
        q = curve(rng.uniform(0.0, trajectory.duration))
        what = thing(rng, arm, q, 0.0)
        for _ in range(2):  # so that it is touched by little, or nearly
            looks = np.linspace(0.0, trajectory.duration, 40)
            free = rng.uniform(-0.004, 0.004) - min(distance(arm, curve(t), what) for t in looks)
            what = what.moved(free * what.out)
        judgement = judging.judge(_scene(q, what), arm.robot, trajectory)
        free = not any(c.other == "it" for c in judgement.contacts)
        free &= not any(v.kind == "unchecked" for v in judgement.violations)
        ours = said(what, judgement.metrics.to_dict())
        theirs, when = deepest(arm, curve, what)
        text = f"moving {k}: {arm.name}, {what}, at {when:.3f} s"
        tally.add(free, ours, theirs, text, measured=False)
    return tally


def selves(cases: int, seed: int) -> Tally:
    """Random configurations: contacts between links whose spheres the judge keeps apart."""
    tally, every = Tally(), arms(False)
    for k in range(cases):
        rng = np.random.default_rng([seed, 3, k])
        arm = every[k % len(every)]
        robot, q = arm.robot, rng.uniform(arm.low, arm.high)
        names = np.array([robot.link_names[i] for i in robot.spheres.link])
        kept = {frozenset(pair) for pair in names[robot.self_pairs].tolist()}
        goal = Scene("s", "robot", (), goal=JointGoal(q))
        found, contacts = judging.clearances(goal, robot, q[None])
        turns, places = arm.poses(q)
        poses = [coal.Transform3s(*pose) for pose in zip(turns, places, strict=True)]
        least = np.inf
        for i, a in enumerate(arm.pieces):
            for j in range(i):
                if frozenset((a.link, arm.pieces[j].link)) in kept:
                    d = coal.distance(arm.bodies[i], poses[i], arm.bodies[j], poses[j],
                                      coal.DistanceRequest(), coal.DistanceResult())  # fmt: skip
                    least = min(least, d)
        ours = found["clearance_self"]
        tally.add(not contacts, np.inf if ours is None else ours, least, f"self {k}: {arm.name}")
    return tally


def curve_of(rng: Any, arm: Arm) -> Trajectory:
    """A random curve of 2 to 6 waypoints: smooth, or with a state of its own at each."""
    count, names = int(rng.integers(2, 7)), arm.robot.joint_names
    size = np.exp(rng.uniform(np.log(0.02), np.log(1.5)))
    q = rng.uniform(arm.low, arm.high) + size * rng.normal(size=(count, arm.model.nq)).cumsum(0)
    if rng.random() < 0.5:
        return Trajectory.through(q, 0.5, names)
    times = np.cumsum(rng.uniform(0.1, 1.0, count))
    speed, gain = (size * factor * rng.normal(size=q.shape) for factor in (2.0, 8.0))
    return Trajectory(times - times[0], q, speed, gain, names)


def _scene(q: Any, what: Thing) -> Scene:
    return Scene("s", "robot", (what.item,), goal=JointGoal(q))


def main() -> None:
    """Run the cases that are asked for."""
    parser = argparse.ArgumentParser()
    runs: dict[str, Any] = {
        "still": still, "moving": moving, "own": partial(still, own=True, mujocos=False),
        "own-moving": partial(moving, own=True), "self": selves,
    }  # fmt: skip
    for name in (*runs, "seed"):
        parser.add_argument(f"--{name}", dest=name, type=int, default=0)
    asked = vars(parser.parse_args())
    off = "our distance minus theirs [mm]: 1 %, 5 %, median, 95 %, 99 %"
    lines = [
        "### Contacts",
        "",
        f"| cases | in contact by > 1 mm | missed | {off} |",
        "|---|---|---|---|",
    ]
    for name, run in runs.items():
        if cases := asked[name]:
            tally = run(cases, asked["seed"])
            touching, missed, quantiles = tally.cells()
            print(f"{name}: {missed} missed", *tally.missed[:20], sep="\n  ", flush=True)
            lines.append(f"| {CASES[name]} | {touching} of {cases:,} | {missed} | {quantiles} |")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
