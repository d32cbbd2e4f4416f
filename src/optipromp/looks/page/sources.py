"""The source that the page opens: a scene, a plan, or executed plans."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_file, is_folder, is_there
from optipromp.core.output import load_plan
from optipromp.core.planning import Plan
from optipromp.core.scenes.io import load_scene, scene_names
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.experiments.rows import ROWS
from optipromp.looks.page.replay import Replay, load_replay
from optipromp.perception.pictures import OVERLAY, Image8, read_pixels


@dataclass(frozen=True, eq=False)
class Source:
    """A scene, its plan, executed plans of it, and the picture in which it was seen, if any."""

    scene: Scene
    plan: Plan | None = None
    replays: tuple[Replay, ...] = ()
    seen: Image8 | None = None


def open_source(item: str, beside: str | None = None) -> Source:
    """The source in a scene file, a built-in scene, or a folder of a plan or a rollout.

    ``item``: name or path. ``beside``: a second folder of a rollout, replayed beside the first.
    """
    folder = Path(item)
    replays = tuple(
        load_replay(Path(name))
        for name in (item, beside)
        if name is not None and is_there(Path(name) / "rollout.npz")
    )
    if beside is not None and len(replays) < 2:
        raise InvalidRequestError(f"{item} and {beside} are not both folders of a rollout")
    if is_folder(folder) and item not in scene_names():
        if is_there(folder / ROWS):
            raise InvalidRequestError(
                f"{item} is a study: 'optipromp report {item}' writes a page about it"
            )
        if is_there(folder / "plan.json"):
            plan = load_plan(folder)
            return Source(plan.scene, plan, replays, _seen(folder / "seen"))
        if replays:
            return Source(replays[0].scene, None, replays)
        raise InvalidRequestError(
            f"{item} holds neither a plan (plan.json) nor a rollout (rollout.npz)"
        )
    if folder.name == "plan.json":
        return open_source(str(folder.parent), beside)
    return Source(load_scene(item), seen=_seen(folder))


def _seen(scene: Path) -> Image8 | None:
    """The picture that ``see`` left beside a scene; None: there is none that can be read."""
    picture = scene.with_suffix(OVERLAY)
    if is_file(picture):
        with suppress(OptiPrompError):
            return read_pixels(picture, "RGB").astype("uint8")
    return None
