"""What the guard gives: entries and a random policy, on the same scenes with and without it.

    python scripts/guard_study.py random straight clone --scenes 5
    python scripts/guard_study.py clone act --scenes 50 --engines arm,flight \\
        --noise none,detector,sway --json guard.jsonl      # goes on where it was stopped
    python scripts/guard_study.py clone --presets cluster --first 900000 --film guard.gif

Run it from the repository. It prints what each entry harmed, and a table at the end: clean and
harmed without the guard and with it, with Wilson's intervals (95 %), the share of periods in which
the guard acted, and its time by step. A run behind the guard ends where the arm has stood
still for 4 s. Engines are those of ``optipromp bench``: ``arm`` is the main simulation, ``flight``
the second; plants that move are of ``arm`` alone. Motions of entries that plan are followed by
joint velocities, in both cases. ``--json`` keeps a line for each run. Several processes may share
the file, with presets of their own. ``--film`` draws the first scene: alone at the left, guarded
at the right.
"""

import argparse
import itertools
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.trajectory import Trajectory
from optipromp_bench.entries import ENTRIES
from optipromp_bench.episode import LONGEST, Episode, FlightWorld, Observation, guarded
from optipromp_bench.experiments.rows import source_version
from optipromp_bench.experiments.statistics import share, tabled
from optipromp_bench.running import ENGINES, STEADY
from optipromp_loop.guard import Guard, GuardParameters, Safe
from optipromp_sim.generate import PRESETS, generate
from optipromp_sim.simulation import Outcome, Run, Simulation
from optipromp_sim.situations import CONDITIONS

LONG = 60.0  # [s] of a random policy
FIRST = 940_000  # of the scenes' seeds; the guard's numbers were set on 900000 to 900003
GAIN = 2.0  # [1/s] of the joints' error of position
LATE = 0.02  # [rad] of a joint
STILL, REST = 4.0, 1e-3  # [s], [rad/s]: behind the guard an arm that stands so long goes on no more
SLOWED = 0.5  # [s] twice, before the end of a run: in the first the wishes go to 0
RESULTS = "clean", "harmed", "missed", "refused", "error"
SHARES = np.linspace(0.0, 1.0, 21)  # of the steps of a run, whose times are kept
VIEW = 480, 540  # [pixel] of each half of a film
Policy = Callable[[Observation], FloatArray]


@dataclass(frozen=True)
class Asked:
    """One run."""

    entry: str
    guarded: bool
    engine: str
    noise: str  # of CONDITIONS
    preset: str
    seed: int

    @property
    def group(self) -> tuple[Any, ...]:
        """Of the line of the table that it counts in."""
        return self.entry, self.engine, self.noise, self.guarded


class Timed(Guard):
    """A guard that tells how long its last call took [s]."""

    spent = 0.0

    def __call__(self, *args: Any, **options: Any) -> Safe:
        """See :class:`optipromp_loop.guard.Guard`."""
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


def driven(asked: Asked, parameters: GuardParameters) -> tuple[dict[str, Any], Run | None]:
    """What became of one run, as in the file; and the run, for a film.

    ``steps`` is the number of calls of the guard, ``acted`` in how many it acted, ``spent`` their
    times [ms] at the shares SHARES, ``why`` counts its reasons.
    """
    situation = CONDITIONS[asked.noise](generate(asked.preset, asked.seed), asked.seed)
    arena = FlightWorld(situation.scene, asked.seed) if asked.engine == "flight" else None
    episode = Episode(situation, asked.seed, arena=arena)
    policy = policy_of(asked.entry, episode, asked.seed)
    if policy is None:
        return {"result": "refused"}, None
    guard = Timed(episode.scene, episode.robot, parameters=parameters)
    acted, spent, why, moved = 0, list[float](), Counter[str](), 0.0
    wanders = asked.entry == "random"
    most, patience = (LONG, LONG) if wanders else (LONGEST, STILL if asked.guarded else LONGEST)
    while episode.time < min(most, moved + patience) and not episode.done:
        seen = episode.observe()
        if np.abs(seen.velocity).max() > REST:
            moved = episode.time
        left = most - episode.time  # a run of its longest time ends at rest
        wish = policy(seen) * min(max(left - SLOWED, 0.0) / SLOWED, 1.0)
        if asked.guarded:
            safe = guarded(guard, wish, episode)
            episode.lead(episode.toward(safe.velocity, safe.curve))
            acted += safe.acted
            why.update([re.sub(r"\d+(\.\d+)?", "…", safe.reason)] * safe.acted)
            spent.append(guard.spent)
        else:
            episode.act(wish)
    simulation, seconds = episode.simulation, round(episode.time, 2)
    end = simulation.time
    outcome = episode.outcome(out=False)
    causes = (
        outcome.causes if isinstance(outcome, Outcome)
        else (*outcome.harm, *(f"swallowed {name}" for name in outcome.swallowed))
    )  # fmt: skip
    row = {
        "result": outcome.result, "causes": " ".join(map(str, causes)),
        "seconds": seconds, "steps": len(spent), "acted": acted,
        "spent": (1e3 * np.quantile(spent, SHARES)).round(2).tolist() if spent else [],
        "why": dict(why),
    }  # fmt: skip
    if not isinstance(simulation, Simulation):
        return row, None
    shown = situation.scene, episode.robot, simulation.parameters, asked.seed
    return row, Run(*shown, simulation.rollout(end), outcome, 0.0)  # type: ignore[arg-type]


