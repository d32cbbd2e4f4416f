"""What is no fruit, and what is wrong with a picture: told apart, or told by its cause."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.perception.shots import shot_of, with_flower

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp_bench.experiments.eyes import paired
from optipromp_eyes import (
    ByDetector,
    ByGeometry,
    ByNetwork,
    CameraModel,
    DepthPicture,
    Detected,
    EyeParameters,
    Sighting,
    look_at,
    seen_scene,
)
from optipromp_eyes.doubts import register_of
from optipromp_eyes.eyes import doubt_of

UP = np.array([0.0, -1.0, 0.0])  # of a camera without pose that looks ahead
LENS = CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5)
GREEN, GREY, RIPE = (85, 140, 60), (150, 150, 150), (190, 25, 30)
WHITE, YELLOW, GOLD = (225, 225, 215), (235, 205, 60), (225, 170, 30)
WEAK = [(1.0, s, t) for s in (0.5, 0.35) for t in (0.9 * s, 0.95)]  # red and grow light
TUNGSTEN, RED, GROW = (1.0, 0.77, 0.56), (1.0, 0.25, 0.2), (1.0, 0.3, 0.9)


def still(
    *things: tuple[FloatArray, FloatArray, tuple[int, int, int]], light: FloatArray | None = None
) -> DepthPicture:
    """Ellipsoids (centre, half sizes, colour) before leaves and a gutter, in a light."""
    depth = np.full((240, 320), 0.6)
    rows = np.indices(depth.shape)[0]
    rgb = np.where((rows < 160)[..., None], GREEN, GREY).astype(float)
    for center, half, colour in things:
        rays, at = LENS.rays / half, np.asarray(center) / half
        a, b = (rays**2).sum(axis=2), rays @ at
        inside = b**2 - a * (at @ at - 1.0)
        far = (b - np.sqrt(np.maximum(inside, 0.0))) / a
        front = (inside > 0.0) & (far < depth)
        depth[front], rgb[front] = far[front], colour
    noise = np.random.default_rng(0).standard_normal((2, *depth.shape))
    rgb = rgb * (1.0 if light is None else light) + 2.0 * noise[0][..., None]
    rgb = np.clip(rgb, 0, 255).astype(np.uint8)
    return DepthPicture(rgb, depth + 0.0004 * noise[1], LENS)


def ball(colour: tuple[int, int, int], across: float = 0.0, radius: float = 0.017):
    return np.array([across, 0.0, 0.4]), np.full(3, radius), colour


def believed(mask: BoolArray) -> ByDetector:
    """A detector that says there is a ripe fruit."""
    return ByDetector(lambda rgb: [Detected("ripe", 0.9, mask=mask)])


def kinds(sight: Sighting) -> list[str]:
    return [each.region.kind for each in sight.detections]


def words(sight: Sighting) -> str:
    return "; ".join(sight.doubts)


def targets(sight: Sighting) -> list[str]:
    return [each.item.id for each in sight.detections if each.item.role == "target"]


def test_a_red_tube_and_a_red_tape_are_no_targets_and_a_small_fruit_is() -> None:
    at = np.array([0.0, 0.0, 0.4])
    tube, tape = np.array([0.012, 5.0, 0.012]), np.array([0.012, 0.02, 0.0004])
    for thing in ((at, tube, RIPE), (at, tape, RIPE)):
        assert targets(look_at(still(thing), up=UP, finder=ByGeometry())) == []
    small = still((np.array([0.0, 0.0, 0.55]), np.full(3, 0.012), RIPE))  # 130 pixels
    assert targets(look_at(small, up=UP, finder=ByGeometry())) == ["ripe1"]


@pytest.mark.parametrize("light", [RED, GROW, (0.2, 0.25, 1.0)])
def test_where_nothing_reflects_green_no_fruit_is_ripe(light: tuple[float, ...]) -> None:
    disc = np.hypot(*(np.indices((240, 320)) - [[[119.5]], [[159.5]]])) < 11
    for colour in (GREEN, RIPE):
        sight = look_at(still(ball(colour), light=np.array(light)), up=UP, finder=believed(disc))
        assert kinds(sight) == ["ripe"]
        assert targets(sight) == []
        assert "red, blue or grow light?" in words(sight)


def test_in_a_grey_picture_no_fruit_is_ripe() -> None:
    shown = still(ball(RIPE))
    grey = np.repeat(shown.rgb.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    sight = look_at(replace(shown, rgb=grey), up=UP, finder=believed(shown.depth < 0.5))
    assert targets(sight) == []
    assert "the picture is grey" in words(sight)


def test_a_fruit_less_red_than_its_crop_wants_is_no_target() -> None:
    """The upper third of a fruit is green."""
    shown = still(ball(RIPE, radius=0.02))
    high = (np.indices(shown.depth.shape)[0] < 115) & (shown.depth < 0.5)
    half = replace(shown, rgb=np.where(high[..., None], np.uint8(GREEN), shown.rgb))
    disc = believed(shown.depth < 0.5)
    for least, roles in ((0.0, ["target"]), (0.5, ["target"]), (0.75, ["pushable"])):
        sight = look_at(half, up=UP, finder=disc, parameters=EyeParameters(least_red=least))
        assert [each.item.role for each in sight.detections] == roles
        assert 0.55 < sight.detections[0].redness < 0.74


TABLES = {
    "white": (225, 222, 215), "grey": (120, 120, 122), "paper": (200, 170, 130),
    "soil": (110, 80, 60),
}  # fmt: skip


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), TUNGSTEN])
@pytest.mark.parametrize("table", [*TABLES, "red, and a wall behind"])
def test_a_ripe_fruit_without_a_leaf_near_is_a_target(table: str, light: tuple[float, ...]) -> None:
    """On a table, with nothing green; what is far counts too."""
    shown = still(ball(RIPE))
    behind, far = shown.depth > 0.5, np.indices(shown.depth.shape)[0] < 60
    rgb = np.where(behind[..., None], np.uint8(TABLES.get(table, (190, 60, 50))), shown.rgb)
    if table not in TABLES:
        rgb = np.where(far[..., None], np.uint8(GREY), rgb)
    if light != TUNGSTEN or table in ("white", "grey"):
        lit = replace(shown, rgb=np.rint(rgb * np.array(light)).astype(np.uint8))
        assert targets(look_at(lit, up=UP)) == ["ripe1"]


@pytest.mark.parametrize("looks", ["plain", "rich"])
@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), *WEAK])
def test_weak_coloured_light_makes_no_unripe_fruit_a_target(
    looks: str, light: tuple[float, ...]
) -> None:
    shot = shot_of(looks=looks)
    rgb = np.rint(shot.picture.rgb * np.array(light)).astype(np.uint8)
    sight = look_at(replace(shot.picture, rgb=rgb), up=shot.scene.up)
    pairs, _ = paired(shot, sight)
    assert sum(pair.detection is not None for pair in pairs) >= 2
    for pair in pairs:
        assert (
            pair.detection is None
            or pair.detection.item.role == "pushable"
            or (pair.item.role == "target")
        )
    if light[1] == 1.0:
        assert targets(sight)
        assert sight.doubts == ()


@pytest.mark.parametrize("finder", [ByGeometry, ByNetwork])
@pytest.mark.parametrize("dyes", [(WHITE, YELLOW), (YELLOW, GOLD)])
def test_flowers_are_no_fruits(
    finder: type[ByGeometry | ByNetwork], dyes: tuple[tuple[int, int, int], ...]
) -> None:
    """A strawberry's and a yellow one, small and large, beside fruits and their stems."""
    shot, eye = shot_of(), finder()
    fruits = kinds(look_at(shot.picture, up=shot.scene.up, finder=eye))
    assert len(fruits) == 3
    shown = shot.picture
    for at, size in (((343, 88), 0.008), ((420, 180), 0.009), ((180, 400), 0.011)):
        shown = with_flower(shown, at, 0.4, size, *dyes)
    assert kinds(look_at(shown, up=shot.scene.up, finder=eye)) == fruits


