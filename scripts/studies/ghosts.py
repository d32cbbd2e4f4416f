"""Does a pick touch what nobody told? Something stands on its way, and only a picture shows it.

    optipromp bench study scripts/studies/ghosts.toml --out ghosts
    python -m scripts.studies.ghosts post field 96010 round.gif

A ghost stands where a pick without it leads the tool, clear of fruits and stems. The picture shows
it, and a pick that is promised is executed in the truth. The second command draws one.
"""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp import plan_pick
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Box, Cylinder, Shape, Sphere, distances
from optipromp.core.geometry.obstacles import pack
from optipromp.core.judging.clearance import pieces
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp_bench.experiments.statistics import Table, share
from optipromp_eyes import look_at, seen_scene
from optipromp_sim.generate import generate
from optipromp_sim.simulation import Run, simulate
from optipromp_sim.simulation.film import animation
from optipromp_sim.simulation.photograph import photograph

SHAPES: Mapping[str, Shape] = {  # [m]
    "post": Box((0.024, 0.024, 0.20)), "board": Box((0.10, 0.012, 0.12)),
    "wire": Cylinder(0.002, 0.20), "ball": Sphere(0.010), "cardboard": Box((0.07, 0.004, 0.05)),
}  # fmt: skip
AWAY = np.arange(0.09, 0.20, 0.01)  # [m] of the tool from the target where a ghost stands, in turn
FREE = 0.004  # [m] from fruits and stems, at least
ENDS = "clean", "touched", "else harmed", "refused", "not seen", "no way"


def haunted(known: Scene, name: str) -> Scene | None:
    """The scene with a ghost on the way of its pick; None: no pick, or no room on its way."""
    pick = plan_pick(known, seed=0)
    if not pick.success or known.target is None:
        return None
    way = pick.reach.robot.tool_pose(pick.reach.trajectory.positions)[0]
    far = np.linalg.norm(way - known.target.position, axis=1)
    stems = [part for o in known.objects if o.stem is not None for part in pieces(o, o.stem)]
    around = pack([(o.shape, o.position, o.rotation) for o in (*known.objects, *stems)])
    ticks = (np.linspace(-h, h, 2 + int(2.0 * h / FREE)) for h in SHAPES[name].measure.half)
    whole = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 3)
    for away in AWAY:
        at = way[int(np.argmin(np.abs(far - away)))]
        if distances(around, at + whole)[0].min() > FREE:
            ghost = SceneObject(name, "static", SHAPES[name], at)
            return replace(known, objects=(*known.objects, ghost))
    return None


def picked(name: str, preset: Any, seed: int) -> tuple[str, str, Run | None]:
    """How a pick ends that meets a ghost, one of :data:`ENDS`; why; and its run."""
    known = generate(preset, seed)
    truth = haunted(known, name)
    shot = None if truth is None else photograph(truth, seed=seed)
    if truth is None or shot is None or not shot.mask(name, "static").any():  # beyond the border
        return "no way", "", None
    try:
        sight = look_at(shot.picture, up=known.up)
        plan = plan_pick(seen_scene(sight, known)[0], seed=0)
    except InvalidRequestError as error:
        return "not seen", error.message, None
    if not plan.success:
        return "refused", plan.message, None
    run = simulate(plan, truth)
    hit = any(contact.other == name for contact in run.outcome.static_contacts)
    harmed = "clean" if run.success else "else harmed"
    return "touched" if hit else harmed, run.outcome.message, run


@dataclass(frozen=True)
class Ghosts:
    """A study of picks past what nobody told; ghosts and presets come in turn with the seed."""

    presets: tuple[str, ...] = ("cluster", "field", "wild")
    seeds: tuple[int, int] = (94_000, 94_030)

    def asks(self) -> list[dict[str, Any]]:
        """See :class:`optipromp_bench.experiments.kinds.Kind`."""
        turns = tuple(SHAPES), self.presets
        picks = [(*(each[k % len(each)] for each in turns), k) for k in range(*self.seeds)]
        return [dict(zip(("ghost", "preset", "seed"), each, strict=True)) for each in picks]

    def trial(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """What becomes of a pick."""
        result, why, _ = picked(ask["ghost"], ask["preset"], ask["seed"])
        return {"result": result, "why": why}

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
        """A table for each study, a line for each ghost."""
        columns, out = ("ghost", "n", "promised", "touched of these % (95 %)", *ENDS), []
        for title, rows in parts.items():
            lines = []
            for name in (*SHAPES, "all"):
                ends = Counter(row["result"] for row in rows if name in (row["ghost"], "all"))
                sure, counts = sum(ends[end] for end in ENDS[:3]), [ends[end] for end in ENDS]
                lines.append([name, ends.total(), sure, share(ends["touched"], sure), *counts])
            out.append(Table(f"Ghosts, {title}", columns, lines))
        return out


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(str(__doc__))
    end, why, run = picked(sys.argv[1], sys.argv[2], int(sys.argv[3]))
    print(end, why)
    if run is not None:
        Path(sys.argv[4]).write_bytes(animation(run))
