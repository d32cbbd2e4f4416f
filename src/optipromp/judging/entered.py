"""Where the tool or the last link is inside of what the tool may push or pick.

They may touch it on the way. No motion can begin there.
"""

import numpy as np

from optipromp.arrays import FloatArray, lengths
from optipromp.judging.clearance import Overlap, enter, swept
from optipromp.judging.distances import Objects, measured, nearest
from optipromp.judging.kinematics import centers
from optipromp.robots.model import Robot
from optipromp.scenes.scene import Scene, SceneObject

BRUSHED = 0.005  # [m] a choice: spheres stand out of a cup's wall by 4.5 mm
EXCESS = 0.015  # [m] by which spheres stand out of a link that does not state it; as the Panda's


def touching(scene: Scene, robot: Robot, q: FloatArray, *, begun: bool = False) -> list[Overlap]:
    """What a motion must not touch where it begins, at ``q`` (n,).

    With ``begun`` it goes on with one that ran: what the tool may push, it may touch.
    """
    _, contacts, points, axes = swept(scene, robot, q[None])
    return [*contacts, *([] if begun else entered(scene, robot, q, points[0], axes[0]))]


def entered(
    scene: Scene, robot: Robot, q: FloatArray, point: FloatArray, axis: FloatArray
) -> list[Overlap]:
    """The target and the pushables that the tool or the last link is inside of, and how deep.

    An object that is in the tool's mouth, or before it, is not inside of the tool. A link may be in
    an object as deep as its spheres stand out of it: then it need not be, and a model of the push
    tells what comes of it.

    Args:
        scene: with the objects.
        robot: with its tool.
        q: (n,) its configuration.
        point, axis: (3,) of the tool there.
    """
    own = np.flatnonzero(robot.spheres.distal)
    if not len(own):
        return []
    spheres, radius = centers(robot, q[None])[:, own], np.asarray(robot.spheres.radius)[own]
    middle = spheres[0].mean(axis=0)
    reach = float((lengths(spheres[0] - middle) + radius).max())
    rows = np.concatenate([scene.rows("target"), scene.rows("pushable")])
    near = lengths(scene.positions[rows] - middle) < scene.bounds[rows] + reach
    link, out = np.asarray(robot.spheres.link)[own], []
    for item in scene.objects_at(rows[near]):
        for one in np.unique(link):
            name = str(robot.link_names[one])
            is_tool = robot.tool is not None and one == link.max()
            if is_tool and _in_mouth(robot, item, point, axis):
                continue
            depth = _depth(item, spheres[:, link == one], radius[link == one])
            if depth > (BRUSHED if is_tool else robot.excess.get(name, EXCESS)):
                out.append(Overlap(name, item.id, item.role, depth, 0.0))
    return out


def _in_mouth(robot: Robot, item: SceneObject, point: FloatArray, axis: FloatArray) -> bool:
    """Whether an object is in the tool's mouth, or before it; a long one is taken for as thin as it
    is.
    """
    tool = robot.tool
    assert tool is not None
    off = item.position - point
    height = float(off @ axis)
    aside = float(np.linalg.norm(off - height * axis))
    _, size, _ = measured([item.shape])
    thin = float(size.min(where=size > 0.0, initial=np.inf)) if size.any() else 0.0
    return height > tool.front - tool.reach and aside + thin < tool.mouth[0] + BRUSHED


def _depth(item: SceneObject, spheres: FloatArray, radius: FloatArray) -> float:
    """How deep (1, B, 3) spheres are in an object [m]."""
    kind, size, bound = measured([item.shape])
    if kind[0] < 0:
        return -nearest(item, spheres, radius, 0.0)[0]
    none, found = np.zeros(1, dtype=np.int64), np.zeros(3)
    alone = Objects(
        none, kind, none, np.array([item.position]), np.array([item.rotation]), size, bound, none,
        np.zeros((0, 3)), np.zeros(0),
    )  # fmt: skip
    enter(alone, 0, spheres, radius, np.ones(len(radius), dtype=np.bool_), found)
    return float(found[0])
