"""The built-in scenarios hold the numbers of the paper."""

import math

import numpy as np
import pytest

from optipromp.core import judging
from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Box, Sphere
from optipromp.core.planning.task import resolve
from optipromp.core.scenes import load_scene, scene_names

NAMES = ("scenario-1", "scenario-2", "scenario-3", "scenario-4")
PAPER = ("paper-3", "paper-4")


def test_names():
    assert scene_names() == (*PAPER, *NAMES)


@pytest.mark.parametrize("name", PAPER)
def test_what_the_paper_must_have_had(name):
    """The fruits of scenario III or IV; the hand, and the start but for joint 6, of the paper."""
    scene, like = load_scene(name), load_scene(name.replace("paper", "scenario"))
    assert scene.name == name
    assert scene.tool.kind == "franka_hand"
    assert scene.start.tolist() == [0.0, 0.0, 0.0, -0.1, 0.0, 0.22, 0.8]
    robot = resolve(scene).robot
    distances, touching = judging.clearances(scene, robot, scene.start[None])
    assert not touching
    assert distances["clearance_self"] >= 0.005
    assert [o.id for o in scene.objects] == [o.id for o in like.objects]
    for one, other in zip(scene.objects, like.objects, strict=True):
        if one.role == "static":
            assert one.shape == Box((0.4, 0.06, 0.06))  # the paper's half depth is 0.03
            assert one.position[1] == pytest.approx(0.0352 + 0.03379, abs=2e-3)  # M_c + M_p
        else:
            np.testing.assert_array_equal(one.position, other.position)
            assert one.shape == other.shape
    assert scene.options == {"drift_offset": {"n1": 0.010, "n2": 0.002}}


@pytest.mark.parametrize("name", NAMES)
def test_common(name):
    scene = load_scene(name)
    assert scene.name == name
    assert [item.id for item in scene.pushables] == ["n1", "n2"]
    assert scene.target.id == "ripe"
    for item in (scene.target, *scene.pushables):
        assert item.shape == Sphere(0.015)
        assert item.stem.radius == 0.003
        np.testing.assert_array_equal(item.stem.points[0], item.position)
    np.testing.assert_array_equal(scene.frame, np.eye(3))
    assert scene.approach.camera_distance == 0.10


@pytest.mark.parametrize("name", NAMES[:2])
def test_beside_the_scara(name):
    scene = load_scene(name)
    assert scene.robot == "scara"
    tool = scene.tool.parameters
    assert scene.tool.kind == "cup"
    assert tool["length"] + tool["height"] == pytest.approx(0.1116)
    assert (tool["radius"], tool["opening"], tool["depth"]) == (0.03, 0.04, 0.02)
    np.testing.assert_array_equal(scene.target.position, [0, 0.5, 0.33])
    np.testing.assert_array_equal(scene.pushables[0].position, [-0.02, 0.5, 0.2175])
    np.testing.assert_array_equal(scene.pushables[1].position, [-0.0235, 0.5, 0.2752])
    assert {item.stem.root[2] for item in scene.objects if item.stem} == {0.40}
    (table,) = scene.static
    assert table.shape == Box((1.0, 0.2, 0.06))
    np.testing.assert_array_equal(table.position, [0, 0.62, 0.37])


@pytest.mark.parametrize("name", NAMES[2:])
def test_before_the_panda(name):
    scene = load_scene(name)
    assert scene.robot == "panda"
    assert scene.tool.parameters == {"radius": 0.05, "height": 0.05, "length": 0.10}
    assert scene.start.shape == (7,)
    np.testing.assert_array_equal(scene.target.position, [0.45, 0, 0.89])
    np.testing.assert_allclose(scene.target.stem.vector, [0, 0, 0.13], atol=1e-12)
    first, second = scene.pushables
    np.testing.assert_array_equal(first.position, [0.45, 0.00385, 0.7541])
    np.testing.assert_array_equal(second.position, [0.45, 0.00217, 0.8286])
    lean = np.array([0, math.sin(math.pi / 20), math.cos(math.pi / 20)])
    np.testing.assert_allclose(first.stem.vector, 0.28 * lean, atol=1e-8)
    np.testing.assert_allclose(second.stem.vector, 0.20 * lean * [1, -1, 1], atol=1e-8)


def test_side_clusters():
    scene = load_scene("scenario-3")
    assert scene.static == ()
    assert [item.shape for item in scene.avoid] == [Sphere(0.1)] * 2
    np.testing.assert_allclose(
        [item.position - scene.target.position for item in scene.avoid],
        [[0, 0.2, -0.1], [0, -0.2, -0.1]],
        atol=1e-12,
    )


def test_table_top():
    scene = load_scene("scenario-4")
    assert scene.avoid == ()
    (table,) = scene.static
    assert table.shape == Box((1.0, 0.06, 0.16))
    np.testing.assert_array_equal(table.position, [0.45, 0.12, 0.97])


def test_an_unknown_name_lists_the_valid_ones():
    with pytest.raises(InvalidSceneError) as caught:
        load_scene("scenario-33")
    assert (
        "paper-3, paper-4, scenario-1, scenario-2, scenario-3, scenario-4" in caught.value.message
    )
    assert "did you mean 'scenario-3'?" in caught.value.message
