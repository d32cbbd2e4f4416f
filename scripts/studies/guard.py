"""What the guard gives: entries and a random policy, on the same scenes without it and with it.

    optipromp bench study scripts/studies/guard.toml --out guard
    python -m scripts.studies.guard clone cluster 900001 guarded.gif 0.25

The table has clean and harmed in each of the ``ways`` that a study asks for (alone; guarded; takes
over: where the guard stands, the loop goes on), with Wilson's intervals (95 %), the share of
periods in which the guard acted, and its time a step. A run behind the guard ends where the arm has
stood still for 4 s. Motions of entries that plan are followed by joint velocities, in all ways. The
second command draws a scene four times faster, the three ways beside each other.
"""

import itertools
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.trajectory import Trajectory
from optipromp_bench.entries import ENTRIES
from optipromp_bench.episode import LONGEST, Driven, Episode, Observation
from optipromp_bench.experiments.statistics import Table, share
from optipromp_bench.running import STEADY
from optipromp_loop.guard import Guard
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Outcome, Run, Simulation
from optipromp_sim.simulation.rollouts import rollout
from optipromp_sim.situations import CONDITIONS

LONG = 60.0  # [s] of a random policy
GAIN = 2.0  # [1/s] of the joints' error of position
LATE = 0.02  # [rad] of a joint
STILL, REST = 4.0, 1e-3  # [s], [rad/s]: behind the guard an arm that stands so long goes on no more
SLOWED = 0.5  # [s] twice, before the end of a run: in the first the wishes go to 0
RESULTS = "clean", "harmed"
WAYS = {"alone": (False, False), "guarded": (True, False), "takes over": (True, True)}
SHARES = np.linspace(0.0, 1.0, 21)  # of the steps of a run, whose times are kept
VIEW = 480, 810  # [pixel] of each part of a film
Policy = Callable[[Observation], FloatArray]


