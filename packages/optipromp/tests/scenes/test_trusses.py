"""Stems that grow from other stems, in scenes: checked, written and read, moved, generated."""

from dataclasses import replace

import numpy as np
import pytest
from tests.scenes.sampled import made

from optipromp import load_scene, save_scene
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Cone, Ellipsoid, Sphere
from optipromp.core.scenes import Pose, Scene, SceneObject, Stem
from optipromp.core.scenes.objects import nearest, parents_first, rooted
from optipromp_ros.scenes import collision_object, read_collision_object
from optipromp_sim.generate import NOISES, generate, perceived
from optipromp_sim.generate.plants import untold

TOP = np.array([0.45, 0.0, 1.1])


def fruit(name: str, position: tuple[float, float, float], root, parent=None, role="pushable"):
    stem = Stem(np.array([position, root]), parent=parent)
    return SceneObject(name, role, Sphere(0.015), np.array(position), stem=stem)


def scene(*objects: SceneObject) -> Scene:
    return Scene("truss", "panda", objects)


def pair(parent: str | None = "a", root=(0.45, 0.0, 1.0)) -> tuple[SceneObject, SceneObject]:
    return (
        fruit("b", (0.48, 0.0, 0.93), root, parent),
        fruit("a", (0.45, 0.0, 0.9), TOP, role="target"),
    )


def test_a_stem_grows_from_another(tmp_path) -> None:
    made = scene(*pair())
    assert [item.id for item in parents_first(made.objects)] == ["a", "b"]
    save_scene(made, tmp_path / "truss.yaml")
    read = load_scene(tmp_path / "truss.yaml")
    stem = read.objects[0].stem
    assert stem.parent == "a"
    moved = read.transformed(Pose(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 0.0, 1.0])))
    assert moved.objects[0].stem.parent == "a"
    (told,) = read_collision_object(collision_object(read.objects[0]))
    assert told.stem.parent == "a"


@pytest.mark.parametrize(
    ("objects", "words"),
    [
        (pair("c"), "'c' is no object"),
        (pair("a", (0.47, 0.0, 1.0)), "0.02 m from the stem of 'a'"),
        ((fruit("b", (0.48, 0.0, 0.93), (0.45, 0, 1.0), "b"), pair()[1]), "grows from it in turn"),
        ((pair()[0], replace(pair()[1], stem=None)), "has no stem"),
    ],
)
def test_what_cannot_be_a_truss_is_refused(objects, words) -> None:
    with pytest.raises(InvalidSceneError, match=words):
        scene(*objects)


def test_roots_follow_the_stem_that_they_grow_from() -> None:
    child, parent = pair()
    shift = np.array([0.02, 0.0, 0.0])
    apart = replace(
        parent, position=parent.position + shift,
        stem=replace(parent.stem, points=parent.stem.points + shift),
    )  # fmt: skip
    back, _ = rooted([child, apart])
    np.testing.assert_allclose(
        back.stem.root, nearest(apart.stem.points, np.array([0.45, 0.0, 1.0]))[1]
    )
    (lone,) = rooted([child])
    assert lone.stem.parent is None


def test_detected_trusses_are_whole() -> None:
    for seed in range(20000, 20005):
        true = generate("truss", seed)
        assert 3 <= len(true.pushables) + 1 <= 5
        held = [item for item in true.objects if item.stem and item.stem.parent is None]
        assert len(held) == 1
        seen = perceived(true, np.random.default_rng(seed), NOISES["zero-mean"])
        assert [item.stem.parent for item in seen.objects if item.stem] == [
            item.stem.parent for item in true.objects if item.stem
        ]


def test_field_scenes_are_of_all_kinds_and_keep_their_secrets() -> None:
    scenes = [made("field", seed)[0] for seed in range(12)]
    shapes = {type(item.shape) for one in scenes for item in one.objects}
    assert {Cone, Ellipsoid} < shapes
    assert any(item.stem and item.stem.parent for one in scenes for item in one.objects)
    assert all(item.physical for one in scenes for item in one.objects)
    assert not any(item.physical for item in untold(scenes[0]).objects)
