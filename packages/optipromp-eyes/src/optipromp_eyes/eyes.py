"""From a picture to detections with covariances, and to a scene that can be planned in."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, uniform_filter
from scipy.spatial import cKDTree

from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Ellipsoid, Shape, Sphere
from optipromp.core.planning.task import posed
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.look import HIDDEN as BEHIND
from optipromp.core.scenes.look import Look, points_of
from optipromp.core.scenes.objects import STEEPEST, Role, SceneObject, Stem, cleared
from optipromp.core.scenes.scene import Scene
from optipromp_eyes.detector import usual_finder
from optipromp_eyes.doubts import judged, pose_of, register_of, told
from optipromp_eyes.finder import MOST_FITS, Finder, Found, Region, box_of, largest, most_about
from optipromp_eyes.fusing import Detection as Detection
from optipromp_eyes.fusing import Sighting as Sighting
from optipromp_eyes.fusing import fused
from optipromp_eyes.geometry import ByGeometry, coloured, edge_of, is_green, is_large, smooth
from optipromp_eyes.parameters import EyeParameters, eyes_of
from optipromp_eyes.pictures import (
    CLOSEST,
    WORKSPACE,
    CameraModel,
    DepthPicture,
    Image8,
    load_picture,
    placed,
)
from optipromp_eyes.solids import solids
from optipromp_eyes.spheroids import NEAREST, Codes, Spheroid, all_fitted, claimed
from optipromp_eyes.stems import DEPTH, FIRST_GAP, HIDDEN, LEAST, SeenStem, stem_of
from optipromp_eyes.unmeasured import USUAL, unmeasured
from optipromp_eyes.unseen import solid_things, unseen_about

KINDS = {"ripe": 1, "unripe": 2, "stem": 2}
SEEDINGS = 2  # of fits: to what the finder tells, and to what that leaves: a choice
DENSE, MOST_LEFT = 0.4, 12  # share of a fruit's breadth that is left, and such places: a choice
FLATTEST, FAR_ROUND = -1.5, 1.35
"""Bulge above which errors of depth may hide that a ripe fruit is round: of drawn ones up to 0.85 m
away the least is -1.4; and the median of their ``round`` at 0.8 m, which then counts."""
ROUND = 1.06  # length over width below which a fruit is a sphere: a choice
SURELY = 0.95  # probability of ripeness below which it is told: a choice
UNUSUAL = 3.0  # standard deviations of a crop's width, beyond which a fruit is reported: a choice
TOGETHER = 0.6  # of the sum of two fruits' radii, the least distance of their centres: a choice
BEYOND = 0.012  # [m] beyond the end of a stem, where the picture tells whether it ends: a choice
BEFORE = 0.004  # [m] nearer than a stem, what hides it: a choice
CUT = 1.25  # length of a stem over what shows of it, where it is cut off: a choice
MOST_STEM_POINTS = 6000  # that are looked at: a choice
BESIDE = 13  # [pixel] side of the square that tells what is beside a stem: a choice
STANDS_OUT = 0.012  # [m] by which a stem is nearer than that: a choice
LENT = 0.05  # [m] from which a depth is lent: a choice
RED_ERROR = 0.03  # of a redness: a choice
UNSURE = 0.1  # [m] deviation of a lent depth, which errs with all others of its stem: a choice


def look_at(
    picture: DepthPicture, time: float = 0.0, *, up: FloatArray | None = None,
    finder: Finder | None = None, parameters: EyeParameters | None = None,
) -> Sighting:  # fmt: skip
    """Find and measure the fruits of a picture.

    A fruit that is ripe with the probability ``parameters.least_ripe`` has the role ``target``, any
    other ``pushable``. Ids are ``ripe1``, ``ripe2``
    and ``unripe1`` and so on, from the left of the picture. A fruit that shows too little, or is no
    spheroid, is left out.

    Args:
        picture: with its camera.
        time: of the exposure [s].
        up: (3,) upwards in the robot's base frame; None: its z axis.
        finder: of fruits and stems; None: :func:`optipromp_eyes.detector.usual_finder`.
        parameters: of the measuring, and of the default finder.
    """
    p = parameters or EyeParameters()
    register = register_of(picture, p)
    finder = finder or usual_finder(p)
    by_colour = isinstance(finder, ByGeometry)
    found = finder.find(picture)
    if not found.stems:  # of a detector that knows fruits alone: by their colour
        found = replace(found, regions=(*found.regions, *ByGeometry(p).find(picture).stems))
    found, doubted = judged(picture, found, p, by_colour)
    turn = picture.camera.pose.rotation
    upward = turn.T @ (np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up))
    good, left_out = _measured(picture, found, upward, p)
    found = replace(found, left_out=found.left_out + left_out)
    good.sort(key=lambda pair: float(pair[1].center[0] / pair[1].center[2]))
    traces = _stem_points(picture, found, good, p)
    counts = {"ripe": 0, "unripe": 0}
    detections, straight = [], []  # whether a fruit has a straight stem above it
    for region, fit in good:
        wide = 0.006 * picture.camera.focal / fit.center[2]  # [pixel] of a stem: what errs as one
        per = max(min(wide, 6.0), 1.0)
        stem = stem_of(fit, *traces[0], upward, p, per)
        straight.append(stem is not None and not stem.gap)
        if stem is None and len(traces) > 1:
            stem = stem_of(fit, *traces[1], upward, p, per, HIDDEN[:1])
        begun = None if stem is None or stem.gap else stem  # nothing hides where it begins
        unsure = any((region.pixels[each.box] & each.part).any() for each, _ in doubted)
        if abs(math.log(fit.radius / p.radius)) > USUAL * p.radius_spread:
            named = _hangs(fit, begun, traces[0][0], p)
        else:
            named = begun is not None or region.kind == "ripe" or unsure
            named = named or is_green(picture, region, p)
        if not named:
            continue  # a round front of unknown kind, among the solids
        stem = _whole(stem, fit, picture)
        counts[region.kind] += 1
        name = f"{region.kind}{counts[region.kind]}"
        red = _redness(picture, fit, p)
        if p.least_red > 0.0:
            surely = 1.0 / (1.0 + math.exp((p.least_red - red) / RED_ERROR))
            region = region.with_ripe(min(region.ripe, surely))
        detections.append(
            Detection(_item(name, region, fit, stem, upward, p), region, fit, stem, red)
        )
    items = tuple(each.item for each in detections)
    above = np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up)
    posed = pose_of(picture, [fit for _, fit in good], straight, traces[0], above, p)
    blind = unmeasured(picture, found, [fit for _, fit in good], p, by_colour)
    solid = (*blind, *solids(picture, found, detections, upward, p))
    look = Look(
        time, picture.camera.pose, items, picture.camera.view, solids=tuple(o for _, o in solid)
    )
    doubts = (*register, *told(doubted, [region for region, _ in good]), *posed)
    places = tuple(where for where, _ in solid)
    return Sighting(look, tuple(detections), found, doubts, places, picture)


def look_as(scene: Scene, picture: DepthPicture, time: float) -> Look:
    """What a picture shows to the eyes of a scene's crop at a ``time`` [s]."""
    return look_at(picture, time, up=scene.up, parameters=eyes_of(scene.crop)).look


