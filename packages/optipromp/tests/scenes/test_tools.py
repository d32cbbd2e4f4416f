"""Tools in scene files: every kind comes back, and what is wrong is named."""

from pathlib import Path

import numpy as np
import pytest
from tests.robots.builders import BAR, TOOLS, cup_parts, joined, write_obj
from tests.scenes.documents import MINIMAL

from optipromp.core.errors import InvalidSceneError
from optipromp.core.planning.task import resolve
from optipromp.core.robots import Cup, FingerGripper, MeshTool, Scissor
from optipromp.core.scenes import (
    Scene,
    ToolSpec,
    load_scene,
    save_scene,
    scene_from_dict,
    scene_to_dict,
)

MESH = {"kind": "mesh", "file": "parts/cup.obj", "scale": 0.001, "tool_point": [0.0, 0.0, 0.12],
        "opening": 0.044, "height": 0.04}  # fmt: skip
STATED = {
    "cup": {"kind": "cup", "radius": 0.03, "opening": 0.052},
    "tapered cup": {"kind": "cup", "radius": 0.03, "taper": 45.0},
    "franka_hand": {"kind": "franka_hand"},
    "finger_gripper": {"kind": "finger_gripper", "opening": 0.06, "turn": 0.4},
    "scissor": {"kind": "scissor", "opening": 0.05},
    "suction": {"kind": "suction", "radius": 0.012, "angle": 20.0,
                "mount": {"position": [0.0, 0.01, 0.0], "orientation": [0.6, 0.0, 0.8, 0.0]}},
    "mesh": MESH,
    "mesh of parts": {"kind": "mesh", "parts": ["bar.obj", "parts/other.obj"],
                      "tool_point": [0.0, 0.0, 0.118], "tool_axis": [0.0, 0.1, 1.0]},
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A mesh in millimetres, and two in metres."""
    (tmp_path / "parts").mkdir()
    vertices, faces = joined(cup_parts())
    write_obj(tmp_path / "parts/cup.obj", 1000.0 * vertices, faces)
    write_obj(tmp_path / "bar.obj", *BAR)
    write_obj(tmp_path / "parts/other.obj", BAR[0] + [0.0, 0.05, 0.0], BAR[1])
    return tmp_path


def scene_with(tool: object, folder: Path) -> Scene:
    return scene_from_dict(MINIMAL | {"tool": tool}, base_dir=folder, source="my.yaml")


@pytest.mark.parametrize("name", STATED)
@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_a_tool_outlives_its_file(name: str, suffix: str, folder: Path) -> None:
    scene = scene_with(STATED[name], folder)
    save_scene(scene, folder / f"again.{suffix}")
    again = load_scene(folder / f"again.{suffix}")
    assert scene_to_dict(again, base_dir=folder)["tool"] == STATED[name]
    one, other = resolve(scene).robot, resolve(again).robot
    np.testing.assert_array_equal(one.spheres.center, other.spheres.center)
    np.testing.assert_array_equal(one.tool_point, other.tool_point)
    np.testing.assert_array_equal(one.tool_axis, other.tool_axis)
    assert one.gripper_radius == other.gripper_radius


def test_a_mesh_is_read_with_its_scale(folder: Path) -> None:
    tool = resolve(scene_with(MESH, folder)).robot.tool
    assert isinstance(tool, MeshTool)
    assert tool.tip == pytest.approx(0.14)
    reach, wanted = (
        np.sort(np.linalg.norm(cover[:, :3], axis=1) + cover[:, 3])
        for cover in (tool.spheres(), TOOLS["mesh"].spheres())
    )
    np.testing.assert_allclose(reach, wanted, atol=1e-9)


def test_lengths_are_scaled_and_turns_are_not(folder: Path) -> None:
    def tool(stated: dict[str, object]) -> object:
        document = MINIMAL | {
            "scale": 0.001,
            "objects": [],
            "goal": {"position": [450, 0, 890], "axis": "free"},
        }
        return resolve(scene_from_dict(document | {"tool": stated}, base_dir=folder)).robot.tool

    gripper = tool({"kind": "finger_gripper", "opening": 60, "depth": 10, "turn": 0.4})
    assert gripper == FingerGripper(0.06, depth=0.01, turn=0.4)
    assert tool({"kind": "scissor", "opening": 50}) == Scissor(0.05)
    cup = {"kind": "cup", "radius": 30, "height": 50, "length": 100, "depth": 20, "taper": 45}
    assert tool(cup) == Cup(0.03, taper=45)
    mesh = tool(MESH | {"tool_point": [0, 0, 120], "opening": 44, "height": 40})
    assert isinstance(mesh, MeshTool)
    assert (mesh.tool_point, mesh.opening) == ((0.0, 0.0, 0.12), pytest.approx(0.044))
    assert mesh.tip == pytest.approx(0.14)  # the file has a scale of its own


def test_a_mesh_tool_is_made_once(folder: Path) -> None:
    scene = scene_with(MESH, folder)
    assert resolve(scene).robot is resolve(scene).robot


def test_a_mesh_from_memory_cannot_be_saved(tmp_path: Path) -> None:
    mesh = TOOLS["mesh"]
    assert isinstance(mesh, MeshTool)
    spec = ToolSpec("mesh", {"meshes": mesh.meshes, "tool_point": [0.0, 0.0, 0.12]})
    scene = Scene("s", "panda", scene_with(None, tmp_path).objects, tool=spec)
    assert resolve(scene).robot.tool == MeshTool(mesh.meshes, (0.0, 0.0, 0.12))
    with pytest.raises(InvalidSceneError, match="has no file"):
        save_scene(scene, tmp_path / "s.yaml")


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        (5, ["tool is 5", "a mapping"]),
        (
            {},
            [
                "tool.kind is missing: valid are cup, franka_hand, finger_gripper, scissor, "
                "suction, mesh"
            ],
        ),
        ({"kind": "scissors"}, ["tool.kind is 'scissors'", "did you mean 'scissor'"]),
        ({"kind": "cup"}, ["tool.radius is missing"]),
        ({"kind": "cup", "radius": 0.05, "depth": 0.06}, ["tool cup: depth is 0.06", "0.05]"]),
        ({"kind": "cup", "radius": 0.05, "turn": 1}, ["tool: turn is no parameter of cup"]),
        ({"kind": "finger_gripper", "opening": 0.06, "finger": 1}, ["did you mean 'finger_"]),
        ({"kind": "suction", "radius": 0.01, "angle": 120.0}, ["angle is 120", "90 [degrees]"]),
        (
            {"kind": "cup", "radius": 0.03, "mount": {"orientation": [1, 1, 0, 0]}},
            ["mount.orientation", "of length 1.414", "unit quaternion"],
        ),
        ({"kind": "cup", "radius": 0.03, "mount": {"pose": [0, 0, 0]}}, ["tool.mount", "'pose'"]),
        (
            {
                "kind": "mesh",
                "file": "bar.obj",
                "fingers": ["bar.obj", "parts/other.obj"],
                "tool_point": [0, 0, 0.1],
            },
            ["fingers are at 0, 50 mm", "either side"],
        ),
        ({"kind": "mesh", "tool_point": [0, 0, 0.1]}, ["tool: must have exactly one of file, par"]),
        (MESH | {"file": "no.obj"}, ["no.obj", "No such file"]),
        (MESH | {"scale": 1.0}, ["cup.obj", "millimetres? then give it the scale 0.001"]),
    ],
)
def test_refused(tool: object, words: list[str], folder: Path) -> None:
    with pytest.raises(InvalidSceneError) as caught:
        scene_with(tool, folder)
    assert caught.value.message.startswith("my.yaml: ")
    for word in words:
        assert word in caught.value.message


def test_a_tool_of_an_unknown_kind_made_in_python_is_refused(tmp_path: Path) -> None:
    scene = Scene("s", "panda", scene_with(None, tmp_path).objects, tool=ToolSpec("claw"))
    with pytest.raises(InvalidSceneError, match=r"tool\.kind is 'claw'; valid are cup"):
        resolve(scene)
