"""Fruits and stems by colour, depth and width; no model file, nothing learnt."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.compiled import kernel
from optipromp_eyes.finder import Class, Found, Region, box_of, largest, most_about
from optipromp_eyes.needed import opencv
from optipromp_eyes.parameters import Colour, EyeParameters
from optipromp_eyes.pictures import DepthPicture, Image8

SQUARE = np.ones((3, 3), dtype=bool)
MARGIN = 3  # [pixel] about a fruit, in which its holes are filled: a choice
HOLE = 4  # [pixel] from a depth, within which colours count where none was measured: a choice
RAGGED = 2  # [pixel] by which edges of depth are ragged: a choice
WALL = 1.2  # radii of the largest fruit inside a surface that is a wall: a choice
REACH = 1.6  # radii of the ball inside a fruit up to which the fruit goes: a choice
LARGE = 4.0  # areas of the largest fruit's disc that no fruit has, be it twice as long: a choice
MOST_BALLS = 512  # of an island: a choice; pictures of rows have up to 196
MOST_WORK = 3  # areas of the picture that the boxes of islands have together; rows have 1.8


@dataclass(frozen=True)
class ByGeometry:
    """A finder that needs colours, depths and sizes only.

    Pixels of the colours of fruits are cut apart where the depth jumps. What is wider than a stem
    is a fruit; fruits that touch are parted at their necks (the power diagram of the largest discs
    inside). What is left of the colours of stems is stem. Of too many fruits the largest
    are regions, see :func:`optipromp_eyes.finder.largest`.
    """

    parameters: EyeParameters = field(default_factory=EyeParameters)

    def find(self, picture: DepthPicture) -> Found:
        """The fruits of a picture, and one region of all its stems."""
        p = self.parameters
        near = (picture.depth > 0.0) & (picture.depth < p.farthest)
        box = box_of(near, HOLE)
        near = near[box]
        close = most_about(near, 2 * HOLE + 1)
        rgb = smooth(picture.rgb[box])
        colours = np.zeros(close.shape, dtype=np.int8)
        colours[close] = coloured(rgb[close], p)
        ripe, green = colours == 1, colours == 2
        depth = _filled(np.where(near, picture.depth[box], 0.0), ripe | green)
        stems = np.zeros(picture.depth.shape, dtype=bool)
        stems[box] = (colours >= 2) & near
        kinds: tuple[tuple[Class, BoolArray], ...] = (("ripe", ripe), ("unripe", green))
        known = np.where(depth > 0.0, -depth, -np.inf)
        least = np.maximum(p.step, 3.0 * p.depth_noise * depth**2)  # [m] that is no error: a choice
        steps = depth + most_about(known, 3) > least  # the nearer side keeps its edge
        left_out = 0
        found: list[tuple[Class, tuple[slice, ...], BoolArray]] = []
        for kind, mask in kinds:
            parts, left = self._parted(mask, colours == 0, depth, steps, picture.camera.focal)
            found += [(kind, part, pixels) for part, pixels in parts]
            left_out += left
        regions = []
        for k in largest(np.array([pixels.sum() for _, _, pixels in found])):
            kind, part, pixels = found[k]
            stems[box][part] &= ~pixels
            rows, columns = (
                slice(b.start + c.start, b.stop + c.start) for b, c in zip(part, box, strict=True)
            )
            score = min(float(pixels.sum()) / ellipse_of(pixels)[2], 1.0)  # of a half about 0.7
            regions.append(Region(kind, pixels, score, (rows, columns), picture.depth.shape))
        left_out += len(found) - len(regions)
        regions.sort(key=lambda region: -region.score)
        return Found((*regions, Region("stem", stems, 1.0)), left_out)

    def _parted(
        self, mask: BoolArray, plain: BoolArray, depth: FloatArray, steps: BoolArray, focal: float
    ) -> tuple[list[tuple[tuple[slice, ...], BoolArray]], int]:
        """The largest fruits among the pixels of one colour: boxes, and the pixels in them; and
        how many others there are. Of ``plain`` pixels, of no colour, those that a fruit encloses
        and that are not behind it are its gloss. Islands end at ``steps`` of depth."""
        p = self.parameters
        islands = numbered(morphed(mask, "CLOSE") & ~steps)
        parts = np.zeros(mask.shape, dtype=np.int64)
        areas = np.bincount(islands.ravel(), (depth / focal).ravel() ** 2)[1:]  # [m²]
        boxes = ndimage.find_objects(islands)
        wide = np.flatnonzero(areas > math.pi * p.thin**2)
        wide = wide[np.argsort(-areas[wide], kind="stable")]
        work = np.cumsum([islands[boxes[row]].size for row in wide], dtype=np.int64)
        rows = np.sort(wide[work <= MOST_WORK * mask.size])
        left_out, count = len(wide) - len(rows), 0
        for row in rows:
            box = boxes[row]
            island, far = islands[box] == row + 1, depth[box]
            front = far[island]
            gloss = without_holes(island) & plain[box] & (far < front.max() + p.step)
            far = np.where(gloss & (far == 0.0), middle_of(front), far)
            fruits, left = _part(island | gloss, far / focal, p)
            parts[box] += np.where(fruits > 0, fruits + count, 0)
            count, left_out = count + int(fruits.max()), left_out + left
        grown = most_about(parts, 2 * RAGGED + 1)
        parts = np.where(mask & (parts == 0), grown, parts)
        boxes, sizes = ndimage.find_objects(parts), np.bincount(parts.ravel(), minlength=1)[1:]
        out, chosen = [], largest(sizes)
        for row in chosen:
            if boxes[row] is not None:
                box = tuple(slice(max(b.start - MARGIN, 0), b.stop + MARGIN) for b in boxes[row])
                pixels = without_holes(parts[box] == row + 1)
                if pixels.sum() >= p.least_pixels:
                    out.append((box, pixels))
        return out, left_out + int(np.sum(np.delete(sizes, chosen) >= p.least_pixels))


def _part(island: BoolArray, metres: FloatArray, p: EyeParameters) -> tuple[IntArray, int]:
    """Numbers (h, w) from 1 of the fruits of an island of one colour and surface, 0: none; and how
    many peaks beyond :data:`MOST_BALLS` are left out, the narrowest.

    Each peak of the distance from the edge is the middle of a ball. A pixel belongs to the ball
    with the least power (square of the distance from the middle, less that of the radius): the cut
    between two discs that overlap. A ball is compared within the reach of the largest only: beyond
    it no pixel is of any ball.
    """
    edge = distance_in(np.pad(island, 1))[1:-1, 1:-1]
    core = edge * metres > p.thin
    if not core.any():
        return np.zeros(island.shape, dtype=np.int64), 0
    wall = edge * metres > WALL * p.most_radius
    if wall.any():  # look at what is beside it
        within = distance_in(~wall) * metres <= 1.1 * WALL * p.most_radius
        return _part(island & ~within, metres, p)
    smooth = ndimage.gaussian_filter(edge, 1.0)
    peaks = np.argwhere((smooth == most_about(smooth, 5)) & core)
    radii = edge[peaks[:, 0], peaks[:, 1]]
    island = island & (distance_in(~core) * metres <= p.thin)  # without its stem
    order = np.argsort(-radii, kind="stable")
    balls: tuple[IntArray, int] = _balls(island, peaks[order], radii[order])
    return balls


@kernel
def _balls(island, peaks, radii):
    """See :func:`_part`: of ``peaks`` (K, 2) those that no ball before them encloses."""
    high, wide = island.shape
    parts, least = np.zeros((high, wide), dtype=np.int64), np.full((high, wide), np.inf)
    left, count = np.ones(len(peaks), dtype=np.bool_), 0
    reach = math.ceil(REACH * radii[0]) if len(radii) else 0
    for k in range(len(peaks)):
        if not left[k] or count == MOST_BALLS:
            continue
        count += 1
        (row, column), square = peaks[k], radii[k] ** 2
        for i in range(max(row - reach, 0), min(row + reach + 1, high)):
            for j in range(max(column - reach, 0), min(column + reach + 1, wide)):
                power = (i - row) ** 2 + (j - column) ** 2 - square
                if power < least[i, j]:
                    least[i, j] = power
                    within = island[i, j] and power < (REACH**2 - 1.0) * square
                    parts[i, j] = count if within else 0
        for n in range(k, len(peaks)):
            if math.hypot(peaks[n, 0] - row, peaks[n, 1] - column) <= radii[k]:
                left[n] = False
    return parts, left.sum()


def smooth(rgb: Image8) -> NDArray[np.float32]:
    """Colours (height, width, 3) without their grain, as they are judged."""
    grain = 0.7  # [pixel] a choice
    cv, fine = opencv(), rgb.astype(np.float32)
    return np.asarray(cv.GaussianBlur(fine, (3, 3), grain, borderType=cv.BORDER_REFLECT))


def off(colour: Colour, hue: FloatArray, dye: FloatArray, bright: FloatArray) -> FloatArray:
    """How far pixels (N,) are from a colour, in its widths; it has them below 1."""
    far = apart(hue, colour.hue) / np.float32(colour.width)
    if colour.dye_width == colour.bright_width == np.inf:
        return far
    pale = (dye - colour.dye) / colour.dye_width
    dark = (bright - colour.bright) / colour.bright_width
    return np.asarray(np.sqrt(far**2 + pale**2 + dark**2))


def coloured(rgb: FloatArray, p: EyeParameters) -> NDArray[np.int8]:
    """Row (N,), from 1, of :attr:`EyeParameters.colours` that each pixel (N, 3) has; 0: none."""
    hue, dye, bright = hsv(rgb)
    out, least = np.zeros(len(hue), dtype=np.int8), np.ones(len(hue), dtype=np.float32)
    for row, colour in enumerate(p.colours, start=1):
        if colour.width == 0.0:
            continue
        far = off(colour, hue, dye, bright)
        nearer = far < least
        out[nearer], least[nearer] = row, far[nearer]
    out[(dye <= p.least_dye) | (bright <= p.least_bright)] = 0
    return out


def hsv(rgb: NDArray[Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hue [deg], saturation and value (0 to 1) of pixels (N, 3) of 0 to 255."""
    if not len(rgb):
        return rgb[:, 0], rgb[:, 1], rgb[:, 2]
    flat = (rgb / np.float32(255.0)).astype(np.float32)[:, None]
    hue, dye, bright = opencv().cvtColor(flat, opencv().COLOR_RGB2HSV).reshape(-1, 3).T
    return hue, dye, bright


