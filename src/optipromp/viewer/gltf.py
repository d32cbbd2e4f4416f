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
from optipromp.geometry.faces import tube
from optipromp.looks import Part, arm_parts, object_parts, scenery
from optipromp.looks.part import Colour, hex_colour
from optipromp.looks.scene import stem_part
from optipromp.robots.model import Robot
from optipromp.scenes.scene import Pose, Scene, SceneObject
from optipromp.trajectory import Trajectory
from optipromp.viewer.drawn import OPTIMISED

_PATH_RADIUS = 0.001  # [m] a line of no width is hardly seen
_ROUGH = 0.55  # of every surface; a choice
_RATE = 50.0  # [Hz] of the animation's frames, at least
_UPRIGHT = Pose(np.zeros(3), np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]))  # z up to y up
_FLOAT, _INDEX = 5126, 5125  # glTF's codes of numbers
_CORNERS = 34962  # glTF's code of corners; the next is that of indices to them


def glb(
    scene: Scene, robot: Robot, start: FloatArray, trajectory: Trajectory | None = None
) -> bytes:
    """The file's content.

    Nodes: ``scene``, in it ``base`` (the frame of the robot's base), in it one node an object
    (``target:ripe``, in it ``calyx:ripe``), a stem (``stem:ripe``), a part of the scenery
    (``gutter``, ``floor``) and the arm: ``robot``, and nested in it one node a moving segment with
    the name of its joint, the last of which holds ``tool``. With a trajectory, the arm is animated
    (``plan``) and the tool point's path is drawn (``tool path``).

    Args:
        scene: robot and objects.
        robot: the scene's, with its tool.
        start: (n,) configuration shown at rest; with a trajectory, its first waypoint is.
        trajectory: of the arm.
    """
    file = _File()
    objects = [node for item in scene.objects for node in _object(file, scene, item)]
    objects += [file.solid(part.name, [part]) for part in scenery(scene)]
    times, q = None, np.atleast_2d(start)
    if trajectory is not None:
        count = int(np.ceil(_RATE * trajectory.duration)) + 1
        times = np.linspace(0.0, trajectory.duration, max(count, 2))
        q = trajectory.sample(times)[0]
    arm = _arm(file, robot, q, times)
    children = [arm, *objects]
    if trajectory is not None:
        path = Part.of("tool path", tube(robot.tool_pose(q)[0], _PATH_RADIUS, 6), OPTIMISED)
        children.append(file.solid(path.name, [path]))
    if scene.camera is not None:
        children.append(file.node("camera", scene.camera))
    base = file.node("base", scene.base, children=children)
    return file.content(file.node("scene", _UPRIGHT, children=[base]), scene.name)


def _object(file: "_File", scene: Scene, item: SceneObject) -> list[int]:
    body, *further = object_parts(scene, item)
    inner = [file.solid(part.name, [part]) for part in further]
    nodes = [file.solid(body.name, [body], Pose(item.position, item.orientation), children=inner)]
    if item.stem is not None:
        nodes.append(file.solid(f"stem:{item.id}", [stem_part(item)]))
    return nodes


def _arm(file: "_File", robot: Robot, q: FloatArray, times: FloatArray | None) -> int:
    """The node of the arm at the first of ``q`` (T, n), animated where ``times`` (T,) are given."""
    origins, rotations = robot.segment_frames(q)
    before = np.concatenate([np.tile(np.eye(3), (len(q), 1, 1, 1)), rotations[:, :-1]], axis=1)
    shift = np.diff(origins, axis=1, prepend=np.zeros((len(q), 1, 3)))
    places = np.einsum("tsji,tsj->tsi", before, shift)
    turns = np.einsum("tsji,tsjk->tsik", before, rotations)
    parts = arm_parts(robot)
    tool = [part for part in parts if part.name.startswith("tool")]
    inner = [file.solid("tool", tool)] if tool else []
    for s in reversed(range(robot.n_segments)):
        quaternions = _continuous(Rotation.from_matrix(turns[:, s]).as_quat())
        pose = Pose(places[0, s], np.roll(quaternions[0], 1))
        body = [part for part in parts if part.segment == s and part not in tool]
        node = file.solid(_segment_name(robot, s), body, pose, children=inner)
        if times is not None:
            slides = robot.kinematics.kind[s] == 1
            values = places[:, s] if slides else quaternions
            file.animate(node, "translation" if slides else "rotation", times, values)
        inner = [node]
    return file.solid("robot", [part for part in parts if part.segment < 0], children=inner)


def _segment_name(robot: Robot, s: int) -> str:
    joint = int(robot.kinematics.dof[s])
    first = int(np.flatnonzero(robot.kinematics.dof == joint)[0])
    return robot.joint_names[joint] + ("" if s == first else f":{s}")


def _continuous(quaternions: FloatArray) -> FloatArray:
    """The same rotations (T, 4), neighbours on the same side."""
    same = np.einsum("ti,ti->t", quaternions[1:], quaternions[:-1]) >= 0.0
    signs = np.cumprod(np.append(1.0, np.where(same, 1.0, -1.0)))
    return np.asarray(quaternions * signs[:, None])


def _linear(colour: Colour, opacity: float) -> list[float]:
    """A colour as glTF wants it: linear, with opacity."""
    srgb = np.array(colour) / 255.0
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
        self._materials: dict[tuple[Colour, float], int] = {}

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
        self, name: str, parts: Sequence[Part], pose: Pose | None = None, *,
        children: Sequence[int] = (),
    ) -> int:  # fmt: skip
        """A node with a mesh of parts in its frame; without parts to be seen, a bare node."""
        node = self.node(name, pose, children=children)
        parts = [part for part in parts if len(part.faces)]
        if parts:
            primitives = [
                {
                    "attributes": {
                        "POSITION": self._numbers(part.vertices, "VEC3", _CORNERS),
                        "NORMAL": self._numbers(part.normals, "VEC3", _CORNERS),
                    },
                    "indices": self._numbers(
                        part.faces.reshape(-1).astype(np.uint32), "SCALAR", _CORNERS + 1
                    ),
                    "material": self._material(part.colour, part.opacity),
                }
                for part in parts
            ]
            mesh = self._add("meshes", {"name": name, "primitives": primitives})
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

    def _material(self, colour: Colour, opacity: float) -> int:
        if (colour, opacity) not in self._materials:
            surface = {
                "baseColorFactor": _linear(colour, opacity),
                "metallicFactor": 0.0,
                "roughnessFactor": _ROUGH,
            }
            entry = {
                "name": hex_colour(colour),
                "pbrMetallicRoughness": surface,
                "doubleSided": True,
            }
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
