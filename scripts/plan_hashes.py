"""Is the behaviour the same before and after a change? Five kinds, kept as numbers and words.

    python scripts/plan_hashes.py BEFORE.npz                 # before the change, and after it
    python scripts/plan_hashes.py --compare BEFORE.npz AFTER.npz
    python scripts/plan_hashes.py AFTER.npz --kinds picks,guard
    python scripts/plan_hashes.py --digest                   # one hash a kind, in two minutes

``plans``: 300 scenes of all presets, by all planners. ``picks``: 20 picks with their way out.
``loops``: 20 picks in closed loop, of ten conditions. ``looks``: 20 rendered pictures, as the eyes
see them. ``guard``: 10 policies behind the guard. Run it from the repository.

The comparison exits with 1 where a number differs by more than 1e-9, or a word. It compares the
kinds that both files have.

``--digest`` takes 60 plans, 20 picks, 10 loops, 10 looks and the first 60 actions of each guard. A
hash is of the words, and of rows of the numbers that are rounded to 1e-7, so that sums in another
order give the same one.
"""

import argparse
import hashlib
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks

from benchmarks import furniture
from optipromp import plan, plan_pick
from optipromp.core.arrays import FloatArray
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory
from optipromp_bench.episode import Episode, guarded
from optipromp_bench.experiments.trials import STUDY_PLANNERS, attempt
from optipromp_eyes.eyes import look_at
from optipromp_loop.guard import Guard
from optipromp_sim.generate import NOISES, generate, noisy
from optipromp_sim.simulation.photograph import photograph
from optipromp_sim.situations import CONDITIONS, picked

HANGING = "cluster", "side-clusters", "table-top", "mixed", "tight", "limp", "elongated", "truss"
PRESETS = *HANGING, "field", "shelf"
BUILT_IN = "scenario-1", "scenario-2", "scenario-3", "scenario-4", "paper-3", "paper-4"
LOOPED = (
    "none", "zero-mean", "detector", "missed", "aside", "sway", "calibration", "limp", "gust",
    "all",
)  # fmt: skip
FIRST = 7000  # seed of the first scene: of development, no figure is published on these
SAME = 1e-9  # [rad, m or s] what sums in another order may change
DIGITS = 7  # decimals of a number in a digest
ROWS = 8  # rows of an array in a digest, evenly spread
EVERY = 10  # records of a loop for one that is kept, which are then 0.1 s apart
ACTIONS, FEW = 150, 60  # of each guard, 20 ms each: the tool has met the fruits; of a digest
Part = FloatArray | str


class Case(NamedTuple):
    """One behaviour: ``name`` is unique within its kind; ``run`` gives words, and numbers."""

    name: str
    run: Callable[[], list[Part]]


def columns(motion: Trajectory) -> FloatArray:
    """Time, position, velocity and acceleration (T, 1 + 3n)."""
    return np.column_stack(
        [motion.times, motion.positions, motion.velocities, motion.accelerations]
    )


def drawn(name: str, seed: int) -> Scene:
    """The scene of a preset or of a built-in name; ``NAME seen``: with errors of detection."""
    preset, _, how = name.partition(" ")
    if preset in furniture.FURNITURE:
        scene = furniture.generate(preset, seed)
    else:
        scene = load_scene(preset) if preset in BUILT_IN else generate(preset, seed)
    return noisy(scene, seed, NOISES["zero-mean"]) if how == "seen" else scene


def plans() -> Iterator[Case]:
    """By all planners."""
    ours = [("opti-promp", p, FIRST + k) for k in range(13) for p in PRESETS]
    ours += [("opti-promp", f"{p} seen", FIRST + k) for k in range(3) for p in PRESETS]
    ours += [("opti-promp", f"{p} again", FIRST + k) for k in range(2) for p in PRESETS]
    ours += [("opti-promp", p, FIRST + k) for k in range(2) for p in furniture.FURNITURE]
    by = "opti-promp", "paper", "i-promp"
    ours += [(planner, name, 0) for planner in by for name in BUILT_IN]
    others = [p for p in STUDY_PLANNERS if p != "opti-promp"]
    ours += [(planner, p, FIRST + 20 + k) for k, planner in enumerate(others) for p in
             (*PRESETS, "cluster seen", "table-top seen")]  # fmt: skip
    for one in ours:
        yield Case("/".join(map(str, one)), lambda one=one: solved(*one))


