"""Overlapping fruits are moved apart: two fruits are never in one place."""

import math
from collections.abc import Sequence

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import kernel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.bending import balls_of
from optipromp.core.scenes.scene import SceneObject

SWEEPS, GAP = PUSH.beam.parting_sweeps, PUSH.beam.parting_gap


@kernel
def part(
    fruit: FloatArray, root: FloatArray, radius: FloatArray, above: FloatArray, apart: FloatArray
) -> None:
    """Move each fruit of an overlapping pair by half of the overlap, in place.

    ``fruit``: (M, N, 3) centres of the lower balls of N fruits in M states, in and out [m].
    ``root``: (M, N, 3) roots of the stems [m]. ``radius``: (N,) see
    :class:`optipromp.core.pushing.stems.bending.Balls`, as for the others.
    """
    count, up, way = len(radius), np.zeros(3), np.zeros(3)
    off = np.zeros((count, 3))  # from the lower to the upper ball
    for m in range(len(fruit)):
        for i in range(count):
            far = 0.0
            for k in range(3):
                up[k] = root[m, i, k] - fruit[m, i, k]
                far += up[k] * up[k]
            for k in range(3):
                off[i, k] = apart[i] * up[k] / math.sqrt(far)
        for _ in range(SWEEPS):
            moved = False
            for i in range(count):
                for o in range(i):
                    deep = 0.0
                    for a in range(2 if apart[i] > 0.0 else 1):
                        for b in range(2 if apart[o] > 0.0 else 1):
                            far = 0.0
                            for k in range(3):
                                d = fruit[m, i, k] + a * off[i, k] - fruit[m, o, k] - b * off[o, k]
                                up[k] = d
                                far += d * d
                            far = math.sqrt(far)
                            own = above[i] if a else radius[i]
                            other = above[o] if b else radius[o]
                            over = own + other - far
                            if over > deep and far > 1e-9:
                                deep = over
                                for k in range(3):
                                    way[k] = up[k] / far
                    if deep > 0.0:
                        moved = True
                        for k in range(3):
                            fruit[m, i, k] += 0.5 * (deep + GAP) * way[k]
                            fruit[m, o, k] -= 0.5 * (deep + GAP) * way[k]
            if not moved:
                break


def shifts(objects: Sequence[SceneObject]) -> FloatArray:
    """Motions (N, 3) of N hanging fruits after which no two of them overlap [m]."""
    balls = [balls_of(item) for item in objects]
    seen = np.array([own.center for own in balls]).reshape(-1, 3)
    root = np.array([t.stem.points[-1] for t in objects if t.stem is not None]).reshape(-1, 3)
    fruit = seen[None].copy()
    part(
        fruit,
        root[None],
        np.array([own.radius for own in balls]),
        np.array([own.above for own in balls]),
        np.array([own.apart for own in balls]),
    )
    return np.asarray(fruit[0] - seen)
