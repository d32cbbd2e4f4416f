"""What no fruit, stem or known thing explains is solid."""

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.perception.shots import SEED, shot_of

from optipromp.core.arrays import lengths, rotation
from optipromp.core.geometry.shapes import Box
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_eyes import (
    ByDetector,
    ByGeometry,
    ByNetwork,
    CameraModel,
    DepthPicture,
    Detected,
    look_at,
    seen_scene,
)  # fmt: skip
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, photograph

FINDERS = pytest.mark.parametrize("finder", [ByGeometry, ByNetwork])


@cache
def with_post() -> tuple[Scene, SceneObject, Photograph]:
    """A cluster, a post beside it, and a picture of both."""
    known = generate("cluster", SEED)
    at = known.target.position - 0.09 * known.up
    post = SceneObject("post", "static", Box((0.024, 0.024, 0.1)), at)
    return known, post, photograph(replace(known, objects=(*known.objects, post)), seed=SEED)


def at_post(scene: Scene, post: SceneObject) -> list[SceneObject]:
    """The static clouds of which some point is in the post or 8 mm beside it."""
    half = 0.5 * np.array(post.shape.size) + 0.008
    clouds = [item for item in scene.static if item.id.startswith("unknown")]
    return [
        item
        for item in clouds
        if (np.abs(item.position + item.shape.points - post.position) < half).all(axis=1).any()
    ]


@FINDERS
def test_a_post_that_nobody_told_is_solid_and_told(finder: type[ByGeometry | ByNetwork]) -> None:
    known, post, shot = with_post()
    sight = look_at(shot.picture, up=known.up, finder=finder())
    scene, words = seen_scene(sight, known)
    (solid,) = at_post(scene, post)
    (told,) = [line for line in words if "explains" in line]
    column, row = map(int, re.search(rf"{solid.id} at column (\d+), row (\d+)", told).groups())
    assert shot.mask("post", "static")[row, column]
    assert solid.padding > 0.0
    again, _ = seen_scene(sight, replace(known, objects=(*known.objects, solid)))  # ids are free
    assert solid.id in {item.id for item in again.static}
    told_of, _ = seen_scene(sight, replace(known, objects=(*known.objects, post)))
    assert not at_post(told_of, post)


@FINDERS
@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_nothing_hard_is_seen_at_the_fruits_of_a_clean_picture(
    finder: type[ByGeometry | ByNetwork], seed: int
) -> None:
    shot = shot_of(seed)
    scene, _ = seen_scene(look_at(shot.picture, up=shot.scene.up, finder=finder()), shot.scene)
    places = [item.position + item.shape.points for item in scene.static if "unk" in item.id]
    away = np.linalg.norm(np.concatenate(places) - scene.target.position, axis=1)
    assert away.min() > 0.08


def aside(shot: Photograph, degrees: float) -> Photograph:
    """The same scene by a camera that is turned about the vertical of the target."""
    pose, middle = shot.picture.camera.pose, shot.scene.target.position
    turn = rotation(shot.scene.up, math.radians(degrees))
    camera = Pose(middle + turn @ (pose.position - middle), turn @ pose.rotation)
    return photograph(replace(shot.scene, camera=camera), seed=SEED)


def behind(scene: Scene, post: SceneObject) -> int:
    """How many points of what is hard about a post are more than 30 mm beside its axis."""
    points = np.concatenate([o.position + o.shape.points for o in at_post(scene, post)])
    off = points - post.position
    return int((lengths(off - (off @ scene.up)[:, None] * scene.up) > 0.03).sum())


def test_what_nobody_saw_behind_a_hard_thing_is_solid_until_another_picture_shows_it() -> None:
    known, post, shot = with_post()
    one, two = (
        look_at(each.picture, up=known.up, finder=ByNetwork()) for each in (shot, aside(shot, 60.0))
    )
    alone, words = seen_scene(one, known)
    assert behind(alone, post) > 50
    assert any("another picture from aside" in line for line in words)
    both, _ = seen_scene([one, two], known)
    assert behind(both, post) < 0.3 * behind(alone, post)


def balls(
    *things: tuple[int, tuple[int, int, int]], blend: float = 0.0, size: float = 13.0
) -> DepthPicture:
    """Balls of 13 pixels, or another ``size``, at a column, each of a colour, 0.4 m before the
    camera; ``blend``: pixels at the edge of each whose depth lies between ball and wall."""
    depth, rgb = np.full((240, 320), 2.0), np.full((240, 320, 3), (90, 90, 160), dtype=np.uint8)
    rows, columns = np.indices(depth.shape)
    for middle, colour in things:
        away = np.hypot(rows - 120, columns - middle)
        front = 0.4 - np.sqrt(np.maximum(size**2 - away**2, 0.0)) * 0.4 / 300.0
        share = np.clip((away - size) / max(blend, 1e-9), 0.0, 1.0)
        depth = np.minimum(depth, (1.0 - share) * front + share * 2.0)
        rgb[away < size] = colour
    return DepthPicture(rgb, depth, CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5))