def look_at_files(
    rgb: Path, depth: Path, camera: object, scene: Scene, time: float,
    arm: Callable[[float], FloatArray],
) -> Look:  # fmt: skip
    """What the picture of two files (:func:`load_picture`) shows to the eyes of a scene's crop.

    ``camera``: the document of :meth:`CameraModel.from_document`. ``time``: of the exposure [s].
    ``arm``: tells joint positions (n,) at a time; asked for a camera on the hand.

    Raises:
        InvalidRequestError: a file that cannot be used, or a camera whose place is not told.
    """
    model, step = CameraModel.from_document(camera, source := f"camera of {rgb}")
    there = placed(model, source, lambda: flange_of(posed(scene)[0], arm(time)))
    return look_as(scene, load_picture(rgb, depth, (there, step)), time)


def _measured(
    picture: DepthPicture, found: Found, up: FloatArray, p: EyeParameters
) -> tuple[list[tuple[Region, Spheroid]], int]:
    """Fruits and what shows them, of regions each of which may be a fruit, a part of one, two, or
    none: the likeliest first, then those that are beside them; and how many were not tried."""
    colours = np.zeros(picture.depth.shape, dtype=np.int8)
    for region in (*found.stems, *found.fruits):
        colours[region.box][region.part] = KINDS[region.kind]
    out: list[tuple[Region, Spheroid]] = []
    masks = {kind: colours == KINDS[kind] for kind in ("ripe", "unripe")}
    seeds = [region for region in found.fruits if not is_large(picture, region, p)]
    chosen = largest(np.array([region.part.sum() for region in seeds], dtype=np.int64), MOST_FITS)
    left_out, seeds = len(seeds) - len(chosen), [seeds[k] for k in chosen]
    for again in range(SEEDINGS):
        if again:
            seeds = _left(picture, colours, [region for region, _ in out], p)
        kinds = np.array([KINDS[region.kind] for region in seeds], dtype=np.int64)
        fits = [
            replace(fit, round=max(fit.round, FAR_ROUND))
            if fit is not None and kind == KINDS["ripe"] and fit.bulge > FLATTEST
            else fit
            for kind, fit in zip(
                kinds, all_fitted(picture, seeds, kinds, colours, up, p), strict=True
            )
        ]  # flowers and leaves are not red
        pairs = [(r, f) for r, f in zip(seeds, fits, strict=True) if f and f.round > p.least_round]
        for region, fit in sorted(pairs, key=lambda pair: -pair[1].odds):
            if fit.odds <= p.least_odds:
                break
            far = np.linalg.norm(
                fit.center - np.array([o.center for _, o in out]).reshape(-1, 3), axis=1
            )
            near = TOGETHER * (fit.radius + np.array([other.radius for _, other in out]))
            if (far > near).all():
                box, mine = claimed(picture, masks[region.kind], fit, p)
                shape = picture.depth.shape
                out.append((Region(region.kind, mine, region.score, box, shape, region.ripe), fit))
    return out, left_out


