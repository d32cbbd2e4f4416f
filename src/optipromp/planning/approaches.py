"""Other ways to come to a target than straight: tilted, from a tilt upright, or off its centre.

A scene allows them by the cone and the distance of its approach
(:class:`optipromp.scenes.scene.Approach`). They are tried where the straight way is refused, in the
order of the harm that the push model predicts for its first candidate paths.
"""

import itertools
from dataclasses import replace

import numpy as np

from optipromp.arrays import FloatArray, rotation
from optipromp.planning.parameters import APPROACH
from optipromp.planning.task import push_model, resolve
from optipromp.pushing.model import PushModel
from optipromp.pushing.path import turning
from optipromp.robots.model import Robot
from optipromp.scenes.scene import Scene


def others(scene: Scene, robot: Robot) -> list[Scene]:
    """The scene with each other approach that it allows, the most promising first.

    The cup stays round the target: a tool ends no farther beside its centre than its mouth leaves
    room.
    """
    target, approach = scene.target, scene.approach
    if target is None or robot.tool is None or (approach.cone == 0.0 and approach.aside == 0.0):
        return []
    room = max(robot.tool.mouth[0] - target.radius - APPROACH.room, 0.0)
    reach = min(approach.aside, room)
    x_g, y_g, z_g = scene.frame
    tilts = [share * np.deg2rad(approach.cone) for share in (APPROACH.inner, 1.0)]
    around = np.arange(APPROACH.around) * 2.0 * np.pi / APPROACH.around
    ways: list[tuple[FloatArray, FloatArray, FloatArray | None]] = []
    for turn in around:
        flat = np.cos(turn) * x_g + np.sin(turn) * y_g
        if reach > 0.0:
            ways.append((z_g, reach * flat, None))
        if approach.cone > 0.0:
            for tilt, share in itertools.product(tilts, (0.0, 1.0) if reach > 0.0 else (0.0,)):
                turned = rotation(np.cross(z_g, flat), float(tilt))
                ways.append((turned @ z_g, share * reach * (turned @ flat), None))
                if tilt == tilts[-1]:  # the tool turns upright on its way
                    ways.append((z_g, share * reach * flat, turned @ z_g))
    scenes = [
        replace(scene, approach=replace(approach, direction=way, shift=shift, lead=lead))
        for way, shift, lead in ways
    ]
    models = [push_model(resolve(one, robot), robot.home) for one in scenes]
    harms = [np.inf if model is None else _promise(one, model) for one, model in
             zip(scenes, models, strict=True)]  # fmt: skip
    return [scenes[k] for k in np.argsort(harms, kind="stable")[: APPROACH.tried]]


def _promise(scene: Scene, model: PushModel) -> float:
    """The least harm of the model's first candidate paths, in the perceived state."""
    axis, least = scene.frame[2], np.inf
    for x in model.first():
        path = model.path(x)
        share = np.linspace(0.0, 1.0, len(path.points))
        axes = turning(axis, scene.approach.lead, share)
        least = min(least, model.harm(path.points, axes, 1, least) + model.aside(x, path))
    return least
