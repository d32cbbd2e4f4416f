"""Fits against pictures of spheroids that are made here, pixel by pixel."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Ellipsoid, Sphere
from optipromp_eyes import (
    ByGeometry,
    ByNetwork,
    CameraModel,
    DepthPicture,
    EyeParameters,
    look_at,
)
from optipromp_eyes.finder import Region
from optipromp_eyes.spheroids import INSIDE, all_fitted, start_of
from optipromp_sim.simulation.photograph import StereoParameters, sensed

CAMERA = CameraModel(320, 240, 480.0, 480.0, 159.5, 119.5)
UP = np.array([0.0, -1.0, 0.0])  # in the frame of the camera
RED, GREEN, STEM = (200, 20, 30), (140, 180, 80), (70, 120, 45)
P = EyeParameters()


class Painter:
    """A picture of balls and rods before nothing, each over what is farther."""

    def __init__(self) -> None:
        self.rgb = np.full((240, 320, 3), 128, dtype=np.uint8)
        self.depth = np.full((240, 320), np.inf)

    def ellipsoid(
        self, center: FloatArray, radii: tuple[float, float, float], colour: tuple[int, int, int]
    ) -> "Painter":
        scale = 1.0 / np.array(radii)
        eye, ways = -np.asarray(center) * scale, CAMERA.rays * scale
        a, b = (ways**2).sum(axis=2), ways @ eye
        root = b**2 - a * (eye @ eye - 1.0)
        far = np.where(root > 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
        return self._over(far, colour)

    def rod(self, begin: FloatArray, end: FloatArray, radius: float = 0.003) -> "Painter":
        for share in np.linspace(0.0, 1.0, 400):
            self.ellipsoid(begin + share * (end - begin), (radius,) * 3, STEM)
        return self

    def _over(self, far: FloatArray, colour: tuple[int, int, int]) -> "Painter":
        nearer = far < self.depth
        self.rgb[nearer], self.depth = colour, np.minimum(far, self.depth)
        return self

    def picture(self, noise: float = 0.0, seed: int = 0) -> DepthPicture:
        rng = np.random.default_rng(seed)
        depth = np.where(np.isfinite(self.depth), self.depth, 0.0)
        depth = depth * (1.0 + noise * depth * rng.standard_normal(depth.shape))
        return DepthPicture(self.rgb, np.maximum(depth, 0.0), CAMERA)


def test_a_whole_ball_has_its_centre_and_radius() -> None:
    center = np.array([0.03, -0.02, 0.45])
    picture = Painter().ellipsoid(center, (0.016,) * 3, RED).picture()
    (fruit,) = look_at(picture, up=UP).detections
    assert fruit.region.kind == "ripe"
    assert fruit.item.role == "target"
    assert np.linalg.norm(fruit.item.position - center) < 0.0015
    assert fruit.item.radius == pytest.approx(0.016, abs=0.0015)
    assert fruit.item.stem is None


def test_a_long_fruit_is_an_ellipsoid_along_the_vertical() -> None:
    center = np.array([0.0, 0.0, 0.40])
    picture = Painter().ellipsoid(center, (0.016, 0.022, 0.016), GREEN).picture()
    (fruit,) = look_at(picture, up=UP).detections
    assert isinstance(fruit.item.shape, Ellipsoid)
    wide, _, half = fruit.item.shape.radii
    assert half / wide == pytest.approx(22 / 16, abs=0.12)
    assert abs(fruit.item.rotation[:, 2] @ UP) > 0.98
    assert np.linalg.norm(fruit.item.position - center) < 0.003


def half_hidden() -> DepthPicture:
    """A ripe fruit at 0.45 m behind a green one."""
    painter = Painter().ellipsoid(np.array([0.0, 0.0, 0.45]), (0.017,) * 3, RED)
    return painter.ellipsoid(np.array([0.016, 0.0, 0.40]), (0.017,) * 3, GREEN).picture()


def test_the_front_alone_does_not_pull_a_half_hidden_fruit_to_the_camera() -> None:
    """The centre of the visible cap's points is 8 mm before that of the fruit."""
    hidden = next(d for d in look_at(half_hidden(), up=UP).detections if d.region.kind == "ripe")
    assert hidden.spheroid.share < 0.9
    assert abs(hidden.item.position[2] - 0.45) < 0.006
    assert abs(hidden.item.position[0]) < 0.006


def test_the_less_is_seen_the_wider_the_covariance() -> None:
    whole = Painter().ellipsoid(np.array([0.0, 0.0, 0.45]), (0.017,) * 3, RED).picture()
    spreads = []
    for picture in (whole, half_hidden()):
        region = next(r for r in ByGeometry().find(picture).fruits if r.kind == "ripe")
        kind, colours = np.ones(1, dtype=np.int64), region.pixels.astype(np.int64)
        (fit,) = all_fitted(picture, [region], kind, colours, UP, P)
        assert fit is not None
        spreads.append(float(np.trace(fit.covariance)))
    assert spreads[1] > 1.05 * spreads[0]


def test_errors_under_noise_are_as_large_as_the_covariances_say() -> None:
    """White noise of the stated size; the scale error and the model's share are not drawn here."""
    center = np.array([-0.02, 0.01, 0.45])
    painter = Painter().ellipsoid(center, (0.016,) * 3, GREEN)
    squares = []
    for seed in range(12):
        (fruit,) = look_at(painter.picture(P.depth_noise, seed), up=UP).detections
        assert fruit.item.covariance is not None
        error = fruit.item.position - center
        squares.append(float(error @ np.linalg.solve(fruit.item.covariance, error)))
    assert np.mean(squares) < 3.0


