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
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry import Sphere, distances
from optipromp.core.geometry.obstacles import pack
from optipromp.core.scenes.scene import Role, SceneObject
from optipromp_bench.experiments.eyes import LEAST_PIXELS, LEAST_SHARE, Paired, paired
from optipromp_bench.experiments.statistics import Table, share
from optipromp_eyes.detector import finder_named
from optipromp_eyes.eyes import Detection, Sighting, look_at
from optipromp_eyes.finder import Finder
from optipromp_eyes.pictures import CameraModel, DepthPicture
from optipromp_sim.generate import generate
from optipromp_sim.simulation.detector_parameters import EYES
from optipromp_sim.simulation.photograph import Photograph, photograph
from optipromp_sim.simulation.sight import standing_pose

NEAREST = 0.075  # [m] of a fruit that must be found: a depth camera measures nothing nearer
LEAST_LENGTH = 0.025  # [m] of a visible stem of the second renderer: a choice
LEAST_STEM = 60  # pixels of a visible stem: a choice
SURE = 11.34  # squared normalised error that 1 % of true Gaussian errors exceed (χ², 3 degrees)


NUMBERS = (
    "visible", "found", "error", "normalised", "right", "ripe", "stem", "angle", "tilts", "blocks",
)  # fmt: skip
"""Of a fruit: whether enough shows that it must be found, and whether it is; the error of its
centre [m], and its square over the covariance, 3 in the mean if that is true; whether ripe was
taken for ripe, and is; whether enough of its stem shows; the angle between the true stem and the
one found [deg], and that over the deviation of each tilt, √2 in the root mean square if that is
true; whether it is found, or something solid is where it is. nan: nothing tells it."""


@dataclass(frozen=True, eq=False)
class SeenPicture:
    """The fruits of one photograph and :data:`NUMBERS` of each, the detections that match none, the
    doubts, and the time of the process [s]."""

    fruits: tuple[Paired, ...]
    numbers: list[list[float]]
    wrong: tuple[Detection, ...]
    doubts: tuple[str, ...]
    seconds: float

    def plain(self) -> dict[str, Any]:
        """As :func:`figures` takes it."""
        out = {"fruits": self.numbers, "false": len(self.wrong), "doubts": self.doubts}
        return out | {"seconds": self.seconds}


def compared(shot: Photograph, finder: Finder | None = None) -> SeenPicture:
    """What is seen in a photograph against its truth; see :func:`paired`."""
    began = time.process_time()
    sight = look_at(shot.picture, up=shot.scene.up, finder=finder)
    seconds = time.process_time() - began
    fruits, wrong = paired(shot, sight)
    turn, rows = shot.picture.camera.pose.rotation.T, []
    for each in fruits:
        stem = each.item.stem
        shows = stem is not None and int(shot.mask(each.item.id, "stem").sum()) >= LEAST_STEM
        rows.append(_numbers(each, None if stem is None else turn @ stem.vector, shows, sight))
    return SeenPicture(tuple(fruits), rows, tuple(wrong), sight.doubts, seconds)


def _numbers(each: Paired, way: FloatArray | None, shows: bool, sight: Sighting) -> list[float]:
    """:data:`NUMBERS` of a fruit, whose stem leads ``way`` (3,) in the frame of the camera."""
    item, center, match, _, visible = each
    error = normalised = angle = tilts = math.nan
    right, solid = False, sight.look.solids
    blocks = match is not None
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
    elif solid:
        around = pack([(o.shape, o.position, o.rotation) for o in solid])
        blocks = bool(distances(around, center[None])[0].min() < item.radius)
    told = visible, match is not None, error, normalised, right, item.role == "target", shows
    return [float(number) for number in (*told, angle, tilts, blocks)]


REACH = 0.05  # [m] along a stem, to which its true direction is taken: a choice


def in_garden(seed: int, finder: Finder | None = None) -> SeenPicture:
    """What is seen in a picture of the second renderer against its truth; see garden.py."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    held = import_module("garden").drawn(seed, native=True)
    truth = json.loads(str(held["truth"]))
    height, width = held["depth"].shape
    focal = truth["focal"]
    camera = CameraModel(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
    picture = DepthPicture(held["rgb"], held["depth"].astype(np.float64), camera)
    began = time.process_time()
    sight = look_at(picture, up=np.array(truth["up"]), finder=finder)
    seconds = time.process_time() - began
    free, fruits, rows = list(sight.detections), [], []
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
        role: Role = "target" if each["kind"] == "ripe" else "pushable"
        item = SceneObject("fruit", role, Sphere(each["radius"]), center)
        wide = 2.0 * each["thick"] * (focal / center[2]) ** 2  # [pixel] of a metre of stem
        shows = each["stem_pixels"] >= max(LEAST_LENGTH * wide, 0.5 * LEAST_STEM)
        fruits.append(Paired(item, center, match, each["share"], visible))
        rows.append(_numbers(fruits[-1], way, shows, sight))
    return SeenPicture(tuple(fruits), rows, tuple(free), sight.doubts, seconds)


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
        "open": int((visible & (f["blocks"] == 0.0)).sum()),
        "doubted": sum(bool(picture["doubts"]) for picture in pictures),
        "ms": 1e3 * float(np.median([picture["seconds"] for picture in pictures] or [math.nan])),
    }


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _quantile(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan


def taken(preset: Any, mount: str, seed: int, looks: Any) -> Photograph:
    """A picture of a drawn scene; ``far``: from 0.8 m away."""
    scene = generate(preset, seed)
    if mount == "far" and scene.target is not None:
        pose, middle = standing_pose(scene, EYES["beside"]), scene.target.position
        away = pose.position - middle
        pose = replace(pose, position=middle + 0.8 / np.linalg.norm(away) * away)
        scene, mount = replace(scene, camera=pose), "beside"
    return photograph(scene, mount, seed, looks=looks)


@dataclass(frozen=True)
class Sees:
    """A study of finders in pictures."""

    presets: tuple[str, ...] = ("cluster", "mixed", "field", "wild")
    seeds: tuple[int, int] = (70_000, 70_030)
    mounts: tuple[str, ...] = ("beside",)  # of beside, far, palm, hand
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
            shot = taken(ask["preset"], ask["mount"], seed, ask["looks"])
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
            groups: dict[tuple[str, str, str, str], list[Mapping[str, Any]]] = {}
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
    "stems found of visible", "angle: mean, 90 % [°] (over deviation)",
    "visible, not found, nothing solid there", "doubted pictures", "ms",
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
        f"{f['open']}", f"{f['doubted']}", f"{f['ms']:.0f}",
    ]  # fmt: skip
    return [cell.replace("nan", "–") for cell in told]  # nothing tells it
