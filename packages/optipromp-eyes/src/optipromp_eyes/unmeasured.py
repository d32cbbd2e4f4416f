"""Fruits that a picture shows and whose depth nobody measured, as of a shiny skin.

Where such a fruit is tell its breadth in the picture and that of usual fruits: it is solid from the
nearest to the farthest place.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from optipromp.core.arrays import BoolArray, FloatArray, frame_along
from optipromp.core.geometry.shapes import Cone
from optipromp.core.scenes.objects import SceneObject
from optipromp_eyes.doubts import steepness
from optipromp_eyes.finder import Found
from optipromp_eyes.fusing import Sighting
from optipromp_eyes.geometry import SQUARE, coloured, smooth
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
RING = 3  # [pixel] about it, looked at, whose farthest depth it is before: a choice


class Unmeasured(NamedTuple):
    """A round patch of the colour of fruits without depth: its middle (column, row), and what is
    solid, in the frame of the camera."""

    pixel: tuple[int, int]
    item: SceneObject


def unmeasured(
    picture: DepthPicture,
    found: Found,
    fruits: Sequence[Spheroid],
    p: EyeParameters,
    by_colour: bool,
) -> tuple[Unmeasured, ...]:
    """Fruits without depth of a picture: what a finder found there, and ``by_colour`` patches of
    their colours with edges all about, where the finder knows colours alone.

    Left out is what is in the outline of one of the ``fruits`` that were measured, and what a usual
    fruit would show from beyond ``p.farthest``.
    """
    depth = picture.depth[::EVERY, ::EVERY]
    missing = depth == 0.0
    if not missing.any():
        return ()
    shown = np.zeros(picture.depth.shape, dtype=bool)
    for region in found.fruits:
        shown[region.box] |= region.part
    masks, bounds = [missing & shown[::EVERY, ::EVERY]], ~missing
    if by_colour:
        rgb = smooth(picture.rgb[::EVERY, ::EVERY])
        bounds |= steepness(rgb) >= 8.0 * EDGE  # the sum of Sobel's weights
        colours = np.zeros(depth.shape, dtype=np.int8)
        colours[~bounds] = coloured(rgb[~bounds], p)
        masks += [colours == 1, colours == 2]
    patches = [
        (box, marks[box] == number)
        for marks in (ndimage.label(ndimage.binary_opening(mask, SQUARE))[0] for mask in masks)
        for number, box in enumerate(ndimage.find_objects(marks), 1)
    ]
    out: list[Unmeasured] = []
    for box, patch in patches:
        if EVERY**2 * patch.sum() < p.least_pixels or not _is_round(patch):
            continue
        if by_colour and not _ringed(box, patch, bounds):
            continue
        pixel = tuple(
            EVERY * (part.start + float(place.mean()))
            for part, place in zip(box[::-1], np.nonzero(patch)[::-1], strict=True)
        )
        radius = EVERY * (math.sqrt(patch.sum() / math.pi) + BLURRED)
        around = tuple(slice(max(b.start - RING, 0), b.stop + RING) for b in box)
        solid = _solid(picture, pixel, radius, depth[around], p)
        known = [one.pixel for one in out]
        if solid is None or _explained(picture, pixel, radius, fruits):
            continue
        if all(math.dist(pixel, other) > radius for other in known):
            item = SceneObject(f"unmeasured{len(out) + 1}", "static", *solid)
            out.append(Unmeasured((round(pixel[0]), round(pixel[1])), item))
    return tuple(out)


def _is_round(patch: BoolArray) -> bool:
    whole = ndimage.binary_fill_holes(patch)
    small, large = np.linalg.eigvalsh(np.cov(np.vstack(np.nonzero(whole))))
    ellipse = 4.0 * math.pi * math.sqrt(max(small * large, 1e-9))
    return bool(large <= LONGEST**2 * small and whole.sum() >= DENSEST * ellipse)


def _ringed(box: tuple[slice, ...], patch: BoolArray, edges: BoolArray) -> bool:
    """Whether a patch has edges of colours about it, and not the border of the picture."""
    if any(b.start == 0 or b.stop == n for b, n in zip(box, edges.shape, strict=True)):
        return False
    wide = np.pad(patch, 1)
    ring = ndimage.binary_dilation(wide, SQUARE) & ~wide
    about = tuple(slice(b.start - 1, b.stop + 1) for b in box)
    return bool(edges[about][ring].mean() > CLOSED)


def _solid(
    picture: DepthPicture, pixel: Sequence[float], radius: float, ring: FloatArray,
    p: EyeParameters,
) -> tuple[Cone, FloatArray, FloatArray] | None:  # fmt: skip
    """Shape, place and orientation of where a fruit of a ``radius`` [pixel] may be; None: no fruit
    that is near is so large or so small."""
    focal, known = 0.5 * (picture.camera.fx + picture.camera.fy), ring[ring > 0.0]
    spread = math.exp(USUAL * p.radius_spread)
    low, high = max(p.radius / spread, p.least_radius), min(p.radius * spread, p.most_radius)
    near, far = low * focal / radius, high * focal / radius
    if known.size:
        far = min(far, max(float(known.max()) + high, near + high))
    if far < CLOSEST or p.radius * focal / radius > p.farthest:
        return None
    ray = picture.camera.through(np.array(pixel))
    ray /= np.linalg.norm(ray)
    tip, wide = near * radius / focal, far * radius / focal
    return Cone(wide, tip, far - near), 0.5 * (near + far) * ray, frame_along(ray)


def _explained(
    picture: DepthPicture, pixel: Sequence[float], radius: float, fruits: Sequence[Spheroid]
) -> bool:
    """Whether a patch is in the outline of a fruit that was measured."""
    focal = 0.5 * (picture.camera.fx + picture.camera.fy)
    for fit in fruits:
        away = float(np.linalg.norm(picture.camera.pixels(fit.center) - pixel))
        if away + radius < 1.3 * focal * max(fit.radius, fit.half) / fit.center[2]:
            return True
    return False


def hidden_in(sights: Sequence[Sighting], fruits: Sequence[SceneObject]) -> Iterator[SceneObject]:
    """What is solid in the base frame, where no picture measured one of the ``fruits``."""
    places = np.array([item.position for item in fruits]).reshape(-1, 3)
    for k, sight in enumerate(sights):
        for item in sight.unmeasured:
            there = item.transformed(sight.look.camera)
            local = np.abs((places - there.position) @ there.rotation)
            if not (local <= there.shape.measure.half).all(axis=1).any():
                name = item.id if len(sights) == 1 else f"{item.id}-{k + 1}"
                yield replace(there, id=name)


def told_of(some: Sequence[Unmeasured]) -> list[str]:
    """What is said of them."""
    if not some:
        return []
    places = ", ".join(f"column {column}, row {row}" for (column, row), _ in some)
    return [
        f"of the colour of fruits, and without depth, at {places}: solid where a fruit of usual "
        "size would be; take another picture from aside, and look at both with --together"
    ]
