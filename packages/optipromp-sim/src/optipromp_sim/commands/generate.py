"""``optipromp generate`` and ``render``: random scenes, and pictures of scenes."""

import os
import shlex
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import optipromp
from optipromp.cli.command import Report, Shown, command
from optipromp.cli.console import Preset, progress_bar, seeds_of, waiting
from optipromp.cli.robot import ArmOptions, Named, Whose
from optipromp.core import files
from optipromp.core.errors import InvalidRequestError, check_one_of

if TYPE_CHECKING:
    from optipromp.core.scenes.scene import Scene
    from optipromp_sim.simulation.photograph import Photograph


SEEN = "seen"


@command()
def generate(
    preset: Preset,
    out: Path,
    seed: int = 0,
    count: int = 1,
    noise: str = "",
    crop: str | None = None,
    *,
    robot: Whose = None,
    arm: ArmOptions,
) -> Report:
    """Sample random scenes and write them as scene files.

    The same seed gives the same scene. Another robot than the Panda has its base placed so that it
    reaches the scenes, and a cup with a neck as long as its wrist asks for. Scenes that are
    impossible (objects inside one another) or that no arm could solve (target out of reach or
    inside the gutter, every goal configuration in collision) are sampled again; how many, and why,
    is printed.

    Examples:
        optipromp generate --preset mixed --seed 100 --count 20 --out scenes
        optipromp generate --preset cluster --robot ur5.urdf --tip tool0 --count 20 --out ur5-scenes
        optipromp plan scenes --out plans
        optipromp simulate plans/mixed-100
        optipromp generate --preset tight --noise detector --out tight
        optipromp plan tight/seen --out plans
        optipromp simulate plans/tight-0 --in tight/tight-0.yaml

    Args:
        preset: cluster: 1-4 fruits before the ripe one; side-clusters: and neighbours; table-top:
            and a gutter; mixed: all of these; tight: fruits that nearly touch; limp: plumb stems;
            elongated: long fruits; truss: fruits on one truss; field: fruits, stems and trusses of
            all kinds; shelf: cans and boxes; wild: as in pictures of plantations; standing:
            mushrooms and asparagus; vine: peppers and cucumbers, which a scissor cuts; trusses:
            of tomatoes, cut as a whole.
        out (DIR): Where the scene files go.
        seed (0..): Of the first scene; each next has one more.
        count (1..): How many scenes.
        noise (NAME): Write the scenes as a detector sees them, too, into DIR/seen: zero-mean, low,
            high, missed or detector, as of 'bench study'.
        crop (CROP): Fruits and stems of a crop: strawberry, tomato, apple or a file.
    """
    from optipromp.core.scenes.crops import load_crop
    from optipromp_sim.generate import NOISES, PANDA, generate_with_report

    if noise:
        check_one_of("noise", noise, NOISES)
    files.check_folder(out / SEEN if noise else out)
    named, grown = arm.of(robot), None if crop is None else load_crop(crop)
    documents: list[dict[str, Any]] = []
    reasons: Counter[str] = Counter()
    with waiting("sampling scenes") as say:
        for number in range(seed, seed + count):
            say(f"sampling scene {number - seed + 1} of {count}")
            whose = named.name or PANDA, named.choice
            scene, report = generate_with_report(preset, number, *whose, grown)
            if named.name is not None:
                _judge_start(scene)
            optipromp.save_scene(scene, path := out / f"{scene.name}.yaml")
            reasons.update(report.reasons)
            documents.append({
                "file": str(path), "seed": number, "pushables": len(scene.pushables),
                "redraws": report.redraws, "reasons": report.reasons,
                **(_seen(scene, number, noise, out) if noise else {}),
            })  # fmt: skip
    redraws = reasons.total()
    unread = _unread(named, out)
    why = "".join(f", {number} {reason}" for reason, number in reasons.most_common())
    lines = [f"wrote {count} scene{'s' * (count != 1)} to {out}", f"sampled again: {redraws}{why}"]
    if noise:
        missed = sum(len(document["missed"]) for document in documents)
        lines.append(f"wrote as seen to {out / SEEN}; fruits missed: {missed}")
    document = {"preset": preset, "redraws": redraws, "scenes": documents, "folders": unread}
    return Report(document, chain(lines, _to_allow(unread, robot)))


