"""Meshes in packages, DAE meshes, and xacro."""

import sys
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import completed
from tests.robots.links import Writer
from tests.robots.meshes import mesh, with_mesh

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import load_robot
from optipromp.readers.packages import package_folders


def reach(path: Path, **choice: object) -> float:
    """The farthest point [m] of the spheres, in the frame of the link b."""
    spheres = load_robot(path, **choice).spheres  # type: ignore[arg-type]
    return float((np.linalg.norm(spheres.center, axis=1) + spheres.radius).max())


@pytest.fixture(autouse=True)
def no_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):
        monkeypatch.delenv(name, raising=False)


WHERE = {  # folder of the package, argument, variable
    "over the URDF": ("robot.pkg", None, None),
    "the package given": ("far/my_arm", "far/my_arm", None),
    "its parent given": ("far/my_arm", "far", None),
    "ament": ("ws/share/my_arm", None, ("AMENT_PREFIX_PATH", "ws")),
    "ROS 1": ("src/my_arm", None, ("ROS_PACKAGE_PATH", "src")),
    "ROS 1, the package": ("src/my_arm", None, ("ROS_PACKAGE_PATH", "src/my_arm")),
}


@pytest.mark.parametrize("case", WHERE)
def test_packages(write, tmp_path, monkeypatch, case):
    folder, given, variable = WHERE[case]
    mesh(tmp_path / folder.replace("robot.pkg", "my_arm") / "meshes")
    path = write(with_mesh("package://my_arm/meshes/part.obj"))
    if variable:
        monkeypatch.setenv(variable[0], f"/nowhere:{tmp_path / variable[1]}")
    assert 0.1 <= reach(path, package_dirs=[tmp_path / given] if given else []) < 0.2


def test_three_slashes(write: Writer, tmp_path: Path) -> None:
    mesh(tmp_path / "my_arm")
    assert reach(write(with_mesh("package:///my_arm/part.obj"))) < 0.2


def test_what_is_given_comes_first(write: Writer, tmp_path: Path) -> None:
    mesh(tmp_path / "my_arm", size=1.0)
    mesh(tmp_path / "other" / "my_arm", size=3.0)
    path = write(with_mesh("package://my_arm/part.obj"))
    assert reach(path) < 0.2
    assert reach(path, package_dirs=[tmp_path / "other"]) >= 0.3
    completed("check", str(path), "--package-dir", str(tmp_path / "other"))
    head = "format: 1\nname: mine\nurdf: robot.urdf\npackage_dirs: [other]\n"
    assert reach(write(head, "mine.yaml")) >= 0.3


def test_a_mesh_in_no_package(write: Writer, tmp_path: Path) -> None:
    path = write(with_mesh("package://my_arm/part.obj"))
    with pytest.raises(InvalidRobotError) as caught:
        load_robot(path)
    for word in ("robot.urdf", "link 'b'", "package://my_arm/part.obj", "no folder 'my_arm'",
                 "package_dirs=", "AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH"):  # fmt: skip
        assert word in caught.value.message
    (tmp_path / "my_arm").mkdir()
    with pytest.raises(InvalidRobotError, match=r"not in .*my_arm"):
        load_robot(path)
    spheres = "format: 1\nname: n\nurdf: robot.urdf\nspheres: {b: [[0, 0, 0, 0.1]]}\n"
    assert load_robot(write(spheres, "own.yaml")).n_joints == 1  # the mesh is not needed


def test_dae(write: Writer, tmp_path: Path) -> None:
    pytest.importorskip("collada")
    mesh(tmp_path, "part.dae")
    mesh(tmp_path, "part.obj")
    in_dae = reach(write(with_mesh("part.dae")))
    assert in_dae == pytest.approx(reach(write(with_mesh("part.obj"))), rel=0.05)


def test_a_scale_beyond_all_numbers_is_refused(write: Writer, tmp_path: Path) -> None:
    mesh(tmp_path, "part.obj")
    with pytest.raises(InvalidRobotError, match="beyond 20 m: millimetres"):
        load_robot(write(with_mesh('part.obj" scale="-1e300 1 1')))


def test_unit_of_dae(write: Writer, tmp_path: Path) -> None:
    pytest.importorskip("collada")
    file = mesh(tmp_path / "my_arm", "part.dae", size=1000.0)  # a part of 0.1 m in millimetres
    unit = '<unit name="millimeter" meter="0.001"/><up_axis>'
    file.write_text(file.read_text().replace("<up_axis>", unit))
    assert 0.1 <= reach(write(with_mesh("my_arm/part.dae"))) < 0.2
    assert 0.1 <= reach(write(with_mesh("package://my_arm/part.dae"))) < 0.2


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="length" default="0.3"/>
<xacro:include filename="$(find my_arm)/parts.xacro"/>
<link name="a"/>
<link name="b"><collision><geometry>
<mesh filename="package://my_arm/part.obj"/></geometry></collision></link>
<xacro:hinge name="ab" parent="a" child="b" z="${2 * $(arg length)}"/>
</robot>"""
PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:macro name="hinge" params="name parent child z">
<joint name="${name}" type="revolute"><parent link="${parent}"/><child link="${child}"/>
<origin xyz="0 0 ${z}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>
</xacro:macro></robot>"""


def test_xacro(write: Writer, tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    mesh(tmp_path / "else" / "my_arm")
    (tmp_path / "else" / "my_arm" / "parts.xacro").write_text(PARTS)
    path = write(XACRO, "robot.urdf.xacro")
    robot = load_robot(path, package_dirs=[tmp_path / "else"])
    assert robot.tool_pose(np.zeros(1))[0][2] == pytest.approx(0.6)
    with pytest.raises(InvalidRobotError, match=r"\.xacro: xacro cannot expand it.*my_arm"):
        load_robot(path)


def test_xacro_without_the_extra(write: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(InvalidRobotError) as caught:
        load_robot(write(XACRO, "robot.urdf.xacro"))
    for word in (
        "robot.urdf.xacro",
        "pip install -e 'packages/optipromp[xacro]'",
        "xacro robot.urdf.xacro > robot.urdf",
    ):
        assert word in caught.value.message


def test_a_package_has_the_name_that_its_package_xml_states(tmp_path: Path) -> None:
    folder = tmp_path / "arm-main"
    (folder / "meshes").mkdir(parents=True)
    words = "<?xml version='1.0'?><!-- <name>other</name> --><package format='3'>{}</package>"
    (folder / "package.xml").write_text(words.format("<name>arm_description</name>"))
    (folder / "urdf").mkdir()
    inside, beside = folder / "urdf" / "a.urdf", tmp_path / "b.urdf"
    assert package_folders("arm_description", inside) == [folder]
    assert package_folders("arm_description", beside) == [folder]
    assert package_folders("arm_description", beside, [folder]) == [folder]
    assert package_folders("other", inside) == []
