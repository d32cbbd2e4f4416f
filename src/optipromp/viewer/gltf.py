"""A scene and its robot as a binary glTF 2.0 file (.glb), along a trajectory as an animation.

Written by hand: a GLB is a JSON document and one block of numbers. Units are metres; the root node
turns the world's z axis to glTF's y axis.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optipromp.arrays import FloatArray
from optipromp.looks.faces import shape_faces, sphere, tube
from optipromp.robots.model import Robot
from optipromp.robots.tools import TOOL_LINK
from optipromp.scenes.scene import Pose, Scene, SceneObject
from optipromp.trajectory import Trajectory
from optipromp.viewer.drawn import COLOURS, OPTIMISED, PUSHABLES

__all__ = ["glb"]

_BASE, _LINK, _TOOL, _STEM = "#8c9199", "#d9dbde", "#2f6f8f", "#4c8030"
_OPACITY = {"avoid": 0.35}
_AROUND = 16  # corners around a body sphere
_PATH_RADIUS = 0.001  # [m] a line of no width is hardly seen
_RATE = 50.0  # [Hz] of the animation's frames, at least
_UPRIGHT = Pose(np.zeros(3), np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]))  # z up to y up
_DIGITS = 7  # of metres: corners nearer than that are one
_FLOAT, _INDEX = 5126, 5125  # glTF's codes of numbers
_CORNERS = 34962  # glTF's code of corners; the next is that of indices to them


def glb(
    scene: Scene, robot: Robot, start: FloatArray, trajectory: Trajectory | None = None
) -> bytes:
    """The file's content.

    Nodes: ``scene``, in it ``base`` (the frame of the robot's base), in it one node an object
    (``target:ripe``), a stem (``stem:ripe``) and the arm: ``robot``, and nested in it one node a
    moving segment with the name of its joint, the last of which holds ``tool``. With a trajectory,
    the arm is animated (``plan``) and the tool point's path is drawn (``tool path``).

    Args:
        scene: robot and objects.
        robot: the scene's, with its tool.
        start: (n,) configuration shown at rest; with a trajectory, its first waypoint is.
        trajectory: of the arm.
    """
    file = _File()
    objects = [node for k in range(len(scene.objects)) for node in _object(file, scene, k)]
    times, q = None, np.atleast_2d(start)
    if trajectory is not None:
        count = int(np.ceil(_RATE * trajectory.duration)) + 1
        times = np.linspace(0.0, trajectory.duration, max(count, 2))
        q = trajectory.sample(times)[0]
    arm = _arm(file, robot, q, times)
    children = [arm, *objects]
    if trajectory is not None:
        path = tube(robot.tool_pose(q)[0], _PATH_RADIUS, 6)
        children.append(file.solid("tool path", path, OPTIMISED))
    if scene.camera is not None:
        children.append(file.node("camera", scene.camera))
    base = file.node("base", scene.base, children=children)
    return file.content(file.node("scene", _UPRIGHT, children=[base]), scene.name)


def _object(file: "_File", scene: Scene, index: int) -> list[int]:
    item = scene.objects[index]
    colour = COLOURS.get(item.role) or PUSHABLES[_turn(scene, item) % len(PUSHABLES)]
    faces = shape_faces(item.shape, np.zeros(3), np.eye(3))
    pose, opacity = Pose(item.position, item.orientation), _OPACITY.get(item.role, 1.0)
    nodes = [file.solid(f"{item.role}:{item.id}", faces, colour, pose, opacity=opacity)]
    if item.stem is not None:
        faces = tube(np.asarray(item.stem.points), item.stem.radius, 8)
        nodes.append(file.solid(f"stem:{item.id}", faces, _STEM))
    return nodes


def _turn(scene: Scene, item: SceneObject) -> int:
    return [other.id for other in scene.pushables].index(item.id)


def _arm(file: "_File", robot: Robot, q: FloatArray, times: FloatArray | None) -> int:
    """The node of the arm at the first of ``q`` (T, n), animated where ``times`` (T,) are given."""
    origins, rotations = robot.segment_frames(q)
    before = np.concatenate([np.tile(np.eye(3), (len(q), 1, 1, 1)), rotations[:, :-1]], axis=1)
    shift = np.diff(origins, axis=1, prepend=np.zeros((len(q), 1, 3)))
    places = np.einsum("tsji,tsj->tsi", before, shift)
    turns = np.einsum("tsji,tsjk->tsik", before, rotations)
    inner: list[int] = []
    for s in reversed(range(robot.n_segments)):
        quaternions = _continuous(Rotation.from_matrix(turns[:, s]).as_quat())
        pose = Pose(places[0, s], np.roll(quaternions[0], 1))
        if s == robot.n_segments - 1 and robot.tool is not None:
            inner = [_tool(file, robot)]
        cover = _spheres(robot, s)
        node = file.solid(_segment_name(robot, s), cover, _LINK, pose, children=inner)
        if times is not None:
            slides = robot.kinematics.kind[s] == 1
            values = places[:, s] if slides else quaternions
            file.animate(node, "translation" if slides else "rotation", times, values)
        inner = [node]
    return file.solid("robot", _spheres(robot, -1), _BASE, children=inner)


def _segment_name(robot: Robot, s: int) -> str:
    joint = int(robot.kinematics.dof[s])
    first = int(np.flatnonzero(robot.kinematics.dof == joint)[0])
    return robot.joint_names[joint] + ("" if s == first else f":{s}")


def _continuous(quaternions: FloatArray) -> FloatArray:
    """The same rotations (T, 4), neighbours on the same side."""
    same = np.einsum("ti,ti->t", quaternions[1:], quaternions[:-1]) >= 0.0
    signs = np.cumprod(np.append(1.0, np.where(same, 1.0, -1.0)))
    return np.asarray(quaternions * signs[:, None])


def _spheres(robot: Robot, segment: int) -> FloatArray:
    """Faces (F, 4, 3) of the body spheres of a segment, the tool's left out."""
    cover = robot.spheres
    tool = -1 if robot.tool is None else robot.link_names.index(TOOL_LINK)
    rows = np.flatnonzero((cover.segment == segment) & (cover.link != tool))
    parts = [sphere(cover.center[k], float(cover.radius[k]), _AROUND) for k in rows]
    return np.concatenate([np.zeros((0, 4, 3)), *parts])


def _tool(file: "_File", robot: Robot) -> int:
    assert robot.tool is not None
    solids = robot.tool.solids()
    faces = np.concatenate([shape_faces(s.shape, s.position, s.rotation) for s in solids])
    pose = Pose(robot.flange_translation, robot.flange_rotation)
    return file.solid("tool", faces, _TOOL, pose)


def _triangles(faces: FloatArray) -> tuple[FloatArray, NDArray[np.uint32]]:
    """Corners (V, 3) and triangles (M, 3) of quadrilaterals (F, 4, 3); those of no area go."""
    points, index = np.unique(
        np.round(faces.reshape(-1, 3), _DIGITS) + 0.0, axis=0, return_inverse=True
    )
    quads = index.reshape(-1, 4)
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    a, b, c = halves.T
    kept = halves[(a != b) & (b != c) & (c != a)]
    return points, kept.astype(np.uint32)


def _linear(colour: str, opacity: float) -> list[float]:
    """``#rrggbb`` as glTF wants it: linear, with opacity."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return [*linear.tolist(), opacity]


class _File:
    """A glTF document under construction, and its block of numbers."""

    def __init__(self) -> None:
        self._lists: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("nodes", "meshes", "materials", "accessors", "bufferViews")
        }
        self._channels: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._block = bytearray()
        self._materials: dict[tuple[str, float], int] = {}

    def _add(self, name: str, entry: dict[str, Any]) -> int:
        self._lists[name].append(entry)
        return len(self._lists[name]) - 1

    def node(self, name: str, pose: Pose | None = None, *, children: Sequence[int] = ()) -> int:
        entry: dict[str, Any] = {"name": name}
        if pose is not None:
            entry["translation"] = pose.position.tolist()
            entry["rotation"] = np.roll(pose.orientation, -1).tolist()
        if children:
            entry["children"] = list(children)
        return self._add("nodes", entry)

    def solid(
        self, name: str, faces: FloatArray, colour: str, pose: Pose | None = None, *,
        children: Sequence[int] = (), opacity: float = 1.0,
    ) -> int:  # fmt: skip
        """A node with a mesh of faces (F, 4, 3); without faces, a bare node."""
        node = self.node(name, pose, children=children)
        if len(faces):
            points, triangles = _triangles(faces)
            primitive = {
                "attributes": {"POSITION": self._numbers(points, "VEC3", _CORNERS)},
                "indices": self._numbers(triangles.reshape(-1), "SCALAR", _CORNERS + 1),
                "material": self._material(colour, opacity),
            }
            mesh = self._add("meshes", {"name": name, "primitives": [primitive]})
            self._lists["nodes"][node]["mesh"] = mesh
        return node

    def animate(self, node: int, path: str, times: FloatArray, values: FloatArray) -> None:
        """Move a node: ``rotation`` (T, 4) xyzw or ``translation`` (T, 3) at ``times`` (T,) [s]."""
        kind = "VEC4" if path == "rotation" else "VEC3"
        sampler = {
            "input": self._numbers(times, "SCALAR"), "output": self._numbers(values, kind),
            "interpolation": "LINEAR",
        }  # fmt: skip
        self._samplers.append(sampler)
        target = {"node": node, "path": path}
        self._channels.append({"sampler": len(self._samplers) - 1, "target": target})

    def _material(self, colour: str, opacity: float) -> int:
        if (colour, opacity) not in self._materials:
            surface = {"baseColorFactor": _linear(colour, opacity), "metallicFactor": 0.0}
            entry = {"name": colour, "pbrMetallicRoughness": surface, "doubleSided": True}
            entry |= {"alphaMode": "BLEND"} if opacity < 1.0 else {}
            self._materials[colour, opacity] = self._add("materials", entry)
        return self._materials[colour, opacity]

    def _numbers(self, values: NDArray[Any], kind: str, target: int | None = None) -> int:
        """An accessor of rows of float32, or of uint32; ``target``: what the graphics card uses."""
        whole = values.dtype.kind == "u"
        packed = np.ascontiguousarray(values, dtype="<u4" if whole else "<f4")
        view = {"buffer": 0, "byteOffset": len(self._block), "byteLength": packed.nbytes}
        view |= {} if target is None else {"target": target}
        self._block += packed.tobytes()
        rows = packed.reshape(len(packed), -1)
        return self._add(
            "accessors",
            {
                "bufferView": self._add("bufferViews", view),
                "componentType": _INDEX if whole else _FLOAT, "count": len(packed), "type": kind,
                "min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist(),
            },
        )  # fmt: skip

    def content(self, root: int, name: str) -> bytes:
        """The whole file: header, JSON padded with blanks, numbers (all of four bytes)."""
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "optipromp"},
            "scene": 0, "scenes": [{"name": name, "nodes": [root]}], **self._lists,
            "buffers": [{"byteLength": len(self._block)}],
        }  # fmt: skip
        if self._channels:
            document["animations"] = [
                {"name": "plan", "samplers": self._samplers, "channels": self._channels}
            ]
        text = json.dumps(document, allow_nan=False, separators=(",", ":")).encode("utf-8")
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(self._block)
        return (
            struct.pack("<4sII", b"glTF", 2, total)
            + struct.pack("<I4s", len(text), b"JSON") + text
            + struct.pack("<I4s", len(self._block), b"BIN\0") + bytes(self._block)
        )  # fmt: skip