def _to_allow(folders: list[str], robot: str | None) -> Shown:
    """The environment variables that let the scenes read their robot, as lines to be copied."""
    from rich.text import Text

    from optipromp.readers.packages import is_xacro

    elsewhere = "the robot lies elsewhere, where scenes may read nothing unless you allow it"
    runs = "the robot is a xacro, which scenes may not run unless you allow it"
    because = {files.FOLDERS: elsewhere, files.ALLOW_XACRO: runs}
    allowed = {files.FOLDERS: os.pathsep.join(folders)} if folders else {}
    if robot is not None and Path(robot).suffix and is_xacro(Path(robot)):
        allowed[files.ALLOW_XACRO] = "1"
    for name, value in allowed.items():
        line = f"{because[name]}: export {name}={shlex.quote(value)}"
        yield Text(line, no_wrap=True)


def _judge_start(scene: "Scene") -> None:
    """Refuse a scene whose start is in collision, by the judge of plans. A start that the arm
    cannot hold against gravity gives a warning."""
    from optipromp.core import judging
    from optipromp.core.planning.task import posed
    from optipromp.core.robots.model import warn_of_gravity

    robot, state = posed(scene)
    touching = judging.touching(scene, robot, state.q)
    if touching:
        told = "; ".join(map(str, touching))
        raise InvalidRequestError(f"{scene.name}: the robot has no free start: {told}")
    warn_of_gravity(robot, state.q[None], scene.up, f"at the start of {scene.name}")


def _unread(named: Named, out: Path) -> list[str]:
    """The folders of the robot's files that scenes in ``out`` may not read."""
    if named.name is None or not Path(named.name).suffix:
        return []
    from optipromp.core.robots.library import files_of

    lacking = set[Path]()
    for file in files_of(named.name, named.choice):
        try:
            files.check_inside(file, out, InvalidRequestError)
        except InvalidRequestError:
            lacking.add(file.resolve() if files.is_folder(file) else file.resolve().parent)
    return [str(each) for each in sorted(lacking) if not lacking & set(each.parents)]


def _seen(scene: "Scene", seed: int, noise: str, out: Path) -> dict[str, Any]:
    """Write the scene as detected; returns its path and the ids of the fruits not seen."""
    from optipromp_sim.generate import NOISES, noisy

    seen, file = noisy(scene, seed, NOISES[noise]), out / SEEN / f"{scene.name}.yaml"
    optipromp.save_scene(seen, file)
    ids = {item.id for item in seen.objects}
    return {"seen": str(file), "missed": [i.id for i in scene.objects if i.id not in ids]}


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

    Examples:
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
    from optipromp_sim.generate import generate as sampled
    from optipromp_sim.simulation.photograph import photograph

    if (scene is None) == (preset is None):
        raise InvalidRequestError("give a scene or --preset, one of them")
    numbers = range(*seeds_of(seeds))
    files.check_folder(out)
    looks = looks or ("rich" if preset == "wild" else "plain")
    records: list[dict[str, Any]] = []
    with progress_bar(10) as told:
        for number in numbers:
            shown = sampled(preset, number) if preset else optipromp.load_scene(str(scene))
            shot = photograph(shown, mount, number, looks=looks)
            name = f"{Path(scene).stem}-{number}" if scene is not None else shot.scene.name
            told(len(records), len(numbers), name)
            records.append(write_shot(shot, name, out))
    lines = [f"wrote {len(records)} picture{'s' * (len(records) != 1)} to {out}"]
    return Report({"mount": mount, "looks": looks, "pictures": records}, lines)


def write_shot(shot: "Photograph", name: str, out: Path) -> dict[str, Any]:
    """Write the files of a picture; returns what is said of it."""
    from optipromp_eyes.pictures import picture_files, png_file

    masks = [
        {"value": k + 1, "id": each.id, "kind": each.kind}
        | ({} if each.share != each.share else {"visible": round(each.share, 3)})
        for k, each in enumerate(shot.marked)
    ]
    parts = picture_files(name, shot.picture)
    parts[f"{name}.masks.png"] = png_file(shot.masks)
    parts[f"{name}.masks.json"] = files.json_text(masks).encode()
    files.write_together(out, parts)
    fruits = [each.id for each in shot.marked if each.kind in ("ripe", "unripe")]
    optipromp.save_scene(shot.scene, out / f"{name}.yaml")
    return {"name": name, "scene": str(out / f"{name}.yaml"), "fruits": fruits}
