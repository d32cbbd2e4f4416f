"""Faces of solids are closed, turned outwards and in place."""

import numpy as np
import pytest

from optipromp.core.arrays import frame_along
from optipromp.core.geometry.faces import sphere
from optipromp.core.geometry.shapes import Box, Cylinder, PointCloudShape, Sphere
from optipromp.looks.appearance import shape_faces
from optipromp.looks.viewer.reach import Camera, Picture

ROTATION = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def volume(faces: np.ndarray) -> float:
    """By the divergence theorem, each quadrilateral as two triangles."""
    a, b, c, d = (faces[:, i] for i in range(4))
    first = np.einsum("fi,fi->f", a, np.cross(b, c))
    second = np.einsum("fi,fi->f", a, np.cross(c, d))
    return float((first + second).sum() / 6.0)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Sphere(0.1), 4 / 3 * np.pi * 0.1**3),
        (Box((0.1, 0.2, 0.3)), 0.006),
        (Cylinder(0.1, 0.4), np.pi * 0.1**2 * 0.4),
    ],
)
def test_faces_enclose_the_volume_of_the_shape(shape: Sphere, expected: float) -> None:
    position = np.array([0.5, -0.2, 0.3])
    faces = shape_faces(shape, position, ROTATION)
    assert volume(faces - position) == pytest.approx(expected, rel=0.05)
    middle = 0.5 * (faces.min(axis=(0, 1)) + faces.max(axis=(0, 1)))
    np.testing.assert_allclose(middle, position, atol=1e-3)


def test_a_large_cloud_is_thinned() -> None:
    points = np.random.default_rng(0).uniform(size=(20_000, 3))
    faces = shape_faces(PointCloudShape(points, 0.01), np.zeros(3), np.eye(3))
    assert len(faces) < 50_000


@pytest.mark.parametrize("axis", np.vstack([np.eye(3), -np.eye(3), [[0.6, 0.0, 0.8]]]))
def test_frames_along_an_axis_are_rotations(axis: np.ndarray) -> None:
    frame = frame_along(axis)
    np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    np.testing.assert_array_equal(frame[:, 2], axis)


def test_near_faces_are_painted_after_far_ones() -> None:
    from matplotlib.figure import Figure

    picture = Picture(Camera.orbit(np.zeros(3), 0.0, 0.0, 3.0))
    picture.add(sphere(np.array([0.5, 0.0, 0.0]), 0.1), "#ff0000")
    picture.add(sphere(np.array([-0.5, 0.0, 0.0]), 0.1), "#0000ff")
    axes = Figure().subplots()
    picture.draw(axes)
    colours = np.asarray(axes.collections[0].get_facecolor())
    red = colours[:, 0] > colours[:, 2]
    assert red.any()
    assert not red.all()
    assert not red[: int((~red).sum())].any()
