"""A small painter: shaded faces, lines and dots of a 3-D scene on matplotlib axes.

matplotlib's own 3-D axes sort whole objects, not faces, so that objects in front vanish behind
objects at the back. Here every face goes into one list, sorted by depth.

A solid is an array of quadrilaterals, see :mod:`optipromp.looks.appearance.faces`.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from optipromp.core.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TOWARDS_LIGHT = np.array([-0.35, 0.75, 0.56])  # in the camera's right, up, back


@dataclass(frozen=True)
class Camera:
    """A camera that looks along ``forward``, from ``distance`` [m] or (None) with parallel rays."""

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
    """Collects shaded faces; :meth:`draw` paints them, the farthest first."""

    camera: Camera
    _corners: list[FloatArray] = field(default_factory=list)
    _colours: list[FloatArray] = field(default_factory=list)
    _framed: list[bool] = field(default_factory=list)

    def add(
        self, faces: FloatArray, colour: str, alpha: float = 1.0, *, framed: bool = True
    ) -> None:
        """Add faces (F, 4, 3); those that face away from the camera are left out.

        Faces of glass (``alpha`` below 1) are one flat shape: where they cover each other, and
        along their seams, it is as dark as elsewhere.
        The picture's frame holds all faces but those added with ``framed=False``.
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
        if alpha < 1.0 and len(faces):
            shades = shades.mean(axis=0, keepdims=True)
        self._corners.append(self.camera.project(faces))
        self._colours.append(shades)
        self._framed.append(framed and len(faces) > 0)

    def draw(self, axes: "Axes") -> None:
        """Paint everything onto ``axes``, one metre to the unit, without ticks."""
        from matplotlib.collections import PathCollection
        from matplotlib.path import Path

        paths: list[Path] = []
        depths = []
        for corners, colour in zip(self._corners, self._colours, strict=True):
            closed = np.concatenate([corners, corners[:, :1]], axis=1)
            flat = [Path(face, closed=True) for face in closed[..., :2]]
            depth = corners[..., 2].mean(axis=1)
            if len(colour) < len(flat):
                flat, depth = [Path.make_compound_path(*flat)], depth.mean(keepdims=True)
            paths += flat
            depths.append(depth)
        colours = np.concatenate(self._colours)
        # An edge in a face's own colour hides the seam to its neighbour; on glass it would show.
        edges = np.where(colours[:, 3:] < 1.0, 0.0, colours)
        order = np.argsort(np.concatenate(depths), kind="stable")
        axes.add_collection(
            PathCollection(
                [paths[k] for k in order],
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
