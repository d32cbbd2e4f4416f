"""A robot and its scene as nodes of viser; a node is sent again only where it changes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.looks.appearance import Part, arm_parts, object_parts, scenery
from optipromp.looks.appearance.scene import STEM, rgb

FLAT = {"cast_shadow": False, "receive_shadow": False}  # slow without a graphics card


class Nodes:
    """Nodes under ``/root`` of a scene of viser.

    ``api``: the scene of a server, or of one of its clients. ``root``: name of the first node.
    ``offset``: (3,) of all nodes in the world [m]. ``shadows``: whether nodes cast shadows.
    """

    def __init__(self, api: Any, root: str = "a", offset: Sequence[float] = (0.0, 0.0, 0.0),
                 *, shadows: bool = False) -> None:  # fmt: skip
        self.api, self.root = api, f"/{root}"
        self.offset, self.shadows = np.asarray(offset), shadows
        self.scene: Scene | None = None
        self.robot: Robot | None = None
        self._segments: list[Any] = []
        self._meshes: dict[str, tuple[Part, Any]] = {}
        self._items: dict[str, SceneObject] = {}  # objects whose looks are drawn
        self._stands: dict[str, SceneObject] = {}  # objects at their perceived places
        self.on_click: Callable[[str], None] | None = None

    def clear(self) -> None:
        """Remove every node."""
        self.api.remove_by_name(self.root)
        self._segments = []
        self._meshes, self._items, self._stands = {}, {}, {}
        self.scene = self.robot = None

    def show(self, scene: Scene, robot: Robot, *, haste: bool = False) -> None:
        """Show a scene as perceived, with its robot.

        In ``haste`` known objects are only moved: their looks, and the row that they hang from, are
        not drawn again.
        """
        if self.scene is None:
            self.api.configure_default_lights(cast_shadow=self.shadows)
            self.api.add_frame(self.root, show_axes=False, wxyz=scene.base.orientation,
                               position=scene.base.position + self.offset)  # fmt: skip
        if self.robot is not robot:
            self._mount(robot)
        for gone in self._items.keys() - {item.id for item in scene.objects}:
            del self._items[gone]
            self._stands.pop(gone, None)
            for name in [n for n, (part, _) in self._meshes.items() if part.owner == gone]:
                self._meshes.pop(name)[1].remove()
        for item in scene.objects:
            old = self._items.get(item.id)
            if old is None or (old is not item and not haste):
                for part in object_parts(scene, item):
                    self._mesh(part)
                self._items[item.id] = item
                self._stands.pop(item.id, None)
            if self._stands.get(item.id) is not item:
                stem = None if item.stem is None else item.stem.points
                self.put(item, item.position, item.rotation, stem)
                self._stands[item.id] = item
        if not haste:
            wanted = {f"row {part.name}": part for part in scenery(scene)}
            for name in [n for n in self._meshes if n.startswith("row ") and n not in wanted]:
                self._meshes.pop(name)[1].remove()
            for name, part in wanted.items():
                self._mesh(replace(part, name=name))
        self.scene, self.robot = scene, robot

    def _mount(self, robot: Robot) -> None:
        self.api.remove_by_name(f"{self.root}/arm")
        self.api.add_frame(f"{self.root}/arm", show_axes=False)
        self._segments = [
            self.api.add_frame(f"{self.root}/arm/{s}", show_axes=False)
            for s in range(robot.n_segments)
        ]
        for part in arm_parts(robot):
            where = f"{self.root}/arm" + ("" if part.segment < 0 else f"/{part.segment}")
            self._added(where, part)

    def _mesh(self, part: Part) -> Any:
        """The node of a part of the scene, sent again where its looks differ."""
        old, node = self._meshes.get(part.name, (None, None))
        if (
            old is None
            or (old.colour, old.opacity) != (part.colour, part.opacity)
            or not np.array_equal(old.vertices, part.vertices)
        ):
            node = self._added(f"{self.root}/things", part)
            if part.owner and self.on_click is not None:
                told = self.on_click
                node.on_click(lambda _: told(part.owner))
            self._meshes[part.name] = part, node
        return node

    def _added(self, where: str, part: Part) -> Any:
        return self.api.add_mesh_simple(
            f"{where}/{part.name.replace('/', '_')}", part.vertices, part.faces, color=part.colour,
            opacity=part.opacity if part.opacity < 1.0 else None, side="double",
            **({} if self.shadows else FLAT),
        )  # fmt: skip

    def pose(self, q: FloatArray) -> None:
        """Move the arm to ``q`` (n,)."""
        assert self.robot is not None
        origins, rotations = self.robot.segment_frames(q)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        for node, origin, turn in zip(self._segments, origins, turns, strict=True):
            node.position, node.wxyz = origin, turn

    def put(
        self, item: SceneObject, position: FloatArray, rotation: FloatArray, stem: FloatArray | None
    ) -> None:
        """Move an object to ``position`` (3,) and ``rotation`` (3, 3), its stem along (k, 3)."""
        self._stands.pop(item.id, None)
        turn = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        for part, node in list(self._meshes.values()):
            if part.owner == item.id and not part.name.startswith("stem:"):
                node.position, node.wxyz = position, turn
        if item.stem is not None and stem is not None:
            corners, faces = tube(np.asarray(stem), np.full(len(stem), item.stem.radius), 8)
            self._mesh(Part(f"stem:{item.id}", -1, corners, faces, rgb(STEM), owner=item.id))

    def line(self, name: str, points: FloatArray, colour: str, width: float, **options: Any) -> Any:
        """A line through points (k, 3), ``width`` pixels wide."""
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        return self.api.add_line_segments(
            f"{self.root}/{name}", pieces, rgb(colour), thickness=width, thickness_units="screen",
            **options,
        )  # fmt: skip


def tube(points: FloatArray, radius: FloatArray, around: int = 14) -> tuple[FloatArray, IntArray]:
    """Corners (V, 3) and triangles (F, 3) of a tube of radii (T,) along points (T, 3)."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(lengths(tangent), 1e-12)[:, None]
    side = np.empty_like(points)
    last = np.eye(3)[int(np.abs(tangent[0]).argmin())]
    for k, t in enumerate(tangent):  # each section's first direction is the last one's, levelled
        last = last - (last @ t) * t
        last /= max(float(np.linalg.norm(last)), 1e-12)
        side[k] = last
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[None, :, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * np.cross(tangent, side)[:, None]
    corners = points[:, None] + np.maximum(radius, 1e-5)[:, None, None] * ring
    a = np.arange((len(points) - 1) * around).reshape(-1, around)
    b = np.roll(a, -1, axis=1)
    faces = np.stack([a, b, b + around, a, b + around, a + around], axis=-1)
    return corners.reshape(-1, 3), faces.reshape(-1, 3)
