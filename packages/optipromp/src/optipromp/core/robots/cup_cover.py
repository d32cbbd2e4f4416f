r"""Covering a cup (an open cylinder on a neck) with few spheres.

The outside is tight: no sphere reaches more than a bulge b = max(4 mm, 0.09 R) beyond the outer
radius R or above the rim. Inside the mouth and behind the base, within R + b of the axis, there is
room for larger spheres.

A ring of m spheres of radius s whose centres stand at ρ = R + b - s, at one height, covers the wall
between neighbours up to h above and below where

.. math:: h^2 = s^2 - (\rho^2 + R^2 - 2 ρ R \cos(\pi / m)).

One sphere on the axis of radius R + b covers h = sqrt((R + b)² - R²). The wall is stacked from such
bands, from the rim down; the cheapest stack is found by dynamic programming over heights.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.compiled import called
from optipromp.core.robots.tool_geometry import cover_capsule

NECK_RADIUS = 0.01  # [m] chosen
_STEPS = 100  # steps of the dynamic programme, chosen: at least; a step is at most a bulge high
_SLACK = 1.0 + 1e-9  # factor of the radii, against rounding


@dataclass(frozen=True)
class _Band:
    """A ring of ``count`` spheres of ``radius`` at distance ``ring`` from the axis, all [m]."""

    count: int
    ring: float
    radius: float
    half_height: float  # [m] of the wall that it covers, above and below its height


def cover_cup(radius: float, inner: float, height: float, length: float, cone: float) -> FloatArray:
    """Spheres (k, 4) over a cup whose base stands ``length`` above the origin, mouth along z [m].

    Covered: the outer wall, the base disc, the rim from ``inner`` to ``radius``, the neck, and the
    cone of height ``cone`` under the base. 0: none. Under a cup wider than high, its spheres stand
    out farther than a bulge.
    """
    bulge = max(0.004, 0.09 * radius)
    rows = _stack(radius, height, bulge)
    rows += _rim(radius, inner, height, bulge, rows)
    rings = [_ring(z, band) for z, band in rows]
    under = _cone(radius, height, cone, bulge) if cone else _base(radius, height, bulge, rows)
    cup = np.concatenate([*rings, under])
    cup[:, 2] += length
    neck = np.zeros((0, 4))
    # the neck ends where a sphere on the axis begins to cover it
    on_axis = cup[np.hypot(cup[:, 0], cup[:, 1]) < 1e-12]
    below = [z - math.sqrt(s * s - NECK_RADIUS**2) for _, _, z, s in on_axis if s > NECK_RADIUS]
    top = min([length, *below])
    if top > 0.0:
        base, tip = np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, top])
        neck = cover_capsule(base, tip, NECK_RADIUS, bulge=0.004)
    cover: FloatArray = np.concatenate([neck, cup])
    cover[:, 3] *= _SLACK
    return cover


def _stack(radius: float, height: float, bulge: float) -> list[tuple[float, _Band]]:
    """Heights and bands that cover the wall from the rim (z = height) to the base (z = 0)."""
    steps = max(_STEPS, math.ceil(height / bulge))
    step = height / steps
    count, ring, size, half, steps_on, below_rim = _bands(radius, bulge, height, step)
    kept = _undominated(count + 1e-3 * size, below_rim, steps_on)
    count, ring, size, half = count[kept], ring[kept], size[kept], half[kept]
    cost, choice, after = np.zeros(steps + 1), *np.zeros((2, steps + 1), dtype=np.int64)
    _cheapest(
        count, 1e-3 * size, 2.0 * half / step, size - half, step, height + bulge,
        cost, choice, after,
    )  # fmt: skip
    rows, i = [], steps
    while i > 0:
        k, top = choice[i], i * step
        band = _Band(int(count[k]), float(ring[k]), float(size[k]), float(half[k]))
        # the lowest band may stand higher than needed, so that it does not reach behind the base
        middle = min(max(top - band.half_height, top / 2.0), height + bulge - band.radius)
        rows.append((middle if after[i] == 0 else top - band.half_height, band))
        i = int(after[i])
    return rows


@called
def _cheapest(count, price, advance, below_rim, step, top, cost, choice, after):
    """The least ``cost`` of the wall below each height of the programme, the band chosen there and
    the next height ``after`` it, in place. A band must be below the rim, and must advance."""
    for i in range(1, cost.shape[0]):
        cost[i] = np.inf
        for k in range(count.shape[0]):
            to = max(math.ceil(i - advance[k] + 1e-9), 0)
            if to >= i or below_rim[k] > top - i * step + 1e-12:
                continue
            total = count[k] + cost[to] + price[k]
            if total < cost[i]:
                cost[i], choice[i], after[i] = total, k, to


def _undominated(cost: FloatArray, below_rim: FloatArray, steps: FloatArray) -> IntArray:
    """Indices of the bands that no cheaper band replaces with as many steps, as near to the rim."""
    order = np.lexsort((cost, below_rim, steps))
    price = (cost - 2.0 * cost.max() * steps)[order]  # those of more steps begin a new minimum
    least = np.minimum.accumulate(price)
    cheaper = np.append(True, price[1:] < least[:-1])
    return np.sort(order[cheaper])


def _bands(
    radius: float, bulge: float, height: float, step: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The bands (m,) to choose from: count, ring, radius and half height of :class:`_Band`.

    Fifth and sixth array: see :func:`_in_steps`. Of rings with spheres of one size that agree in
    both, only the ring of the fewest spheres is returned.
    """
    outer = radius + bulge
    count = np.arange(5.0, 61.0)[:, None]
    size = np.linspace(bulge, 0.9 * outer, 120)
    ring = outer - size
    square = size**2 - (ring**2 + radius**2 - 2.0 * ring * radius * np.cos(np.pi / count))
    half = np.sqrt(np.maximum(square, 0.0))
    covers = square > 0.0
    steps, lowest = _in_steps(size, half, height + bulge, step)
    alike = (steps[1:] == steps[:-1]) & (lowest[1:] == lowest[:-1])
    covers[1:] &= ~(alike & covers[:-1])
    rows, columns = np.nonzero(covers)
    axis = np.array([1.0, 0.0, outer, math.sqrt(outer**2 - radius**2)])
    first = *axis, *_in_steps(axis[2], axis[3], height + bulge, step)
    rings = (
        count[rows, 0], ring[columns], size[columns], half[covers], steps[covers], lowest[covers],
    )  # fmt: skip
    bands = [np.append(one, many) for one, many in zip(first, rings, strict=True)]
    return bands[0], bands[1], bands[2], bands[3], bands[4], bands[5]


