"""Lifting a target that stands: straight up, then back along the reach, higher by the lift.

A target without a stem that is reached from the side stands on a board. Dragged back it would rub
on the board and push what stands before it. Lifted, the target and the tool leave by the corridor
that the reach has pushed free. The packs stand where the push model says that the reach left them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths, rotation
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.result import Plan
from optipromp.core.planning.verdict import led
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, SceneObject


@dataclass(frozen=True)
class LiftParameters(Checked):
    """Numbers of a lift."""

    heights: tuple[float, ...] = parameter(
        (0.02, 0.04, 0.01), "m", "choice", "of the lift, in the order in which they are tried"
    )
    step: float = parameter(0.005, "m", "choice", "between the waypoints of a lift")
    speed: float = parameter(
        0.025, "m/s", "measured", "of the tool until it is out: at 0.1 m/s 4 of 14 runs pressed a "
        "pack beyond 10 N on the way back, at 0.025 m/s none of these"
    )  # fmt: skip
    level: float = parameter(30.0, "deg", "choice", "largest slope of an approach from the side")
    pushed: float = parameter(
        0.001, "m", "choice", "a pack that the reach moves farther touches the tool, and may do so"
    )


LIFT = LiftParameters()


def stands(scene: Scene) -> bool:
    """Whether the target stands and is reached from the side."""
    target, slope = scene.target, abs(float(scene.frame[2] @ scene.up))
    return target is not None and target.stem is None and slope < np.sin(np.deg2rad(LIFT.level))


def settled(reach: Plan, scene: Scene) -> Scene:
    """The ``scene`` of the way back, with the packs where the reach has left them, as static.

    Packs that the reach has pushed may be touched by the tool, the last link and what they hold.
    """
    places: dict[str, tuple[FloatArray, float]] = {}
    model, robot = reach.push_model, reach.robot
    if model is not None:
        points, axes, *_ = led(reach.task, model, reach.trajectory)
        left = model.moved(points, axes)
        ends = zip(left.ids, left.positions, left.turns, strict=True)
        places = {id_: (place, float(turn)) for id_, place, turn in ends}
    objects, pairs = list[SceneObject](), list(scene.may_touch)
    near = [
        str(name) for name in robot.link_names[robot.spheres.link[robot.spheres.distal].min() :]
    ]
    holders = [*dict.fromkeys(near), *(item.id for item in scene.attached)]
    for item in scene.objects:
        if item.role == "static" or item.stem is not None:
            objects.append(item)
            continue
        place, turn = places.get(item.id, (item.position, 0.0))
        orientation = to_quaternion(rotation(-scene.frame[0], turn) @ item.rotation)
        objects.append(SceneObject(item.id, "static", item.shape, place, orientation, padding=0.0))
        if np.linalg.norm(place - item.position) > LIFT.pushed or abs(turn) > LIFT.pushed:
            pairs += [(name, item.id) for name in holders]
    return replace(scene, objects=tuple(objects), may_touch=tuple(pairs))


def lifted_pairs(before: Scene, scene: Scene) -> tuple[tuple[str, str], ...]:
    """The pairs of a ``scene`` that may touch, less those of the target with the board it left.

    ``before`` is the scene of the reach.
    """
    target, static = before.target, {item.id for item in before.static}
    assert target is not None
    return tuple(
        pair
        for pair in scene.may_touch
        if pair in before.may_touch or not (target.id in pair and static & set(pair))
    )


def ways(reach: Plan, robot: Robot, distance: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Waypoints (T, n) of the lift and (U, n) of the way back, for each height.

    The way back ends ``distance`` [m] along the reach from its end, and at least where the approach
    begins.
    """
    q = reach.trajectory.positions
    tips, axes = robot.tool_pose(q)
    gone = np.append(0.0, np.cumsum(lengths(np.diff(tips[::-1], axis=0))))
    first = len(q) - 1 - reach.first
    last = max(min(int(np.searchsorted(gone, distance)), len(q) - 1), first, 2)
    for height in LIFT.heights:
        rise = np.linspace(0.0, height, max(3, int(np.ceil(height / LIFT.step)) + 1))
        points = tips[-1] + rise[:, None] * reach.scene.up
        up, off = ik.track(robot, points, np.tile(axes[-1], (len(rise), 1)), q[-1])
        level = (tips - tips[-1]) @ reach.scene.up  # the way back is nowhere lower than the lift
        over = tips + (height - np.minimum(level, 0.0))[:, None] * reach.scene.up
        above = over[::-1][: last + 1]
        back, missed = ik.track(robot, above, axes[::-1][: last + 1], up[-1])
        if max(off.max(), missed.max()) < judging.GOAL_TOLERANCE:
            yield np.vstack([q[-1:], up[1:]]), np.vstack([up[-1:], back[1:]])
