"""``optipromp see``: from pictures to scenes."""

import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import optipromp
from optipromp.cli.command import FAILED, OK, Report, command
from optipromp.cli.console import waiting
from optipromp.core.errors import Code, InvalidRequestError, short
from optipromp.core.files import check_folder, is_file, is_folder, npz, write_atomically
from optipromp.parts import part

if TYPE_CHECKING:
    from optipromp.core.scenes.crops import Crop
    from optipromp.core.scenes.scene import Scene, SceneObject
    from optipromp_eyes.eyes import Sighting
    from optipromp_eyes.parameters import EyeParameters
    from optipromp_eyes.pictures import DepthPicture


class _Asked(NamedTuple):
    """One picture, by files or of a bag, what tells what is known, and where the answer goes."""

    name: str
    files: Sequence[Path]  # colours, depth and camera
    known: str | None
    out: Path
    picture: "DepthPicture | None" = None


@command()
def see(
    folder: Path | None = None,
    /,
    out: Path | None = None,
    *,
    rgb: Path | None = None,
    depth: Path | None = None,
    camera: Path | None = None,
    known: str | None = None,
    finder: str | None = None,
    model: Path | None = None,
    boxes: Path | None = None,
    together: bool = False,
    bag: Path | None = None,
    topics: str | None = None,
    prefix: str | None = None,
    every: float = 1.0,
    crop: str | None = None,
    eyes: str | None = None,
    teach: str | None = None,
) -> Report:
    """Find fruits and stems in pictures, and write scenes to plan in.

    By a network, or by colour, depth and shape (--finder). Ripe fruits become the target (the
    lowest of several), unripe ones pushable. Every position has its covariance. What nobody saw,
    such as the stem of a fruit, is assumed and said. A picture NAME.overlay.png shows what was
    found.

    Examples:
        optipromp see pictures --out seen
        optipromp see pictures --finder geometry --out seen
        optipromp see views --together --known row.yaml --out seen
        optipromp see --rgb a.png --depth a.npz --camera camera.json --known row.yaml --out a.yaml
        optipromp see --bag row.mcap --known row.yaml --every 2 --out seen
        optipromp see pictures --boxes detections.json --out seen
        optipromp see pictures --teach page --out my-crop.yaml
        optipromp see pictures --crop my-crop.yaml --out seen
        optipromp plan a.yaml --out reach

    Args:
        folder (DIR): Pictures as 'render' leaves them; else --rgb.
        out (FILE.yaml|DIR): The scene; of a folder, all scenes.
        rgb: A picture: PNG, JPEG, TIFF, BMP or PPM.
        depth: Its depth: 16-bit PNG or TIFF, NPZ with 'depth' in metres, TIFF or NPY.
        camera: Its camera: JSON or YAML with width, height, fx, fy, cx, cy, position and
            orientation in the robot's base, depth_scale; or what 'calibrate' wrote.
        known (SCENE): Whose robot, tool, start, approach and static objects are known; its fruits
            are not used. In a folder by default the scene beside each picture; else scenario-3.
        finder (geometry|network|MODULE:NAME): Of fruits and stems: by colour and shape, by our
            network, or your own; by default our network where onnxruntime is installed and the
            crop has no colours of its own, else geometry.
        model (FILE.onnx): Of the network, in place of ours.
        boxes (COCO.json): What a detector found elsewhere, in place of --finder: boxes or masks of
            ripe, unripe and stem, with their score (of a class that is ripe its probability).
        together: All pictures show one scene, from different places: one scene 'together.yaml',
            too, each fruit's position the mean of all pictures that show it.
        bag: Of ROS 2, in place of files: colour and depth, or a cloud, and frames.
        topics (A,B): Of the bag: colour and depth, or the cloud, to take.
        prefix (PREFIX): Of the bag's joints and links, of one of several arms.
        every (SECONDS 0..): Of the bag: between pictures.
        crop (CROP): Of the fruits: strawberry, tomato, apple or a file. The scenes name it, its
            sizes and colours are looked for, and fruits of other sizes are said.
        eyes (CROP|FILE): Colours and sizes alone: a crop, or a YAML file of EyeParameters, as
            'ripe_hue: 55'.
        teach (page|FILE.json): Write a crop to --out, with the colours and sizes of some ten ripe
            and unripe fruits and stems that you click on a page, or that a file marks: COCO, or a
            list of picture, kind, and box (left, top, right, bottom) or at (column, row). What is
            not seen is of --crop, by default strawberry.
    """
    from optipromp.core.documents import read_document
    from optipromp.core.output import OVERLAY
    from optipromp.core.scenes.crops import load_crop
    from optipromp_eyes.detector import ByDetector, finder_named, of_coco
    from optipromp_eyes.eyes import doubt_of, look_at, overlay
    from optipromp_eyes.parameters import EyeParameters, eyes_of
    from optipromp_eyes.pictures import png_file

    made = {EyeParameters(): finder_named(finder, model)}  # refused before anything is read
    if boxes is not None and (finder or model or bag):
        raise InvalidRequestError("--boxes goes without --finder, --model and --bag")
    marked = None if boxes is None else read_document(boxes, InvalidRequestError, "COCO")
    things = None if marked is None else of_coco(marked, str(boxes))
    grown = None if crop is None else load_crop(crop)
    asked: Iterator[_Asked] | list[_Asked]
    if bag is not None:
        if folder is not None or rgb is not None or depth is not None:
            raise InvalidRequestError("--bag goes without a folder, --rgb and --depth")
        asked = _of_bag(bag, topics, prefix or "", every, camera, known, out)
    elif topics is not None or prefix is not None:
        raise InvalidRequestError(f"--{'prefix' if topics is None else 'topics'} goes with --bag")
    else:
        asked = _asked(folder, rgb, depth, camera, known, out if teach is None else None)
    if teach is not None:
        return _taught(asked, teach, grown or load_crop("strawberry"), out)
    records, lines = list[dict[str, Any]](), list[str]()
    sights: list[tuple[Sighting, Scene, EyeParameters, Path]] = []
    with waiting("looking") as say:
        for each in asked:
            say(f"looking at {each.name}")
            scene = optipromp.load_scene(each.known or "scenario-3")
            scene = scene if grown is None else replace(scene, crop=grown)
            picture = _load(each, scene)
            began = time.perf_counter()
            p = eyes_of(scene.crop, eyes)
            if p not in made:
                made[p] = finder_named(finder, model, p)
            eye = made[p]
            if things is not None:
                if each.name not in things:
                    raise InvalidRequestError(
                        f"{boxes}: has no image {each.name!r}, but {short(sorted(things))}"
                    )
                eye = ByDetector.of(things[each.name], _step(each, picture))
            sight = look_at(picture, up=scene.up, finder=eye, parameters=p)
            took = time.perf_counter() - began
            record, told = _answer(sight, scene, each, took, p)
            if record["scene"] is None and (
                doubt := doubt_of(picture, up=scene.up, finder=eye, parameters=p)
            ):
                record["message"] += f"; {doubt}"
                told = [f"{told[0]}; {doubt}", *told[1:]]
            drawn = each.out.with_suffix(OVERLAY)
            write_atomically(drawn, png_file(overlay(picture, sight)))
            records.append({**record, "overlay": str(drawn)})
            lines += told
            sights.append((sight, scene, p, each.out))
    document: dict[str, Any] = {"pictures": records}
    if together and sights:
        record, told = _together([sight for sight, *_ in sights], *sights[0][1:])
        document, records, lines = {**document, "together": record}, [record], [*lines, *told]
    seen = all(record["scene"] is not None for record in records)
    return Report(document, lines, OK if seen else FAILED)


