"""What the page opens: a scene, a plan, executed plans, or the runs of a study."""

from dataclasses import dataclass
from pathlib import Path

from optipromp.errors import InvalidRequestError
from optipromp.experiments.runs import Row, scenes_of
from optipromp.experiments.study import ROWS, rows_of, settings_of
from optipromp.files import is_folder, is_there
from optipromp.output import load_plan
from optipromp.page.replay import Replay, load_replay
from optipromp.planning import Plan, planner_names
from optipromp.scenes.generate import PANDA
from optipromp.scenes.io import load_scene, scene_names
from optipromp.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class Source:
    """What the page opens: a scene, its plan, executed plans of it; a study's rows and robot."""

    scene: Scene
    plan: Plan | None = None
    replays: tuple[Replay, ...] = ()
    rows: tuple[Row, ...] = ()
    robot: str = PANDA


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
        if name is not None and is_there(Path(name) / "rollout.npz")
    )  # fmt: skip
    if beside is not None and len(replays) < 2:
        raise InvalidRequestError(f"{item} and {beside} are not both folders of a rollout")
    if is_folder(folder) and item not in scene_names():
        if is_there(folder / ROWS):
            rows, (_, robot) = tuple(rows_of(folder)), settings_of(folder)
            if not rows or robot is None:
                why = "has no run yet" if robot else "is of a robot that was read with choices"
                raise InvalidRequestError(f"{item}: the study {why}")
            return Source(scenes_of(rows[0], robot)[1], None, (), rows, robot)
        if is_there(folder / "plan.json"):
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


def row_planner(row: Row) -> str | None:
    """The planner of a run; None for one that is not known here."""
    return row.planner if row.planner in planner_names() else None
