"""How well do the eyes see? Random scenes rendered, seen, and compared with the truth.

Run from the repository: ``python scripts/eyes_study.py --seeds 70000:70030``. The
script prints figures, a preset, a mount and a finder a line, as JSON, and a table of them. Every
finder sees the same pictures. ``--finder network,shapes.onnx`` compares weights.
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.scene import SceneObject
from optipromp_bench.experiments.eyes import LEAST_PIXELS, LEAST_SHARE, Paired, paired
from optipromp_bench.experiments.statistics import share, tabled
from optipromp_eyes.detector import finder_named
from optipromp_eyes.eyes import Detection, Sighting, look_at
from optipromp_eyes.finder import Finder
from optipromp_eyes.pictures import CameraModel, DepthPicture
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, photograph

NEAREST = 0.075  # [m] of a fruit that must be found: a depth camera measures nothing nearer
LEAST_LENGTH = 0.025  # [m] of a visible stem of the second renderer: a choice
LEAST_STEM = 60  # pixels of a visible stem: a choice
SURE = 11.34  # squared normalised error that 1 % of true Gaussian errors exceed (χ², 3 degrees)


@dataclass(frozen=True, eq=False)
class SeenFruit:
    """A fruit of a photograph, and what was seen of it."""

    share: float  # part of its outline that shows
    visible: bool  # whether enough shows that it must be found
    error: float  # of its centre, where it was found; else nan [m]
    # squared error of the centre over its covariance; 3 in the mean if that is true
    normalised: float
    kind_right: bool  # whether ripe was taken for ripe
    stem_visible: bool  # whether enough of its stem shows
    angle: float  # between the true stem and the one found; nan where none was [deg]
    # this angle over the deviation of each tilt; √2 in the root mean square if that is true
    tilts: float
    item: SceneObject  # the true fruit, in the base frame
    center: FloatArray  # (3,) true middle of its extent in the frame of the camera [m]
    detection: Detection | None  # that matches it; None: it was not found

    @property
    def found(self) -> bool:
        """Whether a detection matches it."""
        return self.detection is not None


@dataclass(frozen=True, eq=False)
class SeenPicture:
    """The fruits of one photograph, the detections that match none, and the time [s]."""

    fruits: tuple[SeenFruit, ...]
    wrong: tuple[Detection, ...]
    seconds: float

    @property
    def false(self) -> int:
        """Number of detections that match no fruit."""
        return len(self.wrong)


def compared(shot: Photograph, finder: Finder | None = None) -> SeenPicture:
    """What is seen in a photograph against its truth; see :func:`matched`."""
    began = time.process_time()
    sight = look_at(shot.picture, up=shot.scene.up, finder=finder)
    return matched(shot, sight, time.process_time() - began)


def matched(shot: Photograph, sight: Sighting, seconds: float) -> SeenPicture:
    """A sight of a photograph, made in ``seconds``, against the truth; see :func:`paired`."""
    fruits, wrong = paired(shot, sight)
    turn, seen = shot.picture.camera.pose.rotation.T, []
    for each in fruits:
        stem = each.item.stem
        shows = stem is not None and int(shot.mask(each.item.id, "stem").sum()) >= LEAST_STEM
        seen.append(_fruit(each, None if stem is None else turn @ stem.vector, shows))
    return SeenPicture(tuple(seen), tuple(wrong), seconds)


def _fruit(each: Paired, way: FloatArray | None, shows: bool) -> SeenFruit:
    """What is seen of a fruit, whose stem leads ``way`` (3,) in the frame of the camera."""
    item, center, match, share, visible = each
    error = normalised = angle = tilts = math.nan
    right = False
    if match is not None:
        off = match.item.position - center
        assert match.item.covariance is not None
        error = float(np.linalg.norm(off))
        normalised = float(off @ np.linalg.solve(match.item.covariance, off))
        right = (match.region.kind == "ripe") == (item.role == "target")
        if way is not None and match.stem is not None:
            cosine = float(way @ match.stem.direction) / float(np.linalg.norm(way))
            turned = math.acos(min(max(cosine, -1.0), 1.0))
            angle, tilts = math.degrees(turned), turned / match.stem.deviation
    return SeenFruit(
        share, visible, error, normalised, right, shows, angle, tilts, item, center, match
    )


REACH = 0.05  # [m] along a stem, to which its true direction is taken: a choice


def in_garden(seed: int, finder: Finder | None = None) -> SeenPicture:
    """What is seen in a picture of the second renderer against its truth; see garden.py."""
    from garden import drawn

    return seen_in(drawn(seed, native=True), finder)


def seen_in(held: Mapping[str, np.ndarray], finder: Finder | None = None) -> SeenPicture:
    """What is seen in the arrays of such a picture."""
    truth = json.loads(str(held["truth"]))
    height, width = held["depth"].shape
    focal = truth["focal"]
    camera = CameraModel(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    picture = DepthPicture(held["rgb"], held["depth"].astype(np.float64), camera)
    began = time.process_time()
    sight = look_at(picture, up=np.array(truth["up"]), finder=finder)
    seconds = time.process_time() - began
    free, fruits = list(sight.detections), []
    for each in sorted(truth["fruits"], key=lambda one: -one["share"]):
        center, line = np.array(each["center"]), np.array(each["stem"])
        away = [float(np.linalg.norm(one.item.position - center)) for one in free]
        match = None
        if away and min(away) < max(each["radius"], each["half"]):
            match = free.pop(int(np.argmin(away)))
        visible = each["share"] >= LEAST_SHARE and each["pixels"] >= LEAST_PIXELS
        visible = visible and center[2] >= NEAREST
        along = np.linalg.norm(line - line[0], axis=1)
        way = line[int(np.argmin(np.abs(along - REACH)))] - center
        role = "target" if each["kind"] == "ripe" else "pushable"
        item = SceneObject("fruit", role, Sphere(each["radius"]), center)
        wide = 2.0 * each["thick"] * (focal / center[2]) ** 2  # [pixel] of a metre of stem
        shows = each["stem_pixels"] >= max(LEAST_LENGTH * wide, 0.5 * LEAST_STEM)
        fruits.append(_fruit(Paired(item, center, match, each["share"], visible), way, shows))
    return SeenPicture(tuple(fruits), tuple(free), seconds)


def figures(pictures: Sequence[SeenPicture]) -> dict[str, float]:
    """Counts, rates and errors of pictures; nan where nothing tells one."""
    fruits = [fruit for picture in pictures for fruit in picture.fruits]
    visible = [fruit for fruit in fruits if fruit.visible]
    found = [fruit for fruit in fruits if fruit.found]
    false = sum(picture.false for picture in pictures)
    errors = np.array([fruit.error for fruit in found]) * 1e3
    stems = [f for f in found if f.stem_visible]
    seen = [f for f in stems if not math.isnan(f.angle)]
    angles = np.array([fruit.angle for fruit in seen])
    squares = np.array([fruit.normalised for fruit in found])
    return {
        "pictures": len(pictures),
        "visible": len(visible),
        "recall": _mean([fruit.found for fruit in visible]),
        "false": false,
        "false_share": false / max(false + len(found), 1),
        "kind_right": _mean([fruit.kind_right for fruit in found]),
        "ripe_right": _mean([f.kind_right for f in found if f.item.role == "target"]),
        "found": len(found),
        "center_median_mm": _quantile(errors, 0.5),
        "center_90_mm": _quantile(errors, 0.9),
        "normalised_mean": _mean(squares),
        "normalised_beyond_99": _mean(squares > SURE),
        "stems_visible": len(stems),
        "stems_found": len(seen),
        "angle_mean_deg": _mean(angles),
        "angle_90_deg": _quantile(angles, 0.9),
        "angle_over_deviation": math.sqrt(_mean([f.tilts**2 for f in seen])) if seen else math.nan,
        "ms": 1e3 * float(np.median([picture.seconds for picture in pictures] or [math.nan])),
    }


def _mean(values: Sequence[float] | Sequence[bool] | FloatArray | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _quantile(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan


def main() -> None:
    """Print the figures of each preset, mount and finder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", default="cluster,mixed,field,wild")
    parser.add_argument("--seeds", default="70000:70030", metavar="A:B")
    parser.add_argument("--mount", default="beside", help="one or more of beside,palm,hand")
    parser.add_argument("--looks", default="plain", help="one or more of plain,rich")
    parser.add_argument(
        "--finder", default="geometry", metavar="A,B",
        help="one or more of geometry, network, a network's FILE.onnx, MODULE:NAME",
    )  # fmt: skip
    given = parser.parse_args()
    first, end = map(int, given.seeds.split(":"))
    finders = {
        name: finder_named("network", Path(name)) if name.endswith(".onnx") else finder_named(name)
        for name in given.finder.split(",")
    }
    rows: list[dict[str, Any]] = []
    for preset, mount, looks in itertools.product(
        given.presets.split(","), given.mount.split(","), given.looks.split(",")
    ):
        seen = {name: [] for name in finders}
        for seed in range(first, end):
            if preset != "garden":
                shot = photograph(generate(preset, seed), mount, seed, looks=looks)
            for name, finder in finders.items():
                seen[name].append(
                    in_garden(seed, finder) if preset == "garden" else compared(shot, finder)
                )
        for name, pictures in seen.items():
            told = {key: round(value, 3) for key, value in figures(pictures).items()}
            row = {"preset": preset, "mount": mount, "looks": looks, "finder": name, **told}
            print(json.dumps(row), flush=True)
            rows.append(row)
    print(tabled(f"Pictures with {given.looks} looks", COLUMNS, map(cells, rows)))