def _step(asked: _Asked, picture: "DepthPicture") -> int:
    """Of how many rows and columns of a picture's file one is looked at."""
    from optipromp_eyes.pictures import load_camera

    wide = load_camera(asked.files[2])[0].width if asked.files else picture.camera.width
    return round(wide / picture.camera.width)


def _taught(asked: Iterable[_Asked], teach: str, like: "Crop", out: Path | None) -> Report:
    """Write the crop whose fruits are marked, on a page or in a file."""
    from optipromp.core.scenes.crops import save_crop
    from optipromp_eyes.teaching import Mark, read_marks, taught

    if out is None or out.suffix not in (".yaml", ".yml", ".json"):
        raise InvalidRequestError("--teach writes a crop: give --out FILE.yaml")
    pictures, steps = dict[str, "DepthPicture"](), dict[str, int]()
    for each in asked:
        picture = _load(each, optipromp.load_scene(each.known or "scenario-3"))
        pictures[each.name], steps[each.name] = picture, _step(each, picture)

    def learn(marks: "Sequence[Mark]") -> tuple["Crop", tuple[str, ...]]:
        return taught(out.stem, like, pictures, marks)

    if teach == "page":
        import webbrowser

        page = part("teaching_page")({name: each.rgb for name, each in pictures.items()}, learn)
        sys.stderr.write(f"mark fruits and stems at {page.url}  (Ctrl-C ends it)\n")
        webbrowser.open(page.url)
        crop, told = page.result()
    else:  # of pictures with many pixels every second (third, ...) is looked at
        crop, told = learn(
            [each.seen(steps.get(each.picture, 1)) for each in read_marks(Path(teach))]
        )
    save_crop(crop, out)
    document = {"file": str(out), "name": crop.name, "learnt": list(told), "eyes": dict(crop.eyes)}
    return Report(document, [*told, f"wrote {out}; see with --crop {out}"])