def solved(planner: str, name: str, seed: int) -> list[Part]:
    """What a plan tells, and its trajectory; ``NAME again``: the plan from half of another one."""
    scene = drawn(name, seed)
    if name.endswith(" again"):
        first = plan(scene, seed=seed)
        made = plan(scene, seed=seed, previous=first, at=0.5 * first.trajectory.duration)
        return [f"{made.status} {made.message} {made.prediction}", columns(made.trajectory)]
    answer = attempt(scene, planner, seed=seed)
    told = f"{answer.status} {answer.message} {answer.harm} {answer.guard} {answer.failure}"
    return [told, np.zeros((0, 0)) if answer.trajectory is None else columns(answer.trajectory)]


def picks() -> Iterator[Case]:
    """By ``plan_pick``: two scenes of each preset; of the second, the scene as detected."""
    for preset in PRESETS:
        for k, name in enumerate((preset, f"{preset} seen")):
            yield Case(f"{name}/{FIRST + k}", lambda name=name, k=k: taken(name, FIRST + k))


def taken(name: str, seed: int) -> list[Part]:
    """What a pick and each of its legs tell, and their trajectories."""
    pick = plan_pick(drawn(name, seed), seed=seed)
    out: list[Part] = [f"{pick.status} {pick.message} {pick.failure}"]
    for leg, made in pick.legs.items():
        out.append(f"{leg} {made.status} {made.message} {made.prediction}")
        out.append(columns(made.trajectory))
    return out


def loops() -> Iterator[Case]:
    """Two presets in each condition."""
    for k, condition in enumerate(LOOPED):
        for j in range(2):
            one = condition, HANGING[(2 * k + j) % len(HANGING)], FIRST + k
            yield Case("/".join(map(str, one)), lambda one=one: looped(*one))


def looped(condition: str, preset: str, seed: int) -> list[Part]:
    """What a controller decided and what became of it; the arm and the fruits on the way."""
    done = picked(CONDITIONS[condition](generate(preset, seed), seed), seed)
    run, outcome = done.run.rollout, done.run.outcome
    events = [f"{event.stage} {event.why}" for event in done.controller.events]
    times = np.array([event.time for event in done.controller.events])
    led = np.column_stack([run.times, run.reference, run.tool_point])[::EVERY]
    plants = run.fruit_positions[::EVERY].reshape(len(led), -1)
    told = f"{done.result} {outcome.result} {outcome.message} {' '.join(outcome.causes)}"
    return [told, "; ".join(events), times, led, plants]


def looks() -> Iterator[Case]:
    """Pictures from beside, and from the palm; of each preset one has plain looks and one rich."""
    for k, preset in enumerate(PRESETS):
        for rich in (False, True):
            one = preset, ("beside", "palm")[k % 2], ("plain", "rich")[rich], FIRST + k
            yield Case("/".join(map(str, one)), lambda one=one: seen(*one))


def seen(preset: str, mount: str, how: str, seed: int) -> list[Part]:
    """What the eyes find in a picture, by geometry; and what the picture has in all."""
    scene = generate(preset, seed)
    shot = photograph(scene, mount, seed, looks="rich" if how == "rich" else "plain")
    sight = look_at(shot.picture, up=scene.up)
    rgb, depth = shot.picture.rgb.astype(np.float64), shot.picture.depth
    whole = np.array([*rgb.mean(axis=(0, 1)), depth.mean(), (depth > 0.0).mean()])
    told = [f"{each.id} {each.role} {type(each.shape).__name__}" for each in sight.look.detections]
    return ["; ".join([*told, *sight.doubts]), whole, *map(of_fruit, sight.look.detections)]


def of_fruit(item: SceneObject) -> FloatArray:
    """Place, orientation, radius, covariance and stem of a detection (m,)."""
    stem = np.zeros(0) if item.stem is None else np.asarray(item.stem.points).ravel()
    covariance = np.zeros((3, 3)) if item.covariance is None else np.asarray(item.covariance)
    return np.concatenate(
        [item.position, item.orientation, [item.radius], covariance.ravel(), stem]
    )


def guard(actions: int = ACTIONS) -> Iterator[Case]:
    """Five policies that go straight for the target, and five that wander."""
    for k, preset in enumerate(("cluster", "side-clusters", "truss", "field", "mixed")):
        for way in ("straight", "random"):
            one = way, preset, FIRST + k
            yield Case("/".join(map(str, one)), lambda one=one: behind(*one, actions))


