"""How well do the eyes see? Random scenes rendered, seen, and compared with the truth.

    optipromp bench study scripts/studies/eyes.toml --out eyes

The table has a line for each preset, mount, looks and finder. Every finder sees the same pictures.
A finder is geometry, network, a network's FILE.onnx, or MODULE:NAME. The preset ``garden`` is of
the second renderer (``scripts/garden.py``).
"""

import itertools
import json
import math
import sys
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
from optipromp_bench.experiments.statistics import Table, share
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

    def plain(self) -> dict[str, Any]:
        """As :func:`figures` takes it: of each fruit the numbers that NUMBERS names."""
        fruits = [
            (f.visible, f.found, f.error, f.normalised, f.kind_right, f.item.role == "target",
             f.stem_visible, f.angle, f.tilts)
            for f in self.fruits
        ]  # fmt: skip
        rows = [[float(number) for number in each] for each in fruits]
        return {"fruits": rows, "false": len(self.wrong), "seconds": self.seconds}


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
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from garden import drawn

    held = drawn(seed, native=True)
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


NUMBERS = (
    "visible", "found", "error", "normalised", "right", "ripe", "stem", "angle", "tilts",
)  # fmt: skip


def figures(seen: Sequence[SeenPicture | Mapping[str, Any]]) -> dict[str, float]:
    """Counts, rates and errors of pictures, plain or not; nan where nothing tells one."""
    pictures = [each.plain() if isinstance(each, SeenPicture) else each for each in seen]
    rows = [fruit for picture in pictures for fruit in picture["fruits"]]
    f = dict(zip(NUMBERS, np.array(rows).reshape(-1, len(NUMBERS)).T, strict=True))
    visible, found = f["visible"] > 0.0, f["found"] > 0.0
    stems, false = found & (f["stem"] > 0.0), sum(picture["false"] for picture in pictures)
    told, errors = stems & ~np.isnan(f["angle"]), 1e3 * f["error"][found]
    tilts = _mean(f["tilts"][told] ** 2)
    return {
        "pictures": len(pictures),
        "visible": int(visible.sum()),
        "recall": _mean(f["found"][visible]),
        "false": false,
        "false_share": false / max(false + int(found.sum()), 1),
        "kind_right": _mean(f["right"][found]),
        "ripe_right": _mean(f["right"][found & (f["ripe"] > 0.0)]),
        "found": int(found.sum()),
        "center_median_mm": _quantile(errors, 0.5),
        "center_90_mm": _quantile(errors, 0.9),
        "normalised_mean": _mean(f["normalised"][found]),
        "normalised_beyond_99": _mean(f["normalised"][found] > SURE),
        "stems_visible": int(stems.sum()),
        "stems_found": int(told.sum()),
        "angle_mean_deg": _mean(f["angle"][told]),
        "angle_90_deg": _quantile(f["angle"][told], 0.9),
        "angle_over_deviation": math.sqrt(tilts) if tilts == tilts else math.nan,
        "ms": 1e3 * float(np.median([picture["seconds"] for picture in pictures] or [math.nan])),
    }


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _quantile(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan


@dataclass(frozen=True)
class Sees:
    """A study of finders in pictures."""

    presets: tuple[str, ...] = ("cluster", "mixed", "field", "wild")
    seeds: tuple[int, int] = (70_000, 70_030)
    mounts: tuple[str, ...] = ("beside",)  # of beside, palm, hand
    looks: tuple[str, ...] = ("plain",)  # of plain, rich
    finders: tuple[str, ...] = ("geometry",)

    def asks(self) -> list[dict[str, Any]]:
        """See :class:`optipromp_bench.experiments.kinds.Kind`."""
        names = "preset", "mount", "looks", "seed"
        all_ = itertools.product(self.presets, self.mounts, self.looks, range(*self.seeds))
        own = {"finders": list(self.finders)}
        return [dict(zip(names, each, strict=True)) | own for each in all_]

    def trial(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """What each finder sees in a picture."""
        seed, out, shot = ask["seed"], {}, None
        if ask["preset"] != "garden":
            scene = generate(ask["preset"], seed)
            shot = photograph(scene, ask["mount"], seed, looks=ask["looks"])
        for name in ask["finders"]:
            known = name.endswith(".onnx")
            finder = finder_named("network", Path(name)) if known else finder_named(name)
            seen = in_garden(seed, finder) if shot is None else compared(shot, finder)
            out[name] = seen.plain()
        return {"seen": out}

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
        """A table for each study, a line for each kind of picture and finder."""
        out = []
        for rows in parts.values():
            groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
            for row in rows:
                for finder, seen in row["seen"].items():
                    key = row["preset"], row["mount"], row["looks"], finder
                    groups.setdefault(key, []).append(seen)
            looks = ",".join(dict.fromkeys(row["looks"] for row in rows))
            lines = [cells(*key, figures(seen)) for key, seen in groups.items()]
            out.append(Table(f"Pictures with {looks} looks", COLUMNS, lines))
        return out


COLUMNS = (
    "pictures", "finder", "n", "visible fruits", "recall % (95 %)", "false (share %)",
    "centre: median, 90 % [mm]", "normalised: mean (beyond %)", "ripe right %",
    "stems found of visible", "angle: mean, 90 % [°] (over deviation)", "ms",
)  # fmt: skip


def cells(
    preset: str, mount: str, looks: str, finder: str, f: Mapping[str, float]
) -> list[str]:  # fmt: skip
    """The figures of a preset, a mount and a finder as cells of the table."""
    drawn = "" if looks == "plain" else f", {looks}"
    told = [
        f"`{preset}`, {mount}{drawn}", finder, f"{f['pictures']}",
        f"{f['visible']}", share(round(f["recall"] * f["visible"]), int(f["visible"]), 1),
        f"{f['false']} ({100 * f['false_share']:.1f})",
        f"{f['center_median_mm']:.1f}, {f['center_90_mm']:.1f}",
        f"{f['normalised_mean']:.1f} ({100 * f['normalised_beyond_99']:.1f})",
        f"{100 * f['ripe_right']:.0f}", f"{f['stems_found']} of {f['stems_visible']}",
        f"{f['angle_mean_deg']:.1f}, {f['angle_90_deg']:.1f} ({f['angle_over_deviation']:.1f})",
        f"{f['ms']:.0f}",
    ]  # fmt: skip
    return [cell.replace("nan", "–") for cell in told]  # nothing tells it
