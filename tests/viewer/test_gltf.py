"""The exported glTF file, read back."""

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from optipromp.geometry import HalfSpace, Sphere
from optipromp.looks import arm_parts
from optipromp.planning import Plan, plan
from optipromp.planning.task import resolve
from optipromp.scenes import JointGoal, Pose, Scene, SceneObject, load_scene
from optipromp.viewer.gltf import glb

trimesh = pytest.importorskip("trimesh")

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from z up


@pytest.fixture(scope="module", params=["scenario-1", "scenario-4"])
def made(request: pytest.FixtureRequest) -> Plan:
    planner = "promp" if request.param == "scenario-1" else "opti-promp"
    return plan(request.param, planner=planner)


def read(content: bytes):
    return trimesh.load(io.BytesIO(content), file_type="glb")


def parts(content: bytes) -> tuple[dict, bytes]:
    magic, version, total = struct.unpack_from("<4sII", content)
    assert (magic, version, total) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    document = json.loads(content[20 : 20 + size])
    length, kind = struct.unpack_from("<I4s", content, 20 + size)
    assert kind == b"BIN\0"
    block = content[28 + size :]
    assert len(block) == length == document["buffers"][0]["byteLength"]
    return document, block


def numbers(document: dict, block: bytes, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
    flat = np.frombuffer(block, kind, accessor["count"] * width, view["byteOffset"])
    rows = flat.reshape(-1, width)
    np.testing.assert_array_equal(rows.min(axis=0), accessor["min"])
    np.testing.assert_array_equal(rows.max(axis=0), accessor["max"])
    return rows


def test_a_scene_has_its_objects_where_they_are() -> None:
    scene = load_scene("scenario-4")
    floor = SceneObject("floor", "static", HalfSpace(), np.array([0.0, 0.0, -0.3]))
    base = Pose(np.array([2.0, 1.0, 0.5]), np.array([0.6, 0.0, 0.0, 0.8]))
    scene = replace(scene, objects=(*scene.objects, floor), base=base, camera=Pose())
    task = resolve(scene)
    found = read(glb(scene, task.robot, task.start))
    nodes = set(found.graph.nodes)
    assert {"scene", "base", "robot", "tool", *task.robot.joint_names} <= nodes
    assert "tool path" not in nodes
    for item in scene.objects:
        name = f"{item.role}:{item.id}"
        placed, mesh = found.graph[name]
        np.testing.assert_allclose(placed[:3, 3], Y_UP @ (base @ item.position), atol=1e-6)
        np.testing.assert_allclose(placed[:3, :3], Y_UP @ base.rotation @ item.rotation, atol=1e-6)
        if item.id in ("ripe", "n1", "n2"):
            ball = found.geometry[mesh]
            assert ball.is_watertight
            np.testing.assert_allclose(
                ball.bounds, [[-item.radius] * 3, [item.radius] * 3], rtol=0.02
            )
            assert ball.volume == pytest.approx(4.0 / 3.0 * np.pi * item.radius**3, rel=0.05)
            placed, mesh = found.graph[f"stem:{item.id}"]
            root = Y_UP @ (base @ item.stem.root)
            corners = trimesh.transform_points(found.geometry[mesh].vertices, placed)
            away = np.linalg.norm(corners - root, axis=1).min()
            assert away == pytest.approx(item.stem.radius, abs=1e-4)
    placed, mesh = found.graph["static:floor"]
    corners = trimesh.transform_points(found.geometry[mesh].vertices, placed)
    np.testing.assert_allclose(corners[:, 1], 0.5 - 0.3, atol=1e-6)


def test_what_is_too_small_to_be_seen_is_a_bare_node() -> None:
    scene = load_scene("scenario-4")
    dust = SceneObject("dust", "static", Sphere(1e-9), np.array([0.4, 0.4, 0.4]))
    task = resolve(replace(scene, objects=(*scene.objects, dust)))
    document, _ = parts(glb(task.scene, task.robot, task.start))
    (node,) = (node for node in document["nodes"] if node["name"] == "static:dust")
    assert "mesh" not in node


def test_the_arm_has_its_looks_where_its_links_are() -> None:
    task = resolve(load_scene("scenario-4"))
    found = read(glb(task.scene, task.robot, task.start))
    origins, rotations = task.robot.segment_frames(task.start)
    for s, name in enumerate([*task.robot.joint_names, "tool"]):
        s = min(s, task.robot.n_segments - 1)
        parts = [
            part for part in arm_parts(task.robot)
            if part.segment == s and part.name.startswith("tool") == (name == "tool")
        ]  # fmt: skip
        corners = []
        for node in found.graph.nodes_geometry:
            placed, mesh = found.graph[node]
            if mesh == name or mesh.startswith(name + "_"):
                corners.append(trimesh.transform_points(found.geometry[mesh].vertices, placed))
        shown = np.concatenate(corners) @ Y_UP
        wanted = np.concatenate([part.vertices for part in parts]) @ rotations[s].T + origins[s]
        np.testing.assert_allclose(shown.min(axis=0), wanted.min(axis=0), atol=1e-5)
        np.testing.assert_allclose(shown.max(axis=0), wanted.max(axis=0), atol=1e-5)


def test_the_animation_takes_the_arm_along_the_trajectory(made: Plan) -> None:
    content = glb(made.scene, made.robot, made.trajectory.positions[0], made.trajectory)
    document, block = parts(content)
    (animation,) = document["animations"]
    tracks = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        name = document["nodes"][channel["target"]["node"]]["name"]
        times = numbers(document, block, sampler["input"])[:, 0]
        values = numbers(document, block, sampler["output"])
        tracks[name, channel["target"]["path"]] = values
        assert times[0] == 0.0
        assert times[-1] == pytest.approx(made.trajectory.duration, rel=1e-6)
        assert len(times) == len(values)
        assert sampler["interpolation"] == "LINEAR"
    assert {name for name, _ in tracks} == set(made.robot.joint_names)
    nodes = {node["name"]: node for node in document["nodes"]}
    for frame in (0, len(times) // 2, -1):
        q, _, _ = made.trajectory.sample(times[frame])
        origins, rotations = made.robot.segment_frames(q[0])
        place, turn = np.zeros(3), np.eye(3)
        for s, name in enumerate(made.robot.joint_names):
            node = nodes[name]
            shift = tracks.get((name, "translation"), [node["translation"]] * len(times))[frame]
            xyzw = tracks.get((name, "rotation"), [node["rotation"]] * len(times))[frame]
            place = place + turn @ shift
            turn = turn @ Rotation.from_quat(xyzw).as_matrix()
            np.testing.assert_allclose(place, origins[s], atol=1e-5)
            np.testing.assert_allclose(turn, rotations[s], atol=1e-5)
    for (_, path), values in tracks.items():
        if path == "rotation":  # neighbours are on the same side: nothing spins between them
            assert (np.einsum("ti,ti->t", values[1:], values[:-1]) > 0.9).all()


def test_the_tool_path_is_drawn(made: Plan) -> None:
    found = read(glb(made.scene, made.robot, made.trajectory.positions[0], made.trajectory))
    corners = found.geometry["tool path"].vertices
    points, _ = made.robot.tool_pose(made.trajectory.positions)
    for point in (points[0], points[-1], points[len(points) // 2]):
        assert np.linalg.norm(corners - point, axis=1).min() < 5e-3
    np.testing.assert_allclose(found.geometry["tool path"].bounds[0], points.min(axis=0), atol=3e-3)


def test_a_scene_may_have_no_objects() -> None:
    start = resolve(load_scene("scenario-4")).start
    task = resolve(Scene("bare", "panda", (), goal=JointGoal(start)))
    found = read(glb(task.scene, task.robot, start))
    assert {"scene", "base", "robot", "joint7"} <= set(found.graph.nodes)
    assert not [name for name in found.graph.nodes if ":" in name]
