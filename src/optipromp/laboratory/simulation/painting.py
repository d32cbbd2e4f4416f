"""Pictures that surfaces of rich looks are painted with: skins of fruits, leaves, backgrounds."""

import numpy as np
from scipy.ndimage import gaussian_filter

from optipromp.core.arrays import FloatArray
from optipromp.perception.pictures import Image8

SEEDS = 60, 220  # on a fruit; a strawberry has about 200
SKIN, BLADE = (48, 96), 64  # [texel] rows and columns; side
PALE = np.array([0.88, 0.84, 0.66])  # shoulder of a ripe fruit
PINK = np.array([0.85, 0.35, 0.30])  # of a fruit that begins to ripen
GREENS = np.array([[0.06, 0.12, 0.05], [0.14, 0.30, 0.10], [0.30, 0.48, 0.16], [0.42, 0.52, 0.24]])
EARTH = np.array([  # soil, straw, film, concrete, sky
    [0.25, 0.17, 0.11], [0.62, 0.52, 0.34], [0.85, 0.86, 0.85], [0.08, 0.08, 0.09],
    [0.55, 0.54, 0.52], [0.66, 0.75, 0.86],
])  # fmt: skip


def skin(colour: FloatArray, ripe: bool, rng: np.random.Generator) -> Image8:
    """The skin of a fruit of a ``colour`` (3,), 0 to 1: rows from the stem to the tip, columns
    around, with seeds; a ripe fruit may have a pale shoulder, an unripe one a blush."""
    rows, columns = SKIN
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns
    way = _directions(polar[:, None], turn[None])
    out = colour * (1.0 + 0.08 * _noise(SKIN, 4.0, rng)[:, :, None])
    if ripe:
        edge = polar[:, None] / np.pi + 0.05 * _noise(SKIN, 6.0, rng)
        out = _mixed(out, PALE, rng.uniform(0.0, 0.8) * np.clip(1.0 - edge / 0.22, 0.0, 1.0))
    elif rng.random() < 0.3:
        side = way @ _directions(rng.uniform(0.5, 2.5), rng.uniform(0.0, 2.0 * np.pi))
        out = _mixed(out, PINK, rng.uniform(0.05, 0.3) * np.clip(side, 0.0, 1.0))
    count = int(rng.integers(SEEDS[0], SEEDS[1] + 1))
    k = np.arange(count) + 0.5
    dots = _directions(np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + np.sqrt(5.0)) * k)
    off = np.arccos(np.clip((way @ dots.T).max(axis=2), -1.0, 1.0))
    dot = out.mean(axis=(0, 1)) * rng.uniform(0.5, 1.1) + [0.15, 0.12, 0.0]
    out = out * (1.0 - 0.15 * np.exp(-((off / 0.12) ** 2)))[:, :, None]  # the dimple of a seed
    return _bytes(_mixed(out, dot, 0.9 * (off < 0.05)))


def blade(rng: np.random.Generator) -> Image8:
    """A leaf: rows along it, the first half of the columns across its upper side, the second half
    across its paler lower side."""
    u, v = np.mgrid[0:BLADE, 0:BLADE] / (BLADE - 1.0)
    aside = np.abs(2.0 * v - 1.0)
    side_veins = np.abs((7.0 * u - 2.5 * aside) % 1.0 - 0.5) < 0.06
    veins = np.maximum(0.35 * side_veins, 0.6 * (aside < 0.06))
    tint = GREENS[1] + rng.uniform(0.0, 0.7) * (GREENS[2] - GREENS[1])
    green = np.clip(tint * (1.0 + 0.12 * rng.standard_normal(3)), 0.0, 1.0)
    upper = green * (1.0 + 0.12 * _noise((BLADE, BLADE), 5.0, rng)[:, :, None])
    if rng.random() < 0.3:  # old
        dry = np.clip(_noise((BLADE, BLADE), 8.0, rng) - 0.6 + 0.8 * aside, 0.0, 1.0)
        upper = _mixed(upper, np.array([0.55, 0.45, 0.18]), 0.8 * dry)
    upper = _mixed(upper, np.array([0.50, 0.62, 0.32]), veins)
    lower = _mixed(upper, np.array([0.55, 0.62, 0.45]), 0.5)
    return _bytes(np.concatenate([upper, lower], axis=1))


