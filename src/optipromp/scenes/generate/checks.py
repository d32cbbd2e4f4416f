"""Whether a sampled scene is physically possible: no two objects overlap at rest."""

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry import distances, pack
from optipromp.geometry.shapes import Sphere
from optipromp.scenes.scene import Scene, SceneObject

SAMPLE = 0.004  # [m] between checks along a stem


class OverlapError(Exception):
    """A sample that failed because objects overlap; the message names them."""


def interpenetration(scene: Scene) -> str | None:
    """What kinds of objects interpenetrate; None where the scene is possible.

    The check covers fruits (spheres) against one another and against neighbours and static objects,
    stems against all of these but their own fruits, and neighbours against static objects.
    """
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    hanging = [item for item in fruits if isinstance(item.shape, Sphere)]
    for i, one in enumerate(hanging):
        for other in hanging[i + 1 :]:
            if _apart(one, other) < 0.0:
                return "fruit in fruit"
    if not hanging:
        return None  # a shelf: its sampler has kept the footprints apart
    positions = np.array([item.position for item in hanging])
    radii = np.array([item.radius for item in hanging])
    for objects, word in ((scene.static, "static"), (scene.avoid, "neighbour")):
        if not objects:
            continue
        surface = pack([(item.shape, item.position, item.rotation) for item in objects])
        away, _ = distances(surface, positions)
        if float((away - radii[:, None]).min()) < 0.0:
            return f"fruit in {word}"
        for item in hanging:
            if item.stem is None:
                continue
            along, _ = distances(surface, _samples(item.stem.points))
            if float(along.min()) < item.stem.radius:
                return f"stem in {word}"
        if word == "static":
            for cluster in scene.avoid:
                away, _ = distances(surface, cluster.position[None])
                if float(away.min()) < cluster.radius:
                    return "neighbour in static"
    for i, one in enumerate(hanging):
        if one.stem is None:
            continue
        for j, other in enumerate(hanging):
            if i == j:
                continue
            gap = to_segment(other.position, one.stem.points[0], one.stem.points[1])
            if gap < other.radius + one.stem.radius:
                return "stem in fruit"
            if j > i and other.stem is not None:
                between = segments(one.stem.points, other.stem.points)
                if between < one.stem.radius + other.stem.radius:
                    return "stem in stem"
    for i, one in enumerate(scene.avoid):
        for other in scene.avoid[i + 1 :]:
            if _apart(one, other) < 0.0:
                return "neighbour in neighbour"
    return None


def _apart(one: SceneObject, other: SceneObject) -> float:
    return float(np.linalg.norm(one.position - other.position)) - one.radius - other.radius


def _samples(points: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(points[1] - points[0]))
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / SAMPLE)) + 1))
    return np.asarray(points[0] + share[:, None] * (points[1] - points[0]))


def to_segment(point: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Distance from a point (3,) to the segment from ``a`` to ``b`` [m]."""
    line = b - a
    share = float(np.clip((point - a) @ line / (line @ line), 0.0, 1.0))
    return float(np.linalg.norm(point - a - share * line))


def segments(one: FloatArray, other: FloatArray) -> float:
    """Distance between two segments (2, 3) [m] (Ericson, Real-Time Collision Detection, 5.1.9)."""
    d1, d2, r = one[1] - one[0], other[1] - other[0], one[0] - other[0]
    a, e, f = float(d1 @ d1), float(d2 @ d2), float(d2 @ r)
    b, c = float(d1 @ d2), float(d1 @ r)
    denominator = a * e - b * b
    s = min(1.0, max(0.0, (b * f - c * e) / denominator)) if denominator > 1e-15 else 0.0
    t = (b * s + f) / e
    if t < 0.0:
        t, s = 0.0, min(1.0, max(0.0, -c / a))
    elif t > 1.0:
        t, s = 1.0, min(1.0, max(0.0, (b - c) / a))
    return float(np.linalg.norm(r + s * d1 - t * d2))
