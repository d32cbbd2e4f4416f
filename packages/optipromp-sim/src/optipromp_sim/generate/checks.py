"""Whether a sampled scene is possible: no two objects overlap, and an arm could reach the target.

No motion is planned. Only goal configurations are checked, and only against static objects and the
arm itself: a scene is not sampled again because its motion is hard, or because the arm must brush a
neighbour.
"""

from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.shapes import Capsule, Cone, Ellipsoid, Sphere
from optipromp.core.judging.speed import between
from optipromp.core.planning.collision import free
from optipromp.core.planning.task import aimed_at_stem, resolve
from optipromp.core.robots import ik
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.ik import level, rolled, rolls
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.robots.tools import WALL, cone_of
from optipromp.core.scenes.scene import Scene, SceneObject, obstacles_of

SAMPLE = 0.004  # [m] between the points of a segment that are checked: a choice
STARTS = 200  # of the inverse kinematics: a choice
ROUND = Sphere | Capsule | Ellipsoid | Cone


class OverlapError(Exception):
    """A sample that failed because objects overlap; the message names them."""


def interpenetration(scene: Scene) -> str | None:
    """The kinds of the first two objects found to overlap, in words; None where none do.

    Checked are: round fruits against one another, neighbours and static objects; stems against the
    same (but for their own fruits) and against stems; neighbours against one another and static
    objects. A shelf is not checked: its sampler keeps the footprints apart.
    """
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    hanging = [item for item in fruits if isinstance(item.shape, ROUND)]
    cores = [_core(item) for item in hanging]
    for i, (core, radius) in enumerate(cores):
        for other_core, other_radius in cores[i + 1 :]:
            if between(*core, *other_core) < radius + other_radius:
                return "fruit in fruit"
    if not hanging:
        return None
    for objects, word in ((scene.static, "static"), (scene.avoid, "neighbour")):
        if not objects:
            continue
        surface = pack([(item.shape, item.position, item.rotation) for item in objects])
        for core, radius in cores:
            away, _ = distances(surface, _samples(core))
            if float(away.min()) < radius:
                return f"fruit in {word}"
        for item in hanging:
            if item.stem is None:
                continue
            along, _ = distances(surface, _samples(item.stem.points))
            if float(along.min()) < item.stem.radius:
                return f"stem in {word}"
        if word == "static":
            for cluster in scene.avoid:
                away, _ = distances(surface, cluster.position[None])
                if float(away.min()) < cluster.radius:
                    return "neighbour in static"
    for i, one in enumerate(hanging):
        if one.stem is None:
            continue
        for j, other in enumerate(hanging):
            if i == j:
                continue
            core, radius = cores[j]
            if between(*one.stem.points, *core) < radius + one.stem.radius:
                return "stem in fruit"
            if j > i and other.stem is not None and scene.tops[one.id] != scene.tops[other.id]:
                gap = between(*one.stem.points, *other.stem.points)
                if gap < one.stem.radius + other.stem.radius:
                    return "stem in stem"
    for i, one in enumerate(scene.avoid):
        for other in scene.avoid[i + 1 :]:
            apart = float(np.linalg.norm(one.position - other.position))
            if apart - one.radius - other.radius < 0.0:
                return "neighbour in neighbour"
    return None


def _core(item: SceneObject) -> tuple[FloatArray, float]:
    """The segment (2, 3) and the radius [m] of a capsule that holds a round fruit."""
    x, y, z = item.shape.measure.half
    radius = max(x, y)
    end = max(z - radius, 0.0) * item.rotation[:, 2]
    return np.array([item.position - end, item.position + end]), radius


def _samples(points: FloatArray) -> FloatArray:
    """Points (k, 3) on a segment (2, 3), at most :data:`SAMPLE` apart."""
    length = float(np.linalg.norm(points[1] - points[0]))
    share = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / SAMPLE)) + 1))
    return np.asarray(points[0] + share[:, None] * (points[1] - points[0]))


def unsolvable(scene: Scene) -> str | None:
    """The reason why no arm motion can end at the target; None where one may.

    Of the goal configurations, one must be free among the static objects alone
    (:func:`optipromp.core.planning.collision.free`).
    """
    target = scene.target
    if target is None:
        return None
    static = obstacles_of(scene, "static")
    if len(static.kind):
        inside, _ = distances(static, target.position[None])
        if float(inside.min()) < 0.0:
            return "target inside a static object"
    task = resolve(replace(scene, objects=(replace(target, stem=None), *scene.static)))
    robot = task.robot
    if any(_rooted_in_tool(scene, item, robot.tool) for item in scene.pushables):
        return "stem rooted where the tool must end"
    aim = aimed_at_stem(scene, robot.tool).aim
    assert aim is not None
    goals = ik.solve(robot, aim, scene.frame[2], starts=STARTS, distinct=0.05).joints
    if not len(goals):
        return "target out of reach"
    if robot.tool is not None and robot.tool.fingers and rolls(robot):
        turned = level(robot, goals, scene.frame[0])  # a finger on either side of the target
    else:
        turned = rolled(robot, goals)
    return None if len(free(task, turned, 1)) else "goal always in collision"


def _rooted_in_tool(scene: Scene, item: SceneObject, tool: Tool | None) -> bool:
    """Whether a cup must go through a stem's root, which does not yield; False for fingers.

    The root is then in cup, cone or neck at the goal, or in the volume that the cup sweeps on
    every path: once the target's lowest point is in the mouth, the cup can only rise, and the
    target leaves the cup little room to the side. In that volume a wall of at most :data:`WALL`
    does not count.
    """
    target = scene.target
    if item.stem is None or tool is None or tool.fingers or target is None:
        return False
    if item.stem.parent is not None:
        return False  # it grows from another stem, which yields
    up = scene.frame[2]
    off = item.stem.points[-1] - target.position
    height = float(off @ up)
    aside = float(np.linalg.norm(off - height * up))
    rim, base, flange = tool.depth, tool.front - tool.reach, -tool.reach
    inner, outer = tool.mouth
    inner = outer if outer - inner < WALL + 1e-9 else inner
    sure = outer - max(inner - target.radius, 0.0)
    rise = tool.depth + target.radius
    share = np.clip(1.0 - (base - height) / max(cone_of(tool), 1e-9), 0.0, 1.0)
    neck = NECK_RADIUS + share * (outer - NECK_RADIUS)  # or the cone, level with the root
    for radius, low, high in ((outer, base, rim), (neck, flange, base), (sure, base - rise, rim)):
        beyond = max(low - height, height - high, 0.0)
        if np.hypot(max(aside - radius, 0.0), beyond) < item.stem.radius:
            return True
    return False
