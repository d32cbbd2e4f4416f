"""A small painter: shaded faces, lines and dots of a 3-D scene on matplotlib axes.

matplotlib's own 3-D axes sort whole objects, not faces, so that objects in front vanish behind
objects at the back. Here every face goes into one list, sorted by depth.

A solid is an array of quadrilaterals (F, 4, 3) in the world frame [m], corners anticlockwise seen
from outside; a triangle repeats its last corner.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.geometry import shapes
from optipromp.geometry.shapes import Shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LARGEST_FACE = 0.04  # [m] big flat faces are cut so that sorting by depth works
_MOST_POINTS = 1500  # of a point cloud that are drawn
_TOWARDS_LIGHT = np.array([-0.35, 0.75, 0.56])  # in the camera's right, up, back


@dataclass(frozen=True)
class Camera:
    """Looks along ``forward``, ``up`` upwards; from ``distance`` [m], or with parallel rays."""

    target: FloatArray  # (3,) [m] the point in the middle of the picture
    forward: FloatArray  # (3,)
    up: FloatArray  # (3,)
    distance: float | None = None

    @staticmethod
    def orbit(target: FloatArray, azimuth: float, elevation: float, distance: float) -> "Camera":
        """A camera at ``azimuth`` and ``elevation`` [rad] about ``target``, z upwards."""
        away = np.array(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        return Camera(np.asarray(target), -away, np.array([0.0, 0.0, 1.0]), distance)

    @property
    def axes(self) -> FloatArray:
        """(3, 3) with rows right, up and back (towards the eye)."""
        back = -self.forward / np.linalg.norm(self.forward)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def project(self, points: FloatArray) -> FloatArray:
        """Picture coordinates [m at the target] and depth, larger nearer the eye: (..., 3)."""
        seen = (np.asarray(points) - self.target) @ self.axes.T
        if self.distance is None:
            return np.asarray(seen)
        scale = self.distance / np.maximum(self.distance - seen[..., 2:], 0.05 * self.distance)
        return np.concatenate([seen[..., :2] * scale, seen[..., 2:]], axis=-1)


@dataclass
class Picture:
    """Collects what is to be seen; :meth:`draw` paints it, far objects first."""

    camera: Camera
    _corners: list[FloatArray] = field(default_factory=list)
    _colours: list[FloatArray] = field(default_factory=list)
    _framed: list[bool] = field(default_factory=list)

    def add(
        self, faces: FloatArray, colour: str, alpha: float = 1.0, *, framed: bool = True
    ) -> None:
        """Add faces (F, 4, 3); those that turn their back to the camera are left out.

        The picture's frame holds everything but what is added with ``framed=False``.
        """
        from matplotlib.colors import to_rgba

        normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
        length = np.linalg.norm(normal, axis=1)
        keep = length > 1e-14
        faces, normal = faces[keep], normal[keep] / length[keep, None]
        back = self.camera.axes[2]
        if self.camera.distance is None:
            to_eye = np.broadcast_to(back, normal.shape)
        else:
            to_eye = self.camera.target + self.camera.distance * back - faces.mean(axis=1)
        facing = np.einsum("fi,fi->f", normal, to_eye) > 0.0
        faces, normal = faces[facing], normal[facing]
        brightness = 0.5 + 0.5 * np.clip(normal @ self.camera.axes.T @ _TOWARDS_LIGHT, 0.0, 1.0)
        base = np.array(to_rgba(colour, alpha))
        shades = np.tile(base, (len(faces), 1))
        shades[:, :3] *= brightness[:, None]
        self._corners.append(self.camera.project(faces))
        self._colours.append(shades)
        self._framed.append(framed and len(faces) > 0)

    def draw(self, axes: "Axes") -> None:
        """Paint everything onto ``axes``, one metre to the unit, without ticks."""
        from matplotlib.collections import PolyCollection

        corners, colours = np.concatenate(self._corners), np.concatenate(self._colours)
        # An edge in a face's own colour hides the seam to its neighbour; on glass it would show.
        edges = np.where(colours[:, 3:] < 1.0, 0.0, colours)
        order = np.argsort(corners[..., 2].mean(axis=1), kind="stable")
        axes.add_collection(
            PolyCollection(
                list(corners[order][..., :2]),
                facecolors=colours[order],
                edgecolors=edges[order],
                linewidths=0.35,
            ),
            autolim=False,
        )
        seen = np.concatenate(
            [c for c, frame in zip(self._corners, self._framed, strict=True) if frame]
        )
        low, high = seen[..., :2].min(axis=(0, 1)), seen[..., :2].max(axis=(0, 1))
        margin = 0.03 * float(np.max(high - low))
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.set_aspect("equal")
        axes.set_axis_off()


def shape_faces(shape: Shape, position: FloatArray, rotation: FloatArray) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world.

    Args:
        shape: the shape in its local frame.
        position: (3,) [m].
        rotation: (3, 3), world from local.
    """
    return np.asarray(_local_faces(shape) @ np.asarray(rotation).T + np.asarray(position))