WHITE, GREEN = (225, 225, 215), (120, 175, 60)
UP = np.array([0.0, -1.0, 0.0])


def test_a_round_front_of_unknown_kind_is_no_fruit_to_push() -> None:
    """A detector takes both balls for unripe: one has neither a stem nor the colour of a fruit."""
    picture = balls((100, WHITE), (220, GREEN))
    there, columns = picture.depth < 1.0, np.indices(picture.depth.shape)[1]
    masks = there & (columns < 160), there & (columns > 160)
    finder = ByDetector(lambda rgb: [Detected("unripe", 0.9, mask=mask) for mask in masks])
    sight = look_at(picture, up=UP, finder=finder)
    (fruit,), (thing,) = sight.detections, sight.look.solids
    assert fruit.item.position[0] > 0.0
    assert thing.role == "static"
    assert masks[0][*map(int, reversed(re.findall(r"\d+", sight.places[0])))]
    middle = LEFT * 0.4 / 300.0, 0.0, 0.4
    far = np.linalg.norm(thing.position + thing.shape.points - middle, axis=1)
    assert far.min() < 0.006  # its inside, too
    assert far.max() < 0.026


@pytest.mark.parametrize(("size", "fruits"), [(13.0, 1), (7.5, 0)])
def test_a_ball_smaller_than_any_fruit_of_the_crop_is_no_fruit_to_push(
    size: float, fruits: int
) -> None:
    """17 and 10 mm of radius, where a usual fruit has 16.5."""
    look = look_at(balls((160, GREEN), size=size), up=UP).look
    assert len(look.detections) == fruits
    assert [item.role for item in look.solids] == ["static"] * (1 - fruits)


def test_a_stem_leads_up_from_its_fruit_and_what_is_thin_else_or_ripe_is_hard() -> None:
    """A green line of 5 mm from a fruit upwards, with a red disc on it, and one downwards."""
    picture = balls((160, GREEN))
    for rows in (slice(20, 110), slice(130, 220)):
        picture.rgb[rows, 158:162], picture.depth[rows, 158:162] = GREEN, 0.4
    disc = np.hypot(*(np.indices(picture.depth.shape) - [[[50]], [[160]]])) < 8.0
    picture.rgb[disc], picture.depth[disc] = (190, 25, 30), 0.4
    look = look_at(picture, up=UP, finder=ByGeometry()).look
    assert look.detections[0].stem is not None
    wire, thing = sorted(look.solids, key=lambda item: -item.position[1])
    assert wire.role == thing.role == "static"
    rows = (wire.position + wire.shape.points)[:, 1]
    assert rows.min() > 0.01  # below the fruit's middle, as the y axis points down
    assert np.ptp(rows) > 0.08


LEFT = 100 - 159.5  # columns of the white ball's middle from the optical axis


def test_depths_that_a_camera_blends_at_an_edge_are_no_thing() -> None:
    sight = look_at(balls((160, GREEN), blend=3.0), up=UP)
    assert len(sight.detections) == 1
    assert not sight.look.solids


def test_leaves_yield_and_a_finder_may_tell_them() -> None:
    picture = balls((160, WHITE))
    finder = ByDetector(lambda rgb: [Detected("leaf", 0.9, mask=picture.depth < 1.0)])
    (thing,) = look_at(picture, up=UP, finder=finder).look.solids
    assert (thing.id, thing.role) == ("leaf1", "avoid")


def test_what_no_picture_shows_is_told_and_another_from_aside_shows_it() -> None:
    """Behind the target, 40 mm along the ray of the first camera, and not before it."""
    shot = shot_of(SEED)
    known, target = shot.scene, shot.scene.target
    sights = [look_at(one.picture, up=known.up) for one in (shot, aside(shot, 70.0))]
    one, both = seen_scene(sights[0], known)[0].unseen, seen_scene(sights, known)[0].unseen
    way = target.position - shot.picture.camera.pose.position
    behind, before = (target.position + by * way / np.linalg.norm(way) for by in (0.04, -0.08))
    cells = one.position + one.shape.points
    assert lengths(cells - behind).min() < 0.01
    assert lengths(cells - before).min() > 0.01
    assert len(both.shape.points) < 0.5 * len(cells)
