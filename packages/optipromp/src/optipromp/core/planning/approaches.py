"""Other approaches to a target than the straight one, the most promising first."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, lengths, rotation
from optipromp.core.budget import clock
from optipromp.core.geometry.shapes import outlines
from optipromp.core.planning.parameters import APPROACH
from optipromp.core.planning.task import Task, approached, cuts
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.cup import fits
from optipromp.core.scenes.scene import Scene

SAME = 1e-6  # 1 less the cosine between two directions that are one: 0.1 degrees


def other_approaches(task: Task, end: float = np.inf) -> Iterator[Task]:
    """The task with each of the ``APPROACH.tried`` most promising approaches of its scene.

    The tool ends no farther beside the target's centre than its mouth leaves room, so that the cup
    stays round the target. To a long target that does not fit in every state, it comes only from
    where the target fits, from where that is narrowest first; it ends at the middle of its outline,
    as low as its length asks for. To a target that stands, and to a stem that is cut, the tool
    comes level, from a little to either side. Where the scene states no cone or no lateral
    distance, ``APPROACH`` does. No approach is looked at after ``end`` [s], a time of the plan's
    clock.
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
    cut = cuts(scene, tool)
    if target.stem is None or cut:
        side = np.cross(scene.up, z_g)
        level = float(np.linalg.norm(side))
        flats = [side / level, -side / level] if level > 0.5 else []  # over 30° off the vertical
        shares, reach = shares if cut else (APPROACH.inner,), 0.0
    tilts = [
        rotation(np.cross(z_g, flat), float(share * cone)) @ z_g
        for share in shares
        if cone > 0.0
        for flat in flats
    ]
    straight = None if target.stem is None else task.push_model(task.robot.home)
    if straight is not None and straight.least > 0.0 and not scene.approach.shift.any():
        first = narrowest(scene, cone)
        axes = np.array([first, *(axis for axis in (z_g, *tilts) if axis @ first < 1.0 - SAME)])
        width, floor, shifts = fits(target, axes, tool)
        shifts = shifts - np.maximum(APPROACH.room - floor, 0.0)[:, None] * axes
        shifts *= np.minimum(1.0, aside / np.maximum(lengths(shifts), 1e-9))[:, None]
        floor += PUSH.harm.fit - np.einsum("mi,mi->m", shifts, axes)
        other = (axes != z_g).any(axis=1) | shifts.any(axis=1)
        fit = other & (np.minimum(width, floor) > 0.0)
        directions = list(zip(axes[fit], shifts[fit], strict=True))
    else:
        directions = [(axis, scene.approach.shift) for axis in tilts]
        beside = (reach * flat for flat in flats if reach > 0.0)
        directions += [(z_g, scene.approach.shift + shift) for shift in beside]
    left, best = APPROACH.tried, list[tuple[float, int, Task]]()
    for k, (direction, shift) in enumerate(directions):
        if clock() > end:
            return
        approach = replace(scene.approach, direction=direction, shift=shift)
        other = approached(task, scene.approached(approach))
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


def narrowest(scene: Scene, cone: float) -> FloatArray:
    """The direction (3,) of a cone of ``cone`` [rad] across which the target is narrowest."""
    assert scene.target is not None
    turns = 2.0 * np.pi / APPROACH.turns * np.arange(APPROACH.turns)
    tilt, turn = np.meshgrid(np.linspace(0.0, cone, APPROACH.rings + 1), turns, indexing="ij")
    local = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    axes = local.reshape(3, -1).T @ np.array(scene.frame)
    radius, _, _ = outlines(scene.target.shape, axes @ scene.target.rotation)
    return np.asarray(axes[np.argmin(radius.round(6))])  # of equal ones that of the least tilt


def misfit(task: Task) -> str:
    """In words, how much wider a hanging target is than a round mouth, and what fits; else empty.

    The room that it needs is that of the push model.
    """
    scene, tool, target = task.scene, task.robot.tool, task.scene.target
    if target is None or target.stem is None or tool is None or tool.fingers:
        return ""
    cone, opening, needed = scene.approach.cone, 2e3 * tool.mouth[0], 2e3 * PUSH.harm.fit
    cone = np.deg2rad(APPROACH.cone if cone is None else cone)
    axes = np.array([scene.frame[2], narrowest(scene, cone)])
    here, least = 2e3 * outlines(target.shape, axes @ target.rotation)[0]
    if opening <= 0.0 or here + needed <= opening:
        return ""
    off = f"in the cone of the approach it is nowhere narrower than {least:.1f} mm"
    if least + needed <= opening:
        tilt = np.rad2deg(np.arccos(axes[0] @ axes[1]))
        off = f"{tilt:.0f} degrees off the approach it is {least:.1f} mm wide: fits"
    return (
        f"{target.id} is {here:.1f} mm wide across the approach, the tool's opening "
        f"{opening:.1f} mm is too narrow: one of {here + needed:.1f} mm fits; {off}"
    )


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
