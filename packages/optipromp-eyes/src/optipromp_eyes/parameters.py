"""The numbers of finding and measuring: by default, of a crop, or of a file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from optipromp.core.documents import read_named
from optipromp.core.errors import InvalidRequestError, short
from optipromp.core.parameters import Checked, parameter
from optipromp.core.scenes.crops import CROP_FOLDER, CROP_KEYS, Crop, crop_from_dict

LARGEST = {"deg": 360.0, "1": 20.0, "m": 10.0, "1/m": 1.0, "pixel": 1e6}
"""Of a number, by its unit; larger ones are mistakes: choices."""
POSITIVE = {
    "ripe_width", "ripe_dye_width", "ripe_bright_width", "green_width", "green_dye_width",
    "green_bright_width", "stem_dye_width", "stem_bright_width", "radius_spread", "longer_spread",
    "depth_noise", "patch", "tilt",
}  # fmt: skip
"""Numbers that divide others."""


class Colour(NamedTuple):
    """A colour: a middle, and how far from it each of three numbers may be alone."""

    hue: float  # [deg]
    width: float  # [deg]
    dye: float  # saturation
    dye_width: float
    bright: float  # value
    bright_width: float


@dataclass(frozen=True)
class EyeParameters(Checked):
    """Colours, sizes and errors by which fruits and stems are found and measured.

    Hues are angles on the circle of colours: red 0, yellow 60, green 120 degrees. A pixel is of the
    colour from which it is least far, in its widths; of none if all are farther than one.

    Raises:
        InvalidRequestError: a number out of range, or radii that do not ascend.
    """

    ripe_hue: float = parameter(4.0, "deg", "guess", "middle hue of ripe fruits")
    ripe_width: float = parameter(30.0, "deg", "guess", "largest difference from it")
    ripe_dye: float = parameter(0.5, "1", "choice", "middle saturation of ripe fruits")
    ripe_dye_width: float = parameter(math.inf, "1 or inf", "choice", "largest difference from it")
    ripe_bright: float = parameter(0.5, "1", "choice", "middle brightness of ripe fruits")
    ripe_bright_width: float = parameter(math.inf, "1 or inf", "choice", "the same of it")
    green_hue: float = parameter(82.0, "deg", "guess", "middle hue of unripe fruits and stems")
    green_width: float = parameter(45.0, "deg", "guess", "largest difference from it")
    green_dye: float = parameter(0.5, "1", "choice", "as of ripe fruits, and so on")
    green_dye_width: float = parameter(math.inf, "1 or inf", "choice", "see ripe_dye_width")
    green_bright: float = parameter(0.5, "1", "choice", "see ripe_bright")
    green_bright_width: float = parameter(math.inf, "1 or inf", "choice", "see ripe_bright_width")
    stem_hue: float = parameter(82.0, "deg", "choice", "of stems that have a colour of their own")
    stem_width: float = parameter(0.0, "deg", "choice", "its largest difference; 0: they have none")
    stem_dye: float = parameter(0.5, "1", "choice", "as of ripe fruits, and so on")
    stem_dye_width: float = parameter(math.inf, "1 or inf", "choice", "see ripe_dye_width")
    stem_bright: float = parameter(0.5, "1", "choice", "see ripe_bright")
    stem_bright_width: float = parameter(math.inf, "1 or inf", "choice", "see ripe_bright_width")
    least_dye: float = parameter(0.18, "1", "guess", "fruit or stem; gutters and metal are grey")
    least_bright: float = parameter(0.04, "1", "guess", "least value of a pixel whose hue counts")
    farthest: float = parameter(0.9, "m", "choice", "largest depth of a fruit")
    step: float = parameter(0.010, "m", "choice", "step of depth between two surfaces")
    thin: float = parameter(0.005, "m", "choice", "half width between stems, 3 mm, and fruits, 12")
    least_radius: float = parameter(0.007, "m", "choice", "of a fruit: small unripe ones")
    most_radius: float = parameter(0.028, "m", "choice", "of a fruit, across its axis")
    least_pixels: int = parameter(60, "pixel", "choice", "of a fruit")
    # logarithm of the odds; at 0.5, 4 % of the fits in `mixed` were false
    least_odds: float = parameter(1.5, "1", "measured", "above which a fit is a fruit")
    # of 470 fruits 1 is below, of 34 leaves and others that fits took for fruits 20
    least_round: float = parameter(
        1.1, "1", "measured", "of depths off a plane over off a fit; flowers and leaves are flat"
    )
    least_ripe: float = parameter(
        0.8, "1", "choice", "probability from which on a fruit is a target"
    )
    least_red: float = parameter(
        0.0, "1", "choice", "redness of a target; growers pick strawberries from 0.75 on"
    )
    radius: float = parameter(0.0165, "m", "reported", "prior median of a fruit's radius")
    radius_spread: float = parameter(0.25, "1", "guess", "prior deviation of its logarithm")
    longer: float = parameter(0.10, "1", "guess", "prior of the logarithm of length over width")
    longer_spread: float = parameter(0.12, "1", "guess", "its deviation")
    # of subpixels of 0.08, a baseline of 18 mm, a focal length of 480 pixels: state your camera's
    depth_noise: float = parameter(0.0093, "1/m", "published", "deviation of depth over its square")
    depth_scale: float = parameter(0.005, "1", "guess", "deviation of a picture's relative depth")
    patch: float = parameter(28.0, "pixel", "measured", "that err as one: 4 π σ², a filter of 1.5")
    tilt: float = parameter(18.0, "deg", "measured", "median of 1,704 strawberries (StrawDI)")
    stem_length: float = parameter(0.15, "m", "guess", "of a stem that was not seen")

    signed = ("longer",)

    def __post_init__(self) -> None:
        super().__post_init__()
        for item in fields(self):
            value, unit = getattr(self, item.name), item.metadata["unit"]
            shares = any(word in item.name for word in ("dye", "bright", "_red"))
            most = 1.0 if shares else LARGEST[unit]  # a share is at most 1
            if not (value <= most or value == math.inf) or (value == 0 and item.name in POSITIVE):
                least = "above 0 and at most" if item.name in POSITIVE else "at most"
                raise InvalidRequestError(
                    f"EyeParameters.{item.name} is {value:g}; must be {least} {most:g} [{unit}]"
                )
        if not 0.0 < self.least_radius < self.radius < self.most_radius or self.thin > self.radius:
            raise InvalidRequestError(
                f"EyeParameters.radius is {self.radius:g}; must be between least_radius and "
                f"most_radius, {self.least_radius:g} and {self.most_radius:g}, and above thin, "
                f"{self.thin:g} [m]"
            )

    @property
    def colours(self) -> tuple[Colour, Colour, Colour]:
        """Of ripe fruits, of unripe ones, and of stems; that of no width is of nothing."""
        ripe, green, stem = (
            Colour(*(getattr(self, f"{kind}_{name}") for name in Colour._fields))
            for kind in ("ripe", "green", "stem")
        )
        return ripe, green, stem


def eyes_of(crop: Crop | None, own: str | Path | None = None) -> EyeParameters:
    """The numbers for a crop: its sizes, then its ``eyes``, then numbers of one's own.

    ``own``: a file of :class:`EyeParameters` by name, or a crop by name or file, which takes the
    place of ``crop``. A ``radius`` takes the limits of radii with it, unless they are given.

    Raises:
        InvalidRequestError: no such file, an unknown name, or a number out of range.
        InvalidSceneError: a crop that cannot be used.
    """
    given: Mapping[str, Any] = {}
    source = ""
    if own is not None:
        holds = "a crop (name, like, eyes, ...), or numbers of the eyes (ripe_hue, radius, ...)"
        document, source, _ = read_named(own, CROP_FOLDER, InvalidRequestError, holds)
        if isinstance(document, dict) and document and CROP_KEYS.isdisjoint(document):
            given = document
        else:
            crop = crop_from_dict(document, source)
    out = EyeParameters()
    if crop is not None:
        long = crop.rows["elongation"]
        sizes = {"radius": 0.5 * crop["width"], "longer": math.log(long.value)}
        if long.spread > 0.0:
            sizes["longer_spread"] = long.spread / long.value
        out = _changed(out, {**sizes, "stem_length": crop["stem_length"]}, crop.name)
        out = _changed(out, crop.eyes, f"eyes of {crop.name}")
    return _changed(out, given, source)


def _changed(base: EyeParameters, given: Mapping[str, Any], source: str) -> EyeParameters:
    numbers = {name: value for name, value in given.items() if name != "source"}
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InvalidRequestError(f"{source}: {name} is {short(value)}; must be a number")
    usual, sizes = EyeParameters(), dict[str, float]()
    if share := min(numbers.get("radius", 0.0), 1.0) / usual.radius:  # [m] none is wider: a choice
        for name in ("thin", "least_radius"):
            sizes[name] = min(1.0, share) * getattr(usual, name)
        sizes["most_radius"] = max(1.0, share) * usual.most_radius
    try:
        return replace(base, **sizes | numbers)
    except InvalidRequestError as error:
        raise InvalidRequestError(f"{source}: {error.message}") from None
