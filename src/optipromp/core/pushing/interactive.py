r"""I-ProMP: where each neighbour is pushed, by the geometry of its stem (method §4, 3 and 4).

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

    ``direction`` is the unit tangent and ``swing`` the angle Δθ [rad] (0 for a fruit that already
    hangs clear).
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
        scene: with a target, where there is something to push.
        objects: neighbours in the order the tool meets them.
        gripper_radius: R_gripper [m].
        rng: for uncertain stems; needed where ``direction_deviation`` is above 0.
        direction_deviation: standard deviation of the push direction [rad], about the approach.

    Returns:
        One push per neighbour. Its direction is along a candidate tangent: towards the next
        neighbour, and for the last neighbour away from the target.

    Raises:
        InvalidRequestError: neighbours to push in a scene without a target.
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
    """The candidate push lines: S × z and S × (S × z); y_g and x_g for a vertical or no stem."""
    x_g, y_g, z_g = scene.frame
    if obj.stem is None:
        return y_g, x_g
    stem = obj.stem.vector / math.hypot(*obj.stem.vector)
    across = _cross(stem, z_g)
    length = math.hypot(*across)
    if length < 1e-6:
        return y_g, x_g
    across = across / length
    return across, _cross(stem, across)


def _push(scene: Scene, obj: SceneObject, direction: FloatArray, gripper_radius: float) -> Push:
    if obj.stem is None:
        return Push(obj.id, obj.position, obj.position + gripper_radius * direction, direction, 0.0)
    root = obj.stem.root
    arm = obj.position - root
    length = math.hypot(*arm)
    along = arm / length
    # keep the tangent perpendicular to the stem (it may have been turned, or the stem be bent)
    tangent = direction - (direction @ along) * along
    tangent = tangent / math.hypot(*tangent)
    z_g = scene.frame[2]
    inclined = math.atan2(arm @ _level(tangent, z_g), -(arm @ z_g))
    swing = max(0.0, math.asin(min(1.0, gripper_radius / length)) - inclined)
    pushed = root + length * (math.cos(swing) * along + math.sin(swing) * tangent)
    return Push(obj.id, obj.position, pushed, tangent, swing)


def _level(tangent: FloatArray, up: FloatArray) -> FloatArray:
    """The level part of a tangent as a unit vector; the tangent itself where it is upright."""
    level = tangent - (tangent @ up) * up
    length = math.hypot(*level)
    return level / length if length > 1e-9 else tangent


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """a × b of two vectors (3,), ten times as fast as NumPy's product for stacks of vectors."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
