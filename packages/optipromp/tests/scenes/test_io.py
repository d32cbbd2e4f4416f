"""Scene files: what they may say, what comes back, and what is refused."""

import copy
import json
import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.scenes.documents import FRUIT, MINIMAL, with_fruit

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Sphere,
)
from optipromp.core.scenes import (
    Approach,
    Scene,
    SceneObject,
    Stem,
    load_scene,
    save_scene,
    scene_from_dict,
    scene_names,
    scene_to_dict,
)
from optipromp.core.scenes.scene import obstacles_of


def full():
    shapes = [
        {"box": {"size": [1.0, 0.06, 0.16]}},
        {"cylinder": {"radius": 0.1, "length": 0.3}},
        {"capsule": {"radius": 0.1, "length": 0.3}},
        {"half_space": {}},
        {"mesh": {"file": "parts/rock.obj", "scale": 0.5}},
        {"point_cloud": {"file": "leaves.csv", "radius": 0.01}},
    ]
    return MINIMAL | {
        "robot": "robots/mine.urdf",
        "tool": {"kind": "cup", "radius": 0.05},
        "start": [0, 0.1, -1.5],
        "target": "ripe",
        "approach": {"direction": [1, 0, 0], "lateral": [0.1, 1, 0], "camera_distance": 0.2},
        "options": {"camera_point": True, "drift_offset": {"n1": 0.01}},
        "objects": [
            FRUIT | {"stem": {"root": [0.45, 0.0, 1.02], "radius": 0.002}, "sigma": 0.004},
            {
                "id": "n1",
                "role": "pushable",
                "shape": {"sphere": {"radius": 0.015}},
                "position": [0.4, 0, 0.8],
                "stem": {"points": [[0.4, 0, 0.815], [0.4, 0.01, 0.9], [0.4, 0, 1]]},
                "covariance": [[1e-4, 0, 0], [0, 2e-4, 1e-5], [0, 1e-5, 1e-4]],
                "physical": {"mass": 0.02},
            },
            *(
                {
                    "id": f"s{i}",
                    "role": "static" if i % 2 else "avoid",
                    "shape": shape,
                    "position": [1, 0.1 * i, 0],
                    "orientation": [0.8, 0, 0.6, 0],
                }
                for i, shape in enumerate(shapes)
            ),
        ],
        "unseen": {"id": "u", "role": "static", "shape": shapes[-1], "position": [0, 0, 1]},
    }