def _filled(depth: FloatArray, where: BoolArray) -> FloatArray:
    """Depths, each hole at ``where`` (0) with that of the nearest pixel that has one."""
    out = depth.astype(np.float32)
    none = np.float32(1e9)  # [m] not infinite: beyond the border OpenCV has a finite number
    for _ in range(HOLE):
        near = opencv().erode(np.where(out > 0.0, out, none), np.ones((3, 3), np.uint8))
        out = np.where(where & (out == 0.0) & (near < none), near, out)
    return np.asarray(out, dtype=np.float64)


def apart(hue: FloatArray, middle: float) -> FloatArray:
    """Difference of hues on their circle [deg]."""
    far = np.abs(hue - middle)
    return np.asarray(np.minimum(far, 360.0 - far))


def is_large(picture: DepthPicture, region: Region, p: EyeParameters) -> bool:
    """Whether a region is larger than the largest fruit, and so none, before it is fitted."""
    depth = picture.depth[region.box][region.part]
    depth = depth[depth > 0.0]
    far = float(middle_of(depth)) if len(depth) else 0.0
    area = len(depth) * far**2 / (picture.camera.fx * picture.camera.fy)
    return area > LARGE * math.pi * p.most_radius**2


def is_green(picture: DepthPicture, region: Region, p: EyeParameters) -> bool:
    """Whether most of a region has the colour of unripe fruits or of stems."""
    green = coloured(picture.rgb[region.box][region.part].astype(np.float32), p) >= 2
    return bool(green.size and green.mean() > 0.5)