def sphere(center: FloatArray, radius: float, around: int = 20) -> FloatArray:
    """Faces of a sphere."""
    polar = np.linspace(0.0, np.pi, around // 2 + 1)
    profile = np.column_stack([np.sin(polar), -np.cos(polar)]) * radius
    return np.asarray(_revolve(profile, around) + np.asarray(center))


def tube(points: FloatArray, radius: float, around: int = 16) -> FloatArray:
    """Faces of a round bar along a polyline (k, 3), with round joints and ends."""
    parts = [sphere(point, radius, around) for point in points]
    for start, end in pairwise(points):
        length = float(np.linalg.norm(end - start))
        if length > 1e-9:
            profile = np.array([[radius, 0.0], [radius, length]])
            parts.append(_revolve(profile, around) @ frame_along((end - start) / length).T + start)
    return np.concatenate(parts)


def frame_along(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose third column is the unit vector ``axis``."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _local_faces(shape: Shape) -> FloatArray:
    match shape:
        case shapes.Sphere(radius=radius):
            return sphere(np.zeros(3), radius, 28)
        case shapes.Box(size=size):
            return _box(np.asarray(size))
        case shapes.Cylinder(radius=radius, length=length):
            steps = np.linspace(-0.5, 0.5, max(2, int(length / _LARGEST_FACE) + 2)) * length
            wall = np.column_stack([np.full_like(steps, radius), steps])
            ends = np.array([[0.0, 0.5 * length]])
            return _revolve(np.concatenate([-ends, wall, ends]), 24)
        case shapes.Capsule(radius=radius, length=length):
            half = np.array([0.0, 0.0, 0.5 * length])
            return tube(np.stack([-half, half]), radius, 24)
        case shapes.HalfSpace():
            return _grid(2.0, 2.0)
        case shapes.MeshShape(vertices=vertices, faces=faces):
            corners = np.asarray(vertices)[np.asarray(faces)]
            return np.concatenate([corners, corners[:, 2:]], axis=1)
        case shapes.PointCloudShape(points=points, radius=radius):
            shown = np.asarray(points)[:: max(1, len(points) // _MOST_POINTS)]
            return np.concatenate([sphere(point, max(radius, 0.003), 6) for point in shown])


def _revolve(profile: FloatArray, around: int) -> FloatArray:
    """Turn a profile of (radius, height) pairs, bottom to top, about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, around + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.empty((len(profile), around + 1, 3))
    points[..., :2] = profile[:, None, :1] * ring
    points[..., 2] = profile[:, 1:]
    lower, upper = points[:-1], points[1:]
    faces = np.stack([lower[:, :-1], lower[:, 1:], upper[:, 1:], upper[:, :-1]], axis=2)
    return faces.reshape(-1, 4, 3)


def _grid(width: float, depth: float) -> FloatArray:
    """A rectangle in the plane z = 0, facing +z, cut into small faces."""
    across = np.linspace(-0.5, 0.5, int(np.ceil(width / _LARGEST_FACE)) + 1) * width
    along = np.linspace(-0.5, 0.5, int(np.ceil(depth / _LARGEST_FACE)) + 1) * depth
    x, y = np.meshgrid(across, along, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    corners = (points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:])
    return np.stack(corners, axis=2).reshape(-1, 4, 3)


def _box(size: FloatArray) -> FloatArray:
    parts = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        face = _grid(size[first], size[second])
        placed = np.empty_like(face)
        placed[..., first], placed[..., second] = face[..., 0], face[..., 1]
        placed[..., axis] = 0.5 * size[axis]
        parts += [placed, -placed]
    return np.concatenate([part if i % 2 == 0 else part[:, ::-1] for i, part in enumerate(parts)])
