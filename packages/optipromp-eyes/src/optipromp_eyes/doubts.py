"""What may be wrong with a picture, told by its cause: light, colours, skin, register, pose."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.finder import Found, Region, most_about
from optipromp_eyes.geometry import apart, front_of, hsv
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import DepthPicture
from optipromp_eyes.stems import Spheroid, stem_of

DARK, BLOWN = 25.0, 250.0  # largest channel below, above which a pixel tells no colour: a choice
GREENISH, LEAST_GREENISH = 0.8, 0.12  # green over the largest channel of what is no fruit, and the
# least share of such pixels: 0.31 in pictures in white light, 0.05 at most in red and grow light
WEAKER, GREENEST = 0.75, 1.4  # the same share, and green over the others of the greenest, 98 %:
# light is weakly red below both; one is 0.82 or the other 1.5 in white light
BLUISH = 1.2  # blue over red of blue things, which tell nothing of red light: a choice
LEAST_SAMPLES = 200  # pixels that tell of the light: a choice
GREY = 0.06  # saturation that 98 % of a grey picture are below: a choice
WARMEST = 0.5  # logarithm of red over green of a lamp of 2,700 K is 0.41: a choice
CAST, PEAK = 0.15, 0.1  # logarithms: least cast that is undone, half width of a peak: choices
SKIN_HUE, SKIN_DYE = 18.0, (0.3, 0.62)  # [deg] of skin; saturation below which red, and skin's hue,
# are no ripe fruit: medians of 71 rendered ripe fruits are 0.78 and more: a choice
LONG, EVEN = 3.0, 0.15  # length over width of a tape, deviation of its width: choices
TAPE = "straight, as a tape or tube is"
TUBE = 4.0  # [1/m] curvature along a tape or tube; a fruit's is 17 and more: a choice
SHIFT, LEAD = 6, 1.35  # [pixel] out of register; correlation over that in register: choices
FARTHEST_SHIFT = 40  # [pixel] that is looked at: a choice
LEAST_EDGE = 60  # [pixel] of edges of depth that tell a shift: a choice
TRIED = 6  # fruits whose stems are looked for by other poses, which bounds time: a choice
OFF_AXIS = 0.2  # of the width and height, from the middle to the optical axis: a choice


def balanced(picture: DepthPicture) -> DepthPicture:
    """The picture in white light, where many pixels have one colour that a warm or cold lamp gives
    to grey; else itself. Gains are those that make these pixels grey."""
    rgb = picture.rgb[::4, ::4].reshape(-1, 3).T.astype(np.float32)
    most = rgb.max(axis=0)
    rgb = rgb[:, (most > DARK) & (most < BLOWN)]
    if rgb.shape[1] < LEAST_SAMPLES:
        return picture
    red, blue = (np.log((rgb[k] + 1.0) / (rgb[1] + 1.0)) for k in (0, 2))
    # a lamp's red and blue go opposite ways from green
    lamp = (np.abs(red) < WARMEST) & (np.abs(blue + 1.3 * red) < 0.3) & (np.abs(blue) < 0.9)
    cells = ((np.stack([red, blue])[:, lamp] + 0.9) / 0.05).astype(int)  # of -0.9 to 0.9
    counts = np.bincount(36 * cells[0] + cells[1], minlength=36**2).reshape(36, 36)
    counts = ndimage.uniform_filter(counts.astype(float), 3)
    at = 0.05 * (np.array(np.unravel_index(int(counts.argmax()), counts.shape)) + 0.5) - 0.9
    here = lamp & (np.hypot(red - at[0], blue - at[1]) < PEAK)
    neutral = np.hypot(red, blue) < CAST
    if np.hypot(*at) < CAST or here.mean() < 0.2 or neutral.sum() > here.sum() / 3:  # a choice
        return picture
    gains = np.exp([-np.median(red[here]), 0.0, -np.median(blue[here])])
    gains /= gains.max()
    return replace(picture, rgb=np.rint(picture.rgb * gains).astype(np.uint8))


def light_of(picture: DepthPicture, ripe: BoolArray, p: EyeParameters) -> str:
    """Why colours cannot be judged; empty: they can. ``ripe``: (height, width) of such fruits.

    In white light much of what is near and no ripe fruit reflects green: stems, leaves, gutters. In
    red, blue and grow light nothing does; where it is weak, leaves still do a little.
    """
    near = (picture.depth > 0.0) & (picture.depth < p.farthest) & ~ripe
    some = np.flatnonzero(near)
    some = some[:: max(len(some) // 20_000, 1)]
    rgb = picture.rgb.reshape(-1, 3)[some].astype(np.float32)
    most = rgb.max(axis=1, initial=0.0)
    rgb, most = rgb[most > DARK], most[most > DARK]
    if len(rgb) < LEAST_SAMPLES:
        return ""
    _, dye, _ = hsv(rgb)
    if np.quantile(dye, 0.98) < GREY:
        return "the picture is grey: ripe cannot be told from unripe"
    red, green, blue = rgb.T
    greenish, other = green > GREENISH * most, np.maximum(red, blue)
    warm = blue < BLUISH * red
    weak = warm.sum() > LEAST_SAMPLES and (
        greenish[warm].mean() < WEAKER and np.quantile((green / other)[warm], 0.98) < GREENEST
    )
    if greenish.mean() < LEAST_GREENISH or weak:
        return (
            "little near reflects green: red, blue or grow light? ripe cannot be told from unripe"
        )
    return ""


def judged(
    picture: DepthPicture, found: Found, p: EyeParameters, by_colour: bool
) -> tuple[Found, list[tuple[Region, str]]]:
    """What was found, with no ripe fruit whose colour or front cannot be one: it counts as unripe,
    and is no target; and those regions, with what is wrong with them or with the light.

    ``by_colour``: whether the finder knows colours alone, so that skin and tape are looked for.
    """
    fruits = (region for region in found.regions if region.kind == "ripe")
    ripe = Region.mask(fruits, picture.depth.shape)
    light = light_of(picture, ripe, p)
    if not (light or by_colour):
        return found, []
    straight = _straight(ripe)
    out, doubts = list[Region](), list[tuple[Region, str]]()
    for region in found.regions:
        why = ""
        if region.kind == "ripe":
            tape = bool((straight[region.box] & region.part).any())
            why = light or (TAPE if tape else _no_fruit(picture, region, p))
        if why:
            region = Region("unripe", region.part, region.score, region.box, region.shape)
            doubts.append((region, why))
        out.append(region)
    return replace(found, regions=tuple(out)), doubts


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
    ripe = ripe.copy()
    islands, _ = ndimage.label(ndimage.binary_closing(ripe, np.ones((3, 3))))
    for number, box in enumerate(ndimage.find_objects(islands), 1):
        places = np.argwhere(islands[box] == number).astype(float)
        if len(places) < LEAST_SAMPLES:
            continue
        way = np.linalg.svd(places[::4] - places.mean(axis=0), full_matrices=False)[2][0]
        along = places @ way
        widths = np.bincount((along - along.min()).astype(int))[2:-2]
        width = float(np.median(widths)) if len(widths) else 1.0
        inner = widths[round(0.5 * width) : len(widths) - round(0.5 * width)]
        strip = len(inner) > (LONG - 1.0) * width and np.std(inner) < EVEN * width
        if not strip:
            ripe[box] &= islands[box] != number
    return np.asarray(ripe & (islands > 0))


def _no_fruit(picture: DepthPicture, region: Region, p: EyeParameters) -> str:
    """Why a region is no ripe fruit; empty: it may be one."""
    if not region.part.any():
        return ""
    hue, dye, bright = hsv(picture.rgb[region.box][region.part].astype(np.float32))
    told = dye[bright > p.least_bright]
    if len(told) and apart(np.array(p.ripe_hue), 0.0) < 15.0:  # a crop that is red when ripe
        turn = np.exp(1j * np.radians(hue[bright > p.least_bright]))
        middle = float(np.degrees(np.angle(turn.mean())))
        skin = apart(np.array(middle), SKIN_HUE) < apart(np.array(middle), p.ripe_hue)
        if np.median(told) < SKIN_DYE[int(skin)]:
            return "the colour of skin: a hand, an arm?"
    front = front_of(picture, region, p)
    if front is not None and front.least + 2.0 * front.deviation < TUBE:
        return TAPE
    return ""


def register_of(picture: DepthPicture, p: EyeParameters) -> tuple[str, ...]:
    """Whether edges of depth lie beside those of colour, in words; empty: they do not."""
    k = max(round(picture.camera.width / 320), 1)
    depth = picture.depth[::k, ::k]
    near = (depth > 0.0) & (depth < p.farthest)
    edges = near & (most_about(depth, 3) - depth > 2.0 * p.step)
    if edges.sum() < LEAST_EDGE:
        return ()
    rgb = picture.rgb[::k, ::k].astype(np.float32)
    steep = steepness(rgb)
    steep = np.minimum(steep, np.quantile(steep, 0.98))
    size = [n + FARTHEST_SHIFT for n in depth.shape]
    there = fft.rfft2(steep - steep.mean(), size) * fft.rfft2(edges.astype(np.float32), size).conj()
    far = FARTHEST_SHIFT // k
    match = np.roll(fft.irfft2(there, size), (far, far), (0, 1))[: 2 * far + 1, : 2 * far + 1]
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
    out = np.zeros(rgb.shape[:2], dtype=np.float32)
    planes = np.pad(np.moveaxis(rgb, 2, 0), ((0, 0), (1, 1), (1, 1)), mode="edge")
    for there in (out, out.T):
        smooth = planes[:, :-2] + 2.0 * planes[:, 1:-1] + planes[:, 2:]
        there += ((smooth[:, :, 2:] - smooth[:, :, :-2]) ** 2).sum(axis=0)
        planes = planes.transpose(0, 2, 1)
    return np.sqrt(out)


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
        stems = (stem_of(fit, *points, turn.T @ up, p, 3.0, bends=False) for fit in some)
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
