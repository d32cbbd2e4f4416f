"""One look of several at plants that stand still."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optipromp.control.look import Look
from optipromp.core.scenes.objects import SceneObject

NEAR = 0.6  # distance over the sum of radii up to which two detections are one: as tracks'


def fused(looks: Sequence[Look]) -> Look:
    """All that was seen from several places, in the frame of the first camera.

    A detection is of the nearest fruit that was seen before, if their centres are nearer than 0.6
    of the sum of their radii; each fruit takes one of a look. Positions are weighted by their
    covariances. Shape, role and id are those of the smaller covariance, and of two stems the one
    with the smaller tilt deviation is kept. What one camera alone has seen stays, so what it took
    wrongly for a fruit stays, too.

    Args:
        looks: one at least; ids need not agree.
    """
    first = looks[0]
    out = list(first.in_base())
    for look in looks[1:]:
        free = set(range(len(out)))
        for item in look.in_base():
            away = {k: float(np.linalg.norm(out[k].position - item.position)) for k in free}
            near = min(away, key=away.__getitem__, default=None)
            if near is not None and away[near] < NEAR * (out[near].radius + item.radius):
                out[near] = _both(out[near], item)
                free.discard(near)
            else:
                out.append(item)
    named = _named(out)
    back = first.camera.inverse()
    return replace(first, detections=tuple(item.transformed(back) for item in named))


def _both(one: SceneObject, other: SceneObject) -> SceneObject:
    """Two detections of a fruit as one."""
    assert one.covariance is not None
    assert other.covariance is not None
    weights = np.linalg.inv(one.covariance), np.linalg.inv(other.covariance)
    spread = np.linalg.inv(weights[0] + weights[1])
    place = spread @ (weights[0] @ one.position + weights[1] @ other.position)
    sure = one if np.trace(one.covariance) <= np.trace(other.covariance) else other
    stems = [(item.stem, item.position) for item in (one, other) if item.stem is not None]
    stem, at = min(stems, key=lambda s: s[0].tilt or 0.0, default=(None, place))
    if stem is not None:
        stem = replace(stem, points=stem.points + (place - at))
    return replace(sure, position=place, covariance=0.5 * (spread + spread.T), stem=stem)


def _named(items: Sequence[SceneObject]) -> list[SceneObject]:
    """The objects, each with an id of its own."""
    counts: dict[str, int] = {}
    out = []
    for item in items:
        kind = "ripe" if item.role == "target" else "unripe"
        counts[kind] = counts.get(kind, 0) + 1
        out.append(replace(item, id=f"{kind}{counts[kind]}"))
    return out
