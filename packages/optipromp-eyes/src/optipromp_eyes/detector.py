"""A detector of your own as a finder: masks or boxes in, regions out."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from scipy.ndimage import label

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp_eyes.finder import Class, Found, Region
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import DepthPicture, Image8

KNOWN: Mapping[str, Class] = {kind: kind for kind in get_args(Class)}
BAND = 0.03  # [m] least depth about the middle of a box that is its fruit: as of strawberries
THIN = 0.01  # [m] the same about the nearest fifth of a stem's box: a choice
CORE = 0.3  # share of a box's width and height, about its middle, that tells its depth: a choice


@dataclass(frozen=True, eq=False)
class Detected:
    """One thing that a detector found.

    Attributes:
        kind: its class, in the detector's words.
        score: 0 to 1.
        box: left, top, right, bottom [pixel]; of no use where there is a mask.
        mask: (height, width) whether a pixel shows it; None: what the box holds at one depth.
    """

    kind: str
    score: float
    box: tuple[float, float, float, float] | None = None
    mask: BoolArray | None = None


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
                fruits.append(Region(kind, pixels, float(each.score)))
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


def finder_named(name: str, model: Any = None, parameters: EyeParameters | None = None) -> Any:
    """A finder by name: ``geometry``, ``network`` (with a ``model`` file; at the scale of the
    ``parameters``), or ``MODULE:NAME``.

    What the module has under that name is a finder, or is called without arguments to make one.

    Raises:
        InvalidRequestError: an unknown name, or something that is no finder.
    """
    import importlib

    from optipromp_eyes.geometry import ByGeometry
    from optipromp_eyes.network import ByNetwork

    if model is not None and name != "network":
        raise InvalidRequestError(f"a model goes with the finder 'network', not with {name!r}")
    if name == "geometry":
        return ByGeometry(parameters or EyeParameters())
    if name == "network":
        return ByNetwork(model, radius=(parameters or EyeParameters()).radius)
    module, colon, attribute = name.partition(":")
    if not colon:
        raise InvalidRequestError(
            f"finder is {name!r}: valid are geometry, network, and MODULE:NAME of your own"
        )
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InvalidRequestError(f"finder {name!r} cannot be loaded: {error}") from None
    made = found() if callable(found) and not hasattr(found, "detect") else found
    if not callable(getattr(made, "find", None)):
        raise InvalidRequestError(f"finder {name!r} has no method find(picture)")
    return made
