"""Tuning of the entries of others: each setting on the same development scenes, in one table.

    python scripts/tune_entries.py --count 12 --out tuned
    python scripts/tune_entries.py --entries mppi,receding --count 12 --out tuned

Every entry of the field that has numbers is tried with several of them, alone in the engine
``arm``, on COUNT development scenes of each preset. The score is the benchmark's: share clean less
share harmed. The best setting becomes the entry's (docs/benchmark.md has the table). Ours is not
tuned here: its numbers were set before the benchmark was. Rows are kept in OUT/rows.csv, and a run
goes on where it ended.
"""

import argparse
import csv
import json
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks

from benchmarks.entries.classic import BesideFruits, FromLine
from benchmarks.entries.sampling import ByEpisodes, ByHorizon, ByMppi
from optipromp.core.planning import plan
from optipromp.core.processes import cores, run_each
from optipromp_bench.entries.planners import gentle_plan
from optipromp_bench.running import Exercise, executed_rows, situated
from optipromp_bench.sets import FIRST, PRESETS
from optipromp_bench.tracks import asked
from optipromp_paper.obstacles import Chomp

Setting = Mapping[str, Any]
GRIDS: Mapping[str, tuple[Any, tuple[Setting, ...]]] = {
    "chomp-line": (
        FromLine,
        (
            {}, {"epsilon": 0.01}, {"epsilon": 0.03}, {"smoothness": 1e-4}, {"smoothness": 1e-6},
            {"epsilon": 0.01, "smoothness": 1e-4},
        ),
    ),
    "chomp": (Chomp, ({}, {"epsilon": 0.01}, {"epsilon": 0.03}, {"smoothness": 1e-4})),
    "push-aside": (
        BesideFruits,
        ({}, {"gap": 0.01}, {"gap": 0.015}, {"widest": 0.08}, {"least": 0.03}, {"least": 0.01}),
    ),
    "mppi": (
        ByMppi,
        (
            {}, {"samples": 96}, {"rounds": 20}, {"deviation": 0.8}, {"temperature": 0.03},
            {"states": 4},
        ),
    ),
    "episodic": (ByEpisodes, ({}, {"samples": 120}, {"rounds": 14}, {"elite": 5}, {"states": 4})),
    "receding": (ByHorizon, ({}, {"aside": 0.02}, {"aside": 0.04}, {"layers": 8}, {"states": 5})),
}  # fmt: skip
KNOWING = "mppi", "episodic", "receding"
"""Entries that know the push model, and refuse by it: their plans are taken as they are."""


def one(name: str, told: str, preset: str, seed: int) -> dict[str, Any]:
    """One scene by one setting."""
    kind, setting = GRIDS[name][0], json.loads(told)
    own = {field.name for field in fields(kind)}
    made = type(kind.__name__, (kind,), {k: v for k, v in setting.items() if k not in own})
    planner = made(**{k: v for k, v in setting.items() if k in own})
    task = Exercise(name, "plan", preset, seed, engines=("arm",))
    situation, digest = situated(task)

    def motion() -> Any:
        found = plan(situation.seen, planner=planner, seed=seed)
        return found if name in KNOWING else gentle_plan(found, situation.seen)

    row = executed_rows(task, situation, digest, {"arm": asked(motion, situation.seen)})[0]
    return {
        "entry": name, "setting": told, "preset": preset, "seed": seed, "result": row.result,
        "cause": row.cause, "thought": row.thought,
    }  # fmt: skip


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows so far."""
    if not path.exists():
        return []
    with path.open() as stream:
        return list(csv.DictReader(stream))


def table(rows: list[dict[str, str]]) -> str:
    """Shares of each setting; the best of an entry is marked."""
    lines = ["| entry | setting | n | clean | harmed | missed | refused | score | think |"]
    lines.append("|---" * 9 + "|")
    for name in GRIDS:
        found = []
        for setting in GRIDS[name][1]:
            told = json.dumps(setting)
            own = [row for row in rows if (row["entry"], row["setting"]) == (name, told)]
            if own:
                share = {
                    k: 100.0 * sum(row["result"] == k for row in own) / len(own)
                    for k in ("clean", "harmed", "missed", "refused")
                }
                think = median(float(row["thought"]) for row in own)
                found.append((share["clean"] - share["harmed"], told, len(own), share, think))
        best = max((each[0] for each in found), default=0.0)
        for score, told, n, share, think in found:
            shown = " | ".join(f"{value:.0f}" for value in share.values())
            words = told.strip("{}").replace('"', "") or "as it was"
            mark = f"**{score:.0f}**" if score == best else f"{score:.0f}"
            lines.append(f"| {name} | {words} | {n} | {shown} | {mark} | {1e3 * think:.0f} ms |")
    return "\n".join(lines)


def main() -> None:
    """See the module."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--out", type=Path, required=True)
    ask.add_argument("--entries", default="", help="separated by commas; all if left out")
    ask.add_argument("--count", type=int, default=12, help="scenes of each preset")
    ask.add_argument("--workers", type=int, default=cores())
    told = ask.parse_args()
    told.out.mkdir(parents=True, exist_ok=True)
    path = told.out / "rows.csv"
    keys = "entry", "setting", "preset", "seed"
    done = {tuple(row[k] for k in keys) for row in rows_of(path)}
    names = [name for name in told.entries.split(",") if name] or list(GRIDS)
    tasks = [
        (name, json.dumps(setting), preset, seed)
        for seed in range(FIRST, FIRST + told.count)
        for name in names
        for setting in GRIDS[name][1]
        for preset in PRESETS
        if (name, json.dumps(setting), preset, str(seed)) not in done
    ]

    def hear(index: int, row: Any) -> None:
        if isinstance(row, Exception):
            raise SystemExit(f"{tasks[index]}: {row}")
        with path.open("a", newline="") as stream:
            out = csv.DictWriter(stream, list(row))
            if stream.tell() == 0:
                out.writeheader()
            out.writerow(row)
        if index % 50 == 0:
            print(f"{index} of {len(tasks)}", flush=True)

    run_each(one, tasks, hear, workers=told.workers)
    print(table(rows_of(path)))


if __name__ == "__main__":
    main()
