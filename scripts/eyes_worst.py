"""The worst pictures of the eyes: overlays with captions on one sheet.

Run from the repository: ``PYTHONPATH=src python scripts/eyes_worst.py --seeds 70000:70030 --out
docs/images/eyes_worst.png``. A fault of a picture is a visible fruit that was missed, a detection
that is no fruit, a centre that is off by more than its covariance says, or a stem that is off by
more than its deviation. Pictures are ranked by their worst fault. The caption names it, and a frame
marks the true fruit, or the false detection.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).parent))  # as a module, too

from studies.eyes import SURE, SeenPicture, matched

from optipromp_eyes import look_at
from optipromp_eyes.detector import finder_named
from optipromp_eyes.eyes import overlay
from optipromp_eyes.finder import Finder
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import FRUITS, Photograph, photograph

WIDE, CAPTION, COLUMNS = 480, 22, 2  # [pixel] of a picture and its caption; pictures in a row
SURE_TILT = 3.0  # deviations of a stem that 1 % of true errors exceed (Rayleigh)


class Fault(NamedTuple):
    """What is wrong in a picture.

    ``weight`` is over 1 for what 1 % of true errors exceed; of a missed fruit it is 1 and more for
    what shows of it, of a false one 1 and more for its score. ``box`` [pixel]: left, top, right,
    bottom.
    """

    weight: float
    words: str
    box: tuple[int, int, int, int]


def faults(shot: Photograph, seen: SeenPicture) -> Iterator[Fault]:
    """All that is wrong in a picture, small errors too."""
    for fruit in seen.fruits:
        name = fruit.item.id
        box = box_of(shot.mask(name, *FRUITS))
        if fruit.detection is None:
            if fruit.visible:
                words = f"{name} missed, {100 * fruit.share:.0f} % visible"
                yield Fault(4.0 * fruit.share, words, box)
            continue
        words = f"{name}: centre {1e3 * fruit.error:.0f} mm off, squared {fruit.normalised:.0f} "
        yield Fault(fruit.normalised / SURE, words + "deviations", box)
        if fruit.stem_visible and not math.isnan(fruit.angle):
            words = f"{name}: stem {fruit.angle:.0f} deg off, {fruit.tilts:.1f} deviations"
            yield Fault(fruit.tilts / SURE_TILT, words, box)
        if not fruit.kind_right:
            yield Fault(4.0, f"{name}: taken for {fruit.detection.region.kind}", box)
    for each in seen.wrong:
        words = f"{each.item.id}: no fruit is there"
        yield Fault(2.0 + each.region.score, words, box_of(each.region.pixels))


def box_of(mask: np.ndarray) -> tuple[int, int, int, int]:
    """The frame about the pixels (height, width) of a mask; of none, the origin."""
    if not mask.any():
        return 0, 0, 0, 0
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


def worst(
    scenes: list[tuple[str, int]], mount: str, finder: Finder | None, count: int
) -> list[tuple[str, Fault, Image.Image]]:
    """Name, worst fault and overlay of the ``count`` worst pictures, the worst first."""
    kept: list[tuple[str, Fault, Image.Image]] = []
    for preset, seed in scenes:
        shot = photograph(generate(preset, seed), mount, seed)  # type: ignore[arg-type]
        sight = look_at(shot.picture, up=shot.scene.up, finder=finder)
        found = list(faults(shot, matched(shot, sight, 0.0)))
        if not found:
            continue
        fault = max(found, key=lambda each: each.weight)
        drawn = Image.fromarray(overlay(shot.picture, sight))
        left, top, right, bottom = fault.box
        frame = left - 6, top - 6, right + 6, bottom + 6
        ImageDraw.Draw(drawn).rectangle(frame, outline=(255, 0, 255), width=2)
        kept.append((f"{preset} {seed}", fault, drawn))
        kept = sorted(kept, key=lambda each: -each[1].weight)[:count]
    return kept


def sheet(pictures: list[tuple[str, Fault, Image.Image]]) -> Image.Image:
    """All pictures with their captions on one."""
    first = pictures[0][2]
    high = round(WIDE * first.height / first.width)
    rows = -(-len(pictures) // COLUMNS)
    out = Image.new("RGB", (COLUMNS * WIDE, rows * (high + CAPTION)), "white")
    draw = ImageDraw.Draw(out)
    for k, (name, fault, picture) in enumerate(pictures):
        x, y = (k % COLUMNS) * WIDE, (k // COLUMNS) * (high + CAPTION)
        out.paste(picture.resize((WIDE, high), Image.Resampling.LANCZOS), (x, y + CAPTION))
        draw.text((x + 4, y + 4), f"{name}: {fault.words}", fill="black", font_size=14)
    return out


def main() -> None:
    """Write the sheet, and print the faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", default="cluster,mixed,field")
    parser.add_argument("--seeds", default="70000:70030", metavar="A:B")
    parser.add_argument("--mount", default="beside", choices=("beside", "palm", "hand"))
    parser.add_argument("--finder", default="geometry")
    parser.add_argument("--count", default=10, type=int)
    parser.add_argument("--out", default="eyes_worst.png", type=Path)
    given = parser.parse_args()
    first, end = map(int, given.seeds.split(":"))
    scenes = [(name, seed) for seed in range(first, end) for name in given.presets.split(",")]
    found = worst(scenes, given.mount, finder_named(given.finder), given.count)
    if not found:
        raise SystemExit("no picture shows a fruit: choose other seeds")
    for name, fault, _ in found:
        print(json.dumps({"picture": name, "weight": round(fault.weight, 2), "what": fault.words}))
    sheet(found).save(given.out)


if __name__ == "__main__":
    main()
