"""Abstract shapes made on the fly: flat ellipses on lines, as in the paper, to learn stems from.

No robot, no light, no perspective: ellipses are fruits, lines are stems, polygons are leaves and
clutter. Each has one colour and a depth; nearer shapes cover those behind.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp_eyes.pictures import CameraModel, DepthPicture
from optipromp_sim.simulation.photograph import Kind, Marked, StereoParameters, sensed

FRUITS = 1, 8  # number in a picture; all numbers here are choices
CLUTTER = 4, 14  # polygons and lines
WIDE = 0.030, 0.042  # [m] of a fruit across
LONGER = 1.0, 1.9  # length over width
BESIDE = 0.5  # share of fruits that hang near another
LEAN = 60.0  # [deg] of a stem off the vertical, at most
CROOKED = 12.0  # [deg] standard deviation of a fruit off its stem
NEAR, FAR = 0.35, 0.75  # [m] depth of fruits
FOCAL = 0.75  # focal length over the width of a picture
RED, GREEN, STEM, LEAF = (0.75, 0.1, 0.1), (0.65, 0.75, 0.45), (0.35, 0.55, 0.25), (0.2, 0.4, 0.15)


class _Shape(NamedTuple):
    name: str
    kind: Kind
    points: FloatArray  # (N, 2) [pixel]
    depth: float  # [m]
    colour: FloatArray


class Shot(NamedTuple):
    """A picture with its truth, as a photograph has it."""

    picture: DepthPicture  # colours and depth
    masks: NDArray[np.uint8]  # (height, width) rows of ``marked`` plus one; 0 is background
    marked: tuple[Marked, ...]  # what each value is


def shapes(seed: int, width: int = 320, height: int = 240) -> Shot:
    """A picture of abstract shapes; the same seed gives the same picture."""
    rng = np.random.default_rng([seed, 37])
    focal = FOCAL * width
    out = _clutter(rng, width, height)
    middle = np.zeros(2)
    for k in range(int(rng.integers(FRUITS[0], FRUITS[1] + 1))):
        if k and rng.random() < BESIDE:
            middle = middle + 0.09 * width * rng.standard_normal(2)
        else:
            middle = rng.uniform([0.1 * width, 0.25 * height], [0.9 * width, 0.95 * height])
        out += _fruit(f"f{k}", middle, focal, rng)
    out.sort(key=lambda shape: -shape.depth)
    rgb = _ground(rng, width, height)
    depth = np.full((height, width), rng.uniform(0.8, 2.0))
    masks = np.zeros((height, width), dtype=np.uint8)
    whole = []
    for row, shape in enumerate(out, start=1):
        cut, inside = _stencil(shape.points, width, height)
        rgb[cut][inside] = shape.colour
        depth[cut][inside] = shape.depth
        masks[cut][inside] = row
        whole.append(int(inside.sum()))
    seen = np.bincount(masks.ravel(), minlength=len(out) + 1)[1:]
    shares = [
        float(part) / max(all_, 1) if shape.kind in ("ripe", "unripe") else math.nan
        for shape, part, all_ in zip(out, seen, whole, strict=True)
    ]
    marked = tuple(Marked(s.name, s.kind, share) for s, share in zip(out, shares, strict=True))
    noisy = 255.0 * rgb + rng.uniform(1.0, 6.0) * rng.standard_normal(rgb.shape, dtype=np.float32)
    picture = DepthPicture(
        np.clip(np.rint(noisy), 0, 255).astype(np.uint8),
        sensed(depth, focal, StereoParameters(), rng),
        CameraModel(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1)),
    )  # fmt: skip
    return Shot(picture, masks, marked)


def _stencil(points: FloatArray, width: int, height: int) -> tuple[tuple[slice, slice], BoolArray]:
    """The box of a polygon (N, 2) in the picture, and which of its pixels are inside."""
    from PIL import Image, ImageDraw

    low = np.clip(np.floor(points.min(axis=0)), 0, [width, height]).astype(int)
    high = np.clip(np.ceil(points.max(axis=0)) + 1, 0, [width, height]).astype(int)
    size = np.maximum(high - low, 1)
    stencil = Image.new("L", tuple(size.tolist()))
    ImageDraw.Draw(stencil).polygon((points - low).ravel().tolist(), fill=1)
    box = slice(low[1], high[1]), slice(low[0], high[0])
    return box, (np.asarray(stencil) > 0)[: high[1] - low[1], : high[0] - low[0]]


def _ground(rng: np.random.Generator, width: int, height: int) -> FloatArray:
    """Two colours (height, width, 3) that pass into one another."""
    from PIL import Image

    coarse = int(rng.integers(2, 40))
    small = Image.fromarray(rng.standard_normal((coarse, coarse), dtype=np.float32))
    rough = np.asarray(small.resize((width, height), Image.Resampling.BICUBIC))
    share = (1.0 / (1.0 + np.exp(-2.0 * rough)))[:, :, None]
    one, other = rng.uniform(0.05, 0.95, (2, 3)).astype(np.float32)
    return np.asarray(share * one + (1.0 - share) * other)


def _coloured(base: tuple[float, float, float], rng: np.random.Generator) -> FloatArray:
    tint = rng.uniform(0.6, 1.3) * (np.array(base) + 0.07 * rng.standard_normal(3))
    return np.clip(tint, 0.02, 0.98)


def _clutter(rng: np.random.Generator, width: int, height: int) -> list[_Shape]:
    """Leaves before and behind the fruits; polygons and lines of any colour behind them."""
    out = []
    for k in range(int(rng.integers(CLUTTER[0], CLUTTER[1] + 1))):
        middle, chance = rng.uniform([0, 0], [width, height]), rng.random()
        kind: Kind = "leaf" if chance < 0.5 else "other"
        near = NEAR if kind == "leaf" else FAR
        colour = _coloured(LEAF, rng) if kind == "leaf" else rng.uniform(0.02, 0.98, 3)
        if chance > 0.8:
            points = _line(middle, rng.uniform([0, 0], [width, height]), rng.uniform(0.6, 4.0), 0.0)
        else:
            size = width * (rng.uniform(0.04, 0.14) if kind == "leaf" else rng.uniform(0.05, 0.3))
            turns = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(4, 9))))
            reach = size * rng.uniform(0.4, 1.0, len(turns))
            points = middle + reach[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
        out.append(_Shape(f"c{k}", kind, points, float(rng.uniform(near, 1.2)), colour))
    return out


def _line(begin: FloatArray, end: FloatArray, thick: float, bow: float) -> FloatArray:
    """A line as a polygon (N, 2), ``thick`` to either side, bowed by ``bow`` of its length."""
    along = end - begin
    across = np.array([-along[1], along[0]])
    share = np.linspace(0.0, 1.0, 7)[:, None]
    middle = begin + share * along + 4.0 * bow * share * (1.0 - share) * across
    side = thick * across / max(float(np.linalg.norm(across)), 1e-9)
    return np.concatenate([middle + side, middle[::-1] - side])


def _fruit(name: str, middle: FloatArray, focal: float, rng: np.random.Generator) -> list[_Shape]:
    """An ellipse on a line, with a star where they meet."""
    depth = float(rng.uniform(NEAR, FAR))
    half = 0.5 * focal * rng.uniform(*WIDE) / depth
    long = half * rng.uniform(*LONGER)
    lean = math.radians(rng.uniform(-LEAN, LEAN))
    off = lean + math.radians(CROOKED) * rng.standard_normal()
    up, axis = (np.array([math.sin(a), -math.cos(a)]) for a in (lean, off))
    side = np.array([-axis[1], axis[0]])
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    ring = middle + np.outer(long * np.cos(turn), axis) + np.outer(half * np.sin(turn), side)
    top = middle + long * axis
    root = top + focal * rng.uniform(0.06, 0.3) / depth * up
    thick = max(0.5 * focal * rng.uniform(0.003, 0.006) / depth, 0.6)
    star = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    reach = half * np.where(np.arange(10) % 2, 0.7, 0.3)
    kind: Kind = "ripe" if rng.random() < 0.35 else "unripe"
    joint = top - 0.1 * long * axis
    stem = _line(joint, root, thick, rng.uniform(-0.06, 0.06))
    calyx = joint + np.column_stack([reach * np.cos(star), reach * np.sin(star)])
    return [
        _Shape(name, "stem", stem, depth + 0.002, _coloured(STEM, rng)),
        _Shape(name, kind, ring, depth, _coloured(RED if kind == "ripe" else GREEN, rng)),
        _Shape(name, "calyx", calyx, depth - 0.002, _coloured(STEM, rng)),
    ]
