"""What a picture measures and no fruit or stem explains: it is solid.

A depth is a point of a surface. How far the thing behind it reaches nobody saw: it is taken to be
as deep as it is wide in the picture. Leaves, and what is green and a part of a fruit or a stem, are
to be avoided; all else is static.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy import ndimage

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.scenes.objects import SceneObject
from optipromp_eyes.finder import Found, Region, most_about
from optipromp_eyes.fusing import Detection
from optipromp_eyes.geometry import SQUARE, coloured
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import DepthPicture, Image8
from optipromp_eyes.stems import FIRST_GAP, STEEPEST

EVERY = 2  # [pixel] of a row and column that is looked at: a choice that bounds time
FARTHEST = 1.2  # [m] depth that may be within an arm's reach of a camera: a choice
VOXEL = 0.005  # [m] side of the cells, one point each: a choice
DEEPEST = 0.03  # [m] behind a surface that is solid, at most: a choice
LEAST_AREA = 5e-5  # [m²] of a thing: 12 mm of a wire of 4 mm: a choice
ABOUT = 0.008  # [m] about a fruit or stem that its skin and calyx may be: a choice
SAME = 2.5  # half lengths about a fruit's centre, where what a finder tells is its own: a choice
MOSTLY = 0.5  # share of a region that a fruit explains, which then is its own: a choice
WIDE = 2.0  # half widths between stems and fruits, of what is no stem: a choice
BOW = 0.1  # [m] by which a stem leaves its line, for each m from its fruit: a choice
CUT = 1.25  # of what shows of a stem, as far as it may go on: a choice
GREEN = 0.5  # share of a stem that has the colour of stems: a choice
LEAFY = 0.5  # share of a thing that is leaf, above which it yields: a choice
DEVIATIONS = 2.0  # of a depth, by which a surface may be off: a choice
MOST_THINGS = 40  # of a picture; the others together are one: a choice


def solids(
    picture: DepthPicture, found: Found, fruits: Sequence[Detection], up: FloatArray,
    p: EyeParameters,
) -> tuple[tuple[str, SceneObject], ...]:  # fmt: skip
    """What no fruit and no stem explains: column and row in words, and clouds of points in the
    frame of the camera, :data:`VOXEL` apart, the largest first.

    A static cloud has a padding of :data:`DEVIATIONS` of its depth. Left out are depths beyond
    :data:`FARTHEST`, those between two surfaces at an edge, and things below :data:`LEAST_AREA` or
    ``p.patch``.
    """
    whole, thin = picture.depth, (slice(None, None, EVERY),) * 2
    there = ((whole > 0.0) & (whole < FARTHEST) & ~_between(whole, p.step))[thin]
    rays, depth = picture.camera.rays[thin], np.where(there, whole[thin], 0.0)
    error = DEVIATIONS * p.depth_noise * depth**2
    side = EVERY * depth / picture.camera.focal  # of a pixel [m]
    leaf = Region.mask((r for r in found.regions if r.kind == "leaf"), whole.shape)[thin]
    stems = Region.mask(found.stems, whole.shape)[thin] & there
    marks, _ = _parted(stems, depth, p.step)
    seen = rays * depth[..., None]
    own = _stems(marks, picture.rgb[thin], side, seen, picture.camera.focal, fruits, up, p)
    there &= ~_explained(found, fruits, seen, error) & ~most_about(own, 3)
    leaf = most_about(leaf, 3)
    depth = np.where(there, depth, 0.0)
    marks, counts = _parted(there, depth, p.step + error)
    areas = np.bincount(marks.ravel(), side.ravel() ** 2)
    soft = np.bincount(marks[leaf], side[leaf] ** 2, len(areas)) > LEAFY * areas
    large = (areas >= LEAST_AREA) & (EVERY**2 * counts >= p.patch)
    order = 1 + np.argsort(-areas[1:], kind="stable")
    order = order[large[order]]
    number = np.zeros(len(areas), dtype=np.int64)
    number[order] = np.minimum(1 + np.arange(len(order)), MOST_THINGS)
    marks = number[marks]
    inner = ndimage.distance_transform_edt(np.pad(marks > 0, 1))[1:-1, 1:-1]
    clouds = _cells(marks, depth, rays, np.minimum(2.0 * inner * side, DEEPEST))
    out = []
    for k, (cloud, box) in enumerate(zip(clouds, ndimage.find_objects(marks), strict=True), 1):
        mine = marks[box] == k
        row, column = np.argwhere(mine)[int(inner[box][mine].argmax())] + [b.start for b in box]
        leafy = bool(soft[order[k - 1]]) and (k < MOST_THINGS or len(order) == k)
        middle = cloud.mean(axis=0)
        thing = SceneObject(
            f"{'leaf' if leafy else 'unknown'}{k}", "avoid" if leafy else "static",
            PointCloudShape(cloud - middle, VOXEL), middle,
            padding=None if leafy else float(np.median(error[box][mine])),
        )  # fmt: skip
        out.append((f"column {EVERY * column}, row {EVERY * row}", thing))
    return tuple(out)


def _between(depth: FloatArray, step: float) -> BoolArray:
    """The pixels that are before one surface and behind another, as cameras blend them."""
    nearest = -most_about(np.where(depth > 0.0, -depth, -np.inf), 3)
    return np.asarray((most_about(depth, 3) - depth > step) & (depth - nearest > step))


def _parted(
    mask: BoolArray, depth: FloatArray, step: float | FloatArray
) -> tuple[IntArray, IntArray]:
    """Numbers (h, w) from 1 of things whose depths go on without a step; pixels of each, (K,)."""
    nearest = -most_about(np.where(mask, -depth, -np.inf), 3)
    marks, _ = ndimage.label(mask & (depth - nearest < step), SQUARE)
    return marks, np.bincount(marks.ravel())


def _stems(
    marks: IntArray, rgb: Image8, side: FloatArray, points: FloatArray, focal: float,
    fruits: Sequence[Detection], up: FloatArray, p: EyeParameters,
) -> BoolArray:  # fmt: skip
    """The pixels (h, w) of stems on which one of the fruits hangs: what is thin and has the colour
    of stems, of things that are numbered from 1, begins at the fruit or behind it, and leads up
    from it."""
    here = marks > 0
    mine, points = marks[here], points[here]
    inner = ndimage.distance_transform_edt(np.pad(here, 1))[1:-1, 1:-1] * side
    count = np.bincount(mine, minlength=int(marks.max(initial=0)) + 1)
    green = coloured(rgb[here].astype(np.float32), p) >= 2
    stem = np.bincount(mine, green, len(count)) > GREEN * count
    np.logical_and.at(stem, mine, inner[here] < WIDE * p.thin)
    own = np.zeros(len(mine), dtype=bool)
    for each in fruits:
        fit = each.spheroid
        error = DEVIATIONS * p.depth_noise * fit.center[2] ** 2
        off = points - fit.center
        near = lengths(off) < max(fit.radius, fit.half) + FIRST_GAP + error
        border = 1 + 2 * round(FIRST_GAP * focal / fit.center[2])  # [pixel] as near in the picture
        behind = most_about(each.region.pixels, border)[::EVERY, ::EVERY][here] & (off[:, 2] > 0.0)
        begins = np.zeros(len(count), dtype=bool)
        begins[mine[near | behind]] = True
        off = points * (fit.center[2] / points[:, 2:]) - fit.center  # as the picture has it
        own |= begins[mine] & (off @ up > STEEPEST * lengths(off))
    out = np.zeros(marks.shape, dtype=bool)
    out[here] = own & stem[mine]
    return out


def _explained(
    found: Found, fruits: Sequence[Detection], points: FloatArray, error: FloatArray
) -> BoolArray:
    """Whether points (h, w, 3) are of one of the fruits, at its spheroid, or at its stem's line."""
    thin = (slice(None, None, EVERY),) * 2
    out = np.zeros(error.shape, dtype=bool)
    here = points[..., 2] > 0.0
    flat, more = points[here], ABOUT + error[here]
    mine = np.zeros(len(flat), dtype=bool)
    red = [r for r in found.fruits if r.kind == "ripe"]  # no stem has this colour
    for each in fruits:
        fit, shown = each.spheroid, each.region.pixels
        most = (r for r in found.fruits if (shown[r.box] & r.part).sum() > MOSTLY * r.part.sum())
        own = Region.mask(most, shown.shape)
        out |= shown[thin]
        off = flat - fit.center
        along = off @ fit.axis
        aside = lengths(off - along[:, None] * fit.axis)
        mine |= np.hypot(aside / (fit.radius + more), along / (fit.half + more)) < 1.0
        mine |= own[thin][here] & (lengths(off) < SAME * max(fit.radius, fit.half))
        if each.item.stem is not None:
            off, ripe = flat - each.item.stem.points[0], Region.mask(red, shown.shape)[thin][here]
            way = each.item.stem.vector / each.item.stem.length
            along = np.clip(off @ way, 0.0, CUT * each.item.stem.length)
            on = lengths(off - along[:, None] * way) < more + BOW * along
            gap = 0.0 if each.stem is None else each.stem.gap  # where something hides the stem
            mine |= on & ~ripe & ((gap == 0.0) | (along > max(fit.radius, fit.half) + gap))
    out[here] |= mine
    return out


SHIFT, BITS = 1 << 15, 16  # cells are numbered from -SHIFT on, each coordinate in so many bits


def _cells(
    marks: IntArray, depth: FloatArray, rays: FloatArray, deep: FloatArray
) -> list[FloatArray]:
    """Middles (N, 3) of the cells that each thing fills from its surface to so ``deep`` behind."""
    codes = []
    for behind in np.arange(0.0, DEEPEST, VOXEL):
        more = (marks > 0) & (deep > behind)
        code, far = marks[more], (depth[more] + behind) / VOXEL
        for way in rays[more].T:
            code = (code << BITS) + np.floor(way * far).astype(np.int64) + SHIFT
        codes.append(code[np.diff(code, prepend=-1) != 0])  # pixels beside each other share cells
    unique, _ = np.unique(np.concatenate(codes), return_counts=True)  # sorts: faster than hashes
    cells = (unique[:, None] >> np.arange(2 * BITS, -1, -BITS)) % (1 << BITS) - SHIFT
    ends = np.searchsorted(unique >> 3 * BITS, np.arange(1, marks.max(initial=0) + 2))
    return [np.asarray((cells[a:b] + 0.5) * VOXEL) for a, b in pairwise(ends.tolist())]
