"""A scene as detected: positions and stem directions with Gaussian errors."""

import math
from dataclasses import replace

import numpy as np

from optipromp.arrays import FloatArray, rotation
from optipromp.errors import InvalidRequestError
from optipromp.geometry.shapes import Sphere
from optipromp.scenes.scene import Scene, SceneObject
from optipromp.scenes.trusses import rooted


def perceived(scene: Scene, rng: np.random.Generator, position_sd: float, angle_sd: float) -> Scene:
    """The scene as detected: target, pushables and neighbours where they seem to be.

    Static objects (a gutter, a shelf) are known exactly. An object that has no stem and is no ball
    stands upright on a known board: its error is horizontal. Each detected
    object carries the covariance of its position.

    Args:
        scene: the truth.
        rng: the same state gives the same errors.
        position_sd: standard deviation of each coordinate of a position [m].
        angle_sd: standard deviation of a stem's tilt about each of two axes across it [rad].

    Raises:
        InvalidRequestError: a standard deviation that is negative or not finite.
    """
    for name, value in (("position_sd", position_sd), ("angle_sd", angle_sd)):
        if not (math.isfinite(value) and value >= 0.0):
            raise InvalidRequestError(f"{name} is {value}; it must be finite and not negative")
    if position_sd == 0.0 and angle_sd == 0.0:
        return scene
    return replace(
        scene,
        objects=rooted(_seen(item, rng, position_sd, angle_sd, scene.up) for item in scene.objects),
    )


def _seen(
    item: SceneObject, rng: np.random.Generator, position_sd: float, angle_sd: float, up: FloatArray
) -> SceneObject:
    # every object takes as many numbers, so that its errors do not depend on the roles of others
    error, turn = position_sd * rng.standard_normal(3), angle_sd * rng.standard_normal(2)
    if item.role == "static":
        return item
    spread = position_sd**2 * np.eye(3)
    if item.stem is None and not isinstance(item.shape, Sphere):  # it stands
        error -= (error @ up) * up
        spread -= position_sd**2 * np.outer(up, up)
    stem = None
    if item.stem is not None:
        away = item.stem.points - item.stem.points[0]
        begin = item.stem.points[0] + error
        stem = replace(item.stem, points=begin + away @ _turn(away[1], turn).T)
    return replace(item, position=item.position + error, stem=stem, covariance=spread)


def _turn(vector: FloatArray, angles: FloatArray) -> FloatArray:
    """Rotation (3, 3) that tilts ``vector`` by two angles [rad] about two axes across it."""
    along = vector / np.linalg.norm(vector)
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first /= np.linalg.norm(first)
    axis = angles[0] * first + angles[1] * np.cross(along, first)
    angle = float(np.linalg.norm(axis))
    return np.eye(3) if angle == 0.0 else rotation(axis / angle, angle)
