"""The push model of a retreat: a tool that is full, among fruits that the reach has pushed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import tool_motion
from optipromp.core.planning.verdict import led
from optipromp.core.pushing.model import Continued, PushModel
from optipromp.core.pushing.stems.cup import flange_of
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import Mounted
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.scene import SceneObject
from optipromp.core.scenes.trusses import rooted


def way_back(reach: Plan, robot: Robot) -> PushModel | None:
    """The push model of the retreat: the tool is full, so that it is a solid body among fruits.

    The model knows the push of the reach. None where nothing else hangs.
    """
    scene, target = reach.scene, reach.scene.target
    assert target is not None
    hanging = [item for item in scene.pushables if item.stem is not None]
    tool = reach.robot.tool
    if target.stem is None or not hanging or tool is None or robot.tool is None:
        return None

    def away(item: SceneObject) -> float:
        return math.dist(item.position, target.position)

    first = min(hanging, key=away)
    objects = (
        replace(item, role="target") if item.id == first.id else item
        for item in scene.objects
        if item.id != target.id
    )
    seen = replace(
        scene, objects=rooted(objects), place=None,
        may_touch=pairs_among(scene.may_touch, [target.id]),
    )  # fmt: skip
    left = tuple(item for item in reach.task.neighbours if item.id not in (first.id, target.id))
    full = replace(Mounted.of(robot.tool), full=True)
    model = Hanging(
        seen, full, left, reach.task.camera, robot.gripper_radius, flange_of(robot), reach.risk,
    )  # fmt: skip
    before = reach.push_model
    if before is None:
        points, axes = tool_motion(reach.robot, reach.trajectory.positions[reach.first :])
        return WayBack(model, points, axes, ())
    points, axes, *_ = led(reach.task, before, reach.trajectory)
    radius = {item.id: item.radius for item in hanging}
    moved = before.moved(points, axes)
    off = moved.positions - points[-1]
    height = off @ axes[-1]
    aside = lengths(off - height[:, None] * axes[-1])
    behind = (height < tool.front - tool.reach) & (height > -tool.reach)
    caught = (
        name
        for name, is_behind, away_by in zip(moved.ids, behind, aside, strict=True)
        if is_behind and name in radius and away_by < tool.mouth[1] + radius[name]
    )
    return WayBack(model, points, axes, tuple(caught))


class WayBack(Continued):
    """The push model of a retreat, after the push of the reach.

    A fruit that the reach left behind the mouth's floor, across the way of its edge, is ``caught``:
    the tool would pull it off its stem. The model of the push does not know such pulls. In the
    simulation, 3 of 4 retreats past such a fruit tore one off; none of 5 others did.
    """

    def __init__(
        self, model: PushModel, points: FloatArray, axes: FloatArray, caught: tuple[str, ...]
    ) -> None:
        super().__init__(model, points, axes)
        self.caught = caught

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """See :class:`PushModel`; two thresholds more where a fruit is caught."""
        more = 2.0 * self.threshold if self.caught else 0.0
        return more + super().harm(points, axes, states, limit - more)

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """See :class:`PushModel`."""
        if self.caught:
            return self.caught[0], "is caught behind the tool, which would tear it off its stem"
        return super().cause(points, axes)
