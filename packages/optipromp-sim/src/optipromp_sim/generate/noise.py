"""A scene as detected: positions and stem directions have errors, some fruits are not seen."""

from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry import distances, pack
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.scene import JointGoal, PoseGoal, Scene, SceneObject
from optipromp_sim.detection import NOISES as NOISES
from optipromp_sim.detection import Noise as Noise
from optipromp_sim.detection import displaced, tilt
from optipromp_sim.generate.plants import untold

LOOK = 0.30  # [m] of the eye before the target where a scene has no camera: a choice
RAYS, STEPS = 48, 60  # rays from the eye to a fruit, points on each ray: choices


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
        eye, chances, more = _eye(scene), rng.random(len(seen)), noise.hidden - noise.missed
        seen = [
            new
            for old, new, chance in zip(scene.objects, seen, chances, strict=True)
            if old.role != "pushable"
            or chance >= noise.missed + more * hidden_share(scene, old, eye)
        ]
    return replace(scene, objects=rooted(seen))


def noisy(scene: Scene, seed: int, noise: Noise) -> Scene:
    """The scene as a study and ``optipromp generate --noise`` perceive it for a seed.

    The physical parameters of fruits are left out: no detector measures them.
    """
    return perceived(untold(scene), np.random.default_rng([seed, 1]), noise)


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
    angles = float(np.deg2rad(noise.angle)) * rng.standard_normal(2)
    if item.role == "static":
        return item
    variance = noise.position**2
    error, spread = displaced(item, error, variance * np.eye(3), variance, up, noise.lower)
    stem = None
    if item.stem is not None:
        away = item.stem.points - item.stem.points[0]
        begin = item.stem.points[0] + error
        stem = replace(item.stem, points=begin + away @ tilt(away[1], -angles).T)
    return replace(item, position=item.position + error, stem=stem, covariance=spread)
