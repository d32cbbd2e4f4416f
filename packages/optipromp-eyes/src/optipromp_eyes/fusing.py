"""What pictures show, and several pictures of one scene as one.

Detections of the same fruit are paired, and their means taken.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Ellipsoid, Sphere
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import Role, SceneObject, Stem
from optipromp_eyes.finder import Found, Region
from optipromp_eyes.pictures import DepthPicture
from optipromp_eyes.stems import SeenStem, Spheroid

GATE = 16.0  # squared normalised distance of one fruit in two pictures; 0.1 % are farther: a choice
NEAR = 0.7  # of the sum of two radii, the distance below which two detections are one: a choice


@dataclass(frozen=True, eq=False)
class Detection:
    """One fruit of a picture.

    Attributes:
        item: in the frame of the camera, with the covariance of its position; without a stem where
            none was seen.
        region: its pixels and class.
        spheroid: as fitted.
        stem: as seen; None where none was.
        redness: share of what shows of a colour that has the colour of ripe fruits.
    """

    item: SceneObject
    region: Region
    spheroid: Spheroid
    stem: SeenStem | None
    redness: float = math.nan


@dataclass(frozen=True, eq=False)
class Sighting:
    """What a picture shows.

    Attributes:
        look: the detections as closed loops take them.
        detections: with pixels, fits and stems.
        found: the regions, also those in which no fruit fits.
        doubts: what may be wrong with the picture, in words.
        places: column and row of each of the solids of the look, in words.
        picture: that was looked at; None: none was.
    """

    look: Look
    detections: tuple[Detection, ...]
    found: Found
    doubts: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    picture: DepthPicture | None = None


@dataclass(frozen=True, eq=False)
class FusedFruit:
    """A fruit that one or several pictures show.

    Attributes:
        item: in the robot's base frame, with the covariance of its position.
        views: how many pictures show it.
        stem_deviation: of each tilt of its stem [rad]; nan where no picture shows one.
        ripe: probability that it is ripe: the odds of all pictures multiplied.
    """

    item: SceneObject
    views: int
    stem_deviation: float
    ripe: float


@dataclass(frozen=True, eq=False)
class _View:
    """A detection in the base frame: direction and deviation are None and nan without a stem."""

    item: SceneObject
    ripe: float
    stem: FloatArray | None
    deviation: float


def fused(sights: Sequence[Sighting]) -> tuple[FusedFruit, ...]:
    """The fruits of several pictures of one scene, none of which has moved between them.

    The detections of each picture are paired with the fruits of those before at least total
    squared normalised distance, within a gate; a pair nearer than two fruits can be is one, too. A
    position is the mean weighted by information, and its covariance the inverse of their sum. Sizes
    are weighted means by what each picture knows of the position, directions of stems by their
    variances; the longest stem counts. The odds of ripeness are those of all pictures, multiplied.

    Args:
        sights: of pictures whose camera poses are in one base frame.

    Raises:
        InvalidRequestError: no picture.
    """
    if not sights:
        raise InvalidRequestError("fused needs at least one sighting")
    tracks: list[list[_View]] = []
    for sight in sights:
        seen = _views(sight)
        rows, columns = _pairs([_mean([v.item for v in track]) for track in tracks], seen)
        for row, column in zip(rows, columns, strict=True):
            tracks[row].append(seen[column])
        taken = set(columns)
        tracks.extend([view] for k, view in enumerate(seen) if k not in taken)
    counts = {"target": 0, "pushable": 0}
    out = []
    for track in tracks:
        one = _fruit(track)
        counts[one.item.role] += 1
        name = "ripe" if one.item.role == "target" else "unripe"
        out.append(replace(one, item=replace(one.item, id=f"{name}{counts[one.item.role]}")))
    return tuple(out)


def _views(sight: Sighting) -> list[_View]:
    out = []
    for item, each in zip(sight.look.in_base(), sight.detections, strict=True):
        way, deviation = None, math.nan
        if each.stem is not None:
            way = sight.look.camera.rotation @ each.stem.direction
            deviation = each.stem.deviation
        out.append(_View(item, each.region.ripe, way, deviation))
    return out


def _covariance(item: SceneObject) -> FloatArray:
    assert item.covariance is not None  # of every detection
    return item.covariance


def _mean(items: Sequence[SceneObject]) -> tuple[FloatArray, FloatArray, float]:
    """Position (3,), covariance (3, 3) and mean radius of detections of one fruit."""
    weights = [np.linalg.inv(_covariance(item)) for item in items]
    covariance = np.linalg.inv(sum(weights))
    vector = sum((w @ item.position for w, item in zip(weights, items, strict=True)), np.zeros(3))
    radius = float(np.mean([item.radius for item in items]))
    return covariance @ vector, 0.5 * (covariance + covariance.T), radius


def _pairs(
    fruits: Sequence[tuple[FloatArray, FloatArray, float]], seen: Sequence[_View]
) -> tuple[list[int], list[int]]:
    """Indices of fruits and of the detections that are of them."""
    far = 1e6  # of a pair that is not allowed: above any sum of those that are
    cost = np.full((len(fruits), len(seen)), far)
    for row, (place, covariance, radius) in enumerate(fruits):
        for column, view in enumerate(seen):
            off = view.item.position - place
            joint = covariance + _covariance(view.item)
            square = float(off @ np.linalg.solve(joint, off))
            close = float(np.linalg.norm(off)) / (radius + view.item.radius)
            if (square < GATE and close < 1.0) or close < NEAR:
                cost[row, column] = min(square, 2.0 * GATE)
    rows, columns = linear_sum_assignment(cost)
    good = cost[rows, columns] < far
    return rows[good].tolist(), columns[good].tolist()


def _fruit(track: Sequence[_View]) -> FusedFruit:
    items = [view.item for view in track]
    place, covariance, _ = _mean(items)
    weights = np.array([1.0 / np.trace(_covariance(item)) for item in items])
    sizes = np.array([_sizes(item) for item in items])
    size = weights @ sizes / weights.sum()
    odds = sum(math.log(view.ripe / (1.0 - view.ripe)) for view in track)
    role: Role = "target" if odds > 0.0 else "pushable"
    best = items[int(np.argmax(weights))]
    shape = Ellipsoid((float(size[0]), float(size[0]), float(size[1])))
    ball = isinstance(best.shape, Sphere)
    stem, deviation = _stem(track, place)
    return FusedFruit(
        replace(
            best, role=role, position=place, covariance=covariance, stem=stem,
            shape=Sphere(float(np.cbrt(size[0] ** 2 * size[1]))) if ball else shape,
        ),
        len(track), deviation, 1.0 / (1.0 + math.exp(-odds)),
    )  # fmt: skip


def _sizes(item: SceneObject) -> tuple[float, float]:
    """Radius across the axis and half the length along it [m]."""
    if isinstance(item.shape, Ellipsoid):
        return float(item.shape.radii[0]), float(item.shape.radii[2])
    return item.radius, item.radius


def _stem(track: Sequence[_View], place: FloatArray) -> tuple[Stem | None, float]:
    """The stem of a fruit at ``place`` (3,), and the deviation of its tilts [rad]."""
    known = [
        (view.stem, view.deviation, view.item.stem.length)
        for view in track
        if view.stem is not None and view.item.stem is not None
    ]
    if not known:
        return None, math.nan
    weights = np.array([deviation**-2 for _, deviation, _ in known])
    way = weights @ np.array([stem for stem, _, _ in known])
    way = way / np.linalg.norm(way)
    apart = np.array([math.acos(float(np.clip(stem @ way, -1.0, 1.0))) for stem, _, _ in known])
    # directions that disagree are of different stems: as wide as they are apart
    scatter = float(weights @ apart**2 / weights.sum()) / 2.0
    deviation = math.sqrt(max(1.0 / float(weights.sum()), scatter))
    return Stem.along(place, way, max(length for _, _, length in known)), deviation
