"""Stems that nobody saw: the likeliest of those that pass through no fruit."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.scenes.objects import SceneObject, Stem

TILTS = 8.0, 16.0, 24.0, 32.0, 40.0  # [degrees] that are tried: choices
AROUND = 12  # directions of each: a choice
ROOM = 0.002  # [m] between a stem and a fruit, at least: a choice
ALONG = 40  # points of a stem that are looked at: a choice


def cleared(objects: Iterable[SceneObject], up: FloatArray) -> tuple[SceneObject, ...]:
    """The objects, each upright stem that nobody saw tilted as little as clears the other fruits.

    An unseen stem of another direction stays, since its direction was told. Where no tilt is clear,
    the one with most room is taken.
    """
    items = tuple(objects)
    return tuple(_cleared(item, items, up) for item in items)


def _cleared(item: SceneObject, items: tuple[SceneObject, ...], up: FloatArray) -> SceneObject:
    stem = item.stem
    if stem is None or not stem.unseen:
        return item
    if stem.vector @ up < (1.0 - 1e-9) * stem.length:
        return item
    others = [one for one in items if one is not item and one.role in ("target", "pushable")]
    if not others:
        return item
    centers = np.array([one.position for one in others])
    sizes = np.array([one.radius for one in others]) + stem.radius
    best, room = stem, -math.inf
    for way in _ways(up):
        line = stem.points[0] + np.linspace(0.0, stem.length, ALONG)[:, None] * way
        gap = float((np.linalg.norm(line[:, None] - centers[None], axis=2) - sizes).min())
        if gap > room:
            made = Stem.along(stem.points[0], way, stem.length, stem.radius)
            best, room = replace(made, tilt=stem.tilt, unseen=True), gap
        if room > ROOM:
            break
    return replace(item, stem=best)


def _ways(up: FloatArray) -> Iterator[FloatArray]:
    """Directions (3,), the steepest first."""
    axes = frame_along(up)
    yield axes[:, 2]
    for tilt in np.deg2rad(TILTS):
        for turn in 2.0 * np.pi * np.arange(AROUND) / AROUND:
            flat = math.sin(tilt) * np.array([math.cos(turn), math.sin(turn)])
            yield axes @ np.append(flat, math.cos(tilt))
