"""The outline of a shape across an axis: the planner's circle and the judge's extent."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)
from optipromp.core.geometry.shapes import hull_faces, outlines
from optipromp.core.judging.ends import half_width
from optipromp.core.scenes import SceneObject

CORNERS = np.array([[np.cos(a), np.sin(a), z] for a in (0.0, 2.1, 4.2) for z in (-1.0, 1.0)])
PRISM = MeshShape(0.02 * CORNERS, hull_faces(0.02 * CORNERS))
ROUND = (
    Sphere(0.018), Capsule(0.017, 0.02), Ellipsoid((0.017, 0.017, 0.03)),
    Ellipsoid((0.012, 0.019, 0.03)), Cone(0.02, 0.009, 0.025), Cone(0.02, 0.006, 0.015),
    Cylinder(0.016, 0.05), Box((0.02, 0.03, 0.05)),
)  # fmt: skip
CLOUD = PointCloudShape(0.02 * CORNERS, 0.003)


def smallest_circle(points: FloatArray) -> float:
    """Radius of the smallest circle round points (N, 2), by steps towards the farthest one."""
    points = points[ConvexHull(points).vertices]
    middle = points.mean(axis=0)
    for k in range(1, 3_000):
        middle = middle + (points[np.argmax(((points - middle) ** 2).sum(1))] - middle) / (k + 1)
    return float(np.linalg.norm(points - middle, axis=1).max())


@pytest.mark.parametrize("shape", ROUND)
def test_the_circle_is_that_of_the_mesh_in_any_direction(shape: Shape) -> None:
    rng = np.random.default_rng(1)
    axes = rng.standard_normal((4, 3))
    axes = np.vstack([np.eye(3)[2], axes / np.linalg.norm(axes, axis=1)[:, None]])
    (radius, middle, below), vertices = outlines(shape, axes), shape.mesh(96).vertices
    for k, axis in enumerate(axes):
        flat = vertices @ frame_along(axis)[:, :2]
        exact = smallest_circle(flat)
        assert radius[k] == pytest.approx(exact, rel=7e-3)
        assert half_width(SceneObject("o", "target", shape, np.zeros(3)), axis) == pytest.approx(
            exact, rel=7e-3
        )
        assert below[k] == pytest.approx(-(vertices @ axis).min(), abs=2.5e-4)
        assert abs(middle[k] @ axis) < 1e-12
        off = vertices - middle[k]
        off -= np.outer(off @ axis, axis)
        assert np.linalg.norm(off, axis=1).max() < 1.002 * radius[k]


@pytest.mark.parametrize("shape", [PRISM, CLOUD])
def test_any_other_outline_is_between_the_extent_and_the_circle(shape: Shape) -> None:
    """What the judge refuses goes through no mouth; what the planner allows goes through."""
    points, more = (PRISM.vertices, 0.0) if shape is PRISM else (CLOUD.points, CLOUD.radius)
    for axis in (np.eye(3)[2], np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])):
        exact = smallest_circle(points @ frame_along(axis)[:, :2]) + more
        item = SceneObject("o", "target", shape, np.zeros(3))
        assert half_width(item, axis) < 1.002 * exact
        assert outlines(shape, axis[None])[0][0] > 0.998 * exact


def test_the_judge_turns_the_axis_into_the_frame_of_the_object() -> None:
    turn = frame_along(np.array([0.6, 0.0, 0.8]))
    item = SceneObject("o", "target", Capsule(0.01, 0.04), np.zeros(3), turn)
    assert half_width(item, turn[:, 2]) == pytest.approx(0.01)
    assert half_width(item, turn[:, 0]) == pytest.approx(0.03, rel=1e-3)