def table(title: str, rows: Iterable[dict[str, Any]]) -> str:
    """A line for each entry, preset, engine and noise: alone beside guarded; and one of all."""
    groups: dict[tuple[str, ...], dict[bool, list[dict[str, Any]]]] = {}
    for row in rows:
        asked = Asked(**row["asked"])
        noise = "" if asked.noise == "none" else asked.noise
        where = ", ".join(filter(None, (asked.engine, noise)))
        keys = [("", noise, f"`{asked.entry}`", f"`{asked.preset}`", where)]
        if asked.entry != "random":
            keys.append(("all", noise, "all", "", noise))
        for key in keys:
            groups.setdefault(key, {False: [], True: []})[asked.guarded].append(row)
    heads = [f"{who}: {end} % (95 %)" for who in ("alone", "guarded") for end in RESULTS[:2]]
    columns = ["entry", "preset", "engine", "n", *heads, "acted", "a step: median, 95 %"]
    lines = []
    for key in sorted(groups):
        cells = [*key[2:], str(len(groups[key][True]))]
        for own in (groups[key][False], groups[key][True]):
            for end in RESULTS[:2]:
                cells.append(share(sum(row["result"] == end for row in own), len(own)))
        lines.append([*cells, *steps_of([row for row in groups[key][True] if row.get("steps")])])
    return tabled(title, columns, lines)


def steps_of(rows: Sequence[dict[str, Any]]) -> tuple[str, str]:
    """In how many periods the guard acted, and its time a step."""
    if not rows:
        return "–", "–"
    steps = np.array([row["steps"] for row in rows])
    times = np.array([row["spent"] for row in rows])  # quantiles of each run [ms]
    weights = np.repeat(steps, times.shape[1])
    half, late = np.quantile(times.ravel(), [0.5, 0.95], weights=weights, method="inverted_cdf")
    acted = sum(row["acted"] for row in rows) / steps.sum()
    return f"{100 * acted:.0f} %", f"{half:.1f} ms, {late:.1f} ms"


def known(file: Path | None, parameters: GuardParameters) -> dict[Asked, dict[str, Any]]:
    """The runs of a file by what was asked; those of another guard are passed over."""
    found: dict[Asked, dict[str, Any]] = {}
    if file is None or not file.exists():
        return found
    for text in file.read_text("utf-8").splitlines():
        row = json.loads(text)
        asked = Asked(**row["asked"])
        if not asked.guarded or row["parameters"] == asdict(parameters):
            found[asked] = row
    return found


