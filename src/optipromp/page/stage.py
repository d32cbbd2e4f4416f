"""The 3-D part of the page: nodes of one robot, its scene and a plan, in one browser window."""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.arrays import FloatArray
from optipromp.looks import Part, arm_parts, object_parts, scenery
from optipromp.looks.part import rgb
from optipromp.looks.scene import STEM
from optipromp.page.content import FAR, NEAR, Bundle, Clearances, between, tube
from optipromp.planning import Plan
from optipromp.robots.model import Robot
from optipromp.scenes.scene import Scene, SceneObject
from optipromp.viewer.drawn import PRIMITIVE, Placed, motions

_WIDTH = {"conditioned ProMP": 4.0, "followed path": 3.0, "optimised": 5.0}  # [pixel]
_CANDIDATE_ROWS = 24  # points of a candidate's line
_STEP = 60  # points of a motion's line
_BALL = 10  # corners around a body sphere
_ARROW = {"shaft_radius": 0.0025, "head_radius": 0.006, "head_length": 0.014}  # [m]
_FORCE = 0.02  # [m/N] length of a force's arrow
_FLAT = {"cast_shadow": False, "receive_shadow": False}  # 14 times as many pictures a second
_SIDE, _PUSH = (32, 90, 167), (200, 50, 43)

LAYERS = (
    "initial bundle", "candidate paths", "trajectories", "passing sides", "pushed objects",
    "body spheres", "conditioned on",
)  # fmt: skip


