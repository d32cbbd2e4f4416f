"""Attached shapes, pairs that may touch, and padding, in scene files and in Python."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry import HalfSpace, Sphere
from optipromp.core.planning.task import posed
from optipromp.core.scenes import Attached, SceneObject, load_scene, save_scene, scene_from_dict

BOARD = {"id": "board", "role": "static", "shape": {"box": {"size": [0.2, 0.2, 0.02]}}}
DOCUMENT = {
    "name": "held",
    "robot": "panda",
    "tool": {"kind": "cup", "radius": 0.03},
    "goal": {"position": [0.5, 0.2, 0.5], "axis": [0, 0, 1]},
    "padding": 0.01,
    "attached": [
        {"id": "punnet", "shape": {"box": {"size": [0.12, 0.1, 0.04]}}, "position": [0, 0, -0.12],
         "orientation": [0.8, 0.6, 0.0, 0.0], "mass": 0.4},
        {"id": "berry", "shape": {"sphere": {"radius": 0.015}}},
    ],
    "may_touch": [["tool", "board"], ["punnet", "link5"]],
    "objects": [BOARD | {"position": [0.5, 0.2, 0.53], "padding": 0.02}],
}  # fmt: skip


def test_a_file_keeps_what_is_held_what_may_touch_and_padding(tmp_path: Path) -> None:
    scene = scene_from_dict(DOCUMENT)
    save_scene(scene, tmp_path / "held.yaml")
    back = load_scene(tmp_path / "held.yaml")
    assert back.may_touch == (("tool", "board"), ("punnet", "link5"))
    assert (back.padding, back.objects[0].padding) == (0.01, 0.02)
    for one, other in zip(scene.attached, back.attached, strict=True):
        assert (one.id, one.shape, one.mass) == (other.id, other.shape, other.mass)
        assert (one.position == other.position).all()
        assert np.abs(one.orientation - other.orientation).max() < 1e-15


def test_a_file_in_millimetres_scales_what_is_held() -> None:
    item = {"id": "box", "shape": {"box": {"size": [100, 100, 40]}}, "position": [0, 0, -120]}
    scene = scene_from_dict(
        {"name": "mm", "robot": "panda", "scale": 0.001, "attached": [item], "padding": 10,
         "tool": {"kind": "cup", "radius": 30},
         "goal": {"position": [500, 200, 500], "axis": [0, 0, 1]}}
    )  # fmt: skip
    (held,) = scene.attached
    assert scene.padding == pytest.approx(0.01)
    assert held.position == pytest.approx([0.0, 0.0, -0.12])
    assert held.load.solids[0].corners.max() == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"attached": [{"id": "tool", "shape": {"sphere": {"radius": 0.01}}}]}, "is taken"),
        ({"attached": [{"id": "board", "shape": {"sphere": {"radius": 0.01}}}]}, "is taken"),
        ({"attached": [{"id": "a", "shape": {"half_space": {}}}]}, "must be convex"),
        ({"attached": [{"id": "a", "shape": {"sphere": {"radius": 0.01}}, "mas": 1}]}, "'mass'"),
        ({"may_touch": [["tool", "tool"]]}, "two different names"),
        ({"may_touch": [["tool"]]}, "must have at least 2"),
        ({"padding": -0.01}, "padding is -0.01: must be at least 0"),
        ({"padding": 10}, "padding is 10.0: must be 0 to 1 [m]"),
        ({"objects": [BOARD | {"role": "avoid", "position": [1, 0, 0], "padding": 0.1}]},
         "padding goes with static objects"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_refused_by_name(change: dict[str, object], words: str) -> None:
    with pytest.raises(InvalidSceneError, match=words.replace("[", r"\[")):
        scene_from_dict(DOCUMENT | change)


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        (("tol", "board"), r"names 'tol', .* did you mean 'tool'"),
        (("link5", "bord"), "names 'bord', .* did you mean 'board'"),
        (("other", "board"), "two objects: one must be a link"),
    ],
)
def test_a_name_that_nothing_has_is_refused_with_the_nearest(pair, words):
    scene = scene_from_dict(DOCUMENT)
    other = SceneObject("other", "static", Sphere(0.01), np.array([0.0, 1.0, 0.0]))
    scene = replace(scene, may_touch=(pair,), objects=(*scene.objects, other))
    with pytest.raises(InvalidSceneError, match=words):
        posed(scene)


def test_an_attached_shape_has_an_end_and_a_mass_above_0() -> None:
    with pytest.raises(InvalidSceneError, match="HalfSpace"):
        Attached("floor", HalfSpace())
    with pytest.raises(InvalidSceneError, match="mass is 0"):
        Attached("ball", Sphere(0.01), mass=0.0)


def test_a_robot_that_is_given_holds_what_the_scene_says_once() -> None:
    scene = scene_from_dict(DOCUMENT)
    bare, _ = posed(replace(scene, attached=(), may_touch=()))
    given, _ = posed(scene, bare)
    own, _ = posed(scene)
    assert given.link_names == own.link_names
    assert (given.spheres.center == own.spheres.center).all()
    strict, _ = posed(replace(scene, may_touch=()))
    assert len(given.self_pairs) == len(own.self_pairs) < len(strict.self_pairs)
    assert posed(scene, given)[0] is given


def test_an_attached_shape_has_no_name_of_a_link_and_needs_a_tool() -> None:
    scene = replace(scene_from_dict(DOCUMENT), may_touch=())
    named_as_link = replace(scene, attached=(Attached("link5", Sphere(0.01)),))
    with pytest.raises(InvalidRequestError, match="'link5' is the name of a link"):
        posed(named_as_link)
    with pytest.raises(InvalidRequestError, match="has no tool"):
        posed(replace(scene, tool=None))