def _together(
    sights: "list[Sighting]", known: "Scene", p: "EyeParameters", out: Path
) -> tuple[dict[str, Any], list[str]]:
    """What is said of all pictures as one, whose scene is written beside ``out``."""
    from optipromp_eyes.fusing import fused

    fruits = fused(sights)
    record: dict[str, Any] = {
        "scene": None, "assumed": [], "status": Code.SUCCESS, "message": "",
        "fruits": [
            {"id": f.item.id, "position": f.item.position.round(5).tolist(), "views": f.views}
            for f in fruits
        ],
    }  # fmt: skip
    several = sum(fruit.views > 1 for fruit in fruits)
    line = f"together: {len(fruits)} fruits, {several} of them in several pictures"
    told = _written(sights, known, p, out.with_name("together.yaml"), record, line)
    return record, told


def _written(
    sights: "Sighting | list[Sighting]",
    known: "Scene",
    p: "EyeParameters",
    file: Path,
    record: dict[str, Any],
    line: str,
) -> list[str]:
    """What is said of the scene that is written to a file, here and in the ``record``."""
    from optipromp_eyes.eyes import seen_scene

    try:
        scene, assumed = seen_scene(sights, known, p)
    except InvalidRequestError as error:
        record.update(status=error.code, message=error.message)
        return [f"{line}; no scene: {error.message}"]
    known_ids = {item.id for item in known.static}
    solids = [item for item in scene.objects if item.stem is None and item.id not in known_ids]
    optipromp.save_scene(_filed(scene, file), file)
    record.update(scene=str(file), assumed=list(assumed))
    record["solids"] = [
        {
            "id": o.id,
            "role": o.role,
            "position": o.position.round(4).tolist(),
            "radius": round(o.radius, 4),
        }
        for o in solids
    ]
    return [f"{line}; wrote {file}", *(f"  {words}" for words in assumed)]


def _filed(scene: "Scene", file: Path) -> "Scene":
    """The scene whose point clouds are in a folder beside its file."""
    from optipromp.core.geometry.shapes import PointCloudShape

    def filed(item: "SceneObject") -> "SceneObject":
        shape = item.shape
        if not isinstance(shape, PointCloudShape) or shape.path is not None:
            return item
        path = file.with_suffix(".solids") / f"{item.id}.npz"
        write_atomically(path, npz({"points": shape.points}))
        return replace(item, shape=replace(shape, path=path.absolute()))

    return replace(scene.each(filed), unseen=scene.unseen and filed(scene.unseen))