def _left(
    picture: DepthPicture, colours: Codes, fruits: Sequence[Region], p: EyeParameters
) -> list[Region]:
    """Where much is left of the colour of fruits that no fruit explains."""
    out = []
    for kind in ("ripe", "unripe"):
        left = (colours == KINDS[kind]) & (picture.depth > 0.0)
        left &= ~Region.mask(fruits, left.shape)
        box = box_of(left, 0)
        left, depth = left[box], picture.depth[box]
        if not left.any():
            continue
        middle = max(float(np.median(depth[left])), NEAREST)
        wide = round(0.6 * p.radius * picture.camera.focal / middle)
        wide = 2 * min(wide, max(left.shape)) + 1
        dense = gaussian_filter(uniform_filter(left.astype(np.float32), wide), 2.0)
        peaks = (dense == most_about(dense, wide)) & (dense > DENSE) & left
        rows = np.argwhere(peaks)
        rows = rows[np.argsort(-dense[peaks], kind="stable")[:MOST_LEFT]]
        for row, column in rows:
            part = tuple(slice(max(at - wide, 0), at + wide) for at in (row, column))
            near = left[part] & (np.abs(depth[part] - depth[row, column]) < p.radius)
            rows_of, columns_of = (
                slice(b.start + c.start, b.stop + c.start) for b, c in zip(part, box, strict=True)
            )
            out.append(Region(kind, near, 0.0, (rows_of, columns_of), picture.depth.shape))
    return out


