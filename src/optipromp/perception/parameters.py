"""The numbers of finding and measuring."""

from dataclasses import dataclass

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class EyeParameters(Checked):
    """Colours, sizes and errors by which fruits and stems are found and measured.

    Hues are angles on the circle of colours: red 0, yellow 60, green 120 degrees.
    """

    ripe_hue: float = parameter(4.0, "deg", "guess", "middle hue of ripe fruits")
    ripe_width: float = parameter(30.0, "deg", "guess", "largest difference from it")
    green_hue: float = parameter(82.0, "deg", "guess", "middle hue of unripe fruits and stems")
    green_width: float = parameter(45.0, "deg", "guess", "largest difference from it")
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
    radius: float = parameter(0.0165, "m", "reported", "prior median of a fruit's radius")
    radius_spread: float = parameter(0.25, "1", "guess", "prior deviation of its logarithm")
    longer: float = parameter(0.10, "1", "guess", "prior of the logarithm of length over width")
    longer_spread: float = parameter(0.12, "1", "guess", "its deviation")
    # of subpixels of 0.08, a baseline of 18 mm, a focal length of 480 pixels: state your camera's
    depth_noise: float = parameter(0.0093, "1/m", "published", "deviation of depth over its square")
    depth_scale: float = parameter(0.005, "1", "guess", "deviation of a picture's relative depth")
    patch: float = parameter(28.0, "pixel", "measured", "that err as one: 4 π σ², a filter of 1.5")
    outline: float = parameter(1.0, "pixel", "guess", "deviation of an outline")
    outline_run: float = parameter(4.0, "pixel", "guess", "length of outline that errs as one")
    model: float = parameter(0.0015, "m", "measured", "of a centre besides: fruits no spheroids")
    # a tip's front tells little of the length
    tip: float = parameter(0.2, "1", "measured", "over the radius, along an axis that is in view")
    tilt: float = parameter(18.0, "deg", "measured", "median of 1,704 strawberries (StrawDI)")
    stem_reach: float = parameter(0.06, "m", "choice", "above a fruit; tells the direction")
    stem_least: float = parameter(0.020, "m", "choice", "least length that is a stem")
    stem_aside: float = parameter(0.0045, "m", "choice", "distance from its line, across the view")
    stem_noise: float = parameter(0.002, "m", "guess", "of a stem's pixels from its line, across")
    stem_depth: float = parameter(0.004, "m", "guess", "the same along the view; edges blur")
    stem_length: float = parameter(0.15, "m", "guess", "of a stem that was not seen")
    stem_floor: float = parameter(2.0, "deg", "guess", "least deviation of a stem's tilt")
