"""The judge's view of passing: on which side the tool goes past each pushable, and how far off.

A part of :mod:`optipromp.metrics`, and like it apart from the planner: positions of the tool go in,
the figures M_p and y_g·S_n and what is wrong come out.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit

from optipromp.arrays import BoolArray, FloatArray, joined, lengths
from optipromp.scenes.scene import Scene

DECIDED = np.sin(np.deg2rad(1.0))  # a stem leans to a side when this share of it is lateral


def passing(
    scene: Scene,
    tips: FloatArray,
    rims: FloatArray,
    gripper_radius: float,
    violations: list[str],
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """M_p at the knot where the tool passes each pushable (the last passage), and y_g·S_n.

    Neither the tool point nor the rim (T, 3), which decides where a fruit ends, may pass a pushable
    on the side of its stem. Of a pushable so close under the target that the rim takes in the one
    while the tool point passes the other, the rim alone is asked.
    """
    things, rows = scene.pushables, scene.rows("pushable")
    if not things:
        return {}, {}
    ids = [thing.id for thing in things]
    places, radii = scene.positions[rows], scene.bounds[rows]
    lateral, up = scene.frame[1], scene.frame[2]
    passed, tip = last_passages(tips, places, up)
    m_p = _known(ids, tip @ lateral, passed)

    hangs = np.array([thing.stem is not None for thing in things])
    stems = np.zeros((len(things), 3))
    stems[hangs] = _first_pieces([thing.stem.points for thing in things if thing.stem is not None])
    flat = stems - (stems @ up)[:, None] * up
    leans = lengths(flat) >= DECIDED * lengths(stems)
    leans &= hangs

    rim_passed, rim = last_passages(rims, places, up)
    in_the_way, closely_under = _around_target(
        scene, places, radii, float((rims[-1] - tips[-1]) @ up), gripper_radius
    )

    def wrong(at: FloatArray) -> BoolArray:
        near = lengths(at) < radii + 2.0 * gripper_radius
        return np.asarray((near | in_the_way) & (np.einsum("ki,ki->k", at, flat) > 0.0))

    bad = rim_passed & wrong(rim) | passed & ~closely_under & wrong(tip)
    violations += [
        f"the tool passes {ids[k]} on the side of its stem"
        for k in np.flatnonzero(leans & bad).tolist()
    ]
    return m_p, _known(ids, stems @ lateral, hangs)


def _known(ids: Sequence[str], values: FloatArray, known: BoolArray) -> dict[str, float | None]:
    """Values (K,) by id, None where they are not known."""
    found = values.astype(object)
    found[~known] = None
    return dict(zip(ids, found.tolist(), strict=True))


def _first_pieces(stems: Sequence[FloatArray]) -> FloatArray:
    """From the first point of each stem (k, 3) to its second (H, 3)."""
    points = joined(stems).reshape(-1, 3)
    count = np.array([len(stem) for stem in stems], dtype=np.int64)
    first = np.cumsum(count) - count
    return np.asarray(points[first + 1] - points[first])


def _around_target(
    scene: Scene, places: FloatArray, radii: FloatArray, depth: float, gripper_radius: float
) -> tuple[BoolArray, BoolArray]:
    """Of pushables at ``places`` (K, 3): how they are placed to the target.

    Whether a straight approach would push them (method §4, 1), and whether the rim, ``depth`` over
    the tool point, takes in the target as that passes them.
    """
    if scene.target is None:
        nowhere = np.zeros(len(places), dtype=bool)
        return nowhere, nowhere
    up = scene.frame[2]
    off = places - scene.target.position
    along = off @ up
    aside = lengths(off - along[:, None] * up)
    in_the_way = (along >= -0.2) & (along < 0.0) & (aside <= 1.5 * gripper_radius)
    return in_the_way, -along < depth + scene.target.radius + radii


def last_passages(
    path: FloatArray, places: FloatArray, up: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Whether a path (T, 3) crosses the level planes of ``places`` (K, 3), and where at last.

    Returns:
        (K,) whether it does, and (K, 3) where, from the place, its knot nearest the last crossing
        is, without its height; zero where there is none.
    """
    passed, at = np.zeros(len(places), dtype=np.bool_), np.zeros((len(places), 3))
    _last_passages(np.array(path), np.array(places), np.array(up), passed, at)
    return passed, at


@njit(cache=True, error_model="numpy", nogil=True)
def _last_passages(path, places, up, passed, at):  # type: ignore[no-untyped-def]
    """:func:`last_passages` in place; what is above or below the whole path is not looked at."""
    heights = path[:, 0] * up[0] + path[:, 1] * up[1] + path[:, 2] * up[2]
    lowest, highest = heights.min() - 1e-9, heights.max() + 1e-9
    for k in range(places.shape[0]):
        p = places[k]
        level = p[0] * up[0] + p[1] * up[1] + p[2] * up[2]
        if not lowest <= level <= highest:
            continue
        after = _over(path[-1], p, up)
        for before in range(path.shape[0] - 2, -1, -1):
            height = _over(path[before], p, up)
            if np.sign(height) != np.sign(after):
                knot, off = before, height
                if abs(after) < abs(height):
                    knot, off = before + 1, after
                passed[k] = True
                for i in range(3):
                    at[k, i] = path[knot, i] - p[i] - off * up[i]
                break
            after = height


@njit(cache=True, error_model="numpy", nogil=True)
def _over(point, place, up):  # type: ignore[no-untyped-def]
    """Height of a point over a place [m]."""
    x, y, z = point[0] - place[0], point[1] - place[1], point[2] - place[2]
    return x * up[0] + y * up[1] + z * up[2]
