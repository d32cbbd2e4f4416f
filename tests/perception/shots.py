"""The photograph of a cluster, taken once, and flowers drawn on it."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from optipromp.core.arrays import frame_along
from optipromp_eyes import DepthPicture
from optipromp_eyes.pictures import picture_files
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, photograph

SEED = 60011


@cache
def shot_of(seed: int = SEED, looks: str = "plain") -> Photograph:
    return photograph(generate("cluster", seed), seed=seed, looks=looks)


def written(folder: Path, **pictures: DepthPicture) -> Path:
    """The folder, with pictures by name as ``render`` leaves them."""
    for name, picture in pictures.items():
        for file, content in picture_files(name, picture).items():
            (folder / file).write_bytes(content)
    return folder


Dye = tuple[int, int, int]


def with_flower(
    picture: DepthPicture, at: tuple[int, int], far: float, size: float, petals: Dye, middle: Dye
) -> DepthPicture:
    """A flower of five petals [m] at a column and row, some metres before the camera."""
    lens, rng = picture.camera, np.random.default_rng(at)
    center, axes = lens.through(np.array(at)) * far, frame_along(np.array([0.3, 0.2, -0.933])).T
    rgb, depth = picture.rgb.astype(float), picture.depth.copy()
    turns = 2.0 * np.pi * np.arange(5) / 5
    flat = np.stack([np.cos(turns), np.sin(turns), np.zeros(5)], axis=1)
    parts = [(size * way, (0.75 * size, 0.75 * size, 0.0008), petals) for way in flat]
    parts.append((np.array([0.0, 0.0, 0.0015]), (0.55 * size, 0.55 * size, 0.0025), middle))
    for off, half, dye in parts:
        rays, place = lens.rays @ axes.T / half, (axes @ center + off) / half
        a, b = (rays**2).sum(axis=2), rays @ place
        inside = b**2 - a * (place @ place - 1.0)
        front = (b - np.sqrt(np.maximum(inside, 0.0))) / a
        shown = (inside > 0.0) & ((front < depth) | (depth == 0.0))
        noise = rng.standard_normal((4, int(shown.sum())))
        depth[shown] = front[shown] * (1.0 + 0.0035 * front[shown] * noise[3])
        rgb[shown] = np.array(dye) + 3.0 * noise[:3].T
    return replace(picture, rgb=np.clip(np.rint(rgb), 0, 255).astype(np.uint8), depth=depth)
