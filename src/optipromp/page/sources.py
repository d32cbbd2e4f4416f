"""What the page opens: a scene, a plan, executed plans, or the runs of a study."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from optipromp.errors import InvalidRequestError
from optipromp.experiments.runs import Row, row_from_text
from optipromp.experiments.study import ROWS
from optipromp.output import load_plan
from optipromp.page.replay import Replay, load_replay
from optipromp.planning import Plan, Planner
from optipromp.scenes.generate import generate, perceived
from optipromp.scenes.io import load_scene, scene_names
from optipromp.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class Source:
    """What the page opens with: a scene; its plan; executed plans of it; the rows of a study."""

    scene: Scene
    plan: Plan | None = None
    replays: tuple[Replay, ...] = ()
    rows: tuple[Row, ...] = ()


def open_source(item: str, beside: str | None = None) -> Source:
    """The content of a scene file or name, or of a folder of a plan, of a rollout or of a study.

    Args:
        item: what is opened.
        beside: a second folder of a rollout, replayed beside the first.

    Raises:
        InvalidRequestError: it is none of these, or damaged.
        InvalidSceneError: a scene that cannot be used.
    """
    folder = Path(item)
    replays = tuple(
        load_replay(Path(name)) for name in (item, beside)
        if name is not None and (Path(name) / "rollout.npz").exists()
    )  # fmt: skip
    if beside is not None and len(replays) < 2:
        raise InvalidRequestError(f"{item} and {beside} are not both folders of a rollout")
    if folder.is_dir() and item not in scene_names():
        if (folder / ROWS).exists():
            rows = read_rows(folder / ROWS)
            return Source(row_scene(rows[0]), None, (), rows)
        if (folder / "plan.json").exists():
            plan = load_plan(folder)
            return Source(plan.scene, plan, replays)
        if replays:
            return Source(replays[0].scene, None, replays)
        raise InvalidRequestError(
            f"{item} holds neither a plan (plan.json), a rollout (rollout.npz) nor a study ({ROWS})"
        )
    if folder.name == "plan.json":
        return open_source(str(folder.parent), beside)
    return Source(load_scene(item))


def read_rows(path: Path) -> tuple[Row, ...]:
    """The rows of a study.

    Raises:
        InvalidRequestError: the file cannot be read, or holds no row.
    """
    try:
        lines = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8")))
        rows = tuple(row_from_text(line) for line in lines)
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InvalidRequestError(f"{path}: not the rows of a study ({error})") from None
    if not rows:
        raise InvalidRequestError(f"{path}: the study has no run yet")
    return rows


def row_scene(row: Row) -> Scene:
    """The scene of a run, as its planner perceived it."""
    scene = generate(row.preset, row.seed)  # type: ignore[arg-type]
    rng = np.random.default_rng([row.seed, 1])
    return perceived(scene, rng, row.noise_position, float(np.deg2rad(row.noise_angle)))


def row_planner(row: Row) -> Planner | None:
    """The planner of a run; None for a baseline that only studies have."""
    return row.planner if row.planner in get_args(Planner) else None  # type: ignore[return-value]