def background(width: int, height: int, rng: np.random.Generator) -> Image8:
    """What is behind a plant: foliage, ground and film, or two colours of any kind."""
    chance = rng.random()
    if chance < 0.6:
        return foliage(width, height, rng)
    pool = EARTH if chance < 0.85 else rng.uniform(0.1, 0.9, (3, 3))
    out = np.broadcast_to(pool[rng.integers(len(pool))], (height, width, 3))
    for _ in range(2):
        share = 1.0 / (1.0 + np.exp(-3.0 * _noise((height, width), rng.uniform(1.0, 30.0), rng)))
        out = _mixed(out, pool[rng.integers(len(pool))], share)
    fine = 1.0 + rng.uniform(0.0, 0.06) * _noise((height, width), 0.8, rng)
    return _bytes(out * fine[:, :, None])


def foliage(width: int, height: int, rng: np.random.Generator) -> Image8:
    """Leaves and stems before the dark, more or less in focus."""
    from PIL import Image, ImageDraw, ImageFilter

    dark, light = rng.uniform(0.2, 1.5), rng.uniform(0.6, 1.1)
    picture = Image.new("RGB", (width, height), _colour(dark * GREENS[0]))
    draw = ImageDraw.Draw(picture)
    u = np.linspace(0.0, 1.0, 7)
    half = 0.33 * np.sin(np.pi * u**0.8)
    side = np.stack([u, half], axis=1)
    other = side[::-1] * [1.0, -1.0]
    size, count = width * rng.uniform(0.04, 0.14), int(rng.integers(120, 320))
    for k in range(count):
        at, turn = rng.uniform([0, 0], [width, height]), rng.uniform(0.0, 2.0 * np.pi)
        long = size * rng.uniform(0.6, 1.4)
        c, s = long * np.cos(turn), long * np.sin(turn)
        green = GREENS[1:][rng.integers(3)] * (0.25 + 0.75 * k / count) * light
        green = green * rng.uniform(0.8, 1.15, 3)
        if rng.random() < 0.15:
            draw.line([*at, *(at + [2.0 * c, 2.0 * s])], fill=_colour(green), width=2)
            continue
        turned = np.array([[c, s], [-s, c]])
        for edge, shade in ((side, 1.0), (other, rng.uniform(0.7, 1.0))):
            draw.polygon((at + edge @ turned).ravel().tolist(), fill=_colour(shade * green))
        draw.line([*at, *(at + [c, s])], fill=_colour(1.25 * green))
    blurred = picture.filter(ImageFilter.GaussianBlur(width * rng.uniform(0.0, 0.012)))
    return np.asarray(blurred, dtype=np.uint8)


def _colour(values: FloatArray) -> tuple[int, ...]:
    return tuple(_bytes(values).tolist())


def _directions(polar: object, turn: object) -> FloatArray:
    """Unit vectors (..., 3) at angles from z and about it [rad]."""
    polar, turn = np.broadcast_arrays(np.asarray(polar), np.asarray(turn))
    flat = np.sin(polar)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.cos(polar)], axis=-1)


def _noise(size: tuple[int, int], width: float, rng: np.random.Generator) -> FloatArray:
    """Noise of unit deviation, correlated over ``width`` texels, that repeats without a seam."""
    rough = gaussian_filter(rng.standard_normal(size), width, mode="wrap")
    return np.asarray(rough / rough.std())


def _mixed(one: FloatArray, other: FloatArray, share: FloatArray | float) -> FloatArray:
    """Colours (..., 3) with a ``share`` (...) of another colour."""
    part = np.asarray(share)[..., None]
    return np.asarray(one * (1.0 - part) + other * part)


def _bytes(colours: FloatArray) -> Image8:
    return np.asarray(np.clip(255.0 * colours, 0.0, 255.0), dtype=np.uint8)
