"""Scene files: what they may say, what comes back, and what is refused."""

import copy
import json
import math
import os
import pickle

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.errors import Code, InvalidRequestError, InvalidSceneError
from optipromp.geometry import Box, Capsule, Cylinder, HalfSpace, MeshShape, PointCloudShape, Sphere
from optipromp.scenes import (
    Approach,
    JointGoal,
    PoseGoal,
    Scene,
    SceneObject,
    Stem,
    load_scene,
    save_scene,
    scene_from_dict,
    scene_to_dict,
)
from optipromp.scenes.rotations import from_quaternion, to_quaternion

FRUIT = {"id": "ripe", "role": "target", "shape": {"sphere": {"radius": 0.015}}}
FRUIT["position"] = [0.45, 0.0, 0.89]
MINIMAL = {"format": 1, "name": "s", "robot": "panda", "objects": [FRUIT]}
TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def with_object(**entries):
    document = copy.deepcopy(MINIMAL)
    document["objects"].append(
        {"id": "n1", "role": "pushable", "shape": {"sphere": {"radius": 0.015}}}
        | {"position": [0.4, 0.0, 0.8]}
        | entries
    )
    return document


def with_fruit(**entries):
    document = copy.deepcopy(MINIMAL)
    document["objects"][0].update(entries)
    return document


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
        "options": {"camera_point": True},
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
    }


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A folder with all the files that ``full`` refers to."""
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/rock.obj").write_text(TETRAHEDRON)
    (tmp_path / "leaves.csv").write_text("0,0,0\n0.1,0,0\n0,0.1,0.1\n")
    return tmp_path


def write(path, document):
    dump = json.dumps if path.suffix == ".json" else yaml.safe_dump
    path.write_text(dump(document))
    return path


def refusal(document, **more):
    with pytest.raises(InvalidSceneError) as caught:
        scene_from_dict(document, **more)
    assert caught.value.code is Code.INVALID_SCENE
    assert "\n" not in caught.value.message
    return caught.value.message


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_everything_loads(files, suffix):
    pytest.importorskip("trimesh")
    scene = load_scene(write(files / f"full.{suffix}", full()))
    assert scene.base_dir == files
    assert [type(item.shape) for item in scene.objects] == [
        Sphere, Sphere, Box, Cylinder, Capsule, HalfSpace, MeshShape, PointCloudShape,
    ]  # fmt: skip
    assert scene.tool.parameters == {"radius": 0.05}
    assert scene.options == {"camera_point": True}
    np.testing.assert_allclose(scene.frame[2], [1, 0, 0])
    np.testing.assert_allclose(scene.frame[1], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(scene.frame @ scene.frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(scene.frame) == pytest.approx(1.0)
    np.testing.assert_allclose(scene.target.covariance, 0.004**2 * np.eye(3))
    np.testing.assert_allclose(scene.pushables[0].stem.vector, [0, 0.01, 0.085])
    assert scene.pushables[0].physical == {"mass": 0.02}
    assert scene.objects[6].shape.vertices.max() == pytest.approx(0.05)
    assert len(scene.obstacles().kind) == 8
    assert len(scene.obstacles("static", "avoid").kind) == 6
    assert len(scene.obstacles("pushable").kind) == 1


@pytest.mark.parametrize("name", ["copy.yaml", "elsewhere/copy.json"])
def test_round_trip(files, name):
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


@pytest.mark.parametrize("name", ["scenario-1", "scenario-2", "scenario-3", "scenario-4"])
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
    assert scene.obstacles("static").kind.shape == (0,)
    with pytest.raises(ValueError, match="read-only"):
        scene.target.position[0] = 1.0


def test_input_is_left_alone():
    document = full()
    document["objects"] = document["objects"][:5]
    before = copy.deepcopy(document)
    scene_from_dict(document)
    assert document == before


def test_goals():
    document = MINIMAL | {"objects": []}
    joints = scene_from_dict(document | {"goal": {"joints": [1, 2, 3]}})
    assert isinstance(joints.goal, JointGoal)
    assert joints.target is None
    pose = scene_from_dict(document | {"goal": {"position": [0.4, 0, 0.8], "axis": [0, 0, 2]}})
    assert isinstance(pose.goal, PoseGoal)
    np.testing.assert_array_equal(pose.goal.axis, [0, 0, 1])
    implied = scene_from_dict(document | {"goal": {"position": [0.4, 0, 0.8]}})
    np.testing.assert_array_equal(implied.goal.axis, [0, 0, 1])
    for scene in (joints, pose):
        assert scene_to_dict(scene_from_dict(scene_to_dict(scene))) == scene_to_dict(scene)


def test_scale_reaches_every_length():
    metres = full()
    metres["objects"] = metres["objects"][:6]

    def thousandfold(value, key=""):
        if key in ("orientation", "direction", "lateral", "start", "physical", "format", "options"):
            return value
        if isinstance(value, dict):
            return {k: thousandfold(v, k) for k, v in value.items()}
        if isinstance(value, list):
            return [thousandfold(v, key) for v in value]
        if isinstance(value, str):
            return value
        return value * (1e6 if key == "covariance" else 1e3)

    scaled = scene_from_dict(thousandfold(metres) | {"scale": 0.001})
    assert_same(scene_to_dict(scaled), scene_to_dict(scene_from_dict(metres)))
    assert scaled.pushables[0].stem.radius == 0.003  # a default is in metres


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.1))
def test_quaternions(wxyz):
    unit = np.array(wxyz) / math.hypot(*wxyz)
    rotation = from_quaternion(unit)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert abs(to_quaternion(rotation) @ unit) == pytest.approx(1.0, abs=1e-12)


def test_a_quaternion_turns_as_it_should():
    half = math.sqrt(0.5)
    np.testing.assert_allclose(
        from_quaternion([half, 0, 0, half]) @ [1, 0, 0], [0, 1, 0], atol=1e-15
    )
    near = with_fruit(orientation=[1.0005, 0, 0, 0])
    np.testing.assert_array_equal(scene_from_dict(near).target.rotation, np.eye(3))


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("document", "words"),
    [
        # numbers
        (with_fruit(position=[0, NAN, 0]), "objects[0].position[1] is nan: must be finite"),
        (with_fruit(position=[0, 0, -INF]), "objects[0].position[2] is -inf"),
        (with_fruit(position=[0, 0]), "objects[0].position has 2 entries: must have at least 3"),
        (with_fruit(position=[0, "0.5", 0]), "objects[0].position[1] is '0.5': must be a number"),
        (with_fruit(position=[0, True, 0]), "objects[0].position[1] is True: must be a number"),
        (with_fruit(position=0.5), "objects[0].position is 0.5: must be a list"),
        (MINIMAL | {"start": [0, INF]}, "start[1] is inf"),
        (MINIMAL | {"objects": [], "goal": {"joints": [NAN]}}, "goal.joints[0] is nan"),
        (MINIMAL | {"objects": [], "goal": {"position": [0, 0, NAN]}}, "goal.position[2] is nan"),
        # shapes
        (with_fruit(shape={"sphere": {"radius": 0}}), "shape.sphere.radius is 0: must be above 0"),
        (with_fruit(shape={"sphere": {"radius": -1.0}}), "shape.sphere.radius is -1.0"),
        (with_fruit(shape={"box": {"size": [1, -1, 1]}}), "shape.box.size[1] is -1"),
        (with_fruit(shape={"cube": {}}), "unknown key 'cube': valid are sphere, box"),
        (with_fruit(shape={"spere": {}}), "did you mean 'sphere'?"),
        (with_fruit(shape="sphere"), "objects[0].shape: is 'sphere': must be a mapping"),
        (with_fruit(shape={}), "must have exactly one of sphere, box"),
        (
            with_fruit(shape={"sphere": {"radius": 1}, "box": {"size": [1, 1, 1]}}),
            "has sphere and box: must have exactly one",
        ),
        (with_fruit(shape={"sphere": None}), "sphere is empty"),
        (with_fruit(shape={"half_space": {}}), "cannot be a half_space"),
        (with_fruit(shape={"sphere": {}}), "objects[0].shape.sphere.radius is missing"),
        # orientation
        (with_fruit(orientation=[1.01, 0, 0, 0]), "has length 1.01: must be a unit quaternion"),
        (with_fruit(orientation=[0, 0, 0, 0]), "has length 0"),
        (with_fruit(orientation=[1, 0, 0]), "orientation has 3 entries"),
        # stems
        (with_fruit(stem={}), "objects[0].stem: must have exactly one of root, points"),
        (with_fruit(stem={"root": [0.45, 0.0, 0.89]}), "objects[0]: stem piece 0 has no length"),
        (with_fruit(stem={"points": [[0.45, 0, 1.2], [0.45, 0, 0.9]]}), "must start at its fruit"),
        (with_fruit(stem={"root": [0.45, NAN, 1]}), "stem.root[1] is nan"),
        # uncertainty
        (with_fruit(sigma=-0.1), "sigma is -0.1: must be at least 0"),
        (with_fruit(sigma=0.1, covariance=np.eye(3).tolist()), "has covariance and sigma"),
        (with_fruit(covariance=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), "positive semi-definite"),
        (with_fruit(covariance=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]), "not symmetric"),
        (with_fruit(physical={"mass": NAN}), "physical.mass is nan"),
        # roles, ids, targets
        (with_object(role="pushabel"), "objects[1].role is 'pushabel': valid are target, pushable"),
        (with_object(role="pushabel"), "did you mean 'pushable'?"),
        (with_object(id="ripe"), "objects[1].id 'ripe' is taken by objects[0]"),
        (with_object(id=3), "objects[1].id is 3: must be text: put it in quotes"),
        (with_object(id=""), "objects[1].id is '': must not be empty"),
        (with_object(role="target"), "two targets, 'ripe' and 'n1'"),
        (with_fruit(role="avoid"), "no target"),
        (MINIMAL | {"objects": []}, "no target"),
        (MINIMAL | {"goal": {"joints": [0.0]}}, "target 'ripe' and a goal"),
        (with_object() | {"target": "n1"}, "'n1' is named as target and has role 'pushable'"),
        (MINIMAL | {"target": "rip"}, "target 'rip' is no object: valid are ripe; did you mean"),
        # the rest
        (with_object(rol="static"), "objects[1]: unknown key 'rol': valid are id, role"),
        (MINIMAL | {"obstacles": []}, "unknown key 'obstacles'"),
        (MINIMAL | {1: 2}, "unknown key 1"),
        (MINIMAL | {"format": 2}, "format is 2"),
        ({"format": 1, "robot": "panda", "objects": [FRUIT]}, "name is missing"),
        (MINIMAL | {"robot": 7}, "robot is 7: must be text"),
        (MINIMAL | {"objects": None}, "objects is None: must be a list"),
        (MINIMAL | {"objects": [3]}, "objects[0]: is 3: must be a mapping"),
        (MINIMAL | {"scale": 0}, "scale is 0: must be above 0"),
        (MINIMAL | {"tool": {"kind": "cap"}}, "tool.kind is 'cap': valid are cup, franka_hand"),
        (MINIMAL | {"tool": {"kind": "cup"}}, "radius is missing"),
        (MINIMAL | {"tool": {"kind": "cup", "radius": -1}}, "tool.radius is -1"),
        (MINIMAL | {"tool": {"kind": "franka_hand", "depth": 1}}, "depth is no parameter"),
        (MINIMAL | {"approach": {"direction": [0, 0, 0]}}, "must have a direction"),
        (MINIMAL | {"approach": {"lateral": [0, 0, 3]}}, "parallel"),
        (MINIMAL | {"approach": {"camera_distance": 0}}, "camera_distance is 0"),
        (MINIMAL | {"options": {"camera": True}}, "unknown key 'camera'"),
        (MINIMAL | {"objects": [], "goal": {}}, "must have either joints, or position"),
        (
            MINIMAL | {"objects": [], "goal": {"joints": [1], "axis": [0, 0, 1]}},
            "goes with position",
        ),
        ([], "must be a mapping"),
        (None, "must be a mapping"),
        # millimetres
        (with_fruit(position=[450, 0, 890]), "is 997.296 m from the robot"),
        (with_object(position=[450, 0, 890]), "objects[1]: position"),
        (with_fruit(shape={"sphere": {"radius": 15}}), "radius 15 m is too large"),
        (with_fruit(stem={"root": [0.45, 0.0, 1020]}), "stem.root"),
        (with_object(position=[1e5, 0, 0], role="static"), "100000 m from the robot"),
        (MINIMAL | {"objects": [], "goal": {"position": [0, 450, 0]}}, "goal.position"),
    ],
)
def test_refuses(document, words):
    message = refusal(document, source="my.yaml")
    assert message.startswith("my.yaml: ")
    assert words in message


@pytest.mark.parametrize("words", ["objects[0].role is missing (and 2 more)"])
def test_counts_further_errors(words):
    document = MINIMAL | {"objects": [{"id": "a"}]}
    assert words in refusal(document)


def test_ten_kilometres_are_left_to_the_planner():
    assert scene_from_dict(with_fruit(position=[10_000.0, 0, 0])).target is not None


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"  \n# nothing\n", "must be a mapping"),
        (b"\x00\x01\x02", "line 1: byte 0x00"),
        (b"format: 1\nname: \xff\xfe\n", "line 2: byte 0xff"),
        (b"format: 1\nobjects:\n  - {id: a, role: ta", "line 3"),
        (b"format: 1\nname: [1, 2\n", "line 3"),
        (b"format: 1\nname: a\nname: b\n", "line 3: key 'name' stands twice"),
        (b"format: 1\nname: !!python/object/apply:os.system ['true']\n", "line 2"),
        (b"name: *nobody\n", "line 1"),
        (b"name: &a [*a]\n", "holds itself"),
        (b"? [1, 2]\n: 3\n", "line 1: a key must be text"),
        (b"---\na: 1\n---\nb: 2\n", "line 3"),
        (b"name: \x07\n", "scene.yaml: "),
        (b"[" * 5000, "scene.yaml: "),
        (b"start: 1" + b"0" * 5000 + b"\n", "scene.yaml: "),
    ],
)
def test_refuses_yaml_files(tmp_path, content, words):
    path = tmp_path / "scene.yaml"
    path.write_bytes(content)
    with pytest.raises(InvalidSceneError) as caught:
        load_scene(path)
    assert words in caught.value.message
    assert caught.value.message.startswith(str(path))
    assert "\n" not in caught.value.message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"format": 1,\n "name"', "line 2"),
        ('{"name": "a", "name": "b"}', "'name' stands twice"),
        ("[" * 100_000, "nested too deep"),
        ('{"format": 1, "name": "a", "robot": "b", "start": [NaN]}', "start[0] is nan"),
    ],
)
def test_refuses_json_files(tmp_path, content, words):
    path = tmp_path / "scene.json"
    path.write_text(content)
    with pytest.raises(InvalidSceneError) as caught:
        load_scene(path)
    assert words in caught.value.message


def test_an_alias_bomb_is_refused(tmp_path):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join(lines))
    with pytest.raises(InvalidSceneError, match="unfold"):
        load_scene(path)


@pytest.mark.parametrize(
    ("path", "words"), [("none.yaml", "No such file"), (".", "is a folder"), ("none", "neither")]
)
def test_refuses_paths(tmp_path, path, words):
    with pytest.raises(InvalidSceneError) as caught:
        load_scene(tmp_path / path)
    assert words in caught.value.message


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_yaml_reads_as_one_would_think(tmp_path, encoding):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "name: no\nrobot: panda\nstart: [1e-3, .5, 010, +2, 1.5E2, -0]\n"
        "objects:\n"
        "  - &fruit {id: on, role: target, shape: &s {sphere: {radius: 15e-3}}, position: [0, 1, 0]}\n"
        "  - {id: 'Kirsche ü', role: avoid, shape: *s, position: [0, 1, 1]}\n"
        "  - {<<: *fruit, id: 1:30, role: pushable}\n",
        encoding=encoding,
    )
    scene = load_scene(path)
    assert scene.name == "no"
    np.testing.assert_array_equal(scene.start, [0.001, 0.5, 10, 2, 150, 0])
    assert [item.id for item in scene.objects] == ["on", "Kirsche ü", "1:30"]
    assert scene.target.radius == 0.015


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"mesh": {"file": "none.stl"}}, "objects[1]: mesh"),
        ({"mesh": {"file": "bad.obj"}}, "bad.obj"),
        ({"mesh": {"file": "parts/rock.obj", "scale": 1000}}, "millimetres?"),
        ({"mesh": {"file": "parts/rock.obj", "scale": -1}}, "mesh.scale is -1"),
        ({"point_cloud": {"file": "none.csv", "radius": 0.1}}, "none.csv"),
        ({"point_cloud": {"file": "leaves.csv"}}, "point_cloud.radius is missing"),
    ],
)
def test_refuses_shape_files(files, entry, words):
    pytest.importorskip("trimesh")
    (files / "bad.obj").write_text("v 0 0 0\nf 1 1 1\n")
    message = refusal(with_object(shape=entry, role="static"), base_dir=files)
    assert words in message


def test_objects_in_python_are_checked_alike():
    with pytest.raises(InvalidSceneError, match="valid are target"):
        SceneObject("a", "fruit", Sphere(0.1), np.zeros(3))
    with pytest.raises(InvalidSceneError, match="parallel"):
        Approach(np.array([0, 1, 0]), np.array([0, -2, 0]))
    with pytest.raises(InvalidSceneError, match="stem.radius"):
        Stem([[0, 0, 0], [0, 0, 1]], 0.0)
    with pytest.raises(InvalidSceneError, match="valid are target"):
        scene_from_dict(MINIMAL).obstacles("statics")
    bent = Stem([[0, 0, 0], [0, 0, 1], [0, 1, 1]])
    assert bent.length == 2.0
    np.testing.assert_array_equal(bent.root, [0, 1, 1])


def test_many_objects_load_in_bounded_time(tmp_path):
    document = with_object()
    rng = np.random.default_rng(0)
    document["objects"] += [
        {"id": f"o{i}", "role": "avoid", "shape": {"sphere": {"radius": 0.01}}, "position": p}
        for i, p in enumerate(rng.uniform(-1, 1, (3000, 3)).tolist())
    ]
    scene = load_scene(write(tmp_path / "many.json", document))
    assert len(scene.obstacles("avoid").kind) == 3000
