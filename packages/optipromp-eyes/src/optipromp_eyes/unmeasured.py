"""Fruits that a picture shows and whose depth nobody measured, as of a shiny skin.

Where such a fruit is tell its breadth in the picture and that of usual fruits: it is solid from the
nearest to the farthest place.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import find_objects

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp.core.geometry.shapes import Cone
from optipromp.core.scenes.objects import SceneObject
from optipromp_eyes.doubts import steepness
from optipromp_eyes.finder import Found, Region, most_about
from optipromp_eyes.geometry import coloured, ellipse_of, morphed, numbered, smooth, without_holes
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import CLOSEST, DepthPicture
from optipromp_eyes.stems import Spheroid

EVERY = 2  # [pixel] of a row and column that is looked at: a choice that bounds time
LONGEST = 2.2  # length over breadth of a fruit: a choice; leaves and stems are longer
DENSEST = 0.85  # area over that of the ellipse of the same spread, at least: a choice
USUAL = 1.5  # deviations of a fruit's radius that the places count: a choice
EDGE = 12.0  # [of 255 a pixel] steepness of colours that bounds a patch: a choice
CLOSED = 0.85  # share of what is about a patch that is edges: a choice
BLURRED = 1.0  # [of EVERY pixels] by which an edge makes a patch smaller: a choice
RING = 3  # [of EVERY pixels] about it, whose farthest depth it is before: a choice
WIDER = 1.3  # outline of a fruit that was measured, whose holes are its own: a choice


def unmeasured(
    picture: DepthPicture, found: Found, fruits: Sequence[Spheroid], p: EyeParameters,
    by_colour: bool,
) -> tuple[tuple[str, SceneObject], ...]:  # fmt: skip
    """Fruits without depth of a picture: column and row in words, and what is solid in the frame
    of the camera.

    They are what a finder found, and ``by_colour`` patches of their colours with edges all about,
    where the finder knows colours alone. Left out is what is in the outline of one of the
    ``fruits`` that were measured, and what a usual fruit would show from beyond ``p.farthest``.
    """
    depth = picture.depth[::EVERY, ::EVERY]
    bounds = depth > 0.0
    masks = [Region.mask(found.fruits, picture.depth.shape)[::EVERY, ::EVERY] & ~bounds]
    if by_colour and not bounds.all():
        rgb = smooth(picture.rgb[::EVERY, ::EVERY])
        bounds |= steepness(rgb) >= 8.0 * EDGE  # the sum of Sobel's weights
        colours = np.zeros(depth.shape, dtype=np.int8)
        colours[~bounds] = coloured(rgb[~bounds].astype(np.float64), p)
        masks += [colours == 1, colours == 2]
    out: list[tuple[str, SceneObject]] = []
    for marks in (numbered(morphed(mask, "OPEN")) for mask in masks):
        large = EVERY**2 * np.bincount(marks.ravel()) >= p.least_pixels
        for number, box in enumerate(find_objects(marks), 1):
            if not large[number]:
                continue
            whole = without_holes(patch := marks[box] == number)
            long, broad, area = ellipse_of(whole)
            if long > LONGEST * broad or whole.sum() < DENSEST * area:
                continue
            if by_colour and not _ringed(box, patch, bounds):
                continue
            row, column = (
                EVERY * (part.start + float(places.mean()))
                for part, places in zip(box, np.nonzero(patch), strict=True)
            )
            radius = EVERY * (math.sqrt(patch.sum() / math.pi) + BLURRED)
            about = tuple(slice(max(b.start - RING, 0), b.stop + RING) for b in box)
            place = np.array([column, row])
            solid = _solid(picture, place, radius, float(depth[about].max()), fruits, p)
            if solid is not None:
                item = SceneObject(f"unmeasured{len(out) + 1}", "static", *solid)
                out.append((f"column {column:.0f}, row {row:.0f}", item))
    return tuple(out)


def _ringed(box: tuple[slice, ...], patch: BoolArray, edges: BoolArray) -> bool:
    """Whether a patch has edges of colours about it, and not the border of the picture."""
    if any(b.start == 0 or b.stop == n for b, n in zip(box, edges.shape, strict=True)):
        return False
    wide = np.pad(patch, 1)
    ring = most_about(wide, 3) & ~wide
    return bool(edges[tuple(slice(b.start - 1, b.stop + 1) for b in box)][ring].mean() > CLOSED)


def _solid(
    picture: DepthPicture, place: FloatArray, radius: float, behind: float,
    fruits: Sequence[Spheroid], p: EyeParameters,
) -> tuple[Cone, FloatArray, FloatArray] | None:  # fmt: skip
    """Shape, place and orientation of where a fruit may be that shows a ``radius`` [pixel] at a
    ``place`` (column, row), ``behind`` it a depth [m], 0: none; None: it is none, or far."""
    lens, focal = picture.camera, picture.camera.focal
    for fit in fruits:
        away = float(np.linalg.norm(lens.pixels(fit.center) - place))
        if away + radius < WIDER * focal * max(fit.radius, fit.half) / fit.center[2]:
            return None
    spread = math.exp(USUAL * p.radius_spread)
    low, high = max(p.radius / spread, p.least_radius), min(p.radius * spread, p.most_radius)
    near, far = low * focal / radius, high * focal / radius
    if behind > 0.0:
        far = min(far, max(behind, near) + high)
    if far < CLOSEST or p.radius * focal / radius > p.farthest:
        return None
    ray = lens.through(place)
    ray /= np.linalg.norm(ray)
    shape = Cone(far * radius / focal, near * radius / focal, far - near)
    return shape, 0.5 * (near + far) * ray, frame_along(ray)
