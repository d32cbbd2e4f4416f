"""Fruits that overlap in a scene are moved apart before it is built."""

from dataclasses import replace

import numpy as np

from optipromp.core.pushing.stems.parting import shifts
from optipromp.core.scenes.scene import Scene
from optipromp.core.scenes.trusses import rooted


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
            points = np.array(item.stem.points)
            points[0] += by[item.id]
            stem = replace(item.stem, points=points)
            motion = item.motion and item.motion.shifted(by[item.id])
            position = item.position + by[item.id]
            item = replace(item, position=position, stem=stem, motion=motion)
        objects.append(item)
    return replace(scene, objects=rooted(objects)), far
