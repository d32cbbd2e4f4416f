"""Abstract shapes made on the fly: flat ellipses on lines, as in the paper, to learn stems from.

No robot, no light, no perspective: ellipses are fruits, lines are stems, polygons are leaves and
clutter. Each has one colour and a depth; nearer shapes cover those behind.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp.laboratory.simulation.photograph import Kind, Marked
from optipromp.laboratory.simulation.stereo import StereoParameters, sensed
from optipromp.perception.pictures import CameraModel, DepthPicture

FRUITS = 1, 8  # number in a picture: choices
CLUTTER = 4, 14  # polygons
WIDE = 0.030, 0.042  # [m] of a fruit across
LONGER = 1.0, 1.9  # length over width
LEAN = 60.0  # [deg] of a stem off the vertical, at most
NEAR, FAR = 0.35, 0.75  # [m] depth of fruits
FOCAL = 0.75  # focal length over the width of a picture
RED, GREEN, STEM, LEAF = (0.75, 0.1, 0.1), (0.65, 0.75, 0.45), (0.35, 0.55, 0.25), (0.2, 0.4, 0.15)


class Drawn(NamedTuple):
    """A picture of shapes with its truth, as of a photograph.

    Attributes:
        picture: colours and depth.
        masks: (height, width) rows of ``marked`` plus one; 0 is background.
        marked: what each value is.
    """

    picture: DepthPicture
    masks: NDArray[np.uint8]
    marked: tuple[Marked, ...]


class _Shape(NamedTuple):
    name: str
    kind: Kind
    points: FloatArray  # (N, 2) [pixel]
    depth: float  # [m]
    colour: FloatArray


def shapes(seed: int, width: int = 320, height: int = 240) -> Drawn:
    """A picture of abstract shapes; the same seed gives the same picture."""
    from PIL import Image, ImageDraw

    rng = np.random.default_rng([seed, 37])
    focal = FOCAL * width
    out = _clutter(rng, width, height)
    for k in range(int(rng.integers(FRUITS[0], FRUITS[1] + 1))):
        out += _fruit(k, rng, width, height, focal)
    out.sort(key=lambda shape: -shape.depth)
    wall = float(rng.uniform(0.8, 2.0))
    rgb = _ground(rng, width, height)
    depth = np.full((height, width), wall)
    masks = np.zeros((height, width), dtype=np.uint8)
    marked: list[Marked] = []
    for shape in out:
        stencil = Image.new("L", (width, height))
        ImageDraw.Draw(stencil).polygon([tuple(p) for p in shape.points.tolist()], fill=1)
        inside = np.asarray(stencil) > 0
        rgb[inside] = shape.colour
        depth[inside] = shape.depth
        if shape.kind != "other":
            marked.append(Marked(shape.name, shape.kind, math.nan))
            masks[inside] = len(marked)
        else:
            masks[inside] = 0
    noisy = 255.0 * rgb + rng.uniform(1.0, 6.0) * rng.standard_normal(rgb.shape)
    picture = DepthPicture(
        np.clip(np.rint(noisy), 0, 255).astype(np.uint8),
        sensed(depth, focal, StereoParameters(), rng),
        CameraModel(
            width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1),
            Pose(np.zeros(3), np.eye(3)),
        ),
    )  # fmt: skip
    return Drawn(picture, masks, tuple(marked))


def _ground(rng: np.random.Generator, width: int, height: int) -> FloatArray:
    rough = gaussian_filter(rng.standard_normal((height, width)), rng.uniform(2.0, 40.0))
    share = 1.0 / (1.0 + np.exp(-2.0 * rough / rough.std()))[:, :, None]
    one, other = rng.uniform(0.05, 0.95, (2, 3))
    return np.asarray(share * one + (1.0 - share) * other)


def _coloured(base: tuple[float, float, float], rng: np.random.Generator) -> FloatArray:
    tint = rng.uniform(0.6, 1.3) * (np.array(base) + 0.07 * rng.standard_normal(3))
    return np.clip(tint, 0.02, 0.98)


def _clutter(rng: np.random.Generator, width: int, height: int) -> list[_Shape]:
    out = []
    for k in range(int(rng.integers(CLUTTER[0], CLUTTER[1] + 1))):
        middle = rng.uniform([0, 0], [width, height])
        if rng.random() < 0.5:
            kind: Kind = "leaf"
            colour, size = _coloured(LEAF, rng), rng.uniform(0.04, 0.14) * width
        else:
            kind, colour = "other", rng.uniform(0.02, 0.98, 3)
            size = rng.uniform(0.05, 0.3) * width
        turns = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(4, 9))))
        reach = size * rng.uniform(0.4, 1.0, len(turns))
        points = middle + reach[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
        near = NEAR if kind == "leaf" else FAR
        out.append(_Shape(f"c{k}", kind, points, float(rng.uniform(near, 1.2)), colour))
    return out


def _fruit(k: int, rng: np.random.Generator, width: int, height: int, focal: float) -> list[_Shape]:
    """An ellipse on a line, with a small polygon where they meet."""
    depth = float(rng.uniform(NEAR, FAR))
    half = 0.5 * focal * rng.uniform(*WIDE) / depth
    long = half * rng.uniform(*LONGER)
    middle = rng.uniform([0.1 * width, 0.25 * height], [0.9 * width, 0.95 * height])
    lean = math.radians(rng.uniform(-LEAN, LEAN))
    up = np.array([math.sin(lean), -math.cos(lean)])
    off = lean + math.radians(15.0) * rng.standard_normal()
    axis = np.array([math.sin(off), -math.cos(off)])
    side = np.array([-axis[1], axis[0]])
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ring = middle + np.outer(long * np.cos(turn), axis) + np.outer(half * np.sin(turn), side)
    top = middle + 0.9 * long * axis
    end = top + focal * rng.uniform(0.06, 0.3) / depth * up
    thick = max(0.5 * focal * rng.uniform(0.003, 0.006) / depth, 0.6)
    across = thick * np.array([-up[1], up[0]])
    bow = 0.5 * (top + end) + rng.uniform(-3.0, 3.0) * across
    line = np.array([top + across, bow + across, end + across, end - across, bow - across,
                     top - across])  # fmt: skip
    ripe = bool(rng.random() < 0.35)
    name = f"f{k}"
    star = [
        top + (0.7 if i % 2 else 0.3) * half * np.array([math.cos(a), math.sin(a)])
        for i, a in enumerate(np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False))
    ]
    return [
        _Shape(name, "stem", line, depth + 0.002, _coloured(STEM, rng)),
        _Shape(
            name, "ripe" if ripe else "unripe", ring, depth, _coloured(RED if ripe else GREEN, rng)
        ),
        _Shape(name, "calyx", np.array(star), depth - 0.002, _coloured(STEM, rng)),
    ]