def write(path, document):
    dump = json.dumps if path.suffix == ".json" else yaml.safe_dump
    path.write_text(dump(document))
    return path


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_everything_loads(files, suffix):
    pytest.importorskip("trimesh")
    scene = load_scene(write(files / f"full.{suffix}", full()))
    assert scene.base_dir == files
    assert [type(item.shape) for item in scene.objects] == [
        Sphere, Sphere, Box, Cylinder, Capsule, HalfSpace, MeshShape, PointCloudShape,
    ]  # fmt: skip
    assert scene.tool.parameters == {"radius": 0.05}
    assert scene.options == {"camera_point": True, "drift_offset": {"n1": 0.01}}
    np.testing.assert_allclose(scene.frame[2], [1, 0, 0])
    np.testing.assert_allclose(scene.frame[1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(scene.frame @ scene.frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(scene.frame) == pytest.approx(1.0)
    np.testing.assert_allclose(scene.target.covariance, 0.004**2 * np.eye(3))
    np.testing.assert_allclose(scene.pushables[0].stem.vector, [0, 0.01, 0.085])
    assert scene.pushables[0].physical == {"mass": 0.02}
    assert scene.objects[6].shape.vertices.max() == pytest.approx(0.05)
    assert len(obstacles_of(scene).kind) == 8  # what is unseen is none
    assert isinstance(scene.unseen.shape, PointCloudShape)
    assert len(obstacles_of(scene, "static", "avoid").kind) == 6
    assert len(obstacles_of(scene, "pushable").kind) == 1


@pytest.mark.parametrize("name", ["copy.yaml", "elsewhere/copy.json"])
def test_round_trip(files, name, monkeypatch):
    monkeypatch.chdir(files)  # which holds both folders
    pytest.importorskip("trimesh")
    scene = load_scene(write(files / "full.yaml", full()))
    path = files / name
    save_scene(scene, path)
    again = load_scene(path)
    assert_same(scene_to_dict(again), scene_to_dict(scene))
    assert (again.base_dir / again.robot).resolve() == files / "robots/mine.urdf"
    assert str(files) not in path.read_text()


def assert_same(a, b):
    if isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, list):
        np.testing.assert_allclose(a, b, atol=1e-15) if not isinstance(a[0], dict) else [
            assert_same(x, y) for x, y in zip(a, b, strict=True)
        ]
    else:
        assert a == b


def test_a_drift_offset_is_a_length():
    """It is in the file's unit, one for all pushables or one by id; nothing negative."""
    for stated, told in ((10, 0.01), ({"ripe": 10.0, "n2": 2}, {"ripe": 0.01, "n2": 0.002})):
        scene = scene_from_dict(MINIMAL | {"scale": 1e-3, "options": {"drift_offset": stated}})
        assert scene.options["drift_offset"] == pytest.approx(told)
    for wrong in (-1.0, {"n1": -1.0}, {"n1": "far"}, [0.01]):
        with pytest.raises(InvalidSceneError, match="drift_offset"):
            scene_from_dict(MINIMAL | {"options": {"drift_offset": wrong}})


@pytest.mark.parametrize("name", scene_names())
def test_built_in_scenes_round_trip_exactly(tmp_path, name):
    scene = load_scene(name)
    save_scene(scene, tmp_path / "s.yaml")
    assert scene_to_dict(load_scene(tmp_path / "s.yaml")) == scene_to_dict(scene)
    assert pickle.loads(pickle.dumps(scene)).target.id == "ripe"


def test_saving_is_whole_or_not_at_all(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidRequestError, match="cannot write"):
        save_scene(load_scene("scenario-3"), tmp_path / "file" / "scene.yaml")
    save_scene(load_scene("scenario-3"), tmp_path / "s.yaml")
    assert sorted(os.listdir(tmp_path)) == ["file", "s.yaml"]  # noqa: PTH208


def test_a_mesh_from_memory_cannot_be_saved(tmp_path):
    shape = PointCloudShape([[0, 0, 0]], 0.1)
    objects = (
        SceneObject("a", "static", shape, np.zeros(3)),
        SceneObject("b", "target", Sphere(0.1), np.ones(3)),
    )
    with pytest.raises(InvalidSceneError, match="no file"):
        save_scene(Scene("s", "panda", objects), tmp_path / "s.yaml")
    assert not list(tmp_path.iterdir())


def test_defaults_and_immutability():
    scene = scene_from_dict(MINIMAL)
    assert (scene.tool, scene.start, scene.goal, scene.base_dir) == (None, None, None, None)
    assert scene.pushables == scene.avoid == scene.static == ()
    assert obstacles_of(scene, "static").kind.shape == (0,)
    with pytest.raises(ValueError, match="read-only"):
        scene.target.position[0] = 1.0


def test_input_is_left_alone():
    document = full()
    document["objects"] = document["objects"][:5]
    document["unseen"] = None
    before = copy.deepcopy(document)
    scene_from_dict(document)
    assert document == before


def test_scale_reaches_every_length():
    metres = full()
    metres["objects"] = metres["objects"][:6]
    del metres["unseen"]

    def thousandfold(value, key=""):
        if key in ("orientation", "direction", "lateral", "start", "physical", "format"):
            return value
        if isinstance(value, dict):
            return {k: thousandfold(v, k) for k, v in value.items()}
        if isinstance(value, list):
            return [thousandfold(v, key) for v in value]
        if isinstance(value, str | bool):
            return value
        return value * (1e6 if key == "covariance" else 1e3)

    scaled = scene_from_dict(thousandfold(metres) | {"scale": 0.001})
    assert_same(scene_to_dict(scaled), scene_to_dict(scene_from_dict(metres)))
    assert scaled.pushables[0].stem.radius == 0.003  # a default is in metres


def test_a_quaternion_nearly_of_length_one_is_normalised():
    near = with_fruit(orientation=[1.0005, 0, 0, 0])
    np.testing.assert_array_equal(scene_from_dict(near).target.rotation, np.eye(3))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_yaml_reads_as_one_would_think(tmp_path, encoding):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "name: no\nrobot: panda\nstart: [1e-3, .5, 010, +2, 1.5E2, -0]\n"
        "objects:\n"
        "  - &fruit {id: on, role: target, shape: &s {sphere: {radius: 15e-3}},\n"
        "            position: [0, 1, 0]}\n"
        "  - {id: 'Kirsche ü', role: avoid, shape: *s, position: [0, 1, 1]}\n"
        "  - {<<: *fruit, id: 1:30, role: pushable, position: [0, 2, 0]}\n",
        encoding=encoding,
    )
    scene = load_scene(path)
    assert scene.name == "no"
    np.testing.assert_array_equal(scene.start, [0.001, 0.5, 10, 2, 150, 0])
    assert [item.id for item in scene.objects] == ["on", "Kirsche ü", "1:30"]
    assert scene.target.radius == 0.015


def test_objects_in_python_are_checked_alike():
    with pytest.raises(InvalidSceneError, match="valid are target"):
        SceneObject("a", "fruit", Sphere(0.1), np.zeros(3))
    with pytest.raises(InvalidSceneError, match="parallel"):
        Approach(np.array([0, 1, 0]), np.array([0, -2, 0]))
    with pytest.raises(InvalidSceneError, match=r"stem\.radius"):
        Stem([[0, 0, 0], [0, 0, 1]], 0.0)
    with pytest.raises(InvalidSceneError, match="valid are target"):
        obstacles_of(scene_from_dict(MINIMAL), "statics")
    bent = Stem([[0, 0, 0], [0, 0, 1], [0, 1, 1]])
    assert bent.length == 2.0
    np.testing.assert_array_equal(bent.root, [0, 1, 1])


def test_what_is_chosen_of_a_robots_file(tmp_path, monkeypatch):
    """Paths follow the scene to another folder; wrong keys are refused by name."""
    monkeypatch.chdir(tmp_path)
    robot = {
        "file": "arms/a.urdf", "tip": "left_tool0", "base": "torso", "srdf": "arms/a.srdf",
        "hold": {"finger": 0.02}, "package_dirs": ["ws"],
    }  # fmt: skip
    scene = load_scene(write(tmp_path / "scene.json", MINIMAL | {"robot": robot}))
    assert (scene.robot, scene.choice.tip, scene.choice.base) == (
        "arms/a.urdf", "left_tool0", "torso",
    )  # fmt: skip
    (tmp_path / "far").mkdir()
    save_scene(scene, tmp_path / "far/scene.yaml")
    moved = scene_to_dict(load_scene(tmp_path / "far/scene.yaml"), base_dir=tmp_path)
    assert moved["robot"] == robot
    with pytest.raises(InvalidSceneError, match=r"robot: unknown key 'tipp'.*tip"):
        scene_from_dict(MINIMAL | {"robot": robot | {"tipp": "x"}})
    with pytest.raises(InvalidSceneError, match=r"robot\.tip is 3: must be text"):
        scene_from_dict(MINIMAL | {"robot": robot | {"tip": 3}})
    with pytest.raises(InvalidSceneError, match=r"robot\.file is missing"):
        scene_from_dict(MINIMAL | {"robot": {"tip": "x"}})


def test_lengths_in_millimetres_are_not_written(tmp_path: Path) -> None:
    """Our writer stated that they were metres, and so disarmed the check of whoever reads them."""
    scene = scene_from_dict(with_fruit())
    far = [replace(scene.objects[0], position=1e3 * scene.objects[0].position)]
    with pytest.raises(InvalidSceneError, match=r"m from the robot .*millimetres"):
        save_scene(replace(scene, objects=(*far, *scene.objects[1:])), tmp_path / "s.yaml")
    assert not (tmp_path / "s.yaml").exists()


def test_a_fruit_that_was_detected_twice_is_told() -> None:
    fruits = [FRUIT, FRUIT | {"id": "again", "role": "pushable"}]
    with pytest.warns(UserWarning, match="'again' are 0 mm apart: one fruit that was detected"):
        scene_from_dict(MINIMAL | {"objects": fruits})