def _stem_points(
    picture: DepthPicture, found: Found, good: Sequence[tuple[Region, Spheroid]], p: EyeParameters
) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Points (N, 3) of all stems in the frame of the camera, and deviations (N,) of their depths
    [m]: as measured, and again with depths that are lent.

    Green regions in which no fruit fits count as stems: stems side by side are as wide as a fruit.
    A thin stem has no depth, or that of the background: the depth of a stem that does not stand out
    before what is beside it. Such a pixel is lent the depth of the nearest that has one, of a stem
    or a fruit.
    """
    green = Region.mask(
        (each for each in found.regions if each.kind in ("unripe", "stem")), picture.depth.shape
    )
    mask = green & ~Region.mask((region for region, _ in good), green.shape)
    rows = np.argwhere(mask)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MOST_STEM_POINTS)).astype(int)]
    rays, depth = picture.camera.through(rows[:, ::-1]), picture.depth[*rows.T]
    measured = (
        rays[depth > 0.0] * depth[depth > 0.0, None],
        np.full((depth > 0.0).sum(), DEPTH),
    )
    box = box_of(mask, BESIDE // 2)
    behind = np.where(mask[box], 0.0, picture.depth[box]).astype(np.float32)
    back = most_about(behind, BESIDE)
    back = back[rows[:, 0] - box[0].start, rows[:, 1] - box[1].start]
    sure = (depth > 0.0) & ((back == 0.0) | (depth < back - STANDS_OUT))
    places, depths = [rows[sure]], [depth[sure]]
    for region, fit in good:
        inside = np.argwhere(region.part)[::8] + [b.start for b in region.box]
        places.append(inside)
        depths.append(np.full(len(inside), fit.center[2]))
    known, far = np.concatenate(places), np.concatenate(depths)
    if not len(known) or sure.all():
        return (measured,)
    away, nearest = cKDTree(known).query(rows[~sure])
    depth[~sure] = np.where(away * far[nearest] < LENT * picture.camera.focal, far[nearest], 0.0)
    there = depth > 0.0
    lent = rays[there] * depth[there, None], np.where(sure[there], DEPTH, UNSURE)
    return measured, lent


def _hangs(fit: Spheroid, stem: SeenStem | None, points: FloatArray, p: EyeParameters) -> bool:
    """Whether a long stem is seen that ends at a fruit: of ``points`` (N, 3) of stems, few are on
    its line beyond the fruit, as where the stem of another passes behind."""
    if stem is None or stem.support < 2.0 * LEAST:
        return False
    off = points - fit.center
    along = -off @ stem.direction - max(fit.radius, fit.half)
    aside = lengths(off - (off @ stem.direction)[:, None] * stem.direction)
    beyond = (along > 0.0) & (along < FIRST_GAP) & (aside < 1.5 * fit.radius)
    return fit.radius > p.radius or int(beyond.sum()) < 5


def _redness(picture: DepthPicture, fit: Spheroid, p: EyeParameters) -> float:
    """The share of ripe colours among the coloured pixels of a fruit's front."""
    box, front = claimed(picture, np.ones(picture.depth.shape, dtype=bool), fit, p)
    codes = coloured(smooth(picture.rgb[box])[front].astype(np.float64), p)
    return float((codes == 1).sum() / max((codes > 0).sum(), 1))


def _whole(stem: SeenStem | None, fit: Spheroid, picture: DepthPicture) -> SeenStem | None:
    """The stem, longer than seen where the border of the picture or a thing before it cuts it."""
    if stem is None:
        return None
    beyond = fit.center + (stem.length + BEYOND) * stem.direction
    column, row = np.rint(picture.camera.pixels(beyond)).astype(int)
    inside = 0 <= row < picture.camera.height and 0 <= column < picture.camera.width
    depth = picture.depth[row, column] if inside else 0.0
    ends = inside and not 0.0 < depth < beyond[2] - BEFORE
    return stem if ends else replace(stem, length=CUT * stem.length)


def _item(
    name: str, region: Region, fit: Spheroid, stem: SeenStem | None, up: FloatArray,
    p: EyeParameters,
) -> SceneObject:  # fmt: skip
    """The fruit as a detection: a sphere, or an ellipsoid along its axis."""
    role: Role = "target" if region.ripe >= p.least_ripe else "pushable"
    axis = fit.axis if fit.axis @ up > 0.0 else -fit.axis
    shape: Shape = Ellipsoid((fit.radius, fit.radius, fit.half))
    if max(fit.half, fit.radius) < ROUND * min(fit.half, fit.radius):
        shape = Sphere(float(np.cbrt(fit.radius**2 * fit.half)))
    grown = None
    if stem is not None:
        tilt = min(math.degrees(stem.deviation), STEEPEST)
        grown = replace(Stem.along(fit.center, stem.direction, stem.length), tilt=tilt)
    return SceneObject(
        name, role, shape, fit.center, frame_along(axis), stem=grown, covariance=fit.covariance
    )