def film(path: Path, asked: Asked, parameters: GuardParameters, slow: float) -> None:
    """Draw a scene twice as a GIF: the policy alone at the left, behind the guard at the right."""
    from PIL import Image, ImageDraw, ImageFont

    from optipromp_sim.simulation import film as films
    from optipromp_sim.simulation.studio import Studio
    from optipromp_sim.simulation.world import build

    fps, size, runs, words = 10, VIEW[1] // 24, list[Run](), list[tuple[str, str]]()
    for guards, name in ((False, "alone"), (True, "behind the guard")):
        row, run = driven(replace(asked, guarded=guards), parameters)
        if run is None:
            raise SystemExit(f"{asked.entry} does not move in {asked.preset} {asked.seed}")
        runs.append(run)
        words.append((f"{asked.entry} {name}", f"{row['result']} {row['causes']}"))
        print(*words[-1], sep=": ", flush=True)
    most = max(run.rollout.times[-1] for run in runs)
    times = np.arange(0.0, most + 1e-9, 1.0 / (fps * slow))
    world = build(runs[1].scene, runs[1].robot, runs[1].parameters, runs[1].seed)
    pictures, font = [], ImageFont.load_default(size)
    with Studio(world, fine=True) as studio:
        camera = films.shot(world, studio.model, runs[1], times, films.View(*VIEW))
        for k, time_ in enumerate(times):
            whole = Image.new("RGB", (2 * VIEW[0], VIEW[1]))
            pen = ImageDraw.Draw(whole)
            for left, run, (name, result) in zip((0, VIEW[0]), runs, words, strict=True):
                last = run.rollout.times[-1]
                record = max(int(np.searchsorted(run.rollout.times, time_ + 1e-9)) - 1, 0)
                studio.stand(run.rollout.states[record])
                whole.paste(Image.fromarray(studio.colours(camera.at(k), *VIEW)), (left, 0))
                ended = time_ >= run.rollout.motion or k == len(times) - 1
                told = f"{min(time_, last):.1f} s" + (f"   {result}" if ended else "")
                for at, text in ((size, name), (VIEW[1] - 2 * size, told)):
                    pen.text((left + size, at), text, films.PALE, font, stroke_width=3,
                             stroke_fill=films.DARK)  # fmt: skip
            pen.line((VIEW[0], 0, VIEW[0], VIEW[1]), films.PALE, 2)
            pictures.append(np.asarray(whole))
    path.write_bytes(films.gif(pictures, fps))


def main() -> None:
    """Print what was harmed, and the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("entries", nargs="+", help="of optipromp bench list, MODULE:CLASS, random")
    parser.add_argument("--scenes", type=int, default=5, help="of each preset")
    parser.add_argument("--first", type=int, default=FIRST, help="seed of the scenes")
    parser.add_argument("--presets", default="cluster,field")
    parser.add_argument("--engines", default="arm", help="arm, flight")
    parser.add_argument("--noise", default="none", help=f"of {', '.join(CONDITIONS)}")
    parser.add_argument("--risk", type=float, default=GuardParameters.risk)
    parser.add_argument("--states", type=int, default=GuardParameters.states)
    parser.add_argument("--guarded", action="store_true", help="with the guard alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="a line for each run, as it ends")
    parser.add_argument(
        "--film", type=Path, metavar="FILE.gif", help="of the first scene; no table"
    )
    parser.add_argument("--slow", type=float, default=1.0, help="times slower that a film runs")
    given = parser.parse_args()
    parameters = GuardParameters(risk=given.risk, states=given.states)
    lists = {k: getattr(given, k).split(",") for k in ("presets", "engines", "noise")}
    may = {"presets": PRESETS, "engines": ENGINES, "noise": CONDITIONS}
    for name, words in lists.items():
        if wrong := [word for word in words if word not in may[name]]:
            parser.error(f"--{name}: {wrong[0]} is none of {', '.join(may[name])}")
    asks = [
        Asked(entry, guards, engine, noise, preset, given.first + k)
        for entry, engine, noise, guards in itertools.product(
            given.entries, lists["engines"], lists["noise"], (False, True)[given.guarded :]
        )
        if engine == "arm" or noise in STEADY
        for k, preset in itertools.product(range(given.scenes), lists["presets"])
    ]
    if given.film:
        film(given.film, asks[0], parameters, given.slow)
        return
    done, version, began = known(given.json, parameters), source_version(), time.monotonic()
    left = sum(each not in done for each in asks)
    for (name, engine, noise, guards), group in itertools.groupby(asks, lambda a: a.group):
        rows = []
        for each in group:
            if each not in done:
                try:
                    row, _ = driven(each, parameters)
                except OptiPrompError as error:
                    row = {"result": "error", "causes": str(error)}
                row |= {"asked": asdict(each), "parameters": asdict(parameters), "version": version}
                done[each], left = row, left - 1
                if given.json:
                    with given.json.open("a", encoding="utf-8") as stream:
                        stream.write(json.dumps(row) + "\n")
                gone = (time.monotonic() - began) / 60.0
                print(f"{gone:.1f} min, {left} runs left", end="\r", file=sys.stderr, flush=True)
            rows.append(done[each])
        print(f"{name} {engine} {noise} {'guarded' if guards else 'alone'}")
        for row in rows:
            if row["result"] in ("harmed", "error"):
                print(f"    {row['asked']['preset']} {row['asked']['seed']}: {row['causes']}")
        sys.stdout.flush()
    told = "Random motions" if given.entries == ["random"] else f"Condition `{given.noise}`"
    print(table(told, (done[each] for each in asks)))
    if len(versions := {done[each]["version"] for each in asks}) > 1:
        print(f"the runs are of {len(versions)} versions of the library: {', '.join(versions)}")


if __name__ == "__main__":
    main()
