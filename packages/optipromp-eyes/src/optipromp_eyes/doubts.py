"""What may be wrong with a picture, told by its cause: light, tapes, register, pose."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.finder import Found, Region, most_about
from optipromp_eyes.needed import opencv
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import DepthPicture
from optipromp_eyes.stems import HIDDEN, Spheroid, stem_of

DARK, BLOWN = 25, 250  # largest channel below, above which a pixel tells no colour: a choice
LEAST_SAMPLES = 200  # pixels that tell of the light: a choice
GREY = 0.06  # saturation that all of a grey picture are below: a choice
GREENEST, STEEP = -0.40, 0.05
"""Logarithm of green over the others, of the 2 % that reflect most green, at which colours tell
ripeness in half of the pictures, and the width of that step: fitted to 91 renders by MuJoCo in
white and tinted light, and judged on the same."""
LONG, FULL = 3.0, 0.85  # length over width of a tape, and share of its box that it fills: choices
TAPE = "straight, as a tape or tube is"
SHIFT, LEAD = 6, 2.0  # [pixel] out of register; correlation over that in register: choices
FARTHEST_SHIFT = 40  # [pixel] that is looked at: a choice
LEAST_EDGE = 60  # [pixel] of edges of depth that tell a shift: a choice
TRIED = 6  # fruits whose stems are looked for by other poses, which bounds time: a choice
OFF_AXIS = 0.2  # of the width and height, from the middle to the optical axis: a choice


def light_of(picture: DepthPicture) -> tuple[float, str]:
    """The probability that colours tell ripe from unripe, and in words what is wrong else.

    In white light something in the whole picture is green or without colour: leaves, or a wall, a
    gutter, metal. In red, blue and grow light nothing is.
    """
    rgb = picture.rgb[2::4, 2::4].reshape(-1, 3)
    most = rgb.max(axis=1)
    rgb = rgb[(most > DARK) & (most < BLOWN)].astype(np.float32)
    if len(rgb) < LEAST_SAMPLES:
        return 1.0, ""
    if (np.ptp(rgb, axis=1) < GREY * rgb.max(axis=1)).all():
        return 0.0, "the picture is grey"
    green = math.log(float(np.quantile(rgb[:, 1] / rgb[:, ::2].max(axis=1).clip(1.0), 0.98)) + 1e-9)
    trust = 1.0 / (1.0 + math.exp(min((GREENEST - green) / STEEP, 500.0)))
    return trust, "little reflects green: red, blue or grow light?"


def judged(
    picture: DepthPicture, found: Found, p: EyeParameters, by_colour: bool
) -> tuple[Found, list[tuple[Region, str]]]:
    """What was found, with the probabilities of ripeness that the light and the forms leave; and
    the regions that are no target by these, with what is wrong. Kinds stay.

    ``by_colour``: whether the finder knows colours alone, so that tapes and tubes are looked for.
    """
    trust, light = light_of(picture)
    fruits = (region for region in found.regions if region.kind == "ripe")
    straight = _straight(Region.mask(fruits, picture.depth.shape)) if by_colour else None
    out, doubts = list[Region](), list[tuple[Region, str]]()
    for region in found.fruits:
        tape = straight is not None and bool((straight[region.box] & region.part).any())
        ripe = 0.5 + (0.0 if tape else trust) * (region.ripe - 0.5)
        if ripe < p.least_ripe <= region.ripe:
            doubts.append((region, TAPE if tape else light))
        out.append(region.with_ripe(ripe))
    rest = (region for region in found.regions if region not in found.fruits)
    return replace(found, regions=(*out, *rest)), doubts


def told(doubted: Sequence[tuple[Region, str]], fruits: Sequence[Region]) -> list[str]:
    """What is wrong, each once, with those of some regions in which a fruit fits."""
    places: dict[str, list[str]] = {}
    for region, why in doubted:
        if any((fruit.pixels[region.box] & region.part).any() for fruit in fruits):
            row, column = (round(0.5 * (b.start + b.stop)) for b in region.box)
            places.setdefault(why, []).append(f"column {column}, row {row}")
    return [f"{why}; no target: at {', '.join(at)}" for why, at in places.items()]


def _straight(ripe: BoolArray) -> BoolArray:
    """The pixels of ripe fruits that lie together in a strip of one width, as a tape or tube:
    fruits side by side have necks."""
    out = np.zeros_like(ripe)
    islands, _ = ndimage.label(ndimage.binary_closing(ripe, np.ones((3, 3))))
    for number, box in enumerate(ndimage.find_objects(islands), 1):
        island = islands[box] == number
        sides = opencv().minAreaRect(np.argwhere(island).astype(np.float32))[1]
        short, long = sorted(side + 1.0 for side in sides)  # [pixel] from edge to edge
        if island.sum() > max(FULL * short * long, LEAST_SAMPLES) and long > LONG * short:
            out[box] |= island
    return out


def register_of(picture: DepthPicture, p: EyeParameters) -> tuple[str, ...]:
    """Whether edges of depth lie beside those of colour, in words; empty: they do not."""
    k = max(round(picture.camera.width / 320), 1)
    depth = picture.depth[::k, ::k]
    near = (depth > 0.0) & (depth < p.farthest)
    least = np.maximum(2.0 * p.step, 6.0 * p.depth_noise * depth**2)  # [m], no error: a choice
    edges = near & (most_about(depth, 3) - depth > least)
    if edges.sum() < LEAST_EDGE:
        return ()
    steep = steepness(picture.rgb[::k, ::k].astype(np.float32))
    steep = np.minimum(steep, 0.1 * steep.max())  # a choice: edges count alike
    far = FARTHEST_SHIFT // k
    wide = np.pad(steep - steep.mean(), far)
    match = opencv().matchTemplate(wide, edges.astype(np.float32), opencv().TM_CCORR)
    match = ndimage.gaussian_filter(match, 1.0)
    row, column = np.unravel_index(int(match.argmax()), match.shape)
    across, down = k * (int(column) - far), k * (int(row) - far)
    here = float(match[far - 1 : far + 2, far - 1 : far + 2].max())
    if math.hypot(across, down) < SHIFT or match.max() < LEAD * max(here, 0.0):
        return ()
    return (
        f"edges of depth lie {across:+d} columns and {down:+d} rows from those of colour: depth is "
        "not registered to the colours, or of another time",
    )


def steepness(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """The steepness (h, w) of colours (h, w, 3), by Sobel's kernels."""
    cv = opencv()
    ways = (cv.Sobel(rgb, -1, *way, borderType=cv.BORDER_REPLICATE) for way in ((1, 0), (0, 1)))
    return np.asarray(np.sqrt(sum((way**2).sum(axis=2) for way in ways)))


