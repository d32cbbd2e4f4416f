"""``optipromp render``: pictures of scenes with depth, masks, camera and truth."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from optipromp.cli.command import Report, command
from optipromp.cli.console import Preset, progress_bar
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder, json_text, write_together

if TYPE_CHECKING:
    from optipromp.core.scenes.scene import Scene
    from optipromp.laboratory.simulation.coco import Shot


@command()
def render(
    scene: str | None = None,
    /,
    *,
    out: Path,
    preset: Preset | None = None,
    seeds: str = "0:1",
    mount: Literal["beside", "palm", "hand"] = "beside",
    looks: Literal["plain", "rich"] | None = None,
) -> Report:
    """Take pictures of a scene, with depth and truth.

    Light, colours and background are sampled by the seed, and so are the errors of depth: noise,
    scale, ragged edges and holes of a stereo camera. A picture NAME leaves NAME.rgb.png,
    NAME.depth.png (16 bits, 0.1 mm), NAME.camera.json, NAME.masks.png (an instance a value),
    NAME.masks.json (what each value is, and its visible share) and NAME.yaml, the true scene.
    annotations.json has all of them as COCO: masks, boxes, key points of fruits and stems, cameras.
    Needs the extra 'sim'.

    [bold]Examples[/bold]

    \b
    optipromp render scenario-3 --seeds 0:3 --out pictures
    optipromp render --preset field --seeds 70000:70010 --out pictures
    optipromp render --preset wild --seeds 70000:70010 --out pictures
    optipromp see pictures --out seen

    Args:
        scene (SCENE): A scene.
        out (DIR): Where the pictures go.
        preset: In place of a scene: random ones, as of 'generate'.
        seeds (A:B): Of the scenes, and of light, colours and errors.
        mount: Of the camera: standing beside, in the tool's mouth, on the hand.
        looks: plain: smooth fruits before two colours; rich: leaves, bowed stems, painted surfaces,
            shadows. Default: rich for the preset wild, else plain.
    """
    from optipromp.laboratory.simulation import coco

    if (scene is None) == (preset is None):
        raise InvalidRequestError("give a scene or --preset, one of them")
    numbers = seeds_of(seeds)
    check_folder(out)
    looks = looks or ("rich" if preset == "wild" else "plain")
    records: list[dict[str, Any]] = []
    annotated: list[coco.Labels] = []
    with progress_bar(10) as told:
        for number in numbers:
            shot, name, true = _taken(scene, preset, number, mount, looks)
            told(len(records), len(numbers), name)
            records.append(write_shot(shot, name, true, out))
            annotated.append(coco.record(name, shot))
    content = json.dumps(coco.document(annotated), separators=(",", ":"))
    write_together(out, {coco.FILE: content.encode()})
    lines = [f"wrote {len(records)} picture{'s' * (len(records) != 1)} to {out}"]
    return Report({"mount": mount, "looks": looks, "pictures": records}, lines)


def seeds_of(text: str) -> range:
    """The seeds from A to before B of A:B."""
    begin, colon, end = text.partition(":")
    if not (begin.isdigit() and end.isdigit() and colon and int(begin) < int(end)):
        raise InvalidRequestError(f"seeds are {text!r}; write them as 0:10")
    return range(int(begin), int(end))


def _scene(scene: str | None, preset: Any, number: int) -> "Scene":
    from optipromp.core.scenes.io import load_scene
    from optipromp.laboratory.generate import generate

    return generate(preset, number) if scene is None else load_scene(scene)


def _taken(
    scene: str | None, preset: Any, number: int, mount: str, looks: str
) -> "tuple[Shot, str, Scene | None]":
    """A picture, its name, and the true scene."""
    from optipromp.laboratory.simulation.photograph import photograph

    shot = photograph(_scene(scene, preset, number), mount, number, looks=looks)  # type: ignore[arg-type]
    name = f"{Path(scene).stem}-{number}" if scene is not None else shot.scene.name
    return shot, name, shot.scene


def write_shot(shot: "Shot", name: str, true: "Scene | None", out: Path) -> dict[str, Any]:
    """Write the files of a picture; returns what is said of it."""
    from optipromp.core.scenes.io import save_scene
    from optipromp.perception.pictures import picture_files, png_file

    masks = [
        {"value": k + 1, "id": each.id, "kind": each.kind}
        | ({} if each.share != each.share else {"visible": round(each.share, 3)})
        for k, each in enumerate(shot.marked)
    ]
    files = picture_files(name, shot.picture)
    files[f"{name}.masks.png"] = png_file(shot.masks)
    files[f"{name}.masks.json"] = json_text(masks).encode()
    write_together(out, files)
    fruits = [each.id for each in shot.marked if each.kind in ("ripe", "unripe")]
    told = {"name": name, "scene": None, "fruits": fruits}
    if true is not None:
        save_scene(true, out / f"{name}.yaml")
        told["scene"] = str(out / f"{name}.yaml")
    return told