def morphed(mask: BoolArray, name: str, kernel: BoolArray = SQUARE, times: int = 1) -> BoolArray:
    """A mask (h, w) after ``ERODE``, ``OPEN`` or ``CLOSE``; no pixel beyond its border counts."""
    cv, form = opencv(), kernel.astype(np.uint8)
    out = cv.morphologyEx(
        mask.astype(np.uint8), getattr(cv, f"MORPH_{name}"), form, iterations=times,
        borderType=cv.BORDER_CONSTANT, borderValue=0,
    )  # fmt: skip
    return np.asarray(out, dtype=bool)


def numbered(mask: BoolArray, sides: int = 4) -> IntArray:
    """Numbers (h, w), from 1, of the islands of a mask, whose pixels share a side, or with 8
    ``sides`` a corner; 0: none."""
    cv = opencv()  # by SAUF the numbers ascend from the top left
    out = cv.connectedComponentsWithAlgorithm(mask.astype(np.uint8), sides, cv.CV_32S, cv.CCL_SAUF)
    return np.asarray(out[1])


def without_holes(mask: BoolArray) -> BoolArray:
    """A mask (h, w) and what it encloses."""
    wide = np.pad(mask.astype(np.uint8), 1)
    opencv().floodFill(wide, None, (0, 0), 2)  # what is outside
    return np.asarray(wide[1:-1, 1:-1] != 2)


def distance_in(mask: BoolArray) -> FloatArray:
    """Distances (h, w) [pixel] of the pixels of a mask from the nearest that is none of it."""
    cv = opencv()
    far = cv.distanceTransform(mask.astype(np.uint8), cv.DIST_L2, cv.DIST_MASK_PRECISE)
    return np.asarray(np.sqrt(np.rint(np.square(far, dtype=np.float64))))  # squares are whole


def ellipse_of(mask: BoolArray) -> tuple[float, float, float]:
    """Length, breadth and area [pixel] of the ellipse of the same spread as a mask (h, w)."""
    m = opencv().moments(mask.astype(np.uint8), True)
    one, two, both = (m[name] / max(m["m00"] - 1.0, 1.0) for name in ("mu20", "mu02", "mu11"))
    apart = math.hypot(one - two, 2.0 * both)
    long, broad = (4.0 * math.sqrt(max(0.5 * (one + two + s * apart), 0.0)) for s in (1.0, -1.0))
    return long, broad, 4.0 * math.pi * math.sqrt(max(one * two - both**2, 1e-9))


def middle_of(values: FloatArray) -> Any:
    """The median of the first axis of a few values; sooner than by NumPy's."""
    ordered, count = np.sort(values, axis=0), len(values)
    return 0.5 * (ordered[(count - 1) // 2] + ordered[count // 2])


def edge_of(pixels: BoolArray) -> BoolArray:
    """The pixels just inside the edge of a region."""
    return np.asarray(pixels & most_about(~pixels, 3))
