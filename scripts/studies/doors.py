"""What the doors beside a pick are worth: way points, a path, something that moves, reports.

    optipromp bench study scripts/studies/doors.toml --out doors

Scenes are of the presets. *way points*: the tool goes along three sides of a square of 10 cm, 20 cm
below the target. *path*: it stays within 10 degrees of the approach on its way 30 cm aside.
*mover*: a ball crosses the way to the target. *report*: one HTML file that needs nothing else.
Plans that succeed are executed in the simulation; *worst* is of the executed motion.
"""

import itertools
import re
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp import plan, write_plan
from optipromp.core import scenes
from optipromp.core.errors import OptiPrompError
from optipromp.core.geometry import Sphere
from optipromp.core.planning import Plan
from optipromp.core.planning.task import posed
from optipromp.core.scenes import Scene
from optipromp.looks.reports import plan_report
from optipromp_bench.experiments.statistics import Table, share
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

SIDE, BELOW, SPEED = 0.10, 0.20, 0.1  # [m] of the square, [m] below the target, [m/s] on its sides
BALL, AWAY, PACE = 0.05, 0.4, 0.1  # [m] radius of what crosses, [m] at first, [m/s]


def below(scene: Scene, **more: Any) -> Scene:
    """The scene with a goal below its fruits in place of the target, and ``more``."""
    objects = [replace(o, role="pushable") if o.role == "target" else o for o in scene.objects]
    return replace(scene, objects=tuple(objects), **more)


def square(scene: Scene, seed: int) -> Scene:
    """The scene with way points."""
    x, y, up = scene.frame
    first = scene.target.position - BELOW * up - 0.5 * SIDE * (x + y)
    corners = [first, first + SIDE * x, first + SIDE * (x + y), first + SIDE * y]
    *points, goal = (scenes.PoseGoal(corner, up) for corner in corners)
    return below(scene, goal=goal, waypoints=scenes.Lines(tuple(points), SPEED))


def upright(scene: Scene, seed: int) -> Scene:
    """The scene with a path, to a goal aside that the seed tells."""
    up, side = scene.frame[2], (-1.0) ** seed * scene.frame[0]
    goal = scenes.PoseGoal(scene.target.position - BELOW * up + 3.0 * SIDE * side, up)
    path = scenes.PathConstraints(upright=scenes.HeldUpright(10.0, direction=up))
    return below(scene, goal=goal, path=path)


def crossed(scene: Scene, seed: int) -> Scene:
    """The scene with a ball that crosses the way, to a side that the seed tells."""
    begin = posed(scene)[0].tool_pose(posed(scene)[1].q)[0]
    side = (-1.0) ** seed * scene.frame[0]
    place = 0.5 * (begin + scene.target.position) - AWAY * side
    motion = scenes.ObjectMotion.steady(place, PACE * side)
    ball = scenes.SceneObject("ball", "static", Sphere(BALL), place, motion=motion)
    return replace(scene, objects=(*scene.objects, ball))


DOORS = {"way points": square, "path": upright, "mover": crossed}


def kept(door: str, made: Plan, rollout: Any) -> float:
    """How far the executed tool was from a way point [mm] or the approach [deg], at the worst."""
    if door == "path":
        cosine = rollout.tool_axis @ made.scene.frame[2]
        return float(np.degrees(np.arccos(np.clip(cosine.min(), -1.0, 1.0))))
    corners = [point.position for point in made.scene.waypoints.points]
    away = np.linalg.norm(rollout.tool_point[:, None] - corners, axis=2)
    return 1e3 * float(away.min(axis=0).max())


def reported(made: Plan) -> dict[str, Any]:
    """Whether the report of a plan is whole, its size [MB], and the time that it took [s]."""
    with tempfile.TemporaryDirectory() as folder:
        write_plan(made, Path(folder))
        began = time.perf_counter()
        content = plan_report(folder)
        spent = time.perf_counter() - began
    whole = not re.search(rb'(?:src|href)="(?!data:|#)', content) and content.count(b"<img") >= 2
    return {"result": "clean" if whole else "harmed", "seconds": spent, "kept": len(content) / 1e6}


@dataclass(frozen=True)
class Doors:
    """A study of doors."""

    doors: tuple[str, ...] = (*DOORS, "shelf", "report")  # shelf: the scenes as they are
    presets: tuple[str, ...] = ("cluster",)
    seeds: tuple[int, int] = (0, 5)

    def asks(self) -> list[dict[str, Any]]:
        """See :class:`optipromp_bench.experiments.kinds.Kind`."""
        all_ = itertools.product(self.doors, self.presets, range(*self.seeds))
        return [{"door": door, "preset": preset, "seed": seed} for door, preset, seed in all_]

    def trial(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """What became of one plan; ``kept`` has the unit of its door."""
        door, seed = ask["door"], ask["seed"]
        try:
            scene, make = generate(ask["preset"], seed), DOORS.get(door)
            scene, began = scene if make is None else make(scene, seed), time.perf_counter()
            made = plan(scene, seed=seed)
            row = {"status": str(made.status), "seconds": time.perf_counter() - began}
            if door == "report":
                return row | reported(made)
            if not made.success:
                return row | {"result": "refused"}
            run = simulate(made, seed=seed)
        except OptiPrompError as error:
            return {"status": str(error.code), "result": "error", "why": error.message}
        row |= {"result": run.outcome.result, "why": run.outcome.message}
        return row | ({"kept": kept(door, made, run.rollout)} if door in KEPT else {})

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
        """A line for each door and preset."""
        lines, groups = [], dict[tuple[str, str], list[Mapping[str, Any]]]()
        for row in itertools.chain(*parts.values()):
            groups.setdefault((row["door"], row["preset"]), []).append(row)
        for (door, preset), rows in groups.items():
            ends = [row["result"] for row in rows]
            times = [row["seconds"] for row in rows if "seconds" in row] or [np.nan]
            worst = max((row["kept"] for row in rows if "kept" in row), default=np.nan)
            lines.append([
                door, f"`{preset}`", len(rows), share(ends.count("clean"), len(rows)),
                share(ends.count("harmed"), len(rows)), ends.count("missed"),
                ends.count("refused") + ends.count("error"),
                " / ".join(f"{t:.2f} s" for t in np.quantile(times, [0.5, 0.95])),
                f"{worst:.1f} {KEPT[door]}" if door in KEPT else "–",
            ])  # fmt: skip
        return [Table("Doors", COLUMNS, lines)]


KEPT = {"way points": "mm", "path": "°", "report": "MB"}
COLUMNS = (
    "door", "preset", "n", "clean, % (95 %)", "harmed, % (95 %)", "missed", "refused",
    "time, median / 95 %", "worst",
)  # fmt: skip
