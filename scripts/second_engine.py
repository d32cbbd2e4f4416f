"""A second engine's word: plans executed by a flying cup among hanging fruits.

    python scripts/second_engine.py [--preset cluster,tight] [--seeds 20000:20060]
        [--planners opti-promp,straight]

The engine is :mod:`optipromp_bench.flight`. The table says how often this and the main simulation
agree.
"""

import argparse
from collections import Counter

from optipromp_bench.flight import execute


def main() -> None:
    """Plan, execute in both engines, and print how often they agree."""
    from optipromp.core.scenes.io import scene_to_dict
    from optipromp_bench.experiments.trials import attempt
    from optipromp_sim.generate import generate
    from optipromp_sim.generate.plants import untold
    from optipromp_sim.simulation import simulate

    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--preset", default="cluster,tight")
    ask.add_argument("--planners", default="opti-promp,straight")
    ask.add_argument("--seeds", default="20000:20060")
    told = ask.parse_args()
    first, end = map(int, told.seeds.split(":"))
    heads = (
        "preset", "planner", "plans", "both succeed", "both fail", "only in the simulation",
        "only in the second", "agree", "of promised successes kept in the second",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for preset in told.preset.split(","):
        for planner in told.planners.split(","):
            both: Counter[tuple[bool, bool]] = Counter()
            words: Counter[str] = Counter()
            promised = Counter[bool]()
            for seed in range(first, end):
                scene = generate(preset, seed)
                made = attempt(untold(scene), planner, seed=seed)  # type: ignore[arg-type]
                if made.trajectory is None:
                    continue
                rows = made.trajectory.resample(1000.0)
                word = execute(scene_to_dict(scene), (rows.times, rows.positions), seed)
                outcome = simulate(made.trajectory, scene, seed=seed).outcome
                both[outcome.success, word.success] += 1
                if made.status == "success":
                    promised[word.success] += 1
                if outcome.success != word.success:
                    told_ = "; ".join(
                        [*word.harm, *(f"{i} swallowed" for i in word.swallowed),
                         *([] if word.picked else ["not picked"])]
                    )  # fmt: skip
                    words[f"{seed}: {outcome.message} | second: {told_ or 'picked'}"] += 1
            runs = both.total()
            print(
                f"| {preset} | {planner} | {runs} | {both[True, True]} | {both[False, False]} | "
                f"{both[True, False]} | {both[False, True]} | "
                f"{100 * (both[True, True] + both[False, False]) / max(runs, 1):.0f} % | "
                f"{promised[True]} of {promised.total()} |", flush=True,
            )  # fmt: skip
            for line in words:
                print("   ", line, flush=True)


if __name__ == "__main__":
    main()
