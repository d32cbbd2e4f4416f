"""The looks of robots and scenes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.geometry import Box, Cylinder
from optipromp.core.geometry.faces import sphere
from optipromp.core.planning.task import resolve
from optipromp.core.robots import Tool, load_robot
from optipromp.core.robots.tools import TOOL_LINK, Cup, FrankaHand, with_tool
from optipromp.core.scenes import Stem, load_scene
from optipromp.looks.appearance import arm_parts, coarser, scene_parts, scenery, shape_faces

SCENES = [f"scenario-{k}" for k in (1, 2, 3, 4)]

CUBE = "\n".join(
    [f"v {x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    + ["f 1 3 4 2", "f 5 6 8 7", "f 1 2 6 5", "f 3 7 8 4", "f 1 5 7 3", "f 2 4 8 6"]
)
ARM = """<robot name="own">
  <link name="base">{visual}<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>
  </link>
  <link name="fore"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="fore"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1"/></joint>
</robot>"""


@pytest.mark.parametrize("name", SCENES)
def test_every_part_is_a_sound_surface(name: str) -> None:
    task = resolve(load_scene(name))
    for parts in (arm_parts(task.robot), scene_parts(task.scene)):
        assert len({part.name for part in parts}) == len(parts)
        for part in parts:
            assert np.isfinite(part.vertices).all()
            assert 0 <= part.faces.min() <= part.faces.max() < len(part.vertices)
            assert -1 <= part.segment < task.robot.n_segments
            assert 0.0 < part.opacity <= 1.0
            a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
            assert (np.linalg.norm(np.cross(b - a, c - a), axis=1) > 0.0).all()
    assert {item.id for item in task.scene.objects} == {
        part.owner for part in scene_parts(task.scene) if part.owner
    }


def test_an_arm_without_meshes_shows_the_hulls_of_its_spheres() -> None:
    robot = load_robot("scara")
    cover = robot.spheres
    for part in arm_parts(robot):
        if part.name in robot.link_names:
            rows = cover.link == robot.link_names.index(part.name)
            low = (cover.center[rows] - cover.radius[rows, None]).min(axis=0)
            high = (cover.center[rows] + cover.radius[rows, None]).max(axis=0)
            np.testing.assert_allclose(part.vertices.min(axis=0), low, atol=1e-3)
            np.testing.assert_allclose(part.vertices.max(axis=0), high, atol=1e-3)
    assert {"base", "lift", "upper_arm", "forearm", "joint:1", "joint:2"} == {
        part.name for part in arm_parts(robot)
    }


@pytest.mark.parametrize("tool", [Cup(0.04), Cup(0.04, taper=45), FrankaHand()])
def test_a_tool_looks_as_large_as_it_is(tool: Tool) -> None:
    robot = with_tool(load_robot("panda"), tool)
    parts = [part for part in arm_parts(robot) if part.name.startswith(TOOL_LINK)]
    points = np.concatenate([part.vertices for part in parts]) - robot.flange_translation
    heights = points @ robot.flange_rotation[:, 2]
    assert heights.max() == pytest.approx(robot.tool.tip, abs=4e-3)
    assert heights.min() == pytest.approx(0.0, abs=0.03)  # the maker's hand encloses the flange
    if isinstance(tool, Cup):
        mouth = next(part for part in parts if part.name == "tool/mouth").vertices
        low = (mouth - robot.flange_translation) @ robot.flange_rotation[:, 2]
        assert low.min() == pytest.approx(tool.front - tool.cone)


def test_visual_meshes_are_shown_and_missing_ones_are_not_missed(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    mesh = '<visual><geometry><mesh filename="{}" scale="0.1 0.1 0.4"/></geometry></visual>'
    (tmp_path / "cube.obj").write_text(CUBE)
    shown = {}
    for name in ("cube.obj", "gone.obj", "package://gone/cube.obj"):
        (tmp_path / "own.urdf").write_text(ARM.format(visual=mesh.format(name)))
        robot = load_robot(tmp_path / "own.urdf")
        shown[name] = next(part for part in arm_parts(robot) if part.name == "base").vertices
    assert shown["cube.obj"].max(axis=0).tolist() == [0.1, 0.1, 0.4]
    for name in ("gone.obj", "package://gone/cube.obj"):
        np.testing.assert_allclose(np.abs(shown[name]), 0.1)  # the box


def test_stems_hang_from_a_gutter_over_them_or_from_what_the_scene_has() -> None:
    free = load_scene("scenario-3")
    parts = {part.name: part for part in scenery(free)}
    roots = np.array([item.stem.root for item in free.objects if item.stem is not None])
    low, high = parts["gutter"].vertices.min(axis=0), parts["gutter"].vertices.max(axis=0)
    assert roots[:, 2].max() < low[2] < roots[:, 2].max() + 0.01
    assert ((low < roots) | [False, False, True]).all()
    assert (roots < high).all()
    assert set(parts) == {"floor", "gutter", "soil", "hangers"}  # no posts that nobody placed
    assert {part.name for part in scenery(load_scene("scenario-1"))} <= {"floor", "hangers"}
    assert "posts" in {part.name for part in scenery(free, props=True)}


def test_stems_of_one_height_hang_from_a_gutter() -> None:
    scene = load_scene("scenario-4")
    for height in (1.0, 2.01):  # rounding left the second no hanger, and drawing ended in an error
        root = np.array([0.45, 0.0, height])
        alone = replace(scene.objects[0], stem=Stem(np.array([scene.objects[0].position, root])))
        parts = {part.name: part for part in scene_parts(replace(scene, objects=(alone,)))}
        hangers = parts["hangers"].vertices[:, 2]
        assert hangers.min() <= height <= parts["gutter"].vertices[:, 2].min() <= hangers.max()


def test_a_floor_of_kilometres_is_drawn_with_few_faces() -> None:
    for shape in (Box((1e4, 1e4, 0.1)), Cylinder(0.1, 1e6)):
        assert len(shape_faces(shape, np.zeros(3), np.eye(3))) < 50_000


def test_a_coarser_mesh_is_smaller_and_where_it_was() -> None:
    quads = sphere(np.zeros(3), 0.1, 100)
    corners = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    few = coarser(corners, 0.02)
    assert len(few) < 0.2 * len(corners)
    assert np.linalg.norm(few, axis=-1).min() > 0.08
