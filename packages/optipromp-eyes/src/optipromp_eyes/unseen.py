"""What pictures do not show: behind what is solid, and wherever none of them looks through."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, count

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.geometry.distances import distances
from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.optimization.problem import reach
from optipromp.core.planning.task import posed
from optipromp.core.scenes.look import unexplained, with_hidden
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.finder import most_about
from optipromp_eyes.fusing import Sighting
from optipromp_eyes.pictures import DepthPicture

CELL = 0.01  # [m] side of the cells that are looked at: a choice
ABOUT = 0.15  # [m] from the target, as far as they are: a choice
BEHIND = 0.01  # [m] before what is measured, where a picture shows that nothing is: a choice


def solid_things(
    sights: Sequence[Sighting], known: Scene, fruits: Sequence[SceneObject]
) -> list[tuple[str, SceneObject]]:
    """What is solid in the base frame beside what is known and the arm at its start, each with its
    place in its picture in words; ids are those of the look, if free."""
    robot, state = posed(known)
    arm = np.column_stack([robot.sphere_centers(state.q), robot.spheres.radius])
    given = known, fruits, arm, reach(robot)
    taken, out = {item.id for item in (*known.objects, *fruits)}, []
    for k, each in enumerate(sights, 1):
        view = "" if len(sights) == 1 else f" of picture {k}"
        places = {o.id: p for o, p in zip(each.look.solids, each.places, strict=True)}
        shown = list(unexplained(each.look, *given))
        others = [one.picture for one in sights if one is not each and one.picture is not None]
        free = partial(_free, pictures=others)
        for item in with_hidden(shown, each.look, *given, free=free):
            more = (f"{item.id}-{n}" for n in count(2))
            name = next(n for n in chain([item.id], more) if n not in taken)
            taken.add(name)
            out.append((places[item.id] + view, replace(item, id=name)))
    return out


def unseen_about(sights: Sequence[Sighting], scene: Scene) -> SceneObject | None:
    """The cells about the target of a scene that none of the pictures shows to be free, less what
    the objects of the scene fill; None: there is no picture, or no such cell."""
    pictures = [each.picture for each in sights if each.picture is not None]
    if scene.target is None or not pictures:
        return None
    ticks = np.arange(-ABOUT, ABOUT + 0.5 * CELL, CELL)
    cells = np.stack(np.meshgrid(ticks, ticks, ticks), axis=-1).reshape(-1, 3)
    cells = scene.target.position + cells[lengths(cells) < ABOUT]
    cells = cells[~_free(cells, pictures)]
    around = pack([(o.shape, o.position, o.rotation) for o in scene.objects])
    cells = cells[distances(around, cells)[0].min(axis=1) > CELL]
    middle = scene.target.position
    if not len(cells):
        return None
    return SceneObject("unseen", "static", PointCloudShape(cells - middle, 0.5 * CELL), middle)


def _free(points: FloatArray, pictures: Sequence[DepthPicture]) -> BoolArray:
    """Whether one of some pictures measures something behind points (N, 3) in the base frame, or
    nothing about them, as of a far background."""
    out = np.zeros(len(points), dtype=bool)
    for picture in pictures:
        lens, known = picture.camera, most_about(picture.depth, 15) > 0.0
        depth = np.where(known, picture.depth, np.inf)
        local = (points - lens.pose.position) @ lens.pose.rotation
        column, row = np.rint(lens.pixels(local)).astype(int).T
        inside = (row >= 0) & (row < lens.height) & (column >= 0) & (column < lens.width)
        inside &= local[:, 2] > 0.0
        out[inside] |= depth[row[inside], column[inside]] > local[inside, 2] + BEHIND
    return out
