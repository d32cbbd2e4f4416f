"""How well eyes see: detections against the truth of photographs."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.scene import SceneObject
from optipromp.laboratory.simulation.photograph import FRUITS, Photograph
from optipromp.perception.eyes import Detection, Sighting, look_at
from optipromp.perception.finder import Finder

LEAST_SHARE = 0.4  # of its outline that is seen of a visible fruit: a choice
LEAST_PIXELS = 150  # of a visible fruit: a choice
LEAST_STEM = 60  # pixels of a visible stem: a choice
SURE = 11.34  # squared normalised error that 1 % of true Gaussian errors exceed (χ², 3 degrees)


@dataclass(frozen=True, eq=False)
class SeenFruit:
    """A fruit of a photograph, and what was seen of it.

    Attributes:
        share: part of its outline that shows.
        visible: whether enough shows that it must be found.
        error: of its centre, where it was found; else nan [m].
        normalised: squared error of the centre over its covariance; 3 in the mean if that is true.
        kind_right: whether ripe was taken for ripe.
        stem_visible: whether enough of its stem shows.
        angle: between the true stem and the one found; nan where none was [deg].
        tilts: this angle over the deviation of each tilt; √2 in the root mean square if that is
            true.
        item: the true fruit, in the base frame.
        center: (3,) true middle of its extent in the frame of the camera [m].
        detection: that matches it; None: it was not found.
    """

    share: float
    visible: bool
    error: float
    normalised: float
    kind_right: bool
    stem_visible: bool
    angle: float
    tilts: float
    item: SceneObject
    center: FloatArray
    detection: Detection | None

    @property
    def found(self) -> bool:
        """Whether a detection matches it."""
        return self.detection is not None


@dataclass(frozen=True, eq=False)
class SeenPicture:
    """The fruits of one photograph, the detections that match none, and the time [s]."""

    fruits: tuple[SeenFruit, ...]
    wrong: tuple[Detection, ...]
    seconds: float

    @property
    def false(self) -> int:
        """Number of detections that match no fruit."""
        return len(self.wrong)


def compared(shot: Photograph, finder: Finder | None = None) -> SeenPicture:
    """What is seen in a photograph against its truth; see :func:`matched`."""
    began = time.process_time()
    sight = look_at(shot.picture, up=shot.scene.up, finder=finder)
    return matched(shot, sight, time.process_time() - began)


def matched(shot: Photograph, sight: Sighting, seconds: float) -> SeenPicture:
    """A sight of a photograph, made in ``seconds``, against the truth.

    A detection matches the nearest fruit, each once, the largest share first, if the centres are
    closer than the fruit's bounding radius. The centre of a fruit is the middle of its extent along
    its own axes. A detection of a fruit of which too little shows is not false.
    """
    free = list(sight.detections)
    fruits = []
    for mark in sorted((m for m in shot.marked if m.kind in FRUITS), key=lambda m: -m.share):
        item = shot.fruits[mark.id]
        center = shot.picture.camera.pose.inverse() @ middle(item)
        away = [float(np.linalg.norm(each.item.position - center)) for each in free]
        match = None
        if away and min(away) < item.radius:
            match = free.pop(int(np.argmin(away)))
        pixels = int(shot.mask(mark.id, *FRUITS).sum())
        visible = mark.share >= LEAST_SHARE and pixels >= LEAST_PIXELS
        fruits.append(_fruit(shot, item, center, match, (mark.share, visible)))
    return SeenPicture(tuple(fruits), tuple(free), seconds)


def middle(item: SceneObject) -> FloatArray:
    """The middle (3,) of a fruit's extent along its own axes, in the base frame [m]."""
    corners = item.shape.surface().reshape(-1, 3)
    return np.asarray(
        item.position + item.rotation @ (0.5 * (corners.min(axis=0) + corners.max(axis=0)))
    )


def _fruit(
    shot: Photograph, item: SceneObject, center: FloatArray, match: Detection | None,
    shown: tuple[float, bool],
) -> SeenFruit:  # fmt: skip
    shows = item.stem is not None and int(shot.mask(item.id, "stem").sum()) >= LEAST_STEM
    error = normalised = angle = tilts = math.nan
    right = False
    if match is not None:
        off = match.item.position - center
        assert match.item.covariance is not None
        error = float(np.linalg.norm(off))
        normalised = float(off @ np.linalg.solve(match.item.covariance, off))
        right = (match.region.kind == "ripe") == (item.role == "target")
        if item.stem is not None and match.stem is not None:
            way = shot.picture.camera.pose.rotation.T @ item.stem.vector
            cosine = float(way @ match.stem.direction) / float(np.linalg.norm(way))
            turned = math.acos(min(max(cosine, -1.0), 1.0))
            angle, tilts = math.degrees(turned), turned / match.stem.deviation
    return SeenFruit(*shown, error, normalised, right, shows, angle, tilts, item, center, match)


def figures(pictures: Sequence[SeenPicture]) -> dict[str, float]:
    """Counts, rates and errors of pictures; nan where nothing tells one."""
    fruits = [fruit for picture in pictures for fruit in picture.fruits]
    visible = [fruit for fruit in fruits if fruit.visible]
    found = [fruit for fruit in fruits if fruit.found]
    false = sum(picture.false for picture in pictures)
    errors = np.array([fruit.error for fruit in found]) * 1e3
    stems = [f for f in found if f.stem_visible]
    seen = [f for f in stems if not math.isnan(f.angle)]
    angles = np.array([fruit.angle for fruit in seen])
    squares = np.array([fruit.normalised for fruit in found])
    return {
        "pictures": len(pictures),
        "visible": len(visible),
        "recall": _mean([fruit.found for fruit in visible]),
        "false": false,
        "false_share": false / max(false + len(found), 1),
        "kind_right": _mean([fruit.kind_right for fruit in found]),
        "found": len(found),
        "center_median_mm": _quantile(errors, 0.5),
        "center_90_mm": _quantile(errors, 0.9),
        "normalised_mean": _mean(squares),
        "normalised_beyond_99": _mean(squares > SURE),
        "stems_visible": len(stems),
        "stems_found": len(seen),
        "angle_mean_deg": _mean(angles),
        "angle_90_deg": _quantile(angles, 0.9),
        "angle_over_deviation": math.sqrt(_mean([f.tilts**2 for f in seen])) if seen else math.nan,
        "ms": 1e3 * float(np.median([picture.seconds for picture in pictures] or [math.nan])),
    }


def _mean(values: Sequence[float] | Sequence[bool] | FloatArray | np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else math.nan


def _quantile(values: FloatArray, share: float) -> float:
    return float(np.quantile(values, share)) if len(values) else math.nan