@pytest.mark.parametrize("finder", [ByGeometry, ByNetwork])
def test_red_and_blue_exchanged_are_told(finder: type[ByGeometry | ByNetwork]) -> None:
    shot, eye = shot_of(), finder()
    bgr = replace(shot.picture, rgb=shot.picture.rgb[:, :, ::-1].copy())
    assert "ripe" not in kinds(look_at(bgr, up=shot.scene.up, finder=eye))
    assert "must be RGB" in doubt_of(bgr, up=shot.scene.up, finder=eye)
    red = np.isin(shot.masks, [k for k, m in enumerate(shot.marked, 1) if m.kind == "ripe"])
    green = np.where(red[..., None], shot.picture.rgb[:, :, [1, 0, 2]], shot.picture.rgb)
    unripe = replace(shot.picture, rgb=green)
    assert doubt_of(unripe, up=shot.scene.up, finder=eye) == ""


@pytest.mark.parametrize("shift", [(0, 18), (0, -12), (10, 10)])
def test_depth_out_of_register_is_told_with_its_shift(shift: tuple[int, int]) -> None:
    shown = still(ball(RIPE, -0.05), ball(GREEN, 0.04), ball(RIPE, 0.0, 0.02))
    shown = replace(shown, rgb=np.where((shown.depth > 0.5)[..., None], np.uint8(GREY), shown.rgb))
    assert register_of(shown, EyeParameters()) == ()
    moved = replace(shown, depth=np.roll(shown.depth, shift, (0, 1)))
    (doubt,) = register_of(moved, EyeParameters())
    down, across = -shift[0], -shift[1]
    assert f"{across:+d} columns and {down:+d} rows" in doubt
    assert doubt in look_at(moved, up=UP).doubts