def _in_steps(size: Any, half: Any, top: float, step: float) -> tuple[Any, Any]:
    """Whole steps by which bands advance, and minus the whole steps from the rim down to them."""
    return np.ceil(2.0 * half / step - 1e-9), np.ceil((size - half - top - 1e-12) / step)


def _span(band: _Band, offset: float) -> tuple[float, float]:
    """Least and largest radius [m] that a band covers of a horizontal plane at ``offset`` [m]."""
    angle = math.pi / band.count if band.count > 1 else 0.0
    reach = band.radius**2 - offset**2
    across = (band.ring * math.sin(angle)) ** 2
    if reach < across:
        return math.inf, -math.inf
    middle, half = band.ring * math.cos(angle), math.sqrt(reach - across)
    return (0.0 if band.ring**2 <= reach else middle - half), middle + half


def _inner_edge(outer: float, plane: float, rows: list[tuple[float, _Band]]) -> float:
    """The radius [m] down to which ``rows`` cover the plane at height ``plane``, from ``outer``."""
    edge = outer
    for low, high in sorted((_span(band, plane - z) for z, band in rows), key=lambda s: -s[1]):
        if high * _SLACK >= edge:
            edge = min(edge, low)
    return edge


def _rim(
    radius: float, inner: float, height: float, bulge: float, rows: list[tuple[float, _Band]]
) -> list[tuple[float, _Band]]:
    """Further bands, if the rim reaches further inward than ``rows`` cover it."""
    edge = _inner_edge(radius, height, rows)
    added: list[tuple[float, _Band]] = []
    while edge > inner * _SLACK:
        best: tuple[float, float, _Band] | None = None
        for size in np.linspace(bulge, min((height + bulge) / 2.0, radius + bulge), 40):
            reach = 2.0 * size * bulge - bulge**2  # squared, in the plane of the rim
            if reach >= edge**2 and (best is None or best[1] > inner or best[2].count > 1):
                best = (1.0 / edge, 0.0, _Band(1, 0.0, float(size), 0.0))
                break
            for count in range(4, 61):
                angle = math.pi / count
                room = reach - (edge * math.sin(angle)) ** 2
                if room <= 0.0:
                    continue
                ring = min(edge * math.cos(angle) - math.sqrt(room) + 1e-9, radius + bulge - size)
                if ring <= 0.0:
                    continue
                band = _Band(count, ring, float(size), 0.0)
                low, high = _span(band, float(size) - bulge)
                if high * _SLACK < edge:  # the outer wall leaves no room for this ring
                    continue
                end = max(low, inner)
                price = count / max(edge - end, 1e-12)
                if best is None or price < best[0]:
                    best = (price, end, band)
        if best is None or best[1] >= edge:  # cannot be: a ring of small enough spheres advances
            raise RuntimeError(f"no cover of the rim from {edge} to {inner}")
        edge = best[1]
        added.append((height + bulge - best[2].radius, best[2]))
    return added


