r"""I-ProMP: the position that each neighbour is pushed to, by its stem (method §4, 3 and 4).

A fruit on a stem of length L, inclined by θ0 in the push plane, swings by
:math:`\Delta\theta=\arcsin(R_{gripper}/L)-\theta_0`, a chord of :math:`2L\sin(\Delta\theta/2)`,
until it clears the gripper.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.scene import Scene, SceneObject


@dataclass(frozen=True, eq=False)
class Push:
    """One push: the neighbour ``id`` goes from ``position`` to ``pushed`` (3,) [m].

    ``direction`` is the unit tangent, ``swing`` the angle Δθ [rad]; 0 for a fruit that hangs clear.
    """

    id: str
    position: FloatArray
    pushed: FloatArray
    direction: FloatArray
    swing: float


def pushes(
    scene: Scene,
    objects: Sequence[SceneObject],
    gripper_radius: float,
    rng: np.random.Generator | None = None,
    direction_deviation: float = 0.0,
) -> tuple[Push, ...]:
    """The pushes of the neighbours, first met first.

    Args:
        scene: with a target, unless ``objects`` is empty.
        objects: neighbours in the order the tool meets them.
        gripper_radius: R_gripper [m].
        rng: samples the push directions.
        direction_deviation: standard deviation of the push direction about the approach [rad].

    Returns:
        A push of each neighbour along a candidate tangent: towards the next neighbour, the last
        neighbour away from the target.

    Raises:
        InvalidRequestError: neighbours in a scene without a target.
    """
    if not objects:
        return ()
    if scene.target is None:
        raise InvalidRequestError("pushes need a scene with a target: the last goes away from it")
    z_g = scene.frame[2]
    out = []
    for i, obj in enumerate(objects):
        if i + 1 < len(objects):
            wish = objects[i + 1].position - obj.position
        else:
            wish = obj.position - scene.target.position
        direction = max(_tangents(scene, obj), key=lambda line: abs(float(line @ wish)))
        if direction @ wish < 0.0:
            direction = -direction
        if rng is not None and direction_deviation > 0.0:
            direction = rotation(z_g, rng.normal(0.0, direction_deviation)) @ direction
        out.append(_push(scene, obj, direction, gripper_radius))
    return tuple(out)


def _tangents(scene: Scene, obj: SceneObject) -> tuple[FloatArray, FloatArray]:
    """The candidate push lines S × z and S × (S × z); y_g and x_g without a stem or its lean."""
    x_g, y_g, z_g = scene.frame
    if obj.stem is None:
        return y_g, x_g
    stem = obj.stem.vector / math.hypot(*obj.stem.vector)
    across = np.cross(stem, z_g)
    length = math.hypot(*across)
    if length < 1e-6:
        return y_g, x_g
    across = across / length
    return across, np.cross(stem, across)


def _push(scene: Scene, obj: SceneObject, direction: FloatArray, gripper_radius: float) -> Push:
    if obj.stem is None:
        return Push(obj.id, obj.position, obj.position + gripper_radius * direction, direction, 0.0)
    root = obj.stem.root
    arm = obj.position - root
    length = math.hypot(*arm)
    along = arm / length
    # across the stem: the direction may have been turned, or the stem be bent
    tangent = direction - (direction @ along) * along
    tangent = tangent / math.hypot(*tangent)
    z_g = scene.frame[2]
    level = tangent - (tangent @ z_g) * z_g
    flat = math.hypot(*level)
    inclined = math.atan2(arm @ (level / flat if flat > 1e-9 else tangent), -(arm @ z_g))
    swing = max(0.0, math.asin(min(1.0, gripper_radius / length)) - inclined)
    pushed = root + length * (math.cos(swing) * along + math.sin(swing) * tangent)
    return Push(obj.id, obj.position, pushed, tangent, swing)
