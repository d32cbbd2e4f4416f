"""A detector of your own as a finder: masks or boxes in, regions out."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args

import numpy as np
from scipy.ndimage import label

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError, short
from optipromp_eyes.finder import RIGHT, Class, Found, Region
from optipromp_eyes.geometry import ByGeometry
from optipromp_eyes.needed import needed
from optipromp_eyes.network import ByNetwork
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import MOST_PIXELS, DepthPicture, Image8

KNOWN: Mapping[str, Class] = {kind: kind for kind in get_args(Class)}
BAND = 0.03  # [m] least depth about the middle of a box that is its fruit: as of strawberries
THIN = 0.01  # [m] the same about the nearest fifth of a stem's box: a choice
CORE = 0.6  # share of a box's sides, about its middle, that tells its depth; of 0.3, half was stem


@dataclass(frozen=True, eq=False)
class Detected:
    """One thing that a detector found.

    Attributes:
        kind: its class, in the detector's words.
        score: 0 to 1.
        box: left, top, right, bottom [pixel]; of no use where there is a mask.
        mask: (height, width) whether a pixel shows it; None: what the box holds at one depth.
        ripe: probability that it is ripe; None: of a class that is ripe its score, at most
            :data:`optipromp_eyes.finder.RIGHT`, else the rest of that.
    """

    kind: str
    score: float
    box: tuple[float, float, float, float] | None = None
    mask: BoolArray | None = None
    ripe: float | None = None


@dataclass(frozen=True)
class ByDetector:
    """A finder by any detector of masks or boxes: a network's runtime, a service, another package.

    Example, of a detector with words of its own (``docs/eyes.md`` has RF-DETR's ONNX file)::

        def detect(rgb):
            return [Detected(word, score, box) for word, score, box in mine(rgb)]

        finder = ByDetector(detect, {"strawberry_ripe": "ripe", "strawberry_green": "unripe"})

    Args:
        detect: what is found in colours (height, width, 3).
        classes: classes of fruits, stems and leaves by the detector's words; others are left out.
        least: score below which a thing is left out.
    """

    detect: Callable[[Image8], Iterable[Detected]]
    classes: Mapping[str, Class] = field(default_factory=lambda: KNOWN)
    least: float = 0.3

    @classmethod
    def of(cls, things: Iterable[Detected], step: int = 1) -> "ByDetector":
        """Of one picture, of which every ``step``-th row and column is looked at."""
        first, seen = (step - 1) // 2, list[Detected]()
        for each in things:
            left, top, right, bottom = np.array(each.box or [0.0] * 4) / step
            mask = None if each.mask is None else each.mask[first::step, first::step]
            seen.append(replace(each, box=each.box and (left, top, right, bottom), mask=mask))
        return cls(lambda rgb: seen)

    def find(self, picture: DepthPicture) -> Found:
        """See :class:`optipromp_eyes.finder.Finder`.

        Raises:
            InvalidRequestError: something with neither mask nor box, a mask of another size.
        """
        plant: dict[Class, BoolArray] = {}
        fruits: list[Region] = []
        for each in sorted(self.detect(picture.rgb), key=lambda one: -one.score):
            kind = self.classes.get(each.kind)
            if kind is None or each.score < self.least:
                continue
            pixels = _pixels(each, picture)
            for other in fruits:  # the surer one has the pixels of both
                pixels &= ~other.pixels
            if kind in ("stem", "leaf"):
                plant[kind] = plant.get(kind, False) | pixels
            elif pixels.any():
                ripe = min(each.score, RIGHT) if kind == "ripe" and each.ripe is None else each.ripe
                fruits.append(Region(kind, pixels, float(each.score), ripe=ripe))
        rest = (Region(kind, pixels, 1.0) for kind, pixels in plant.items() if pixels.any())
        return Found((*fruits, *rest))


def _pixels(each: Detected, picture: DepthPicture) -> BoolArray:
    if each.mask is not None:
        mask = np.array(each.mask, dtype=bool)
        if mask.shape != picture.depth.shape:
            raise InvalidRequestError(
                f"a mask has shape {mask.shape}; the picture has {picture.depth.shape}"
            )
        return mask
    if each.box is None:
        raise InvalidRequestError(f"a detected {each.kind} has neither mask nor box")
    return cut(picture, each.box)


def picture_name(name: str) -> str:
    """The name of a picture by that of its file."""
    return re.sub(r"(?i)(\.rgb)?\.(png|jpe?g|tiff?|bmp|ppm)$", "", Path(name).name)


def of_coco(document: Any, source: str) -> dict[str, list[Detected]]:
    """What a detector found, by the names of all pictures: of COCO, whose ``annotations`` have
    a ``bbox``, and where known ``segmentation`` (polygons or run lengths), ``score`` and ``ripe``.

    Raises:
        InvalidRequestError: a document that is no COCO, a mask of another size than its picture,
            classes of which none is known.
    """
    try:
        images = {one["id"]: one for one in document["images"]}
        kinds = {one["id"]: str(one["name"]) for one in document["categories"]}
        out: dict[str, list[Detected]] = {
            picture_name(image["file_name"]): [] for image in images.values()
        }
        for each in document["annotations"]:
            image = images[each["image_id"]]
            left, top, wide, high = (float(number) for number in each["bbox"])
            one = Detected(
                kinds[each["category_id"]], float(each.get("score", 1.0)),
                (left, top, left + wide, top + high), _mask(each.get("segmentation"), image),
                None if each.get("ripe") is None else float(each["ripe"]),
            )  # fmt: skip
            out[picture_name(image["file_name"])].append(one)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"{source}: must be COCO (images, categories, annotations with bbox; segmentation as "
            f"polygons or uncompressed run lengths) ({error!r:.200})"
        ) from None
    found = sorted({each.kind for things in out.values() for each in things})
    if found and not KNOWN.keys() & found:
        raise InvalidRequestError(
            f"{source}: the classes are {short(found)}; rename its categories: {', '.join(KNOWN)}"
        )
    return out


def _mask(told: Any, image: Mapping[str, Any]) -> BoolArray | None:
    """A mask (height, width) of polygons, or of runs of 0 and 1 in turn, column by column."""
    if not told:
        return None
    high, wide = int(image["height"]), int(image["width"])
    if not 0 < high * wide <= MOST_PIXELS:
        raise ValueError(f"an image of {wide} x {high} pixels")
    if isinstance(told, dict):
        runs = np.array(told["counts"], dtype=np.int64)
        if list(told["size"]) != [high, wide] or (runs < 0).any() or runs.sum() != high * wide:
            raise ValueError(f"run lengths that are not of {wide} x {high} pixels")
        return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(wide, high).T
    sheet = needed("PIL.Image", "masks need Pillow:", "optipromp-eyes").new("1", (wide, high))
    pen = import_module("PIL.ImageDraw").Draw(sheet)
    for ring in told:
        pen.polygon([float(number) for number in ring], fill=1)
    return np.asarray(sheet)


def cut(
    picture: DepthPicture, box: tuple[float, float, float, float], thin: bool = False
) -> BoolArray:
    """The pixels (height, width) of a box at the depth of its middle, in one piece; of something
    ``thin``, at that of its nearest fifth."""
    out = np.zeros(picture.depth.shape, dtype=bool)
    height, width = picture.depth.shape[:2]
    left, top = (max(int(value), 0) for value in box[:2])
    right, bottom = min(int(np.ceil(box[2])), width), min(int(np.ceil(box[3])), height)
    if right <= left or bottom <= top:
        return out
    part: FloatArray = picture.depth[top:bottom, left:right]
    rows, columns = bottom - top, right - left
    r, c = (0 if thin else int(0.5 * (1.0 - CORE) * side) for side in (rows, columns))
    core = part[r : rows - r, c : columns - c]
    known = core[core > 0.0]
    if not known.size:
        return out
    middle = float(np.quantile(known, 0.2 if thin else 0.5))
    band = max(BAND, 0.5 * max(rows, columns) * middle / picture.camera.fx)  # a radius behind
    band = THIN if thin else band
    near = (part > 0.0) & (np.abs(part - middle) < band)
    marks, _ = label(near)
    inner = marks[r : rows - r, c : columns - c]
    if inner.any():
        counts = np.bincount(inner.ravel())
        counts[0] = 0
        out[top:bottom, left:right] = marks == int(counts.argmax())
    return out


@cache
def _network(radius: float) -> ByNetwork:
    return ByNetwork(radius=radius)


def usual_finder(parameters: EyeParameters) -> ByNetwork | ByGeometry:
    """The network, which knows red fruits on green plants; where onnxruntime is not installed, or a
    crop or taught eyes have colours of their own, geometry."""
    own = parameters.colours != EyeParameters().colours
    if own or not find_spec("onnxruntime"):
        return ByGeometry(parameters)
    return _network(parameters.radius)


def finder_named(
    name: str | None = None, model: Any = None, parameters: EyeParameters | None = None
) -> Any:
    """A finder by name: ``geometry``, ``network`` (with a ``model`` file; at the scale of the
    ``parameters``), or ``MODULE:NAME``; None: the network of a ``model``, else
    :func:`usual_finder`.

    What the module has under that name is a finder, or is called without arguments to make one.

    Raises:
        InvalidRequestError: an unknown name, or something that is no finder.
    """
    p = parameters or EyeParameters()
    if model is not None and name not in ("network", None):
        raise InvalidRequestError(f"a model goes with the finder 'network', not with {name!r}")
    if name is None and model is None:
        return usual_finder(p)
    if name == "geometry":
        return ByGeometry(p)
    if name in ("network", None):
        return ByNetwork(model, radius=p.radius)
    module, colon, attribute = name.partition(":")
    if not colon:
        raise InvalidRequestError(
            f"finder is {name!r}: valid are geometry, network, and MODULE:NAME of your own"
        )
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InvalidRequestError(f"finder {name!r} cannot be loaded: {error}") from None
    made = found() if callable(found) and not hasattr(found, "detect") else found
    if not callable(getattr(made, "find", None)):
        raise InvalidRequestError(f"finder {name!r} has no method find(picture)")
    return made