@pytest.mark.parametrize("lean", [-30.0, 0.0, 25.0])
def test_a_stem_has_its_inclination(lean: float) -> None:
    center = np.array([0.0, 0.03, 0.45])
    angle = np.deg2rad(lean)
    way = np.array([np.sin(angle), -np.cos(angle), 0.0])
    painter = Painter().ellipsoid(center, (0.016,) * 3, RED)
    painter.rod(center + 0.015 * way, center + 0.10 * way)
    (fruit,) = look_at(painter.picture(0.5 * P.depth_noise), up=UP).detections
    off = np.degrees(np.arccos(np.clip(fruit.stem.direction @ way, -1.0, 1.0)))
    assert off < 4.0
    assert fruit.item.stem.length == pytest.approx(0.10, abs=0.015)


def test_fruits_that_overlap_in_the_picture_are_two() -> None:
    painter = Painter().ellipsoid(np.array([-0.014, 0.0, 0.45]), (0.016,) * 3, GREEN)
    painter.ellipsoid(np.array([0.014, 0.004, 0.455]), (0.016,) * 3, GREEN)
    found = look_at(painter.picture(), up=UP).detections
    assert [fruit.item.id for fruit in found] == ["unripe1", "unripe2"]
    assert all(isinstance(fruit.item.shape, Sphere | Ellipsoid) for fruit in found)


def test_an_empty_picture_stems_walls_and_grey_balls_show_no_fruits() -> None:
    assert look_at(Painter().picture(), up=UP).detections == ()
    painter = Painter().rod(np.array([-0.05, 0.05, 0.45]), np.array([-0.05, -0.1, 0.45]))
    painter.ellipsoid(np.array([0.05, 0.0, 0.45]), (0.016,) * 3, (120, 120, 122))
    painter.ellipsoid(np.array([0.0, 0.0, 0.7]), (0.3, 0.05, 0.05), GREEN)
    assert look_at(painter.picture(), up=UP, finder=ByGeometry()).detections == ()


@pytest.mark.parametrize("finder", [ByGeometry, ByNetwork])
def test_a_single_fruit_is_found_where_errors_of_depth_hide_that_it_is_round(
    finder: type[ByGeometry | ByNetwork],
) -> None:
    """At 0.8 m, by a camera whose errors there, 6 mm, are those that the eyes expect."""
    there = np.array([0.0, 0.0, 0.8])
    painter = Painter().rod(there - [0.0, 0.017, 0.0], there - [0.0, 0.1, 0.0], 0.0015)
    true = painter.ellipsoid(there, (0.017,) * 3, RED)
    depth = np.where(np.isfinite(true.depth), true.depth, 1.1)
    for seed in range(6):
        measured = sensed(depth, CAMERA.focal, StereoParameters(), np.random.default_rng(seed))
        seen = look_at(DepthPicture(true.rgb, measured, CAMERA), up=UP, finder=finder())
        assert [each.item.id for each in seen.detections] == ["ripe1"]


@pytest.mark.parametrize("depth", [True, False])
def test_gloss_within_a_fruit_is_of_the_fruit(depth: bool) -> None:
    """A highlight has no colour, and of some cameras no depth."""
    painter = Painter()
    for across in (-0.05, 0.0, 0.05):
        center = np.array([across, 0.0, 0.4])
        painter.ellipsoid(center, (0.017,) * 3, RED)
        column, row = CAMERA.pixels(center) - [3, 3]
        rows, columns = np.indices(painter.depth.shape)
        shining = np.hypot(rows - row, columns - column) < 11
        painter.rgb[shining] = 250
        if not depth:
            painter.depth[shining] = np.inf
    seen = look_at(painter.picture(0.002), up=UP, finder=ByGeometry()).detections
    assert [each.item.id for each in seen] == ["ripe1", "ripe2", "ripe3"]


@pytest.mark.filterwarnings("error")
def test_a_region_half_near_and_half_far_begins_at_its_near_half() -> None:
    """The median of as many pixels at 0.3 m as at 0.9 m is a depth at which there is none."""
    picture = Painter().ellipsoid(np.array([0.0, 0.0, 0.45]), (0.02,) * 3, RED).picture()
    pixels = picture.depth > 0.0
    rows = np.argwhere(pixels)
    depth = picture.depth.copy()
    depth[tuple(rows[: len(rows) // 2].T)], depth[tuple(rows[len(rows) // 2 :].T)] = 0.3, 0.9
    one = np.zeros_like(pixels)
    one[tuple(rows[: 2 * (len(rows) // 2)].T)] = True
    inside = binary_erosion(one, iterations=INSIDE)
    far = depth[inside]
    odd = int((far == 0.3).sum() - (far == 0.9).sum())
    flip = np.argwhere(inside & (depth == (0.3 if odd > 0 else 0.9)))[: abs(odd) // 2]
    depth[tuple(flip.T)] = 0.9 if odd > 0 else 0.3
    found = start_of(DepthPicture(picture.rgb, depth, CAMERA), Region("ripe", one, 1.0), P)
    assert np.isfinite(found.place).all()
    assert found.place[2] == pytest.approx(0.3)
