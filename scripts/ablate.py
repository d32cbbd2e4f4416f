"""What is each part of the planner worth? Parts are switched off one at a time, paired.

    python scripts/ablate.py run --count 100 --out ablation   plan and execute; goes on
    python scripts/ablate.py table ablation                      print the table of docs/ablation.md

A scene is planned by the whole planner and with each part off. Where the status or the path
differs, both plans are executed in the simulation.
"""

import argparse
import contextlib
import hashlib
import json
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from optipromp import plan
from optipromp.core.planning import follow
from optipromp.core.planning.planners import OptiProMP
from optipromp.core.planning.result import Proposal
from optipromp.core.pushing.packs.standing import PathsBetween
from optipromp.core.pushing.stems import hanging as paths
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

FIRST = 440_000  # seed of the first scene of each preset
PRESETS = [
    "cluster",
    "side-clusters",
    "table-top",
    "mixed",
    "tight",
    "limp",
    "elongated",
    "truss",
    "field",
    "shelf",
    "wild",
]


@contextlib.contextmanager
def _scheduled(change: Callable[[Any], Any]) -> Iterator[None]:
    """Searches with another schedule."""

    def changed(self: Any) -> Any:
        return change(self.__dict__.get("_schedule", between))

    between = PathsBetween.schedule
    with contextlib.ExitStack() as stack:
        stack.enter_context(
            mock.patch.object(
                paths.PathsPast, "schedule",
                property(changed, lambda self, value: self.__dict__.update(_schedule=value)),
                create=True,
            )
        )  # fmt: skip
        stack.enter_context(mock.patch.object(PathsBetween, "schedule", change(between)))
        yield


@contextlib.contextmanager
def _without(owner: Any, name: str, value: Any) -> Iterator[None]:
    with mock.patch.object(owner, name, value):
        yield


@contextlib.contextmanager
def _followed_always() -> Iterator[None]:
    """A harmful path is followed at once: no answer is a proposal, so there is no second pass."""
    solve = OptiProMP.solve

    def always(self: OptiProMP, task: Any, budget: Any) -> Any:
        made = solve(self, task, budget)
        return made.made() if isinstance(made, Proposal) else made

    with mock.patch.object(OptiProMP, "solve", always):
        yield


PARTS: dict[str, Callable[[], Any]] = {
    "second pass (Harmful)": _followed_always,
    "approaches": lambda: _without(OptiProMP, "approaches", False),
    "ways round (led_round)": lambda: _without(follow, "led_round", lambda *_: iter(())),
    "good that grows (lenient)": lambda: _scheduled(lambda s: replace(s, lenient=1.0)),
    "rounds after the first": lambda: _scheduled(lambda s: replace(s, rounds=s.rounds[:1], runs=1)),
    "samples about the best": lambda: _scheduled(lambda s: replace(s, fresh=1.0)),
    "fresh samples": lambda: _scheduled(lambda s: replace(s, fresh=0.0)),
}


def _made(scene: Any) -> tuple[Any, list[Any]]:
    begin = time.process_time()
    made = plan(scene, seed=0)
    spent = time.process_time() - begin
    where = hashlib.sha256(np.ascontiguousarray(made.trajectory.positions).tobytes()).hexdigest()
    return made, [str(made.status), where[:12], round(spent, 4)]


def _executed(made: Any) -> str:
    outcome = simulate(made).outcome
    return "success" if outcome.success else str(outcome.cause)


def _scene(preset: str, seed: int) -> dict[str, Any]:
    scene = generate(preset, seed)
    _made(scene)  # what is computed once for a scene counts for none
    whole, row = _made(scene)
    out: dict[str, Any] = {"preset": preset, "seed": seed, "whole": row, "parts": {}}
    known: dict[str, str] = {}

    def outcome(made: Any, key: str) -> str:
        if key not in known:
            known[key] = _executed(made)
        return known[key]

    for name, part in PARTS.items():
        with part():
            made, other = _made(scene)
        if other[:2] != row[:2]:
            other.append(outcome(made, other[1]))
            row[3:] = [outcome(whole, row[1])]
        out["parts"][name] = other
    return out


def run(count: int, out: Path, first: int = FIRST) -> None:
    """Plan and execute ``count`` scenes of each preset; rows that are there are kept."""
    plan("scenario-3")
    out.mkdir(parents=True, exist_ok=True)
    file = out / "rows.jsonl"
    done = set()
    if file.exists():
        rows = [json.loads(line) for line in file.read_text().splitlines()]
        done = {(row["preset"], row["seed"]) for row in rows}
    for seed in range(first, first + count):
        for preset in PRESETS:
            if (preset, seed) not in done:
                row = _scene(preset, seed)
                with file.open("a") as stream:
                    stream.write(json.dumps(row) + "\n")
        print(f"{seed - first + 1} of {count}", flush=True)


def table(out: Path) -> None:
    """Print a row a part: scenes that change, successes of those with and without, time."""
    rows = [json.loads(line) for line in (out / "rows.jsonl").read_text().splitlines()]
    print(
        f"{len(rows)} scenes\n\n| without | other plans | promised with / without | executed "
        "successes of these, with / without | won / lost | process time, without : with (median, "
        "mean) |"
    )
    print("|---|---|---|---|---|---|")
    for name in PARTS:
        pairs = [(row["whole"], row["parts"][name]) for row in rows if name in row["parts"]]
        other = [(a, b) for a, b in pairs if a[:2] != b[:2]]
        good = [(a[3] == "success", b[3] == "success") for a, b in other]
        promised = [sum(each[k][0] == "success" for each in pairs) for k in (0, 1)]
        won, lost = sum(b and not a for a, b in good), sum(a and not b for a, b in good)
        ratios = [b[2] / a[2] for a, b in pairs]
        mean = sum(b[2] for _, b in pairs) / sum(a[2] for a, _ in pairs)
        print(
            f"| {name} | {len(other)} of {len(pairs)} | {promised[0]} / {promised[1]} | "
            f"{sum(a for a, _ in good)} / {sum(b for _, b in good)} | {won} / {lost} | "
            f"{np.median(ratios):.2f}, {mean:.2f} |"
        )


def main() -> None:
    """The two commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("command", choices=("run", "table"))
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--out", type=Path, default=Path("ablation"))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=FIRST)
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    folder = given.folder or given.out
    if given.command == "run":
        run(given.count, folder, given.first)
    else:
        table(folder)


if __name__ == "__main__":
    main()
