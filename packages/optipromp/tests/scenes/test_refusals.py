"""What is refused, and in which words: file, field, value and what would be right, in one line."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.scenes.documents import FRUIT, MINIMAL, with_fruit, with_object

from optipromp.core.errors import Code, InvalidSceneError
from optipromp.core.scenes import load_scene, scene_from_dict


def refusal(document, **more):
    with pytest.raises(InvalidSceneError) as caught:
        scene_from_dict(document, **more)
    assert caught.value.code is Code.INVALID_SCENE
    assert "\n" not in caught.value.message
    return caught.value.message


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("document", "words"),
    [
        # numbers
        (with_fruit(position=[0, NAN, 0]), "objects[0].position[1] is nan: must be finite"),
        (with_fruit(position=[0, 0]), "objects[0].position has 2 entries: must have at least 3"),
        (with_fruit(position=[0, "0.5", 0]), "objects[0].position[1] is '0.5': must be a number"),
        (with_fruit(position=[0, True, 0]), "objects[0].position[1] is True: must be a number"),
        (with_fruit(position=0.5), "objects[0].position is 0.5: must be a list"),
        (MINIMAL | {"start": [0, INF]}, "start[1] is inf"),
        (MINIMAL | {"objects": [], "goal": {"joints": [NAN]}}, "goal.joints[0] is nan"),
        # shapes
        (with_fruit(shape={"sphere": {"radius": 0}}), "shape.sphere.radius is 0: must be above 0"),
        (with_fruit(shape={"box": {"size": [1, -1, 1]}}), "shape.box.size[1] is -1"),
        (with_fruit(shape={"cube": {}}), "unknown key 'cube': valid are sphere, box"),
        (with_fruit(shape="sphere"), "objects[0].shape: is 'sphere': must be a mapping"),
        (with_fruit(shape={}), "must have exactly one of sphere, box"),
        (
            with_fruit(shape={"sphere": {"radius": 1}, "box": {"size": [1, 1, 1]}}),
            "has sphere and box: must have exactly one",
        ),
        (with_fruit(shape={"sphere": None}), "sphere is empty"),
        (with_fruit(shape={"half_space": {}}), "cannot be a half_space"),
        (with_fruit(shape={"sphere": {}}), "objects[0].shape.sphere.radius is missing"),
        (MINIMAL | {"unseen": FRUIT}, "unseen is no point_cloud"),
        # orientation
        (with_fruit(orientation=[1.01, 0, 0, 0]), "has length 1.01: must be a unit quaternion"),
        (with_fruit(orientation=[0, 0, 0, 0]), "has length 0"),
        # stems
        (with_fruit(stem={}), "objects[0].stem: must have exactly one of root, direction"),
        (with_fruit(stem={"root": [0.45, 0.0, 0.89]}), "objects[0]: stem piece 0 has no length"),
        (with_fruit(stem={"points": [[0.45, 0, 1.2], [0.45, 0, 0.9]]}), "must start at its fruit"),
        # uncertainty
        (with_fruit(sigma=-0.1), "sigma is -0.1: must be at least 0"),
        (with_fruit(sigma=0.1, covariance=np.eye(3).tolist()), "has covariance and sigma"),
        (with_fruit(covariance=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), "positive semi-definite"),
        (with_fruit(covariance=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]), "not symmetric"),
        (with_fruit(physical={"weight": 1.0}), "'weight' is unknown: valid are mass"),
        (with_fruit(physical={"stem_stiffness": 0.0}), "stem_stiffness is 0"),
        (with_fruit(physical={"stem_stiffness_spread": 1.0}), "must be above 1"),
        # roles, ids, targets
        (with_object(role="pushabel"), "objects[1].role is 'pushabel': valid are target, pushable"),
        (with_object(id="ripe"), "objects[1].id 'ripe' is taken by objects[0]"),
        (with_object(id=3), "objects[1].id is 3: must be text: put it in quotes"),
        (with_object(role="target"), "two targets, 'ripe' and 'n1'"),
        (MINIMAL | {"objects": []}, "no target"),
        (MINIMAL | {"goal": {"joints": [0.0]}}, "target 'ripe' and a goal"),
        (with_object() | {"target": "n1"}, "'n1' is named as target and has role 'pushable'"),
        (MINIMAL | {"target": "rip"}, "target 'rip' is no object: valid are ripe; did you mean"),
        # the rest
        (MINIMAL | {"obstacles": []}, "unknown key 'obstacles'"),
        (MINIMAL | {1: 2}, "unknown key 1"),
        (MINIMAL | {"format": 2}, "format is 2"),
        ({"format": 1, "robot": "panda", "objects": [FRUIT]}, "name is missing"),
        (MINIMAL | {"robot": 7}, "robot is 7: must be text"),
        (MINIMAL | {"objects": None}, "objects is None: must be a list"),
        (MINIMAL | {"objects": [3]}, "objects[0]: is 3: must be a mapping"),
        (MINIMAL | {"scale": 0}, "scale is 0: must be above 0"),
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
        # millimetres
        (with_fruit(position=[450, 0, 890]), "is 997.296 m from the robot"),
        (with_fruit(shape={"sphere": {"radius": 15}}), "radius 15 m is too large"),
        (with_fruit(stem={"root": [0.45, 0.0, 1020]}), "stem.root"),
        (with_object(position=[1e5, 0, 0], role="static"), "100000 m from the robot"),
        (
            MINIMAL | {"objects": [], "goal": {"position": [0, 450, 0], "axis": "free"}},
            "goal.position [0.0, 450.0, 0.0] is 450 m",
        ),
        # frames, and stems by direction
        (MINIMAL | {"base": 3}, "base: is 3: must be a mapping with keys position, orientation"),
        (
            MINIMAL | {"camera": {"position": [0, 0, 0], "orientation": [1, 1, 0, 0]}},
            "camera.orientation [1.0, 1.0, 0.0, 0.0] has length 1.41421: must be a unit quaternion",
        ),
        (MINIMAL | {"frame": "wrld"}, "frame is 'wrld': valid are world, base, camera; did you"),
        (MINIMAL | {"frame": "camera"}, "frame is 'camera' and the scene has no camera: give its"),
        (with_fruit(frame="camera"), "objects[0].frame is 'camera' and the scene has no camera"),
        (
            MINIMAL | {"base": {"position": [30, 0, 0]}},
            "position [-29.55, 0.0, 0.89] in the base's frame is 29.5634 m from the robot",
        ),
        (with_fruit(stem={"direction": [0, 0, 1]}), "stem: has direction and no length"),
        (with_fruit(stem={"root": [0, 0, 1], "length": 1}), "stem: has length and no direction"),
        (
            with_fruit(stem={"direction": [0, 0, 1], "root": [0, 0, 1]}),
            "stem: must have exactly one of root, direction (with length), points",
        ),
        (with_fruit(stem={"direction": [0, 0, 1], "length": 0}), "stem.length is 0: must be above"),
        (with_fruit(stem={"direction": [0, 0, 0], "length": 1}), "objects[0]: stem.direction is"),
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


def bomb(first: str, more: str, count: int, lines: int = 12) -> bytes:
    """Lines each of which holds ``count`` aliases of the line before."""
    texts = [first, *(more % ", ".join([f"*a{i}"] * count) for i in range(lines - 1))]
    return "\n".join(f"a{i}: &a{i} {text}" for i, text in enumerate(texts)).encode()


FILES: dict[str, list[tuple[bytes, str]]] = {
    "scene.yaml": [
        (b"", "is empty"),
        (b"  \n# nothing\n", "must be a mapping"),
        (b"\x00\x01\x02", "line 1: byte 0x00"),
        (b"format: 1\nname: \xff\xfe\n", "line 2: byte 0xff"),
        (b"format: 1\nobjects:\n  - {id: a, role: ta", "line 3"),
        (b"format: 1\nname: [1, 2\n", "line 2"),
        (b"format: 1\nname: a\nname: b\n", "line 3: key 'name' stands twice"),
        (b"format: 1\nname: !!python/object/apply:os.system ['true']\n", "line 2"),
        (b"name: *nobody\n", "line 1"),
        (b"name: &a [*a]\n", "holds itself"),
        (b"? [1, 2]\n: 3\n", "line 1: a key must be text"),
        (b"---\na: 1\n---\nb: 2\n", "line 3"),
        (b"name: \x07\n", "scene.yaml: "),
        (b"[" * 100_000, "nested deeper than 100"),
        (b"- " * 5_000, "nested deeper than 100"),
        (b"start: 1" + b"0" * 5000 + b"\n", "scene.yaml: "),
        (bomb("[1, 1, 1, 1, 1, 1, 1, 1, 1, 1]", "[%s]", 10), "unfold"),
        (bomb("{x: 1}", "\n  <<: [%s]", 9), "unfold"),
        (bomb("[x, x, x, x, x, x, x, x, x]", "[%s]", 9, 6), "unknown key 'a0'"),
        (b"".join(b"k%d: 1\n" % i for i in range(60_000)), "unknown key 'k0'"),
        *((b"name: " + tag + b"\n", "must have none") for tag in (
            b"!!timestamp x", b"!!bool x", b"!!int x", b"!!binary x", b"!!python/name:os.system",
            b"!!set {a}",
        )),
    ],
    "scene.json": [
        (b'{"format": 1,\n "name"', "line 2"),
        (b'{"name": "a", "name": "b"}', "'name' stands twice"),
        (b"[" * 100_000, "nested too deep"),
        (b'{"format": 1, "name": "a", "robot": "b", "start": [NaN]}', "start[0] is nan"),
        (b'{"name": 1' + b"0" * 5000 + b"}", "4300 digits"),
        (b"[" + b"0," * 3_000_001, "more than 3000000 values"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "content", "words"), [(name, *one) for name, rows in FILES.items() for one in rows]
)
def test_refuses_files(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InvalidSceneError) as caught:
        load_scene(path)
    assert words in caught.value.message
    assert caught.value.message.startswith(str(path))
    assert "\n" not in caught.value.message


@pytest.mark.parametrize(
    ("path", "words"), [("none.yaml", "No such file"), (".", "Is a directory"), ("none", "neither")]
)
def test_refuses_paths(tmp_path, path, words):
    with pytest.raises(InvalidSceneError) as caught:
        load_scene(tmp_path / path)
    assert words in caught.value.message


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


@pytest.mark.parametrize("name", ["", "a\nb", "\u202eb", "\x1b[31m", "n" * 1001, 3])
def test_what_a_file_could_not_hold_is_no_name_in_python_either(name):
    scene = load_scene("scenario-3")
    for make in (replace, lambda given, **_: replace(given.objects[0], id=name)):
        with pytest.raises(InvalidSceneError, match=r"must (have 1 to 1000 letters|be text)"):
            make(scene, name=name)
