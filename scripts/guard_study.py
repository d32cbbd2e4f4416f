"""What the guard gives: entries and a random policy, on the same scenes with and without it.

Run from the repository: ``python scripts/guard_study.py --scenes 5 random straight clone``. Each
line is one entry: clean, harmed and missed of the runs in the main simulation without the guard,
then with it, with the share of periods in which the guard acted and its time by step. Motions of
entries that plan are followed by joint velocities, in both cases.
"""

import argparse
import time
from collections import Counter
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any

import numpy as np

from optipromp.bench.entries import ENTRIES
from optipromp.bench.env import guarded
from optipromp.bench.episode import LONGEST, Episode, Observation
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.trajectory import Trajectory
from optipromp.guard import Guard, GuardParameters, Safe
from optipromp.laboratory.experiments.situations import CONDITIONS
from optipromp.laboratory.generate import generate

LONG = 60.0  # [s] of a random policy
FIRST = 940_000  # of the scenes' seeds; the guard's numbers were set on 900000 to 900003
GAIN = 2.0  # [1/s] of the joints' error of position
LATE = 0.02  # [rad] of a joint
Policy = Callable[[Observation], FloatArray]


class Timed(Guard):
    """A guard that tells how long its last call took [s]."""

    spent = 0.0

    def __call__(self, *args: Any, **options: Any) -> Safe:
        """See :class:`optipromp.guard.Guard`."""
        began = time.process_time()
        safe = super().__call__(*args, **options)
        self.spent = time.process_time() - began
        return safe


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
    """Velocities of the tool or of the joints that last for a while."""
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
    entry = resolve_name(ENTRIES[name].spec if name in ENTRIES else name)()
    if hasattr(entry, "act"):
        entry.reset(episode.scene, seed)
        return entry.act
    try:
        made = entry.plan(episode.scene, seed)
    except OptiPrompError:
        return None
    motion = getattr(made, "trajectory", getattr(made, "reach", made))
    return following(motion, episode.period) if isinstance(motion, Trajectory) else None


def run(
    name: str, preset: str, condition: str, seed: int, parameters: GuardParameters | None
) -> tuple[str, list[Any], str]:
    """The result of one run, whether the guard acted and its time by step [s], the cause of harm.

    ``parameters`` of the guard; None: there is none.
    """
    scene = generate(preset, seed)
    episode = Episode(CONDITIONS[condition](scene, seed), seed)
    policy = policy_of(name, episode, seed)
    if policy is None:
        return "refused", [], ""
    guard = Timed(episode.scene, episode.robot, parameters=parameters)
    told, most = [], LONG if name == "random" else LONGEST
    while episode.time < most and not episode.done:
        wish = policy(episode.observe())
        if parameters is None:
            episode.act(wish)
        else:
            safe = guarded(guard, wish, episode)
            told.append((safe.acted, guard.spent))
    outcome = episode.outcome(out=False)
    return outcome.result, told, " ".join(map(str, getattr(outcome, "causes", ())))


def main() -> None:
    """Print a line for each entry."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("entries", nargs="+")
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the scenes")
    parser.add_argument("--presets", default="cluster,field")
    parser.add_argument("--condition", default="none")
    parser.add_argument("--risk", type=float, default=GuardParameters.risk)
    parser.add_argument("--states", type=int, default=GuardParameters.states)
    parser.add_argument("--guarded", action="store_true", help="with the guard alone")
    asked = parser.parse_args()
    parameters = GuardParameters(risk=asked.risk, states=asked.states)
    for name in asked.entries:
        for guards in (False, True)[asked.guarded :]:
            results, told, causes = Counter[str](), [], list[str]()
            for k in range(asked.scenes):
                for preset in asked.presets.split(","):
                    seed, given = asked.first + k, parameters if guards else None
                    result, some, cause = run(name, preset, asked.condition, seed, given)
                    results[result] += 1
                    told += some
                    causes += [f"{preset} {seed}: {cause}"] * (result == "harmed")
            words = ", ".join(f"{results[w]} {w}" for w in ("clean", "harmed", "missed", "refused"))
            line = f"{name:<12} {'guarded' if guards else 'alone':<8} {words}"
            if told:
                acted, spent = np.array(told).T
                line += f"; acted in {100 * acted.mean():.0f} %"
                line += "; {:.1f} ms, 95 % {:.1f}, most {:.1f}".format(
                    *1e3 * np.percentile(spent, [50, 95, 100])
                )
            print(line, *causes, sep="\n    ", flush=True)


if __name__ == "__main__":
    main()