def _ring(z: float, band: _Band) -> FloatArray:
    """The spheres (count, 4) of a band at height ``z``."""
    angle = 2.0 * math.pi * np.arange(band.count) / band.count
    out = np.empty((band.count, 4))
    out[:, 0], out[:, 1] = band.ring * np.cos(angle), band.ring * np.sin(angle)
    out[:, 2], out[:, 3] = z, band.radius
    return out


def _base(
    radius: float, height: float, bulge: float, rows: list[tuple[float, _Band]]
) -> FloatArray:
    """Spheres over the part of the base disc (z = 0) that the bands leave open."""
    edge = _inner_edge(radius, 0.0, rows)
    if edge <= 0.0:
        return np.zeros((0, 4))
    if edge <= height + bulge:
        return np.array([[0.0, 0.0, 0.0, edge]])
    count = math.ceil(math.sqrt(2.0) * edge / (height + bulge))
    while True:
        half = edge / count
        x, y = np.meshgrid(*[(2.0 * np.arange(count) + 1.0) * half - edge] * 2, indexing="ij")
        nearest = np.hypot(np.maximum(np.abs(x) - half, 0.0), np.maximum(np.abs(y) - half, 0.0))
        x, y = x[nearest < edge], y[nearest < edge]
        size = half * math.sqrt(2.0)
        if float(np.hypot(x, y).max()) + size <= radius + bulge:
            return np.column_stack([x, y, np.zeros(len(x)), np.full(len(x), size)])
        count += 1


def _cone(radius: float, height: float, cone: float, bulge: float) -> FloatArray:
    """Spheres on the axis, each through both edges of a slice of the cone, or wider."""
    side, top = math.hypot(radius - NECK_RADIUS, cone), height + bulge
    slices = math.ceil(side / math.sqrt(8.0 * bulge * NECK_RADIUS * side / cone))
    edges = np.linspace([radius, 0.0], [NECK_RADIUS, -cone], slices + 1).tolist()
    out = []
    for (r, h), (a, b) in itertools.pairwise(edges):
        z = min(
            (r * r + h * h - a * a - b * b) / (2.0 * (h - b)),
            h + math.sqrt((radius + bulge) ** 2 - r * r),  # beside the wall
            (top * top - h * h - r * r) / (2.0 * (top - h)),  # below the rim
        )
        out.append((0.0, 0.0, z, math.hypot(r, h - z)))
    return np.array(out)
