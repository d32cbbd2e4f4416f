"""Pictures with truth as COCO (https://cocodataset.org/#format-data): masks, boxes, key points.

    optipromp render --preset wild --seeds 70000:70010 --out pictures
    python scripts/coco.py pictures

writes pictures/annotations.json about all pictures of the folder.
"""

import argparse
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from optipromp import load_scene
from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.files import write_together
from optipromp_eyes.pictures import ENDS, load_picture, read_pixels
from optipromp_sim.simulation.photograph import FRUITS, Kind, Marked, Photograph

FILE = "annotations.json"
KEYS = "tip", "top", "root"
"""Of a fruit: the end away from its stem, the end at its stem, and the far end of its stem."""
CATEGORIES: dict[Kind, str] = {
    "ripe": "fruit", "unripe": "fruit", "calyx": "plant", "stem": "plant", "leaf": "plant",
    "static": "scene",
}  # fmt: skip
"""Kinds of surfaces that are annotated, each with its larger category."""


class Labels(NamedTuple):
    """What COCO has of a picture: its image, and annotations without their numbers."""

    image: dict[str, Any]
    annotations: list[dict[str, Any]]


def record(name: str, shot: Photograph) -> Labels:
    """The record of a picture whose files are called ``name``; see
    :func:`optipromp_eyes.pictures.picture_files`."""
    camera = shot.picture.camera
    colour, depth, _ = (name + end for end in ENDS)
    image = {
        "file_name": colour, "width": camera.width, "height": camera.height, "depth_file": depth,
        "camera": camera.document(),
    }  # fmt: skip
    annotations = []
    for row, each in enumerate(shot.marked, start=1):
        mask = shot.masks == row
        if each.kind in CATEGORIES and mask.any():
            own = [k + 1 for k, other in enumerate(shot.marked) if other.id == each.id]
            keys = shot.keys.get(each.id) if each.kind in FRUITS else None
            told = {} if keys is None else _key_points(keys, np.isin(shot.masks, own))
            if each.share == each.share:
                told["visible"] = round(each.share, 3)
            annotations.append(_annotation(each, mask) | told)
    return Labels(image, annotations)


def document(records: Iterable[Labels]) -> dict[str, Any]:
    """The COCO document of pictures; lengths in pixels from the middle of the first pixel."""
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for image, own in records:
        images.append({"id": len(images) + 1} | image)
        annotations += [
            {"id": len(annotations) + k, "image_id": len(images)} | each
            for k, each in enumerate(own, start=1)
        ]
    points = {"keypoints": list(KEYS), "skeleton": [[1, 2], [2, 3]]}
    categories = [
        {"id": k, "name": kind, "supercategory": larger} | (points if kind in FRUITS else {})
        for k, (kind, larger) in enumerate(CATEGORIES.items(), start=1)
    ]
    return {"images": images, "annotations": annotations, "categories": categories}


def _annotation(each: Marked, mask: BoolArray) -> dict[str, Any]:
    rows, columns = np.nonzero(mask)
    low, high = (int(columns.min()), int(rows.min())), (int(columns.max()), int(rows.max()))
    return {
        "category_id": [*CATEGORIES].index(each.kind) + 1, "object": each.id, "iscrowd": 0,
        "bbox": [*low, high[0] - low[0] + 1, high[1] - low[1] + 1], "area": len(rows),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
    }  # fmt: skip


def run_lengths(mask: BoolArray) -> list[int]:
    """Lengths of the runs of 0 and 1 in turn, column by column; the first is of 0."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat)) + 1
    counts = np.diff(np.concatenate([[0], changes, [flat.size]])).tolist()
    return [0, *counts] if flat[0] else counts


def _key_points(keys: FloatArray, own: BoolArray) -> dict[str, Any]:
    """Key points x, y, v: 0 outside the picture, 1 hidden, 2 within 1.5 pixels of own ones."""
    height, width = own.shape
    told: list[float] = []
    for x, y in keys.tolist():
        if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):
            told += [0, 0, 0]
            continue
        rows, columns = (slice(max(math.ceil(t - 1.5), 0), math.floor(t + 1.5) + 1) for t in (y, x))
        seen = own[rows, columns].any()
        told += [round(x, 2), round(y, 2), 1 + int(seen)]
    return {"keypoints": told, "num_keypoints": sum(v > 0 for v in told[2::3])}


def photographs(folder: Path) -> list[Labels]:
    """The records of all pictures that ``optipromp render`` left in a folder, by name."""
    out = []
    for path in sorted(folder.glob("*.masks.json")):
        name = path.name.removesuffix(".masks.json")
        picture = load_picture(*(folder / (name + end) for end in ENDS))
        marked = tuple(
            Marked(each["id"], each["kind"], each.get("visible", math.nan))
            for each in json.loads(path.read_text(encoding="utf-8"))
        )
        scene = load_scene(folder / f"{name}.yaml")
        fruits = {item.id: item for item in scene.objects}
        masks = read_pixels(folder / f"{name}.masks.png", "L")
        out.append(record(name, Photograph(picture, picture.depth, masks, marked, scene, fruits)))
    return out


def main() -> None:
    """Write the annotations of the pictures of a folder."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("folder", type=Path, metavar="DIR", help="that optipromp render wrote")
    folder = ask.parse_args().folder
    labels = photographs(folder)
    write_together(folder, {FILE: json.dumps(document(labels), separators=(",", ":")).encode()})
    print(f"wrote {FILE} about {len(labels)} pictures to {folder}")


if __name__ == "__main__":
    main()