def _asked(
    folder: Path | None, rgb: Path | None, depth: Path | None, camera: Path | None,
    known: str | None, out: Path | None,
) -> list[_Asked]:  # fmt: skip
    from optipromp_eyes.detector import picture_name
    from optipromp_eyes.pictures import ENDS

    single = {"--rgb": rgb, "--depth": depth, "--camera": camera}
    if (folder is None) == (rgb is None):
        raise InvalidRequestError("give a folder of pictures, or --rgb, --depth and --camera")
    if folder is None:
        if lacking := [name for name, file in single.items() if file is None]:
            raise InvalidRequestError(f"--rgb without {' and '.join(lacking)}: give all three")
        files = [file for file in single.values() if file is not None]
        path = out or files[0].with_suffix(".yaml")
        if path.suffix not in (".yaml", ".yml", ".json"):
            raise InvalidRequestError(f"--out is {str(path)!r}: its name must end in .yaml")
        return [_Asked(picture_name(files[0].name), files, known, path)]
    if depth is not None or camera is not None:
        raise InvalidRequestError("--depth and --camera go with --rgb, not with a folder")
    if not is_folder(folder):
        raise InvalidRequestError(f"{folder}: no such folder")
    target = out or folder / "seen"
    check_folder(target)
    found = []
    for path in sorted(folder.glob(f"*{ENDS[0]}")):
        name = path.name.removesuffix(ENDS[0])
        files = [folder / (name + end) for end in ENDS]
        for file in files:
            if not is_file(file):
                raise InvalidRequestError(f"{file} is missing beside {path.name}")
        beside = folder / f"{name}.yaml"
        told = known or (str(beside) if is_file(beside) else None)
        found.append(_Asked(name, files, told, target / f"{name}.yaml"))
    if not found:
        raise InvalidRequestError(f"{folder}: no pictures; their names end in {', '.join(ENDS)}")
    return found


def _of_bag(
    bag: Path, topics: str | None, prefix: str, every: float, camera: Path | None,
    known: str | None, out: Path | None,
) -> Iterator[_Asked]:  # fmt: skip
    """The pictures of a bag, one after another."""
    from optipromp_eyes.pictures import load_camera

    model = None if camera is None else load_camera(camera)[0]
    chosen = None if topics is None else [name.strip() for name in topics.split(",")]
    scene = optipromp.load_scene(known or "scenario-3")
    check_folder(target := out or bag.with_name(f"{bag.stem}-seen"))
    given = {"topics": chosen, "every": every, "camera": model, "prefix": prefix}
    found = part("bag_pictures")(bag, scene, **given)
    for k, one in enumerate(found):
        name = f"{bag.stem}-{k:03d}"
        yield _Asked(f"{name}, {one.time:.2f} s", (), known, target / f"{name}.yaml", one.picture)


def _load(asked: _Asked, known: "Scene") -> "DepthPicture":
    """The picture; a camera on the hand was where the hand is at the scene's start."""
    if asked.picture is not None:
        return asked.picture
    from optipromp.core.planning.task import posed
    from optipromp.core.scenes.hand import flange_of
    from optipromp_eyes.pictures import load_camera, load_picture, placed

    rgb, depth, file = asked.files
    camera, step = load_camera(file)
    there = placed(camera, str(file), lambda: flange_of(posed(known)[0], posed(known)[1].q))
    return load_picture(rgb, depth, (there, step))


def _answer(
    sight: "Sighting", known: "Scene", asked: _Asked, took: float, p: "EyeParameters"
) -> tuple[dict[str, Any], list[str]]:
    """What is said of a picture under --json and to people."""
    from optipromp_eyes.eyes import summary

    base = {item.id: item for item in sight.look.in_base()}
    fruits = [
        {**summary(each), "position": base[each.item.id].position.round(5).tolist()}
        for each in sight.detections
    ]
    record: dict[str, Any] = {
        "name": asked.name, "scene": None, "fruits": fruits, "ms": round(1e3 * took, 1),
        "assumed": [], "left_out": sight.found.left_out, "doubts": list(sight.doubts),
        "status": Code.SUCCESS, "message": "",
    }  # fmt: skip
    stems = sum(each.stem is not None for each in sight.detections)
    ripe = sum(each.item.role == "target" for each in sight.detections)
    line = f"{asked.name}: {ripe} ripe, {len(fruits) - ripe} unripe, {stems} stems"
    if sight.found.left_out:
        line += f" ({sight.found.left_out} smaller places of their colours were left out)"
    told = _written(sight, known, p, asked.out, record, line)
    return record, [*told, *(f"  doubt: {words}" for words in sight.doubts)]