def pose_of(
    picture: DepthPicture, fruits: Sequence[Spheroid], hanging: Sequence[bool],
    points: tuple[FloatArray, FloatArray], up: FloatArray, p: EyeParameters,
) -> tuple[str, ...]:  # fmt: skip
    """What may be wrong with the camera's pose and numbers.

    Where few of the fruits have a stem above them, others are looked for by other poses: the
    picture turned, the quaternion in the order x, y, z, w, the pose inverted, z not forward.

    ``hanging``: of each fruit, whether it has a straight stem above it by this pose.
    ``points``: (N, 3) of all stems in the frame of the camera, and deviations (N,) of their depths
    [m]. ``up``: (3,) unit, upwards in the robot's base frame.
    """
    lens, out = picture.camera, []
    wide = (lens.width - 1) / 2 - lens.cx, (lens.height - 1) / 2 - lens.cy
    if abs(wide[0]) > OFF_AXIS * lens.width or abs(wide[1]) > OFF_AXIS * lens.height:
        out.append(
            f"the optical axis is at column {lens.cx:.0f}, row {lens.cy:.0f} of {lens.width} x "
            f"{lens.height} pixels: intrinsics of another resolution?"
        )
    if lens.pose.is_identity:
        out.append("the camera has no pose: places are in its own frame, with z forward")
    every = slice(None, None, max(len(fruits) // TRIED, 1))
    some = fruits[every][:TRIED]

    def straight(turn: FloatArray) -> int:
        """How many of some fruits have a straight stem above them, by a camera turned so."""
        stems = (stem_of(fit, *points, turn.T @ up, p, 3.0, HIDDEN[:1]) for fit in some)
        return sum(stem is not None for stem in stems)

    now = sum(hanging[every][:TRIED])
    if 2 * now >= len(some):
        return tuple(out)
    turn = lens.pose.rotation
    w, x, y, z = lens.pose.orientation
    forward = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    tries = {
        "the quaternion is x, y, z, w": Pose(np.zeros(3), np.array([z, w, x, y])).rotation,
        "the pose is inverted, of the base in the camera": turn.T,
        "the pose is of a frame whose x is forward": turn @ forward,
        "the picture is upside down": turn @ np.diag([-1.0, -1.0, 1.0]),
    }
    for side, angle in (("left", 90.0), ("right", -90.0)):
        tries[f"the picture is turned to the {side}"] = (
            turn @ Rotation.from_euler("z", angle, degrees=True).as_matrix()
        )
    counts = {name: straight(other) for name, other in tries.items()}
    most = max(counts.values())
    if most > 2 * now and 2 * most > len(some):
        causes = " or ".join(name for name, count in counts.items() if count == most)
        out.append(
            f"stems do not hang from above: {most} of {len(some)} fruits have one if {causes}"
        )
    return tuple(out)