def behind(way: str, preset: str, seed: int, actions: int) -> list[Part]:
    """What a guard made of some actions: its words, and the arm after each."""
    episode = Episode(CONDITIONS["none"](generate(preset, seed), seed), seed)
    watch, rng = Guard(episode.scene, episode.robot), np.random.default_rng(seed)
    target, words, rows = episode.scene.target, list[str](), list[FloatArray]()
    assert target is not None
    wish = np.zeros(episode.robot.n_joints)
    for k in range(actions):
        if way == "random" and k % 10 == 0:
            wish = 0.5 * rng.uniform(-1.0, 1.0, len(wish)) * episode.robot.velocity
        if way == "straight":
            far = target.position - episode.observe().tool_point
            speed = 0.3 / max(float(np.linalg.norm(far)), 0.1)
            wish = watch.tool(speed * far, episode.state)
        safe = guarded(watch, wish, episode)
        episode.lead(episode.toward(safe.velocity, safe.curve))
        words.append(f"{int(safe.acted)}{int(safe.braked)} {safe.reason}")
        rows.append(
            np.concatenate([safe.velocity, safe.reference.q, [safe.probability], episode.state.q])
        )
    runs = [word for k, word in enumerate(words) if k == 0 or word != words[k - 1]]
    return ["; ".join(runs), np.array(rows)]


KINDS = {"plans": plans, "picks": picks, "loops": loops, "looks": looks, "guard": guard}
DIGESTED = {  # every so many cases of a kind
    "plans": (plans, 5), "picks": (picks, 1), "loops": (loops, 2), "looks": (looks, 2),
    "guard": (lambda: guard(FEW), 1),
}  # fmt: skip


def digest(parts: Sequence[Part]) -> bytes:
    """What a digest knows of a case: words, shapes, and rows of rounded numbers."""
    out = []
    for part in parts:
        if isinstance(part, str):
            out.append(re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda m: rounded(float(m[0])), part))
            continue
        rows = np.unique(np.linspace(0, max(len(part) - 1, 0), ROWS).astype(int))
        out.append(str(part.shape))
        out += [rounded(number) for number in part[rows].ravel().tolist()] if part.size else []
    return " ".join(out).encode()


def rounded(number: float) -> str:
    """A number in words, without digits that sums in another order may change."""
    return f"{round(number, DIGITS) + 0.0:.{DIGITS}f}"


def differences(before: Path, after: Path) -> list[str]:
    """The cases that differ, in words."""
    with np.load(before, allow_pickle=False) as old, np.load(after, allow_pickle=False) as new:
        kinds = [{key.partition("/")[0] for key in each.files} for each in (old, new)]
        both = kinds[0] & kinds[1]
        print("compared:", *sorted(both))
        keys = [{key for key in each.files if key.partition("/")[0] in both} for each in (old, new)]
        out = [f"only in one of them: {key}" for key in sorted(keys[0] ^ keys[1])]
        for key in sorted(keys[0] & keys[1]):
            a, b = old[key], new[key]
            if a.shape != b.shape:
                out.append(f"{key}: {a.shape} is {b.shape}")
            elif a.dtype.kind == "U":
                if a != b:
                    out.append(f"{key}:\n   {a}\n   {b}")
            elif a.size and not (gap := float(np.abs(a - b).max())) <= SAME:
                out.append(f"{key}: differs by {gap:.2g}")
    return out


def main() -> int:
    """Run and write, or compare; 0 where nothing differs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", nargs="*", type=Path)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--digest", action="store_true", help="a few cases, and nothing is written")
    parser.add_argument("--kinds", default=",".join(KINDS), help=f"of {', '.join(KINDS)}")
    parser.add_argument("--every", type=int, default=1, help="only every so many cases of a kind")
    given = parser.parse_args()
    kinds = given.kinds.split(",")
    if wrong := [kind for kind in kinds if kind not in KINDS]:
        parser.error(f"--kinds: {wrong[0]} is none of {', '.join(KINDS)}")
    if len(given.file) != (2 if given.compare else 0 if given.digest else 1):
        parser.error("one file to write, two to compare, none with --digest")
    if given.compare:
        found = differences(*given.file)
        print("\n".join(found) or "every case is the same")
        return int(bool(found))
    kept: dict[str, np.ndarray] = {}
    for kind in kinds:
        began, whole, count = time.perf_counter(), hashlib.sha256(), 0
        make, every = DIGESTED[kind] if given.digest else (KINDS[kind], 1)
        for name, run in list(make())[:: every * given.every]:
            parts, count = run(), count + 1
            whole.update(name.encode() + digest(parts))
            kept |= {f"{kind}/{name}/{k}": np.array(part) for k, part in enumerate(parts)}
            if not given.digest:
                print(f"{kind} {name:<40} {str(parts[0])[:70]}", flush=True)
        spent = time.perf_counter() - began
        print(f"{kind}: {count} cases, {spent:.0f} s, {whole.hexdigest()[:16]}", flush=True)
    if not given.digest:
        np.savez(given.file[0], **kept)
    return 0


if __name__ == "__main__":
    sys.exit(main())
