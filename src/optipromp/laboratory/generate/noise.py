"""A scene as detected: positions and stem directions have errors, some fruits are not seen."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.scene import JointGoal, PoseGoal, Scene, SceneObject
from optipromp.core.scenes.trusses import rooted
from optipromp.laboratory.generate.plants import untold

LOOK = 0.30  # [m] of the eye before the target where a scene has no camera: a choice
RAYS, STEPS = 48, 60  # rays from the eye to a fruit, points on each ray: choices


@dataclass(frozen=True)
class Noise:
    """The errors of a detector.

    ``position``: standard deviation of each coordinate of a position [m]. ``angle``: standard
    deviation of a stem's tilt about each of two axes across it [degrees]. ``lower``: error of the
    height at which hanging objects are seen [m]; positive: below the truth. The covariance of a
    detected object does not include it. ``missed``: probability that a pushable in full view is not
    seen. ``hidden``: probability that a pushable that others wholly hide is not seen. For a partly
    hidden one the probability is interpolated by the hidden share.
    """

    position: float = 0.0
    angle: float = 0.0
    lower: float = 0.0
    missed: float = 0.0
    hidden: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value, least = getattr(self, item.name), -math.inf if item.name == "lower" else 0.0
            most = 1.0 if item.name in ("missed", "hidden") else math.inf
            if not (math.isfinite(value) and least <= value <= most):
                raise InvalidRequestError(
                    f"noise_{item.name} is {value}; must be finite, and from {least:g} to {most:g}"
                )


NOISES: dict[str, Noise] = {
    "zero-mean": Noise(0.005, 5.0),
    "low": Noise(0.005, 5.0, lower=0.010),
    "high": Noise(0.005, 5.0, lower=-0.010),
    "missed": Noise(0.005, 5.0, missed=0.05, hidden=0.5),
    "detector": Noise(0.005, 5.0, lower=0.010, missed=0.05, hidden=0.5),
}
"""Noise by name. Centres of strawberries from what one RGB-D view shows of them are 8.9 mm off,
with the shape completed 5.7 mm (Ge, Xiong, From 2020, doi 10.1016/j.biosystemseng.2020.07.003):
hence 10 mm, and 5 mm a coordinate. Recall is 95.4 % of strawberries (Yu et al. 2019, Mask R-CNN)
and 90.5 % of greenhouse tomatoes (Gao et al. 2022, doi 10.18280/ts.390130): hence 5 %. The half of
those that are wholly hidden is a guess."""


def perceived(scene: Scene, rng: np.random.Generator, noise: Noise) -> Scene:
    """The scene as detected: target, pushables and neighbours at their measured positions.

    Static objects (a gutter, a shelf) are known exactly. An object that has no stem and is no ball
    stands upright on a known board: its error is horizontal. Each detected object has the
    covariance of its position. A pushable that is not seen is not in the scene; the target always
    is seen.

    Args:
        scene: the truth.
        rng: the same state gives the same errors.
        noise: of the detector.
    """
    if noise == Noise():
        return scene
    seen = [_seen(item, rng, noise, scene.up) for item in scene.objects]
    if noise.missed or noise.hidden:
        eye, chances = _eye(scene), rng.random(len(seen))
        seen = [
            new
            for old, new, chance in zip(scene.objects, seen, chances, strict=True)
            if old.role != "pushable" or chance >= _blind(scene, old, eye, noise)
        ]
    return replace(scene, objects=rooted(seen))


def noisy(scene: Scene, seed: int, noise: Noise) -> Scene:
    """The scene as a study and ``optipromp generate --noise`` perceive it for a seed.

    The physical parameters of fruits are left out: no detector measures them.
    """
    return perceived(untold(scene), np.random.default_rng([seed, 1]), noise)


def _blind(scene: Scene, item: SceneObject, eye: FloatArray, noise: Noise) -> float:
    """The probability that a pushable is not seen."""
    return noise.missed + (noise.hidden - noise.missed) * hidden_share(scene, item, eye)


def _eye(scene: Scene) -> FloatArray:
    """The position of the eye (3,) [m]: the camera, or on the approach before the target."""
    if scene.camera is not None:
        return scene.camera.position
    if scene.target is not None:
        return np.asarray(scene.target.position - LOOK * scene.frame[2])
    of_tool = [goal for goal in scene.goals if not isinstance(goal, JointGoal)]
    assert of_tool
    goal = of_tool[0]
    axis = goal.axis if isinstance(goal, PoseGoal) else goal.direction
    return np.asarray(goal.position - LOOK * (scene.frame[2] if axis is None else axis))


def hidden_share(scene: Scene, item: SceneObject, eye: FloatArray) -> float:
    """The share of an object's disc, as seen from ``eye`` (3,), that other objects hide."""
    others = [(o.shape, o.position, o.rotation) for o in scene.objects if o.id != item.id]
    if not others:
        return 0.0
    way = item.position - eye
    away = float(np.linalg.norm(way))
    side = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    side /= np.linalg.norm(side)
    k = np.arange(RAYS) + 0.5
    radius, turn = item.radius * np.sqrt(k / RAYS), np.pi * (3.0 - np.sqrt(5.0)) * k  # sunflower
    up = np.cross(way, side) / away
    ends = item.position + radius[:, None] * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
    )
    share = np.linspace(0.0, 1.0 - item.radius / away, STEPS)[1:]
    points = eye + share[None, :, None] * (ends - eye)[:, None]
    clear, _ = distances(pack(others), points.reshape(-1, 3))
    return float((clear.min(axis=1).reshape(RAYS, -1) < 0.0).any(axis=1).mean())


def _seen(item: SceneObject, rng: np.random.Generator, noise: Noise, up: FloatArray) -> SceneObject:
    # every object takes as many numbers, so that its errors do not depend on the roles of others
    error = noise.position * rng.standard_normal(3)
    turn = float(np.deg2rad(noise.angle)) * rng.standard_normal(2)
    if item.role == "static":
        return item
    spread = noise.position**2 * np.eye(3)
    if item.stem is None and not isinstance(item.shape, Sphere):  # it stands
        error -= (error @ up) * up
        spread -= noise.position**2 * np.outer(up, up)
    else:
        error -= noise.lower * up
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
