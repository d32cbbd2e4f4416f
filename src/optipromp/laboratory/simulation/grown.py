"""Stems that nobody saw, drawn: what hangs in the simulation is one of those that may be."""

import math
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import frame_along
from optipromp.core.scenes.objects import UNSEEN_SPREAD
from optipromp.core.scenes.scene import Scene, Stem


def grown(scene: Scene, seed: int) -> Scene:
    """The scene with a stem drawn by the ``seed`` for each that nobody saw."""
    rng, objects = np.random.default_rng([seed, 40]), []
    for item in scene.objects:
        stem = item.stem
        if stem is not None and stem.unseen:
            across = np.tan(math.radians(stem.tilt or 0.0) * rng.standard_normal(2))
            axes = frame_along(stem.vector / np.linalg.norm(stem.vector))
            way = axes[:, 2] + axes[:, :2] @ across
            length = stem.length * math.exp(UNSEEN_SPREAD * rng.standard_normal())
            item = replace(item, stem=Stem.along(stem.points[0], way, length, stem.radius))
        objects.append(item)
    return replace(scene, objects=tuple(objects)) if scene.assumed else scene