COLUMNS = (
    "pictures", "finder", "n", "visible fruits", "recall % (95 %)", "false (share %)",
    "centre: median, 90 % [mm]", "normalised: mean (beyond %)", "ripe right %",
    "stems found of visible", "angle: mean, 90 % [°] (over deviation)", "ms",
)  # fmt: skip


def cells(f: Mapping[str, Any]) -> list[str]:
    """The figures of a preset, a mount and a finder as cells of the table."""
    looks = "" if f["looks"] == "plain" else f", {f['looks']}"
    told = [
        f"`{f['preset']}`, {f['mount']}{looks}", f["finder"], f"{f['pictures']}",
        f"{f['visible']}", share(round(f["recall"] * f["visible"]), f["visible"], 1),
        f"{f['false']} ({100 * f['false_share']:.1f})",
        f"{f['center_median_mm']:.1f}, {f['center_90_mm']:.1f}",
        f"{f['normalised_mean']:.1f} ({100 * f['normalised_beyond_99']:.1f})",
        f"{100 * f['ripe_right']:.0f}", f"{f['stems_found']} of {f['stems_visible']}",
        f"{f['angle_mean_deg']:.1f}, {f['angle_90_deg']:.1f} ({f['angle_over_deviation']:.1f})",
        f"{f['ms']:.0f}",
    ]  # fmt: skip
    return [cell.replace("nan", "–") for cell in told]  # nothing tells it


if __name__ == "__main__":
    main()
