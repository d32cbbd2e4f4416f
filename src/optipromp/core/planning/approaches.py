"""Other ways to come to a target than straight: tilted, or off its centre.

A scene allows them by the cone and the distance of its approach
(:class:`optipromp.core.scenes.scene.Approach`), or says nothing. They are tried where the straight
way
is refused: first those whose first candidate paths do next to no harm in the perceived state, then
those of least harm.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import rotation
from optipromp.core.planning.parameters import APPROACH
from optipromp.core.planning.task import Task, approached
from optipromp.core.pushing.model import PushModel
from optipromp.core.scenes.scene import Scene


def limits(scene: Scene) -> tuple[float, float]:
    """Largest angle off the approach [rad], and distance beside the target [m], that are allowed.

    Where the scene says nothing, the planner chooses.
    """
    cone, aside = scene.approach.cone, scene.approach.aside
    return np.deg2rad(APPROACH.cone if cone is None else cone), (
        APPROACH.aside if aside is None else aside
    )


def others(task: Task) -> Iterator[Task]:
    """The task with the most promising of the other approaches that it allows.

    The cup stays round the target: a tool ends no farther beside its centre than its mouth leaves
    room. To a target that stands the tool comes level, from a little to either side.
    """
    scene = task.scene
    cone, aside = limits(scene)
    tool, target = task.robot.tool, scene.target
    if tool is None or target is None:
        return
    reach = min(aside, max(tool.mouth[0] - target.radius - APPROACH.room, 0.0))
    x_g, y_g, z_g = scene.frame
    around = np.arange(APPROACH.around) * 2.0 * np.pi / APPROACH.around
    flats = [np.cos(turn) * x_g + np.sin(turn) * y_g for turn in around]
    shares: tuple[float, ...] = (1.0, APPROACH.inner)
    if target.stem is None:
        side = np.cross(scene.up, z_g)
        level = float(np.linalg.norm(side))
        flats = [side / level, -side / level] if level > 0.5 else []
        shares, reach = (APPROACH.inner,), 0.0
    ways = [
        (rotation(np.cross(z_g, flat), float(share * cone)) @ z_g, np.zeros(3))
        for share in shares if cone > 0.0
        for flat in flats
    ]  # fmt: skip
    ways += [(z_g, reach * flat) for flat in flats if reach > 0.0]
    left, best = APPROACH.tried, list[tuple[float, int, Task]]()
    for k, (way, shift) in enumerate(ways):
        approach = replace(scene.approach, direction=way, shift=shift)
        one = approached(task, replace(scene, approach=approach))
        model = one.push_model(task.robot.home)
        if model is None:
            continue
        promise = _promise(one.scene, model, best[-1][0] if len(best) == left else np.inf)
        if promise < APPROACH.promising * model.threshold:
            yield one
            left -= 1
            best = best[:left]
            if not left:
                return
        else:
            best = sorted([*best, (promise, k, one)])[:left]
    yield from (one for _, _, one in best)


def _promise(scene: Scene, model: PushModel, most: float) -> float:
    """The least harm of the model's first candidate paths, in the perceived state.

    Where it is above ``most``, any number above ``most`` may be returned.
    """
    axis, least = scene.frame[2], most
    for x in model.candidates.first()[: APPROACH.candidates]:
        path = model.candidates.path(x)
        away = model.candidates.aside(x, path)
        if away < least:
            axes = np.tile(axis, (len(path.points), 1))
            least = min(least, model.harm(path.points, axes, 1, least - away) + away)
    return least