def seen_scene(
    sight: Sighting | Sequence[Sighting], known: Scene, parameters: EyeParameters | None = None
) -> tuple[Scene, tuple[str, ...]]:
    """The scene of what was seen among what is known, and what was assumed, in words.

    Several sightings of one scene are taken as one (:func:`optipromp_eyes.fusing.fused`).

    Known are robot, tool, start, approach, base and static objects of ``known``; its fruits and
    its goal are not used. Of several ripe fruits the lowest is the target and the others are
    pushable. A fruit whose stem was not seen gets one that is unseen: about upright, clear of the
    other fruits, as long as the median of those seen
    (:func:`optipromp.core.scenes.objects.cleared`). Its tilts have the standard deviation
    ``parameters.tilt``; ``parameters`` are by default those of the crop of ``known``. That crop is
    the scene's, and fruits of a width that is unusual of it are told. Fruits without depth are
    solid where they may be, unless a sighting measured one there. What no picture shows about the
    target is the scene's ``unseen``.

    Raises:
        InvalidRequestError: no fruit is ripe with the probability ``parameters.least_ripe``.
    """
    p = parameters or eyes_of(known.crop)
    sights = [sight] if isinstance(sight, Sighting) else list(sight)
    together = fused(sights)
    found = tuple(fruit.item for fruit in together)
    chances = {fruit.item.id: fruit.ripe for fruit in together}
    ripe = [item for item in found if chances[item.id] >= p.least_ripe]
    if not ripe:
        seen = ", ".join(item.id for item in found) or "no fruit"
        likely = max(found, key=lambda item: chances[item.id], default=None)
        if likely is not None and chances[likely.id] > 0.5:
            raise InvalidRequestError(
                f"no fruit is surely ripe: {likely.id} is with a probability of "
                f"{chances[likely.id]:.2f}, below {p.least_ripe:g}; take another picture from "
                "aside, and look at both with --together"
            )
        raise InvalidRequestError(f"no ripe fruit is seen: the picture shows {seen}")
    assumed = []
    target = min(ripe, key=lambda item: float(item.position @ known.up))
    if chances[target.id] < SURELY:
        assumed.append(f"{target.id} is ripe with a probability of {chances[target.id]:.2f}")
    if len(ripe) > 1:
        others = ", ".join(item.id for item in ripe if item is not target)
        assumed.append(f"{target.id} is the target, the lowest ripe fruit; pushable: {others}")
    lengths = [item.stem.length for item in found if item.stem is not None]
    long = float(np.median(lengths)) if lengths else p.stem_length
    unseen = [item.id for item in found if item.stem is None]
    if unseen:
        assumed.append(
            f"stem not seen of {', '.join(unseen)}: upright, {long:.2f} m long, or any other whose "
            f"tilts have a deviation of {p.tilt:g} degrees"
        )
    if (crop := known.crop) is not None:
        wide = {item.id: 2.0 * float(min(item.shape.measure.half)) for item in found}
        far, width = UNUSUAL * crop.rows["width"].spread, crop["width"]
        odd = [f"{i} {1e3 * w:.0f} mm" for i, w in wide.items() if 0.0 < far < abs(w - width)]
        if odd:
            expected = f"of another width than a {crop.name}, {1e3 * width:.0f} mm"
            assumed.append(f"{expected}: {', '.join(odd)}")
    fruits = []
    for item in found:
        role: Role = "target" if item is target else "pushable"
        stem = item.stem or Stem.hidden(item.position, known.up, long, p.tilt)
        fruits.append(replace(item, role=role, stem=stem))
    if solid := solid_things(sights, known, found):
        told = "; ".join(f"{item.id} at {where}" for where, item in solid)
        assumed.append(
            f"solid, since no fruit, stem or known thing explains it, and up to {1e3 * BEHIND:.0f} "
            "mm behind, which nobody saw (another picture from aside, and --together, may show it "
            f"free): {told}"
        )
    objects = (*cleared(fruits, known.up), *(item for _, item in solid))
    gone = {item.id for item in known.objects if item.role != "static"}
    scene = replace(
        known, name=f"{known.name}-seen", objects=(*objects, *known.static),
        camera=sights[0].look.camera, may_touch=pairs_among(known.may_touch, gone), goal=None,
    )  # fmt: skip
    return replace(scene, unseen=unseen_about(sights, scene)), tuple(assumed)


