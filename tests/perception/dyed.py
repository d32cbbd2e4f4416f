"""Photographs of other crops: ours in other colours, with their truth, and marks upon them."""

import colorsys
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from optipromp.core.scenes.crops import Crop, load_crop
from optipromp_bench.experiments.eyes import paired
from optipromp_eyes import ByGeometry, EyeParameters, look_at
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, PhotoParameters, photograph

Dye = Mapping[str, tuple[float, float, float]]  # hue [deg], saturation, brightness by kind


def crop_of(name: str, width: float, elongation: float, stem: float) -> Crop:
    """A crop of some size [m]."""
    rows = {"width": (width, "m"), "elongation": (elongation, "1"), "stem_length": (stem, "m")}
    told = {k: {"value": v, "unit": u, "spread": 0.06 * v, "source": "drawn"}
            for k, (v, u) in rows.items()}  # fmt: skip
    return load_crop({"name": name, "like": "strawberry", **told})


def dyed(shot: Photograph, dye: Dye, seed: int) -> Photograph:
    """A photograph whose fruits and stems have other colours, each its own: hue by 3 degrees,
    saturation and brightness by 5 %; shading and grain stay."""
    rng, rgb = np.random.default_rng(seed), shot.picture.rgb.astype(float) / 255.0
    usual = {
        kind: np.median(rgb[np.isin(shot.masks, [k + 1 for k, m in enumerate(shot.marked)
                                                 if m.kind == kind])].max(axis=-1))
        for kind in {mark.kind for mark in shot.marked} & dye.keys()
    }  # fmt: skip
    for row, mark in enumerate(shot.marked, start=1):
        if mark.kind in dye and (pixels := shot.masks == row).any():
            hue, share, bright = dye[mark.kind]
            pure = np.array(
                colorsys.hsv_to_rgb(
                    (hue + 3.0 * rng.standard_normal()) / 360.0 % 1.0,
                    np.clip(share * (1.0 + 0.05 * rng.standard_normal()), 0.0, 1.0),
                    1.0,
                )
            )
            light = bright * rgb[pixels].max(axis=-1) / usual[mark.kind]
            light = light * (1.0 + 0.05 * rng.standard_normal())
            rgb[pixels] = np.minimum(light, 1.0)[:, None] * pure
    rgb += 2.5 / 255.0 * rng.standard_normal(rgb.shape)
    picture = replace(shot.picture, rgb=np.clip(np.rint(255.0 * rgb), 0, 255).astype(np.uint8))
    return replace(shot, picture=picture)


def shots_of(crop: Crop, dye: Dye, seeds: range, focal: float) -> dict[str, Photograph]:
    lens = PhotoParameters(focal=focal)
    scenes = {seed: generate("cluster", seed, crop=crop) for seed in seeds}
    return {
        f"{crop.name}{seed}": dyed(photograph(scene, "beside", seed, lens), dye, seed)
        for seed, scene in scenes.items()
    }


def marks_on(shots: Mapping[str, Photograph], most: Mapping[str, int], click: bool = False) -> Any:
    """Boxes (or clicks) of fruits that show whole, and of stems, at most so many of each kind."""
    left, out = dict(most), []
    for name, shot in shots.items():
        for row, mark in enumerate(shot.marked, start=1):
            rows, columns = np.nonzero(shot.masks == row)
            whole = mark.share > 0.7 if mark.kind != "stem" else len(rows) > 100
            if left.get(mark.kind, 0) and whole:
                left[mark.kind] -= 1
                k = len(rows) // 2
                at = int(columns[k]), int(rows[k])
                box = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
                place = {"at": at} if click else {"box": [int(each) for each in box]}
                out.append({"picture": name, "kind": mark.kind, **place})
    return out


def recall(shots: Mapping[str, Photograph], p: EyeParameters) -> tuple[int, int, int, int, int]:
    """Of the visible fruits, by geometry: how many, found, found of the right kind; false ones,
    stems found."""
    fruits, wrong, stems = [], 0, 0
    for shot in shots.values():
        sight = look_at(shot.picture, up=shot.scene.up, finder=ByGeometry(p), parameters=p)
        pairs, others = paired(shot, sight)
        fruits += [pair for pair in pairs if pair.visible]
        wrong += len(others)
    seen = [pair for pair in fruits if pair.detection is not None]
    right = sum((p.item.role == "target") == (p.detection.region.kind == "ripe") for p in seen)
    stems = sum(pair.detection.stem is not None for pair in seen)
    return len(fruits), len(seen), right, wrong, stems
