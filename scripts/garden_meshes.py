"""Meshes of the second renderer's plants: fruits, leaves, stems and slabs, with their colours.

``garden.py`` puts them together. Every number here is a choice.
"""

import math
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter


def unit(v: np.ndarray) -> np.ndarray:
    """A vector of length 1."""
    return np.asarray(v / np.linalg.norm(v))


def frame(z: np.ndarray) -> np.ndarray:
    """Axes (3, 3) in columns, the last along ``z``."""
    z = unit(z)
    x = unit(np.cross(z, [1.0, 0.0, 0.0] if abs(z[0]) < 0.8 else [0.0, 1.0, 0.0]))
    return np.column_stack([x, np.cross(z, x), z])


def spin(angle: float) -> np.ndarray:
    """The turn (3, 3) by an angle [rad] about z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def grid_faces(rows: int, columns: int, closed: bool) -> np.ndarray:
    """Triangles of a grid of corners; ``closed``: the last column meets the first."""
    out = []
    for c in range(columns if closed else columns - 1):
        d = (c + 1) % columns
        r = np.arange(rows - 1)
        a, b = r * columns + c, r * columns + d
        e, f = a + columns, b + columns
        out += [np.column_stack([a, e, b]), np.column_stack([b, e, f])]
    return np.concatenate(out)


def smooth(rng: np.random.Generator, shape: tuple[int, ...], width: float) -> np.ndarray:
    """Noise of unit deviation."""
    rough = gaussian_filter(rng.standard_normal(shape), width, mode="wrap")
    return np.asarray(rough / max(rough.std(), 1e-9))


def skin(rng: np.random.Generator, ripeness: float, crop: str, polar: np.ndarray, turn: np.ndarray):
    """Colours (rows, columns, 3), linear, of a fruit; polar 0 is at its stem."""
    red = np.array([0.42, 0.012, 0.015]) * rng.uniform(0.35, 1.6) + [0, rng.uniform(0, 0.03), 0]
    if crop == "tomato":
        red = np.array([0.5, 0.04, 0.015]) * rng.uniform(0.5, 1.3)
    green = np.array([0.30, 0.42, 0.12]) * rng.uniform(0.4, 1.3) * rng.uniform(0.8, 1.2, 3)
    white = np.array([0.62, 0.62, 0.36]) * rng.uniform(0.7, 1.2)
    young = green + (white - green) * np.clip(ripeness / 0.45, 0.0, 1.0)
    if crop == "tomato":
        young = np.array([0.16, 0.30, 0.06]) * rng.uniform(0.5, 1.5) + 0.1 * ripeness
    side = np.cos(turn[None] - rng.uniform(0, 2 * np.pi)) * np.sin(polar[:, None])
    here = ripeness + 0.12 * side + 0.16 * (polar[:, None] / np.pi - 0.5)
    here = here + 0.05 * smooth(rng, (len(polar), len(turn)), 3.0)
    share = 1.0 / (1.0 + np.exp(-(here - 0.52) / 0.05))
    out = young + share[..., None] * (red - young)
    if ripeness > 0.6 and rng.random() < 0.5:  # a pale shoulder
        pale = np.clip(1.0 - polar[:, None] / rng.uniform(0.3, 0.8), 0.0, 1.0)
        pale = pale * rng.uniform(0.2, 0.9)
        out = out + pale[..., None] * (white - out)
    out = out * (1.0 + 0.08 * smooth(rng, share.shape, 1.5)[..., None])
    if crop == "strawberry":
        count = int(rng.integers(80, 260))
        k = np.arange(count) + 0.5
        p, t = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
        dots = np.stack([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)], axis=-1)
        way = np.stack(
            [
                np.sin(polar)[:, None] * np.cos(turn), np.sin(polar)[:, None] * np.sin(turn),
                np.broadcast_to(np.cos(polar)[:, None], share.shape),
            ],
            axis=-1,
        )  # fmt: skip
        near = (way.reshape(-1, 3) @ dots.T).max(axis=1).reshape(share.shape) > math.cos(0.055)
        seed = np.array([0.45, 0.32, 0.08]) * rng.uniform(0.3, 1.3)
        out = out + (near * rng.uniform(0.3, 0.9))[..., None] * (seed - out)
    return np.clip(out, 0.003, 0.9)


def fruit_mesh(rng, ripeness: float, crop: str, radius: float, half: float):
    """Corners about the middle of the extent, axis z to the stem; faces; colours."""
    rows, columns = 34, 48
    polar = np.linspace(0.0, np.pi, rows)
    turn = np.linspace(0.0, 2 * np.pi, columns, endpoint=False)
    conic = rng.uniform(0.0, 0.45) if crop == "strawberry" else rng.uniform(-0.05, 0.1)
    wide = np.sin(polar) * (1.0 + conic * np.cos(polar))
    wide = wide / wide.max()
    if rng.random() < 0.25:  # a flat or cleft fruit
        wide = wide[:, None] * (1.0 + rng.uniform(0.0, 0.15) * np.cos(2 * turn)[None])
    else:
        wide = np.broadcast_to(wide[:, None], (rows, columns))
    bump = 1.0 + rng.uniform(0.0, 0.035) * smooth(rng, (rows, columns), 3.0)
    r = radius * wide * bump
    points = np.stack(
        [r * np.cos(turn), r * np.sin(turn), np.repeat(half * np.cos(polar)[:, None], columns, 1)],
        axis=-1,
    )
    colours = skin(rng, ripeness, crop, polar, turn)
    return points.reshape(-1, 3), grid_faces(rows, columns, True), colours.reshape(-1, 3)


def tube(points: np.ndarray, radius: Any, sides: int = 8):
    """A pipe along points (N, 3) and its faces."""
    along = np.gradient(points, axis=0)
    turn = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    radius = np.broadcast_to(radius, len(points))
    rings = []
    first = frame(along[0])[:, 0]
    for p, way, r in zip(points, along, radius, strict=True):
        z = unit(way)
        first = unit(first - (first @ z) * z)
        second = np.cross(z, first)
        rings.append(p + r * (np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second))
    return np.concatenate(rings), grid_faces(len(points), sides, True)


def bowed(begin: np.ndarray, end: np.ndarray, rng, bow: float, count: int = 12) -> np.ndarray:
    """A bowed line (N, 3) between two points."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    long = float(np.linalg.norm(end - begin))
    side = unit(np.cross(end - begin, rng.standard_normal(3)))
    wave = 4.0 * share * (1.0 - share) * (1.0 + rng.uniform(-0.8, 0.8) * (share - 0.5))
    return begin + share * (end - begin) + bow * long * wave * side