class Stage:
    """Nodes under ``/root`` of a window's scene; nothing is shared between windows.

    Args:
        api: the scene of one client (``viser.ClientHandle.scene``).
        root: name of the first node.
        offset: (3,) of everything in the world [m].
    """

    def __init__(self, api: Any, root: str = "a", offset: Sequence[float] = (0.0, 0.0, 0.0)):
        self.api, self.root, self.offset = api, f"/{root}", np.asarray(offset)
        self.scene: Scene | None = None
        self.robot: Robot | None = None
        self.near: Clearances | None = None
        self._segments: list[Any] = []
        self._meshes: dict[str, tuple[Part, Any]] = {}
        self._items: dict[str, SceneObject] = {}  # whose looks are drawn
        self._stands: dict[str, SceneObject] = {}  # that stand where they are perceived
        self._shown: dict[str, Any] = {}
        self._hidden = {"body spheres"}
        self.on_click: Callable[[str], None] | None = None

    def clear(self) -> None:
        """Remove every node."""
        self.api.remove_by_name(self.root)
        self._segments, self._shown = [], {}
        self._meshes, self._items, self._stands = {}, {}, {}
        self.scene = self.robot = self.near = None

    # -- the arm and the objects ----------------------------------------------------------------

    def show(self, scene: Scene, robot: Robot, *, haste: bool = False) -> None:
        """Show a scene as perceived, with its robot; what has not changed is not sent again.

        In ``haste`` known objects are only moved: neither their looks nor the row that they hang
        from are drawn anew.
        """
        if self.scene is None:
            self.api.configure_default_lights(cast_shadow=False)
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
        if "body spheres" in self._shown:
            self._shown.pop("body spheres").remove()
        for part in arm_parts(robot):
            where = f"{self.root}/arm" + ("" if part.segment < 0 else f"/{part.segment}")
            self._added(where, part)

    def _mesh(self, part: Part) -> Any:
        """The node of a part of the scene, sent anew where it looks different."""
        old, node = self._meshes.get(part.name, (None, None))
        if old is None or not _alike(old, part):
            node = self._added(f"{self.root}/things", part)
            if part.owner and self.on_click is not None:
                told = self.on_click
                node.on_click(lambda _: told(part.owner))
            self._meshes[part.name] = part, node
        return node

    def _added(self, where: str, part: Part) -> Any:
        return self.api.add_mesh_simple(
            f"{where}/{part.name.replace('/', '_')}", part.vertices, part.faces, color=part.colour,
            opacity=part.opacity if part.opacity < 1.0 else None, side="double", **_FLAT,
        )  # fmt: skip

    def _stem(self, item: SceneObject, points: FloatArray) -> None:
        assert item.stem is not None
        radius = np.full(len(points), item.stem.radius)
        corners, faces = tube(np.asarray(points), radius, 8)
        self._mesh(Part(f"stem:{item.id}", -1, corners, faces, rgb(STEM), owner=item.id))

    def pose(self, q: FloatArray) -> None:
        """Move the arm to ``q`` (n,)."""
        assert self.robot is not None
        origins, rotations = self.robot.segment_frames(q)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        for node, origin, turn in zip(self._segments, origins, turns, strict=True):
            node.position, node.wxyz = origin, turn
        if "body spheres" not in self._hidden:
            self._balls().batched_positions = self.robot.sphere_centers(q).astype(np.float32)

    def place(self, items: Iterable[Placed]) -> None:
        """Put objects where they are at a moment."""
        for item in items:
            self.put(item.item, item.position, item.rotation, item.stem)

    def put(
        self, item: SceneObject, position: FloatArray, rotation: FloatArray,
        stem: FloatArray | None,
    ) -> None:  # fmt: skip
        """Put an object at a place (3,) with a rotation (3, 3) and its stem along (k, 3)."""
        self._stands.pop(item.id, None)
        turn = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        for part, node in list(self._meshes.values()):
            if part.owner == item.id and not part.name.startswith("stem:"):
                node.position, node.wxyz = position, turn
        if item.stem is not None and stem is not None:
            self._stem(item, stem)

    # -- what belongs to a plan -----------------------------------------------------------------

    def layer(self, name: str, shown: bool) -> None:
        """Show or hide a layer of :data:`LAYERS`."""
        (self._hidden.discard if shown else self._hidden.add)(name)
        if name == "body spheres" and self.robot is not None:
            self._balls().visible = shown
        for key, node in self._shown.items():
            if key.partition("|")[0] == name:
                node.visible = shown

    def visible(self, name: str) -> bool:
        """Whether a layer is shown."""
        return name not in self._hidden

    def _add(self, key: str, make: Callable[..., Any], *args: Any, **options: Any) -> None:
        visible = key.partition("|")[0] not in self._hidden
        self._shown[key] = make(
            f"{self.root}/{key.replace('|', '/')}", *args, visible=visible, **options
        )

    def drop(self, layer: str) -> None:
        """Remove what a layer holds."""
        for key in [key for key in self._shown if key.partition("|")[0] == layer]:
            self._shown.pop(key).remove()

    def trajectories(self, plan: Plan) -> None:
        """The tool's lines of the plan's trajectories."""
        found = {motion.name: motion for motion in motions(plan)}
        for name in _WIDTH.keys() - found.keys():
            if (old := self._shown.pop(f"trajectories|{name}", None)) is not None:
                old.remove()
        for name, motion in found.items():
            q = motion.trajectory.positions
            rows = np.unique(np.linspace(0, len(q) - 1, _STEP).round().astype(int))
            self._line(f"trajectories|{name}", plan.robot.tool_pose(q[rows])[0],
                       rgb(motion.colour), _WIDTH[name])  # fmt: skip

    def _line(self, key: str, points: FloatArray, colour: Any, width: float) -> None:
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        self._add(key, self.api.add_line_segments, pieces, colour, thickness=width,
                  thickness_units="screen")  # fmt: skip

    def bundle(self, found: Bundle | None, layer: str = "initial bundle") -> None:
        """A primitive's tube of two standard deviations, and samples of it."""
        self.drop(layer)
        if found is None:
            return
        corners, faces = tube(found.mean, found.radius)
        self._add(f"{layer}|tube", self.api.add_mesh_simple, corners, faces, color=rgb(PRIMITIVE),
                  opacity=0.18, side="double", **_FLAT)  # fmt: skip
        samples = np.stack([found.samples[:, :-1], found.samples[:, 1:]], axis=2)
        self._add(f"{layer}|samples", self.api.add_line_segments,
                  samples.reshape(-1, 2, 3).astype(np.float32), rgb(PRIMITIVE), thickness=1.0,
                  thickness_units="screen")  # fmt: skip

    def candidates(self, found: Sequence[tuple[FloatArray, float]], threshold: float) -> None:
        """Candidate tool paths, red where the predicted harm is above the threshold."""
        self.drop("candidate paths")
        if not found:
            return
        lines, colours = [], []
        for points, harm in found:
            rows = np.linspace(0, len(points) - 1, _CANDIDATE_ROWS).round().astype(int)
            lines.append(np.stack([points[rows[:-1]], points[rows[1:]]], axis=1))
            colour = between(np.array(harm), threshold, 0.0)
            colours.append(np.broadcast_to(colour, (len(lines[-1]), 2, 3)))
        self._add("candidate paths|all", self.api.add_line_segments,
                  np.concatenate(lines).astype(np.float32), np.concatenate(colours),
                  thickness=2.0, thickness_units="screen")  # fmt: skip

    def sides(self, found: Sequence[tuple[str, FloatArray, FloatArray]]) -> None:
        """Arrows from each pushable to where the tool passes."""
        self.drop("passing sides")
        if found:
            points = np.array([[begin, end] for _, begin, end in found], dtype=np.float32)
            self._add("passing sides|all", self.api.add_arrows, points, _SIDE, **_ARROW)

    def via(self, points: Sequence[tuple[str, FloatArray, str]]) -> None:
        """The points of the tool that a primitive was conditioned on."""
        self.drop("conditioned on")
        for name, point, colour in points:
            self._add(f"conditioned on|{name}", self.api.add_icosphere, radius=0.006,
                      color=rgb(colour), position=point)  # fmt: skip

    def ghosts(self, items: Iterable[Placed]) -> None:
        """Small balls where pushed objects are predicted to be at the end."""
        self.drop("pushed objects")
        for item in items:
            if item.shift > 1e-3:
                self._add(f"pushed objects|{item.item.id}", self.api.add_label, item.label,
                          position=item.position, font_screen_scale=0.8)  # fmt: skip

    def colour(self, row: int) -> None:
        """Colour the body spheres by their clearance in row ``row`` of :attr:`near`."""
        if self.near is not None and "body spheres" not in self._hidden:
            self._balls().batched_colors = between(self.near.nearest[row], NEAR, FAR)

    def _balls(self) -> Any:
        assert self.robot is not None
        if "body spheres" not in self._shown:
            import trimesh

            ball = trimesh.creation.uv_sphere(count=[_BALL, _BALL])
            radius = np.asarray(self.robot.spheres.radius)
            self._add("body spheres", self.api.add_batched_meshes_simple, ball.vertices,
                      ball.faces, np.tile([1.0, 0.0, 0.0, 0.0], (len(radius), 1)),
                      self.robot.sphere_centers(self.robot.home), batched_scales=radius,
                      batched_colors=np.full((len(radius), 3), 170, np.uint8), opacity=0.45,
                      lod="off", **_FLAT)  # fmt: skip
        return self._shown["body spheres"]

    def forces(self, points: FloatArray, forces: FloatArray) -> None:
        """Contact forces (k, 3) [N] as arrows that end at points (k, 3) [m]."""
        self.drop("forces")
        if len(points):
            arrows = np.stack([points - _FORCE * forces, points], axis=1).astype(np.float32)
            self._add("forces|all", self.api.add_arrows, arrows, _PUSH, **_ARROW)

    def say(self, text: str, at: FloatArray | None) -> None:
        """A label at a point (3,) [m] of the scene; empty: none."""
        self.drop("message")
        if text and at is not None:
            self._add("message|text", self.api.add_label, _wrapped(text), position=at,
                      anchor="bottom-right")  # fmt: skip


def _alike(one: Part, other: Part) -> bool:
    looks = (one.colour, one.opacity) == (other.colour, other.opacity)
    return looks and np.array_equal(one.vertices, other.vertices)


def _wrapped(text: str) -> str:
    return "\n".join(textwrap.wrap(text, 36)[:7])