@dataclass(frozen=True)
class Guards:
    """A study of entries alone and guarded; ``random`` is a policy that wanders for 60 s."""

    entries: tuple[str, ...] = ("random",)
    presets: tuple[str, ...] = ("cluster", "field")
    seeds: tuple[int, int] = (940_000, 940_005)
    engines: tuple[str, ...] = ("arm",)
    conditions: tuple[str, ...] = ("none",)
    ways: tuple[str, ...] = ("alone", "guarded")  # of WAYS

    def asks(self) -> list[dict[str, Any]]:
        """See :class:`optipromp_bench.experiments.kinds.Kind`."""
        names = "entry", "engine", "condition", "way", "seed", "preset"
        all_ = itertools.product(
            self.entries, self.engines, self.conditions, self.ways, range(*self.seeds),
            self.presets,
        )  # fmt: skip
        asks = [dict(zip(names, each, strict=True)) for each in all_]
        return [ask for ask in asks if ask["engine"] == "arm" or ask["condition"] in STEADY]

    def trial(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """What became of one run; ``spent`` are the guard's times [ms] at the shares SHARES."""
        try:
            return driven(ask)[0]
        except OptiPrompError as error:
            return {"result": "error", "causes": str(error)}

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
        """A table for each study."""
        return [table(title, rows) for title, rows in parts.items()]


def following(curve: Trajectory, period: float) -> Policy:
    """The velocities along a motion."""
    phase = 0.0

    def act(seen: Observation) -> FloatArray:
        nonlocal phase
        (q,), (velocity,), _ = curve.sample(min(phase + period, curve.duration))
        late = np.abs(q - seen.q) - period * np.abs(velocity)
        if late.max() < LATE:  # an arm that is held up is waited for
            phase += period
        return np.asarray(velocity + GAIN * (q - seen.q - period * seen.velocity))

    return act


def at_random(episode: Episode, seed: int) -> Policy:
    """Velocities of the joints that last for a while."""
    rng, robot = np.random.default_rng(seed), episode.robot
    wish, until = np.zeros(robot.n_joints), 0.0

    def act(seen: Observation) -> FloatArray:
        nonlocal wish, until
        if seen.time >= until:
            until = seen.time + rng.uniform(0.1, 1.0)
            wish = rng.uniform(-0.5, 0.5, robot.n_joints) * robot.velocity
        return wish

    return act


def policy_of(name: str, episode: Episode, seed: int) -> Policy | None:
    """An entry's actions in an episode; None: it gives no motion."""
    if name == "random":
        return at_random(episode, seed)
    entry: Any = resolve_name(ENTRIES[name].spec if name in ENTRIES else name)()
    if hasattr(entry, "act"):
        entry.reset(episode.scene, seed)
        act: Policy = entry.act
        return act
    try:
        made = entry.plan(episode.scene, seed)
    except OptiPrompError:
        return None
    motion = getattr(made, "trajectory", getattr(made, "reach", made))
    return following(motion, episode.period) if isinstance(motion, Trajectory) else None


def driven(ask: Mapping[str, Any]) -> tuple[dict[str, Any], Run | None]:
    """What became of one run; and the run, for a film."""
    seed, wanders = ask["seed"], ask["entry"] == "random"
    situation = CONDITIONS[ask["condition"]](generate(ask["preset"], seed), seed)
    most = LONG if wanders else LONGEST
    episode = Episode(situation, seed, engine=ask["engine"], longest=most)
    policy = policy_of(ask["entry"], episode, seed)
    if policy is None:
        return {"result": "refused", "causes": ""}, None
    guard = None
    guards, takes_over = WAYS[ask["way"]]
    if guards:
        guard = Guard(episode.scene, episode.robot, takes_over=takes_over)
    moved, patience = 0.0, STILL if guard and not wanders else most

    def act(seen: Observation) -> FloatArray | None:
        nonlocal moved
        if seen.time >= min(most, moved + patience):
            return None
        led = guard is not None and guard.leads
        moved = seen.time if led or np.abs(seen.velocity).max() > REST else moved
        left = most - seen.time  # a run of its longest time ends at rest
        return policy(seen) * min(max(left - SLOWED, 0.0) / SLOWED, 1.0)

    agent = Driven(act, guard=guard)
    outcome, arena = rollout(agent, episode), episode.arena
    seconds = round(episode.period * len(agent.actions), 2)
    row = {
        "result": outcome.result, "causes": " ".join(map(str, outcome.causes)), "seconds": seconds,
        "steps": len(agent.safe), "acted": sum(safe.acted for safe in agent.safe),
        "spent": (1e3 * np.quantile(agent.spent or [0.0], SHARES)).round(2).tolist(),
    }  # fmt: skip
    if not (isinstance(arena, Simulation) and isinstance(outcome, Outcome)):
        return row, None
    assert episode.records is not None
    shown = situation.scene, episode.robot, arena.parameters, seed
    return row, Run(*shown, episode.records, outcome, 0.0)


def table(title: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """A line for each entry; of several, a line for each preset, and one of all."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    several = len({row["entry"] for row in rows}) > 1
    for name in ("`{entry}`", *("all, `{preset}`", "all")[: 2 * several]):
        for row in rows:
            groups.setdefault(name.format(**row), []).append(row)
    lines, ways = [], tuple(dict.fromkeys(row["way"] for row in rows))
    told = dict.fromkeys(part for row in rows for part in (row["engine"], row["condition"]))
    physics = ", ".join(part for part in told if part != "none")
    for name, own in groups.items():
        by = {way: [row for row in own if row["way"] == way] for way in ways}
        shares = [
            share(sum(row["result"] == end for row in each), len(each))
            for each in by.values()
            for end in RESULTS
        ]
        steps = steps_of([row for row in by["guarded"] if row.get("steps")])
        lines.append([name, physics, len(by[ways[0]]), *shares, *steps])
    heads = [f"{way}: {end} % (95 %)" for way in ways for end in RESULTS]
    columns = ["entry", "physics", "n", *heads, "acted", "a step: median, 95 %"]
    return Table(f"Guard, {title}", columns, lines)


def steps_of(rows: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """In how many periods the guard acted, and its time a step."""
    if not rows:
        return "–", "–"
    steps = np.array([row["steps"] for row in rows])
    times = np.array([row["spent"] for row in rows])  # quantiles of each run [ms]
    weights = np.repeat(steps, times.shape[1])
    half, late = np.quantile(times.ravel(), [0.5, 0.95], weights=weights, method="inverted_cdf")
    acted = sum(row["acted"] for row in rows) / steps.sum()
    return f"{100 * acted:.0f} %", f"{half:.1f} ms, {late:.1f} ms"


def film(path: Path, entry: str, preset: str, seed: int, slow: float) -> None:
    """Draw a scene as a GIF: alone, guarded, and at the right where the loop takes over."""
    from optipromp_sim.simulation import film as films

    fps, runs = 10, list[Run]()
    ask = {"entry": entry, "preset": preset, "seed": seed, "engine": "arm", "condition": "none"}
    for way in WAYS:
        row, run = driven({**ask, "way": way})
        if run is None:
            raise SystemExit(f"{entry} does not move in {preset} {seed}")
        runs.append(run)
        print(way, row["result"], row["causes"], flush=True)
    times = max((films.moments(run, fps, slow) for run in runs), key=len)
    drawn = (films.frames(run, times, films.View(*VIEW), caption=True) for run in runs)
    path.write_bytes(films.gif([np.hstack(pair) for pair in zip(*drawn, strict=True)], fps))


def main() -> None:
    """Draw a film."""
    match sys.argv[1:]:
        case [entry, preset, seed, path, slow]:
            film(Path(path), entry, preset, int(seed), float(slow))
        case _:
            sys.exit(str(__doc__))


if __name__ == "__main__":
    main()