def doubt_of(
    picture: DepthPicture, *, up: FloatArray | None = None, finder: Finder | None = None,
    parameters: EyeParameters | None = None,
) -> str:  # fmt: skip
    """What may be wrong with a picture in which no ripe fruit is seen; empty: nothing is known.

    Depths in other units are tried, and red and blue exchanged: whether ripe fruits are seen so, in
    the latter one on a stem.
    """
    known = picture.depth[picture.depth > 0.0]
    if not known.size:
        return "the depth is 0 at every pixel: nothing was measured"
    middle = f"depths are {np.median(known):.3g} m in the middle"
    tried = {
        f"{middle}; with {factor:g} times these, {{}} ripe are seen: compare the unit of depth and "
        "the camera's depth_scale": replace(picture, depth=factor * picture.depth)
        for factor in WRONG_UNITS
        if factor * known.min() <= WORKSPACE and factor * known.max() >= CLOSEST
    }
    bgr = "with red and blue exchanged, {} ripe are seen: are the colours in the order BGR?"
    tried[f"{bgr} must be RGB"] = replace(picture, rgb=picture.rgb[:, :, ::-1].copy())
    for words, other in tried.items():
        seen = look_at(other, up=up, finder=finder, parameters=parameters).detections
        ripe = [each.stem for each in seen if each.item.role == "target"]
        if any(stem or not words.startswith(bgr) for stem in ripe):
            return words.format(len(ripe))
    return ""


WRONG_UNITS = 1e-3, 0.1, 0.25, 4.0, 10.0, 1e3
"""Factors on depths in other units that are tried: millimetres, and steps of 0.1 and 0.25 mm."""


def summary(each: Detection) -> dict[str, object]:
    """A detection as plain values: for ``--json`` and for tables."""
    item, stem = each.item, each.stem
    assert item.covariance is not None
    deviations = np.sqrt(np.maximum(np.linalg.eigvalsh(item.covariance), 0.0))
    return {
        "id": item.id,
        "kind": each.region.kind,
        "score": round(each.region.score, 3),
        "fit": round(1.0 / (1.0 + math.exp(-each.spheroid.odds)), 3),
        "ripe": round(each.region.ripe, 3),
        "redness": round(each.redness, 2),
        "radius": round(each.spheroid.radius, 5),
        "length": round(2.0 * each.spheroid.half, 5),
        "sigma": [round(float(value), 5) for value in deviations],
        "seen_share": round(each.spheroid.share, 2),
        "stem_seen": stem is not None,
        "stem_deviation_deg": None if stem is None else round(math.degrees(stem.deviation), 1),
    }


RIPE, UNRIPE, STEM, CENTER = (255, 60, 200), (60, 160, 255), (255, 220, 0), (255, 255, 255)
HARD, SOFT = (255, 110, 0), (0, 230, 230)
HALF = 3  # [pixel] half the size of a cross


def overlay(picture: DepthPicture, sight: Sighting) -> Image8:
    """The picture (height, width, 3) with outlines of fruits, their centres, lines of stems, and
    dots where it is solid."""
    out = np.array(picture.rgb)
    for item in sight.look.solids:
        _dots(out, picture, points_of(item), SOFT if item.role == "avoid" else HARD)
    for each in sight.detections:
        edge = binary_dilation(edge_of(each.region.pixels))
        out[edge] = RIPE if each.item.role == "target" else UNRIPE
        center = each.item.position
        if each.item.stem is not None:
            share = np.linspace(0.0, 1.0, 300)[:, None]
            _dots(out, picture, center + share * (each.item.stem.root - center), STEM)
        column, row = np.rint(picture.camera.pixels(center)).astype(int)
        out[max(row - HALF, 0) : row + HALF + 1, max(column, 0) : column + 1] = CENTER
        out[max(row, 0) : row + 1, max(column - HALF, 0) : column + HALF + 1] = CENTER
    return out


def _dots(
    out: Image8, picture: DepthPicture, points: FloatArray, colour: tuple[int, int, int]
) -> None:
    """Draw points (N, 3) in the frame of the camera."""
    ahead = points[points[:, 2] > 1e-3]  # [m] before the camera
    places = np.rint(picture.camera.pixels(ahead)).astype(int)
    inside = (places >= 0).all(axis=1)
    inside &= (places[:, 0] < out.shape[1]) & (places[:, 1] < out.shape[0])
    places = places[inside]
    out[places[:, 1], places[:, 0]] = colour