def test_a_camera_without_a_pose_and_an_axis_beside_the_picture_are_told() -> None:
    sight = look_at(still(ball(RIPE)), up=UP)
    assert kinds(sight) == ["ripe"]
    assert sight.doubts == ("the camera has no pose: places are in its own frame, with z forward",)
    shown = still(ball(RIPE))
    other = replace(LENS, cx=320.0, cy=180.0, pose=Pose(np.ones(3), np.array([1.0, 0.0, 0.0, 0.0])))
    (doubt,) = look_at(replace(shown, camera=other), up=UP).doubts
    assert "column 320, row 180 of 320 x 240 pixels: intrinsics of another resolution?" in doubt


@pytest.mark.parametrize("fault", ["down", "left", "inverted", "xyzw"])
def test_stems_that_do_not_hang_from_above_are_told_with_the_cause(fault: str) -> None:
    shot = shot_of()
    shown, up, pose = shot.picture, shot.scene.up, shot.picture.camera.pose
    cause = {
        "down": "the picture is upside down", "left": "the picture is turned to the ",
        "inverted": "the pose is inverted", "xyzw": "the quaternion is x, y, z, w",
    }[fault]  # fmt: skip
    if fault == "down":
        shown = replace(
            shown, rgb=shown.rgb[::-1, ::-1].copy(), depth=shown.depth[::-1, ::-1].copy()
        )
    elif fault == "left":
        lens = shown.camera
        camera = replace(
            lens, width=lens.height, height=lens.width, fx=lens.fy, fy=lens.fx, cx=lens.cy,
            cy=lens.width - 1 - lens.cx,
        )  # fmt: skip
        shown = DepthPicture(np.rot90(shown.rgb).copy(), np.rot90(shown.depth).copy(), camera)
    elif fault == "inverted":
        shown = replace(shown, camera=replace(shown.camera, pose=pose.inverse()))
    else:  # an arm that hangs from a ceiling
        side = Pose(np.zeros(3), np.array([0.0, 0.0, 1.0, 0.0]))
        w, x, y, z = (side @ pose).orientation
        up = side.rotation @ up
        wrong = Pose(pose.position, np.array([x, y, z, w]))
        shown = replace(shown, camera=replace(shown.camera, pose=wrong))
    told = [each for each in look_at(shown, up=up).doubts if "stems do not hang" in each]
    assert len(told) == 1
    assert cause in told[0]


@pytest.mark.parametrize("finder", [ByGeometry, ByNetwork])
@pytest.mark.parametrize("kind", ["unripe", "ripe"])
def test_a_fruit_without_depth_is_told_and_solid(
    finder: type[ByGeometry | ByNetwork], kind: str
) -> None:
    """As of a shiny skin: it was in no scene and in no doubt, and planned through."""
    shot = shot_of()
    value, name = next((k, one.id) for k, one in enumerate(shot.marked, 1) if one.kind == kind)
    mask = shot.masks == value
    blind = replace(shot.picture, depth=np.where(mask, 0.0, shot.picture.depth))
    eye = finder()
    whole = look_at(shot.picture, up=shot.scene.up, finder=eye)
    assert not any("unmeasured" in item.id for item in whole.look.solids)
    sight = look_at(blind, up=shot.scene.up, finder=eye)
    pairs = zip(sight.look.solids, sight.places, strict=True)
    ((solid, told),) = [pair for pair in pairs if "unmeasured" in pair[0].id]
    column, row = map(int, re.findall(r"(?:column|row) (\d+)", told))
    assert mask[row, column]
    fruit = next(item for item in shot.scene.objects if item.id == name)
    there = solid.transformed(shot.picture.camera.pose)
    local = np.abs((fruit.position - there.position) @ there.rotation)
    assert (local < there.shape.measure.half).all()
    if kind == "unripe":
        assert "unmeasured1" in {item.id for item in seen_scene(sight, shot.scene)[0].static}
    both = seen_scene([whole, sight], shot.scene)[0]  # the other picture measured it
    assert not any("unmeasured" in item.id for item in both.objects)
