"""Approaches to a target other than the straight one: tilted, or off the target's centre.

A scene may state the cone and the lateral distance of its approach
(:class:`optipromp.core.scenes.scene.Approach`). The other approaches are tried where the straight
one is refused. Approaches whose first candidate paths do next to no harm in the perceived state
come first; the approaches of least harm follow.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import rotation
from optipromp.core.budget import clock
from optipromp.core.planning.parameters import APPROACH
from optipromp.core.planning.task import Task, approached
from optipromp.core.pushing.model import PushModel
from optipromp.core.scenes.scene import Scene


def others(task: Task, end: float = np.inf) -> Iterator[Task]:
    """The task with each of the most promising approaches that its scene allows.

    The tool ends no farther beside the target's centre than its mouth leaves room, so that the cup
    stays round the target. To a target that stands the tool comes level, from a little to either
    side. Where the scene states no cone or no lateral distance, ``APPROACH`` does. No approach is
    looked at after ``end`` [s], a time of the plan's clock.
    """
    scene = task.scene
    tool, target = task.robot.tool, scene.target
    if tool is None or target is None:
        return
    cone, aside = scene.approach.cone, scene.approach.aside
    cone = np.deg2rad(APPROACH.cone if cone is None else cone)
    aside = APPROACH.aside if aside is None else aside
    reach = min(aside, max(tool.mouth[0] - target.radius - APPROACH.room, 0.0))
    x_g, y_g, z_g = scene.frame
    around = np.arange(APPROACH.around) * 2.0 * np.pi / APPROACH.around
    flats = [np.cos(turn) * x_g + np.sin(turn) * y_g for turn in around]
    shares: tuple[float, ...] = (1.0, APPROACH.inner)
    if target.stem is None:
        side = np.cross(scene.up, z_g)
        level = float(np.linalg.norm(side))
        flats = [side / level, -side / level] if level > 0.5 else []  # over 30° off the vertical
        shares, reach = (APPROACH.inner,), 0.0
    ways = [
        (rotation(np.cross(z_g, flat), float(share * cone)) @ z_g, scene.approach.shift)
        for share in shares
        if cone > 0.0
        for flat in flats
    ]
    ways += [(z_g, scene.approach.shift + reach * flat) for flat in flats if reach > 0.0]
    left, best = APPROACH.tried, list[tuple[float, int, Task]]()
    for k, (way, shift) in enumerate(ways):
        if clock() > end:
            return
        approach = replace(scene.approach, direction=way, shift=shift)
        other = approached(task, replace(scene, approach=approach))
        model = other.push_model(task.robot.home)
        if model is None:
            continue
        harm = _least_harm(other.scene, model, best[-1][0] if len(best) == left else np.inf)
        if harm < APPROACH.promising * model.threshold:
            yield other
            left -= 1
            best = best[:left]
            if not left:
                return
        else:
            best = sorted([*best, (harm, k, other)])[:left]
    yield from (other for _, _, other in best)


def _least_harm(scene: Scene, model: PushModel, most: float) -> float:
    """The least harm of the model's first candidate paths, in the perceived state.

    A harm above ``most`` is returned as any number that is not below ``most``.
    """
    axis, least = scene.frame[2], most
    for x in model.candidates.first()[: APPROACH.candidates]:
        path = model.candidates.path(x)
        away = model.candidates.aside(x, path)
        if away < least:
            axes = np.tile(axis, (len(path.points), 1))
            least = min(least, model.harm(path.points, axes, 1, least - away) + away)
    return least
