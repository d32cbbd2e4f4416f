"""Several looks as one."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.control.look import Look
from optipromp.core.arrays import frame_along
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.objects import Role, SceneObject, Stem
from optipromp.core.scenes.pose import Pose
from optipromp.perception.fusing import fused

FAR = 0.4  # [m] from camera to plant
DEEP = np.diag([1e-6, 1e-6, 1.6e-5])  # of a detection in its camera's frame [m²]


def look(camera: Pose, *fruits: SceneObject) -> Look:
    back = camera.inverse()
    seen = (replace(item.transformed(back), covariance=DEEP) for item in fruits)
    return Look(0.0, camera, tuple(seen))


def fruit(name: str, role: Role, *place: float, tilt: float | None = None) -> SceneObject:
    at = np.array(place)
    stem = Stem.along(at, np.array([0.0, 0.1, 1.0]), 0.1)
    hung = None if tilt is None else replace(stem, tilt=tilt)
    return SceneObject(name, role, Sphere(0.015), at, stem=hung)


FRONT = Pose(np.array([-FAR, 0.0, 0.0]), frame_along(np.array([1.0, 0.0, 0.0])))
SIDE = Pose(np.array([0.0, -FAR, 0.0]), frame_along(np.array([0.0, 1.0, 0.0])))


def test_each_camera_tells_what_it_sees_best() -> None:
    one = look(FRONT, fruit("a", "target", 0.005, 0.0, 0.0))
    other = look(SIDE, fruit("b", "target", 0.0, 0.005, 0.0))
    (both,) = fused([one, other]).in_base()
    assert both.position == pytest.approx(np.array([0.005, 0.005, 0.0]) / 17.0, abs=1e-9)
    assert both.covariance is not None
    assert np.diag(both.covariance) == pytest.approx([1.6e-5 / 17.0, 1.6e-5 / 17.0, 5e-7])


def test_what_one_camera_alone_has_seen_stays_and_ids_are_unique() -> None:
    near, behind = fruit("x", "pushable", 0.0, 0.0, 0.0), fruit("x", "pushable", 0.04, 0.0, 0.0)
    ripe = fruit("y", "target", 0.0, 0.0, 0.06)
    found = fused([look(FRONT, near, ripe), look(SIDE, near, behind, ripe)])
    assert found.camera is FRONT
    assert sorted(item.id for item in found.detections) == ["ripe1", "unripe1", "unripe2"]


def test_the_surer_stem_is_kept_and_hangs_at_its_fruit() -> None:
    coarse = look(FRONT, fruit("a", "target", 0.0, 0.0, 0.0, tilt=9.0))
    fine = look(SIDE, fruit("a", "target", 0.004, 0.0, 0.0, tilt=3.0))
    bare = look(SIDE, fruit("a", "target", 0.004, 0.0, 0.0))
    for second, tilt in ((fine, 3.0), (bare, 9.0)):
        (both,) = fused([coarse, second]).in_base()
        assert both.stem is not None
        assert both.stem.tilt == tilt
        assert both.stem.points[0] == pytest.approx(both.position)


def test_one_look_stays_as_it_is() -> None:
    one = look(FRONT, fruit("ripe1", "target", 0.005, 0.0, 0.0))
    (same,) = fused([one]).in_base()
    assert same.position == pytest.approx([0.005, 0.0, 0.0])
