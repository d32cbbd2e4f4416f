"""Eyes taught by a few fruits and stems that somebody marks in pictures: colours and sizes."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, short, suggest
from optipromp.core.scenes.crops import Crop, crop_from_dict, crop_to_dict
from optipromp_eyes.detector import BAND, cut, of_coco, picture_name
from optipromp_eyes.finder import Class, box_of
from optipromp_eyes.geometry import HOLE, coloured, hsv, off, smooth
from optipromp_eyes.parameters import Colour, EyeParameters
from optipromp_eyes.pictures import DepthPicture

FEWEST = 3  # ripe fruits that must be marked: a choice
LEAST_PIXELS = 8  # of a mark, with a depth: a choice
MOST_PIXELS = 400  # of a mark, that are looked at: a choice
INNER = 0.75  # share of a box whose ellipse is surely fruit: a choice
ALIKE = 30.0, 0.4, 1.5  # of hue [deg], saturation, brightness about a click: its fruit's: a choice
PALE = 0.2  # saturation below which a hue is noise: a choice
STEM_REACH, FRUIT_REACH = 6, 300  # [pixel] about a click: a choice
QUANTILE, WIDER = 0.7, 2.5  # of differences from a middle, and a width over that: choices
FLOOR = 20.0, 0.08, 0.12  # least widths, because light changes: a choice
MOST_WIDE = 180.0, 1.0, 1.0
MINE = 0.6  # share of a mark's pixels that must be of its kind: a choice
RIGHT = {"ripe": 0.9, "unripe": 0.9, "stem": 0.6}
"""Share of the marks of a kind that must be told right: a choice."""
CLIMBS = 8  # discs from a click to the middle of its fruit: a choice


class Mark(NamedTuple):
    """A fruit or a stem that is marked in a picture.

    ``box``: left, top, right, bottom [pixel]; of a click, a box without width and height.
    """

    picture: str
    kind: Class
    box: tuple[float, float, float, float]

    def seen(self, step: int) -> "Mark":
        """The mark in a picture of which every ``step``-th row and column is looked at."""
        left, top, right, bottom = (value / step for value in self.box)
        return self._replace(box=(left, top, right, bottom))


MARKED: Mapping[str, Class] = {"ripe": "ripe", "unripe": "unripe", "stem": "stem"}


class _Sample(NamedTuple):
    kind: Class
    rgb: FloatArray  # (N, 3) 0 to 255
    depth: float  # of its front [m]
    radius: float  # [m]; nan of a stem
    longer: float  # length over width; nan of a stem, and of a click


def read_marks(path: Path) -> list[Mark]:
    """The marks of a JSON or YAML file: COCO, or a list of ``picture``, ``kind`` (ripe, unripe or
    stem), and ``box`` (left, top, right, bottom) or ``at`` (column, row).

    Raises:
        InvalidRequestError: a file that is neither, or a mark that cannot be used.
    """
    holds = "a list of marks (picture, kind, box or at), or COCO (images, annotations, categories)"
    document = read_document(path, InvalidRequestError, holds)
    try:
        if isinstance(document, dict) and "annotations" in document:  # COCO; others are left out
            marks = [
                {"picture": name, "kind": each.kind, "box": each.box}
                for name, things in of_coco(document, str(path)).items()
                for each in things
                if each.kind in MARKED
            ]
        else:
            marks = document
        return [_mark(each, f"{path}: mark {row}") for row, each in enumerate(marks, start=1)]
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(f"{path}: must be {holds} ({error!r})") from None


def _mark(given: dict[str, Any], where: str) -> Mark:
    kind, place = given["kind"], given["box"] if "box" in given else 2 * list(given["at"])
    box = tuple(float(number) for number in place)
    if kind not in MARKED:
        raise InvalidRequestError(f"{where}: kind is {short(kind)}: {suggest(kind, MARKED)}")
    if len(box) != 4 or not np.isfinite(box).all() or box[2] < box[0] or box[3] < box[1]:
        raise InvalidRequestError(
            f"{where}: {short(place)} must be left, top, right, bottom, or at: column, row [pixel]"
        )
    return Mark(picture_name(str(given["picture"])), MARKED[kind], box)


def taught(
    name: str, like: Crop, pictures: Mapping[str, DepthPicture], marks: Sequence[Mark]
) -> tuple[Crop, tuple[str, ...]]:
    """A crop with the colours and sizes of what is marked, else that which it is ``like``; and what
    was learnt, in words.

    Boxes stand upright about whole fruits. Ripe and unripe fruits are told apart by hue where that
    tells all that are marked, else by hue, saturation and brightness.

    Raises:
        InvalidRequestError: too few marks, a mark where nothing was measured or in no picture, or
            kinds that cannot be told apart by colour; then with what their colours are.
    """
    samples = []
    for mark in marks:
        if mark.picture not in pictures:
            raise InvalidRequestError(
                f"a mark is in {mark.picture!r}, which is no picture: "
                f"{suggest(mark.picture, pictures)}"
            )
        samples.append(_sample(pictures[mark.picture], mark))
    count = {kind: sum(each.kind == kind for each in samples) for kind in MARKED}
    if count["ripe"] < FEWEST:
        raise InvalidRequestError(
            f"{count['ripe']} ripe fruits are marked: mark at least {FEWEST}, better ten, and as "
            "many unripe ones and stems"
        )
    colours, how = _colours(samples)
    fruits = [each for each in samples if each.kind != "stem"]
    wide = np.array([2.0 * each.radius for each in fruits if each.kind == "ripe"])
    all_radii = np.array([each.radius for each in fruits])
    long = np.array([each.longer for each in fruits if math.isfinite(each.longer)])
    source = f"taught by {', '.join(f'{n} {kind}' for kind, n in count.items() if n)}"
    usual = EyeParameters()
    eyes: dict[str, Any] = colours | {
        "radius_spread": round(float(np.clip(np.log(all_radii).std(), 0.15, 0.5)), 3),
        "least_radius": round(0.6 * float(all_radii.min()), 5),
        "most_radius": round(1.7 * float(all_radii.max()), 5),
        "farthest": round(max(usual.farthest, 1.3 * max(each.depth for each in samples)), 2),
        "source": source,
    }
    document = crop_to_dict(like) | {"name": name, "eyes": eyes}
    for row, unit, values in (("width", "m", wide), ("elongation", "1", long)):
        if len(values):
            spread = float(values.std(ddof=1)) if len(values) > 1 else 0.0
            document[row] = {
                "value": round(float(np.median(values)), 5), "unit": unit,
                "spread": round(spread, 5), "source": source,
            }  # fmt: skip
    told = (
        f"width {1e3 * np.median(wide):.0f} mm ({1e3 * wide.min():.0f} to {1e3 * wide.max():.0f})"
    )
    return crop_from_dict(document, "from marks"), (how, told)


def _sample(picture: DepthPicture, mark: Mark) -> _Sample:
    left, top, right, bottom = mark.box
    middle, size = (
        np.array([top + bottom, left + right]) / 2.0,
        np.array([bottom - top, right - left]),
    )
    if click := bool(size.max() < 1.0):
        pixels, radius = _about(picture, np.rint(middle).astype(int), mark.kind)
    else:
        pixels, radius = cut(picture, mark.box, thin=mark.kind == "stem"), 0.5 * float(size[1])
        if mark.kind != "stem":
            rows = np.argwhere(pixels)
            rows = rows[np.linalg.norm((rows - middle) / size, axis=1) > 0.5 * INNER]
            pixels[rows[:, 0], rows[:, 1]] = False
    rows = np.argwhere(pixels & (picture.depth > 0.0))
    if len(rows) < LEAST_PIXELS:
        raise InvalidRequestError(
            f"{mark.picture}: at column {middle[1]:.0f}, row {middle[0]:.0f} ({mark.kind}) next "
            "to no depth was measured: mark another one"
        )
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST_PIXELS)).astype(int)]
    depth = float(np.median(picture.depth[rows[:, 0], rows[:, 1]]))
    box = box_of(pixels, 3)
    rgb = smooth(picture.rgb[box])[rows[:, 0] - box[0].start, rows[:, 1] - box[1].start]
    share = radius / picture.camera.fx  # tangent of half the angle that it fills
    half = depth * share / max(1.0 - share, 0.5)  # its middle is a radius behind its front
    if mark.kind == "stem":
        return _Sample("stem", rgb, depth, math.nan, math.nan)
    return _Sample(mark.kind, rgb, depth, half, math.nan if click else float(size[0] / size[1]))


def _about(picture: DepthPicture, at: IntArray, kind: Class) -> tuple[BoolArray, float]:
    """The pixels (height, width) of the thing at a row and a column, and half its width [pixel]."""
    out = np.zeros(picture.depth.shape, dtype=bool)
    reach = STEM_REACH if kind == "stem" else FRUIT_REACH
    box = tuple(slice(max(k - reach, 0), k + reach + 1) for k in at)
    row, column = at - [box[0].start, box[1].start]
    depth = picture.depth[box]
    if not (0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]):
        return out, 0.0
    hue, dye, bright = hsv(smooth(picture.rgb[box]).reshape(-1, 3))
    here = int(row * depth.shape[1] + column)
    wide = ALIKE[0] if dye[here] > PALE else MOST_WIDE[0]
    about = Colour(hue[here], wide, dye[here], ALIKE[1], bright[here], ALIKE[2])
    like = (off(about, hue, dye, bright) < 1.0).reshape(depth.shape)
    near = tuple(slice(max(k - HOLE, 0), k + HOLE + 1) for k in (row, column))
    known = depth[near][like[near] & (depth[near] > 0.0)]
    if not known.size:
        return out, 0.0
    like &= np.abs(depth - np.median(known)) < 2.0 * BAND
    like[row, column] = True
    radius = 0.0
    rows, columns = np.arange(depth.shape[0])[:, None], np.arange(depth.shape[1])
    for _ in range(2):  # a stem before a fruit cuts it in two; the second bridge is wider
        bridge = max(HOLE, round(radius / 3.0))
        parts, _ = ndimage.label(ndimage.binary_closing(like, iterations=bridge))
        part = ndimage.binary_fill_holes(parts == parts[row, column])
        edge = ndimage.distance_transform_edt(np.pad(part, 1))[1:-1, 1:-1]
        for _ in range(CLIMBS):  # to the middle of the largest disc that is reached by discs
            near = np.hypot(rows - row, columns - column)
            inside = np.where(near <= edge[row, column], edge, 0.0)
            row, column = np.unravel_index(int(inside.argmax()), part.shape)
        radius = float(edge[row, column])
    near = np.hypot(rows - row, columns - column)
    out[box] = part & like & (near < (reach if kind == "stem" else INNER * radius))
    return out, radius


def _colours(samples: Sequence[_Sample]) -> tuple[dict[str, float], str]:
    """Numbers of :class:`EyeParameters` that tell the kinds apart by colour, and what does."""
    charts = {
        kind: np.array(hsv(np.concatenate([s.rgb for s in samples if s.kind == kind])))
        for kind in MARKED
        if any(s.kind == kind for s in samples)
    }
    usual, every = EyeParameters(), np.concatenate(list(charts.values()), axis=1)
    low = {
        name: round(min(getattr(usual, name), 0.6 * float(np.quantile(every[row], 0.05))), 3)
        for row, name in ((1, "least_dye"), (2, "least_bright"))
    }
    plant = [charts[kind] for kind in ("unripe", "stem") if kind in charts]
    middles = {kind: np.median(chart, axis=1) for kind, chart in charts.items()}
    pale = any(middle[1] < PALE for middle in middles.values())
    numbers, best, shares = low, -1.0, dict[str, float]()
    for by_hue, apart in itertools.product((True, False)[pale:], (False, True)):
        ripe = _fitted(charts["ripe"], by_hue)
        green = _fitted(np.concatenate(plant, axis=1), by_hue) if plant else usual.colours[1]
        stem = usual.colours[1] if "unripe" in charts else usual.colours[2]
        if apart and len(plant) == 2:
            green, stem = (_fitted(chart, by_hue) for chart in plant)
        elif not apart:
            stem = usual.colours[2]
        tried = low | _numbers({"ripe": ripe, "green": green, "stem": stem})
        told = _right(samples, EyeParameters(**tried))
        if (worst := min(told[kind] / RIGHT[kind] for kind in told)) > best:
            numbers, best, shares, found = tried, worst, told, (ripe, green, by_hue)
        if best >= 1.0:
            break
    ripe, green, by_hue = found
    one, other = middles["ripe"], np.array([green.hue, green.dye, green.bright])
    if plant:
        other = np.median(np.concatenate(plant, axis=1), axis=1)
    words = ", ".join(
        f"{name} {mine:.{digits}f} from {others:.{digits}f}"
        for name, mine, others, digits in (
            ("hue", ripe.hue, green.hue, 0), ("saturation", one[1], other[1], 2),
            ("brightness", one[2], other[2], 2),
        )[: 1 if by_hue and best >= 1.0 else 3]
    )  # fmt: skip
    if best < 1.0:
        wrong = ", ".join(f"{100 * share:.0f} % of {kind}" for kind, share in shares.items())
        raise InvalidRequestError(
            f"ripe cannot be told from the rest by colour ({words}): right are {wrong}; mark as "
            "ripe all that are to be picked, or see by a detector of your own (--finder)"
        )
    return numbers, f"ripe is told by {words}"


def _fitted(chart: FloatArray, by_hue: bool) -> Colour:
    """The colour of hues, saturations and brightnesses (3, N)."""
    hue, dye, bright = chart
    way = np.deg2rad(hue)
    turn = math.atan2(np.median(dye * np.sin(way)), np.median(dye * np.cos(way)))
    middle = math.degrees(turn) % 360.0, float(np.median(dye)), float(np.median(bright))
    away = np.abs((hue - middle[0] + 180.0) % 360.0 - 180.0), dye - middle[1], bright - middle[2]
    wide = [
        min(most, max(floor, WIDER * float(np.quantile(np.abs(each), QUANTILE))))
        for each, floor, most in zip(away, FLOOR, MOST_WIDE, strict=True)
    ]
    if by_hue:
        return Colour(middle[0], wide[0], 0.5, math.inf, 0.5, math.inf)
    wide = [min(math.sqrt(3.0) * w, most) for w, most in zip(wide, MOST_WIDE, strict=True)]
    return Colour(middle[0], wide[0], middle[1], wide[1], middle[2], wide[2])


def _numbers(colours: Mapping[str, Colour]) -> dict[str, float]:
    """Colours as numbers of :class:`EyeParameters`, without those that are usual."""
    usual = EyeParameters()
    told = {
        f"{kind}_{name}": round(value, 3)
        for kind, colour in colours.items()
        for name, value in colour._asdict().items()
    }
    return {name: value for name, value in told.items() if value != getattr(usual, name)}


def _right(samples: Sequence[_Sample], p: EyeParameters) -> dict[str, float]:
    """Share of the marks of each kind whose pixels mostly are of its colours."""
    wanted = {"ripe": (1,), "unripe": (2,), "stem": (2, 3)}
    told: dict[str, list[bool]] = {}
    for each in samples:
        mine = np.isin(coloured(each.rgb, p), wanted[each.kind]).mean()
        told.setdefault(each.kind, []).append(bool(mine >= MINE))
    return {kind: float(np.mean(right)) for kind, right in told.items()}
