"""Are the plans the same before and after a change? 300 scenes of all presets, by all planners.

Run from the repository, before the change and after: ``python scripts/plan_hashes.py OUT.npz``,
then ``python scripts/plan_hashes.py --compare BEFORE.npz AFTER.npz``. The comparison exits with 1
where a plan differs by more than 1e-9.
"""

import argparse
import hashlib
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks

from benchmarks import furniture
from optipromp import plan
from optipromp.core.scenes import load_scene
from optipromp.laboratory.experiments.trials import STUDY_PLANNERS, attempt
from optipromp.laboratory.generate import NOISES, generate, noisy

HANGING = "cluster", "side-clusters", "table-top", "mixed", "tight", "limp", "elongated", "truss"
PRESETS = *HANGING, "field", "shelf"
BUILT_IN = "scenario-1", "scenario-2", "scenario-3", "scenario-4", "paper-3", "paper-4"
FIRST = 7000  # seed of the first scene: of development, no figure is published on these
SAME = 1e-9  # [rad, m or s] what sums in another order may change


def cases() -> list[tuple[str, str, int]]:
    """Planner, scene and seed of each plan."""
    ours = [("opti-promp", p, FIRST + k) for k in range(13) for p in PRESETS]
    ours += [("opti-promp", f"{p} seen", FIRST + k) for k in range(3) for p in PRESETS]
    ours += [("opti-promp", f"{p} again", FIRST + k) for k in range(2) for p in PRESETS]
    ours += [("opti-promp", p, FIRST + k) for k in range(2) for p in furniture.FURNITURE]
    by = "opti-promp", "paper", "i-promp"
    ours += [(planner, name, 0) for planner in by for name in BUILT_IN]
    others = [p for p in STUDY_PLANNERS if p != "opti-promp"]
    return ours + [(planner, p, FIRST + 20 + k) for k, planner in enumerate(others) for p in
                   (*PRESETS, "cluster seen", "table-top seen")]  # fmt: skip


def solved(planner: str, name: str, seed: int) -> tuple[str, np.ndarray]:
    """What a plan tells in words, and its trajectory (T, 1 + 3n)."""
    preset, _, how = name.partition(" ")
    if preset in furniture.FURNITURE:
        scene = furniture.generate(preset, seed)
    else:
        scene = load_scene(preset) if preset in BUILT_IN else generate(preset, seed)
    if how == "seen":
        scene = noisy(scene, seed, NOISES["zero-mean"])
    if how == "again":
        first = plan(scene, seed=seed)
        made = plan(scene, seed=seed, previous=first, at=0.5 * first.trajectory.duration)
        told, motion = f"{made.status} {made.message} {made.prediction}", made.trajectory
    else:
        answer = attempt(scene, planner, seed=seed)
        told = f"{answer.status} {answer.message} {answer.harm} {answer.guard} {answer.failure}"
        if answer.trajectory is None:
            return told, np.zeros((0, 0))
        motion = answer.trajectory
    return told, np.column_stack(
        [motion.times, motion.positions, motion.velocities, motion.accelerations]
    )


def differences(before: Path, after: Path) -> list[str]:
    """The plans that differ, in words."""
    with np.load(before, allow_pickle=False) as old, np.load(after, allow_pickle=False) as new:
        out = [f"only in one of them: {key}" for key in set(old.files) ^ set(new.files)]
        for key in sorted(set(old.files) & set(new.files)):
            a, b = old[key], new[key]
            if a.shape != b.shape:
                out.append(f"{key}: {a.shape} is {b.shape}")
            elif a.dtype.kind == "U":
                if a != b:
                    out.append(f"{key}:\n   {a}\n   {b}")
            elif a.size and (gap := float(np.abs(a - b).max())) > SAME:
                out.append(f"{key}: differs by {gap:.2g}")
    return out


def main() -> int:
    """Plan and write, or compare; 0 where nothing differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="+", type=Path)
    parser.add_argument("--compare", action="store_true")
    parser.add_argument("--every", type=int, default=1, help="only every so many plans")
    given = parser.parse_args()
    if given.compare:
        found = differences(*given.file)
        print("\n".join(found) or "every plan is the same")
        return int(bool(found))
    kept, whole = {}, hashlib.sha256()
    for planner, name, seed in cases()[:: given.every]:
        told, motion = solved(planner, name, seed)
        kept[f"{planner}/{name}/{seed}"] = motion
        kept[f"{planner}/{name}/{seed}/told"] = np.array(told)
        whole.update(told.encode() + motion.tobytes())
        print(f"{planner:<14} {name:<20} {seed:<5} {told[:70]}", flush=True)
    np.savez(given.file[0], **kept)
    print(len(kept) // 2, "plans", whole.hexdigest())
    return 0


if __name__ == "__main__":
    sys.exit(main())
