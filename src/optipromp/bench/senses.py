"""What a policy sees as arrays of fixed size, in the frame of the approach."""

from collections.abc import Sequence

import numpy as np

from optipromp.bench.episode import Observation
from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import Scene, SceneObject

MOST = 24  # objects that are told; the nearest to the target first: a choice
KINDS = "target", "pushable", "avoid", "static"
WIDTH = 16
"""Numbers of an object: place (3), axis (3), half extents (3), stem's direction (3), stem's
length, and one of target, pushable or else."""


def told(item: SceneObject, scene: Scene, origin: FloatArray) -> FloatArray:
    """An object as numbers (WIDTH,), in the frame of the scene's approach about ``origin`` (3,)."""
    turn = scene.frame
    surface = item.shape.surface().reshape(-1, 3)
    half = 0.5 * np.ptp(surface @ (turn @ item.rotation).T, axis=0)
    stem, long = np.zeros(3), 0.0
    if item.stem is not None:
        long = item.stem.length
        stem = turn @ (item.stem.points[-1] - item.stem.points[0]) / max(long, 1e-9)
    kind = [float(item.role == name) for name in KINDS[:2]]
    rest = [*kind, float(not any(kind))]
    place = turn @ (item.position - origin)
    return np.concatenate([place, turn @ item.rotation[:, 2], half, stem, [long], rest])


def objects_of(items: Sequence[SceneObject], scene: Scene, origin: FloatArray) -> FloatArray:
    """Objects as rows (MOST, WIDTH), the nearest to ``origin`` first; rows of zeros are none."""
    out = np.zeros((MOST, WIDTH))
    near = sorted(items, key=lambda item: float(np.linalg.norm(item.position - origin)))
    for row, item in enumerate(near[:MOST]):
        out[row] = told(item, scene, origin)
    return out


def objects_in(scene: Scene) -> FloatArray:
    """The objects of a scene about its target, as a network sees them."""
    return objects_of(
        scene.objects, scene, np.zeros(3) if scene.target is None else scene.target.position
    )


def state_of(seen: Observation, scene: Scene) -> dict[str, FloatArray]:
    """An observation as arrays: ``arm`` (2n + 11,) and ``objects`` (MOST, WIDTH).

    ``arm`` is joints, velocities, tool point and axis in the frame of the approach about the
    target as last seen, force on the tool, age of the look, and time. A target that is not seen is
    taken where the scene has it.
    """
    target = next((item for item in seen.fruits if item.role == "target"), scene.target)
    origin = seen.tool_point if target is None else target.position
    arm = np.concatenate(
        [
            seen.q, seen.velocity, scene.frame @ (seen.tool_point - origin),
            scene.frame @ seen.tool_axis, scene.frame @ seen.force, [seen.age, seen.time],
        ]
    )  # fmt: skip
    return {"arm": arm, "objects": objects_of((*seen.fruits, *scene.static), scene, origin)}
