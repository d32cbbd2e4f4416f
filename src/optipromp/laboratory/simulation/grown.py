"""What hangs in the simulation: stems that nobody saw are drawn, overlapping fruits moved apart."""

import math
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import frame_along
from optipromp.core.pushing.stems.parting import shifts
from optipromp.core.scenes.objects import UNSEEN_SPREAD
from optipromp.core.scenes.scene import Scene, Stem
from optipromp.core.scenes.trusses import rooted


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


def apart(scene: Scene) -> tuple[Scene, dict[str, float]]:
    """The scene with overlapping fruits moved apart, and the distance of each move, by id [m].

    Only hanging fruits are moved; the roots of their stems stay.
    """
    hanging = [
        item
        for item in scene.objects
        if item.stem is not None and item.role in ("target", "pushable")
    ]
    by = {item.id: shift for item, shift in zip(hanging, shifts(hanging), strict=True)}
    far = {name: float(np.linalg.norm(shift)) for name, shift in by.items()}
    far = {name: size for name, size in far.items() if size > 0.0}
    if not far:
        return scene, {}
    objects = []
    for item in scene.objects:
        if item.id in far and item.stem is not None:
            points, shift = np.array(item.stem.points), by[item.id]
            points[0] += shift
            stem, motion = replace(item.stem, points=points), item.motion
            motion = motion and motion.shifted(shift)
            item = replace(item, position=item.position + shift, stem=stem, motion=motion)
        objects.append(item)
    return replace(scene, objects=rooted(objects)), far
