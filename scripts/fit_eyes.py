"""Fit the camera model to what the eyes do: ``EYES`` of ``detector_parameters.py``.

    python scripts/fit_eyes.py --seeds 70400:70440

Scenes of development seeds are photographed twice, with other light and errors, and seen: from
beside, and from the palm at the camera point of the closed loop. From the fruits in the camera's
cone the script counts and measures:

- misses against the share that the *model* takes for hidden: a ramp, by largest likelihood; how
  often both pictures miss the same fruit (``missed_steadily``);
- errors of the centre along and across the line of sight: root mean squares that grow with the
  square of the distance, the mean along it (``bias``), and the share of variance that both pictures
  have (``steady``);
- stems found of fruits found, and the deviation of their tilt, of which 10 % exceed as much as of
  those that were seen: a few are wrong by far more than the others;
- false detections in a picture, and their median radius; the median time of one core.

Then it lets the model with these numbers look at the same scenes, and prints recall and errors of
both, as JSON, a mount a line.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # as a module, too

from studies.eyes import compared

from optipromp.core.planning import plan
from optipromp.core.planning.task import posed
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp_bench.experiments.eyes import STILL, cameras
from optipromp_eyes.detector import finder_named
from optipromp_eyes.finder import Finder
from optipromp_sim.generate import generate
from optipromp_sim.simulation.detector import Detector, DetectorParameters
from optipromp_sim.simulation.photograph import photograph
from optipromp_sim.simulation.sight import Sight

TWICE = 1_000_000  # added to the seed of the second picture
TRANSFER = 0.03  # [s] of exposure and transfer, on top of the time of seeing: a choice
RAYLEIGH = math.sqrt(2.0 * math.log(10.0))  # deviations of one axis that 10 % of lengths exceed
SLOT = 2.0  # [s] that a camera stands at one place, where a miss stays one: a choice
STEPS = np.linspace(0.0, 1.0, 21)  # of the hidden share


class Observed(NamedTuple):
    """A fruit in the cone of view of one picture.

    ``key`` is that of its scene and fruit, ``hidden`` the share by the model, ``along`` and
    ``across`` (2,) the errors in the line of sight and across [m]; ``tilts`` (2,) of its stem
    [rad]; nan where there is none.
    """

    key: tuple[str, int, str]
    hidden: float
    distance: float
    found: bool
    along: float
    across: tuple[float, float]
    tilts: tuple[float, float]
    size: float  # logarithm of seen size over true size


class Looked(NamedTuple):
    """What the pictures of one mount showed: fruits, false detections, pictures, seconds."""

    fruits: list[Observed]
    false: int
    pictures: int
    seconds: list[float]
    view: float


def looked(scenes: Iterable[tuple[str, int]], mount: str, finder: Finder | None = None) -> Looked:
    """Photograph each scene (preset, seed) twice, see, and compare with the truth."""
    fruits, false, seconds, pictures, view = [], 0, [], 0, 0.0
    for preset, seed in scenes:
        scene = placed(generate(preset, seed), mount)  # type: ignore[arg-type]
        for k in range(2):
            shot = photograph(scene, mount, seed + k * TWICE)
            seen = compared(shot, finder)
            camera = shot.picture.camera
            view, pictures = camera.view, pictures + 1
            seconds.append(seen.seconds)
            hidden = hidden_shares(scene, mount, camera.pose.position)
            for fruit in seen.fruits:
                if fruit.item.id in hidden and in_cone(fruit.center, view):
                    key = preset, seed, fruit.item.id
                    place = Pose(fruit.center, camera.pose.rotation.T)
                    found = fruit.detection and fruit.detection.item
                    fruits.append(observed(key, hidden[fruit.item.id], fruit.item, place, found))
            false += sum(in_cone(each.item.position, view) for each in seen.wrong)
    return Looked(fruits, false, pictures, seconds, view)


def placed(scene: Scene, mount: str) -> Scene:
    """The scene with the camera where it looks from: beside, or at the camera point of the loop.

    The camera point is where the approach of a plan begins; without a plan, the arm's start.
    """
    if mount == "beside":
        return replace(scene, camera=cameras(scene)[0])
    made = plan(scene)
    return replace(scene, start=made.trajectory.positions[made.first])


def hidden_shares(scene: Scene, mount: str, eye: np.ndarray) -> dict[str, float]:
    """The share of each fruit that the model takes for hidden from ``eye`` (3,)."""
    robot, state = posed(scene)
    items = [item for item in scene.objects if item.role != "static"]
    sight = Sight(tuple(item.shape for item in items), scene, robot, mount == "palm")
    shares = sight.hidden(
        eye, tool_frame(robot, state.q), np.array([item.position for item in items]),
        np.array([item.rotation for item in items]), (),
    )  # fmt: skip
    return dict(zip((item.id for item in items), shares.tolist(), strict=True))


def in_cone(center: np.ndarray, view: float) -> bool:
    """Whether a centre (3,) in the frame of the camera is in its cone of view."""
    return math.atan2(math.hypot(center[0], center[1]), center[2]) <= 0.5 * view


def observed(
    key: tuple[str, int, str],
    hidden: float,
    true: SceneObject,
    place: Pose,
    seen: SceneObject | None,
) -> Observed:
    """Errors of a fruit that is ``place``d, and ``seen``, in the frame of the camera."""
    center, nan = place.position, math.nan
    distance = float(np.linalg.norm(center))
    if seen is None:
        return Observed(key, hidden, distance, False, nan, (nan, nan), (nan, nan), nan)
    sight, off, tilts = center / distance, seen.position - center, (nan, nan)
    x, y = _across(sight)
    if seen.stem is not None and true.stem is not None:
        way = place.rotation @ true.stem.vector
        other = seen.stem.vector / np.linalg.norm(seen.stem.vector)
        tilts = tuple(float(math.asin(np.clip(other @ a, -1, 1))) for a in _across(way))
    size = np.log(seen.shape.measure.half).mean() - np.log(true.shape.measure.half).mean()
    errors = float(off @ sight), (float(off @ x), float(off @ y))
    return Observed(key, hidden, distance, True, *errors, tilts, float(size))


def _across(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    way = way / np.linalg.norm(way)
    side = np.cross(way, [1.0, 0.0, 0.0] if abs(way[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    return side, np.cross(way, side)


def fitted(given: Looked, mount: str) -> DetectorParameters:
    """The model with the numbers of what was looked at.

    Raises:
        ValueError: fewer than ten fruits, or none was found.
    """
    fruits = given.fruits
    found = [each for each in fruits if each.found]
    if len(fruits) < 10 or not found:
        raise ValueError(f"{len(found)} of {len(fruits)} fruits were found: too few for a fit")
    hidden = np.array([each.hidden for each in fruits])
    blind = np.array([not each.found for each in fruits])
    missed, most, begin, end = ramp(hidden, blind)
    chance = missed + (most - missed) * np.clip((hidden - begin) / (end - begin), 0.0, 1.0)
    reference = float(np.median([each.distance for each in found]))
    far = np.array([(each.distance / reference) ** 2 for each in found])
    along = np.array([each.along for each in found])
    across = np.array([each.across for each in found])
    bias = float(along @ far / (far @ far))
    along -= bias * far
    position = math.sqrt(float((across**2).sum() / 2.0 / (far @ far)))
    ratio = math.sqrt(float(along @ along / (far @ far))) / position
    tilts = np.array([each.tilts for each in found])
    stems = ~np.isnan(tilts[:, 0])
    use = mount == "beside"  # from below a fruit, no stem is taken
    off = np.hypot(*tilts[stems].T)
    angle = math.degrees(float(np.quantile(off, 0.9))) / RAYLEIGH if use and len(off) else 0.0
    seconds = float(np.median(given.seconds))
    return DetectorParameters(
        mount=mount,  # type: ignore[arg-type]
        view=round(given.view, 2), rate=round(min(20.0, 1.0 / seconds), 1),
        latency=round(seconds + TRANSFER, 2), position=round(position, 4),
        least_position=round(0.5 * position, 4),
        along=round(ratio, 2), bias=round(bias, 4),
        angle=round(angle, 1), reference=round(reference, 2),
        steady=round(_steady(found, along, across), 2),
        missed=round(missed, 3), hidden=round(most, 3), hidden_from=round(begin, 2),
        hidden_to=round(end, 2), missed_steadily=round(_both(fruits, blind, chance), 2), slot=SLOT,
        false=round(given.false / given.pictures, 3),
        stem_seen=round(float(stems.mean()), 2) if use else 0.0,
    )  # fmt: skip


def ramp(hidden: np.ndarray, blind: np.ndarray) -> tuple[float, float, float, float]:
    """The likeliest misses: in full view, of hidden ones, and the shares between which they grow.

    With half a miss and half a find added at either end.
    """
    best, out = -math.inf, (0.0, 1.0, 0.0, 1.0)
    for begin in STEPS[:-1]:
        for end in STEPS[begin + 1e-9 < STEPS]:
            low, high = hidden <= begin, hidden >= end
            missed = (blind[low].sum() + 0.5) / (low.sum() + 1.0)
            most = (blind[high].sum() + 0.5) / (high.sum() + 1.0)
            chance = missed + (most - missed) * np.clip((hidden - begin) / (end - begin), 0.0, 1.0)
            chance = np.clip(chance, 1e-6, 1.0 - 1e-6)
            likely = float(np.log(np.where(blind, chance, 1.0 - chance)).sum())
            if likely > best:
                best, out = likely, (float(missed), float(most), float(begin), float(end))
    return out


def _pairs(keys: Sequence[object]) -> list[tuple[int, int]]:
    """Rows of what was in both pictures."""
    first: dict[object, int] = {}
    return [(first[k], row) for row, k in enumerate(keys) if first.setdefault(k, row) != row]


def _steady(found: list[Observed], along: np.ndarray, across: np.ndarray) -> float:
    """Share of the variance of errors that both pictures have in common."""
    errors = np.column_stack([along / along.std(), across / across.std()])
    pairs = np.array(_pairs([each.key for each in found])).reshape(-1, 2)
    if not len(pairs):
        return 0.3
    return float(np.clip((errors[pairs[:, 0]] * errors[pairs[:, 1]]).mean(), 0.0, 1.0))


def _both(fruits: list[Observed], blind: np.ndarray, chance: np.ndarray) -> float:
    """Share of misses that both pictures have, beyond those by chance."""
    pairs = np.array(_pairs([each.key for each in fruits])).reshape(-1, 2)
    if not len(pairs):
        return 0.5
    one, other = chance[pairs[:, 0]], chance[pairs[:, 1]]
    both = float((blind[pairs[:, 0]] & blind[pairs[:, 1]]).sum())
    most = float((np.minimum(one, other) - one * other).sum())
    return float(np.clip((both - float((one * other).sum())) / most, 0.0, 1.0))


def modelled(
    scenes: Iterable[tuple[str, int]], mount: str, parameters: DetectorParameters
) -> list[Observed]:
    """What the model sees of the same scenes, from the same places but for their jitter."""
    out = []
    for preset, seed in scenes:
        scene = placed(generate(preset, seed), mount)  # type: ignore[arg-type]
        robot, state = posed(scene)
        detector = Detector(scene, robot, parameters, seed)
        look = detector.expose(0.0, state.q, STILL)
        found = {item.id: item for item in look.detections}
        hidden = hidden_shares(scene, mount, look.camera.position)
        for item in detector.fruits:
            center = look.camera.inverse() @ item.position
            if not in_cone(center, parameters.view):
                continue
            key, place = (preset, seed, item.id), Pose(center, look.camera.rotation.T)
            out.append(observed(key, hidden[item.id], item, place, found.get(item.id)))
    return out


def told(fruits: list[Observed]) -> dict[str, float]:
    """Recall and errors, of the eyes or of the model."""
    found = [each for each in fruits if each.found]
    plain = [each for each in fruits if each.hidden <= 0.3]
    errors = np.array([[each.along, *each.across] for each in found]).reshape(-1, 3)
    angles = np.degrees(np.hypot(*np.array([each.tilts for each in found]).reshape(-1, 2).T))
    stems = ~np.isnan(angles)
    norms = 1e3 * np.linalg.norm(errors, axis=1)
    values = {
        "fruits": len(fruits),
        "recall": len(found) / max(len(fruits), 1),
        "recall_in_view": sum(each.found for each in plain) / max(len(plain), 1),
        "center_median_mm": float(np.median(norms)),
        "center_90_mm": float(np.quantile(norms, 0.9)),
        "along_rms_mm": 1e3 * math.sqrt(float((errors[:, 0] ** 2).mean())),
        "across_rms_mm": 1e3 * math.sqrt(float((errors[:, 1:] ** 2).mean())),
        "stems": float(stems.mean()),
        "angle_median_deg": float(np.median(angles[stems])) if stems.any() else math.nan,
        "size_median": float(np.exp(np.median([each.size for each in found]))),
        "size_spread": float(np.std([each.size for each in found])),
    }
    return {name: round(value, 3) for name, value in values.items()}


def main() -> None:
    """Fit and compare, a mount a line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", default="cluster,mixed,field")
    parser.add_argument("--seeds", default="70400:70440", metavar="A:B")
    parser.add_argument("--finder", default="geometry", help="geometry, network or MODULE:NAME")
    parser.add_argument("--mounts", default="beside,palm")
    given = parser.parse_args()
    first, end = map(int, given.seeds.split(":"))
    scenes = [(name, seed) for seed in range(first, end) for name in given.presets.split(",")]
    for mount in given.mounts.split(","):
        seen = looked(scenes, mount, finder_named(given.finder))
        made = fitted(seen, mount)
        plain = DetectorParameters()
        changed = {
            name: getattr(made, name)
            for name in made.__dataclass_fields__
            if getattr(made, name) != getattr(plain, name)
        }
        print(json.dumps({
            "mount": mount, "pictures": seen.pictures, "parameters": changed,
            "eyes": told(seen.fruits), "model": told(modelled(scenes, mount, made)),
        }), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
