"""Scenes before a camera that stands with its back to the robot, and what it sees."""

import numpy as np
from scipy.stats import binom

from optipromp.core.arrays import frame_along
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning.task import posed
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.simulation.detector import Detector, DetectorParameters, Truth

UNLIKELY = 1e-4  # probability that a right detector fails a test of its statistics
CAMERA = Pose([0.0, -1.0, 0.5], frame_along(np.array([0.0, -1.0, 0.0])))  # its back to the robot
WHITE = DetectorParameters(mount="beside", position=0.005, angle=5.0)
ROBOT, _ = posed(Scene(
    "bare", "panda", (SceneObject("ripe", "target", Sphere(0.015), [0.5, 0.0, 0.8]),),
    tool=ToolSpec("cup", {"radius": 0.03}),
))  # fmt: skip
HOME = np.asarray(ROBOT.home)


def fruit(id_, place, role="pushable", radius=0.015, length=0.15):
    """A fruit at ``place`` in the frame of the camera, on a stem straight up."""
    at = CAMERA @ np.array(place, dtype=float)
    stem = Stem.along(at, np.array([0.0, 0.0, 1.0]), length)
    return SceneObject(id_, role, Sphere(radius), at, stem=stem)


def seen_by(*objects, camera=CAMERA):
    return Scene("eye", "panda", objects, tool=ToolSpec("cup", {"radius": 0.03}), camera=camera)


def truth(scene):
    moving = [item for item in scene.objects if item.role != "static"]
    return Truth(
        tuple(item.id for item in moving),
        np.array([item.position for item in moving]),
        np.array([item.rotation for item in moving]),
        tuple(np.zeros((0, 3)) if o.stem is None else o.stem.points[::-1] for o in moving),
    )


def looks(scene, parameters, seed=0, count=1, pause=0.05):
    detector = Detector(scene, ROBOT, parameters, seed)
    return [detector.expose(k * pause, HOME, truth(scene)) for k in range(count)]


def ids(look: Look):
    return {item.id for item in look.detections}


def by_id(look: Look):
    return {item.id: item for item in look.in_base()}


def between(count, p):
    """The band of a binomial count."""
    return binom.ppf(UNLIKELY / 2, count, p), binom.ppf(1 - UNLIKELY / 2, count, p)