GREENS = np.array([[0.02, 0.06, 0.01], [0.06, 0.16, 0.03], [0.15, 0.30, 0.06], [0.30, 0.42, 0.12]])


def green(rng, dark: float = 0.0) -> np.ndarray:
    """A leaf's or stem's colour."""
    a, b = GREENS[rng.integers(0, 3)], GREENS[rng.integers(1, 4)]
    out = (a + rng.random() * (b - a)) * rng.uniform(0.6, 1.4) * rng.uniform(0.85, 1.15, 3)
    return np.clip(out * (1.0 - dark), 0.004, 0.8)


def leaf_mesh(rng, size: float):
    """A blade with veins from the origin along x, in the xy plane, curled."""
    rows, columns = 14, 11
    u, v = np.meshgrid(np.linspace(0, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    edge = np.sin(np.pi * u ** rng.uniform(0.6, 1.1)) * (1 + 0.08 * np.abs(np.sin(9 * np.pi * u)))
    half = rng.uniform(0.25, 0.5)
    x, y = u, half * edge * v
    z = -rng.uniform(0, 0.4) * u**2 + rng.uniform(-0.3, 0.5) * np.abs(y) * 0.6
    z = z + 0.03 * smooth(rng, u.shape, 1.2)
    points = size * np.stack([x, y, z], axis=-1)
    base = green(rng)
    veins = np.maximum(np.abs(v) < 0.08, np.abs((6 * u - 2 * np.abs(v)) % 1 - 0.5) < 0.1)
    colours = base * (1 + 0.15 * smooth(rng, u.shape, 1.5))[..., None]
    pale = (veins * rng.uniform(0, 0.5))[..., None]
    colours = colours + pale * (np.array([0.4, 0.5, 0.2]) - colours)
    if rng.random() < 0.15:  # old
        dry = np.clip(smooth(rng, u.shape, 2.5), 0, 1)[..., None]
        colours = colours + dry * (np.array([0.35, 0.2, 0.06]) * rng.uniform(0.5, 1.2) - colours)
    colours = np.clip(colours, 0.003, 0.9).reshape(-1, 3)
    return points.reshape(-1, 3), grid_faces(rows, columns, False), colours


def slab(size: np.ndarray, cuts: int = 14):
    """A box with corners enough for a texture, about its middle."""
    points, faces, count = [], [], 0
    for axis in range(3):
        for sign in (-1.0, 1.0):
            a, b = [k for k in range(3) if k != axis]
            u, v = np.meshgrid(*[np.linspace(-0.5, 0.5, cuts)] * 2, indexing="ij")
            p = np.zeros((cuts, cuts, 3))
            p[..., axis], p[..., a], p[..., b] = 0.5 * sign, u, v
            points.append(p.reshape(-1, 3) * size)
            faces.append(grid_faces(cuts, cuts, False) + count)
            count += cuts * cuts
    return np.concatenate(points), np.concatenate(faces)
