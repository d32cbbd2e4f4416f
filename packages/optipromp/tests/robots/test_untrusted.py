"""A robot that a file names runs no code and reads no file elsewhere."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from tests.cli.fixtures import completed, invoke, refused
from tests.robots.links import BALL, joint
from tests.robots.meshes import mesh, with_mesh

from optipromp import load_plan, plan
from optipromp.cli.robot import Named
from optipromp.core.errors import InvalidRobotError, InvalidSceneError, OptiPrompError
from optipromp.core.output import write_plan
from optipromp.core.planning import PlanOptions
from optipromp.core.robots import Choice, load_robot
from optipromp.core.robots.library import UNTRUSTED, load_arm
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.scene import bare_robot
from optipromp.readers import packages
from optipromp_bench.experiments.rows import Row
from optipromp_bench.experiments.trials import setting_of

CODE = (
    "${(lambda: [c for c in ().__class__.__base__.__subclasses__() "
    "if c.__name__ == '_wrap_close'][0].__init__.__globals__['system']('touch %s'))()}"
)
LINKS = f'<link name="a"/><link name="b">{BALL}</link>'
URDF = f'<robot name="r">{LINKS}{joint("ab", "a", "b")}</robot>'
GOAL = {"format": 1, "name": "s", "goal": {"joints": [0.5]}, "objects": []}


@pytest.fixture
def far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder beside that of the scene, which is the working directory; what is in it is not."""
    for name in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "OPTIPROMP_FOLDERS"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "far").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "far"


def scene(robot: str) -> Path:
    Path("scene.yaml").write_text(yaml.safe_dump(GOAL | {"robot": robot}))
    return Path("scene.yaml")


def xacro(mark: Path, name: str = "arm.xacro") -> Path:
    """A xacro file that makes the file ``mark`` when it is expanded, and is an arm."""
    pytest.importorskip("xacrodoc")
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    code = f'<xacro:property name="zero" value="{CODE % mark}"/>'
    body = LINKS + joint("ab", "a", "b", origin='<origin xyz="${zero} 0 0"/>')
    Path(name).write_text(f"{head}{code}{body}</robot>")
    return Path(name)


def test_a_xacro_that_a_scene_names_is_not_run(far: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = far / "mark"
    named = scene(str(xacro(mark)))
    for command in (["check", str(named)], ["plan", str(named), "--out", "out"]):
        assert "OPTIPROMP_ALLOW_XACRO=1" in refused(*command)
        assert not mark.exists()
    Path("arm.yaml").write_text("format: 1\nname: r\nurdf: arm.xacro\n")
    with pytest.raises(InvalidRobotError, match="named by a file"):
        bare_robot(load_scene(scene("arm.yaml")))
    with pytest.raises(InvalidRobotError, match="named by a file"):
        load_robot("arm.yaml")
    assert not mark.exists()
    monkeypatch.setenv("OPTIPROMP_ALLOW_XACRO", "1")
    bare_robot(load_scene(named))
    assert mark.exists()


def test_a_xacro_that_the_user_names_is_run(far: Path) -> None:
    mark = far / "mark"
    arm = xacro(mark)
    load_robot(arm)
    assert mark.exists()
    mark.unlink()
    arm.write_text(arm.read_text())  # or the robot would be kept, and not expanded again
    completed("check", str(arm))
    assert mark.exists()


def test_of_a_scene_only_the_robot_that_the_user_names_is_trusted(far: Path) -> None:
    arm = xacro(far / "mark")
    read = load_scene(scene(str(arm)))
    with pytest.raises(InvalidRobotError, match="named by a file"):
        bare_robot(Named(None, Choice(tip="b")).of(read))
    assert not (far / "mark").exists()
    assert bare_robot(Named(str(arm), Choice()).of(read)).n_joints == 1


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
def test_a_plan_and_a_study_run_no_xacro(far: Path) -> None:
    mark = far / "mark"
    Path("arm.urdf").write_text(URDF)
    made = plan(load_scene(scene("arm.urdf")), options=PlanOptions(timeout=60.0))
    write_plan(made, Path("made"))
    stated = json.loads(Path("made/plan.json").read_text())
    stated["scene_file"]["robot"] = f"../{xacro(mark)}"
    Path("made/plan.json").write_text(json.dumps(stated))
    with pytest.raises(OptiPrompError, match="named by a file"):
        load_plan("made")
    for command in ("check", "report"):
        assert invoke(command, "made").exit_code == 2
    with pytest.raises(InvalidRobotError, match="named by a file"):
        setting_of(Row("cluster", 0), str(Path("arm.xacro").absolute()))
    assert not mark.exists()


def test_an_expression_without_end_is_cut(far: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = xacro(far / "mark")
    arm.write_text(arm.read_text().replace('name="ab"', f'name="{"${10**10**10}"}"'))
    monkeypatch.setattr(packages, "LIMITS", replace(packages.LIMITS, time=3.0))
    with pytest.raises(InvalidRobotError, match=r"arm\.xacro.*within 3 s"):
        load_robot(arm)
    arm.write_text(arm.read_text().replace("10**10**10", "len(list(map(str, [0] * 10**9)))"))
    monkeypatch.setattr(packages, "LIMITS", replace(packages.LIMITS, time=60.0, memory=5e8))
    with pytest.raises(InvalidRobotError, match=r"arm\.xacro.*10\*\*9"):
        load_robot(arm)


def arm_of(file: str) -> str:
    Path("arm.urdf").write_text(with_mesh(file))
    return "arm.urdf"


def linked(far: Path) -> str:
    Path("link.obj").symlink_to(far / "part.obj")
    return arm_of("link.obj")


def robot_file(text: str) -> str:
    Path("arm.yaml").write_text(f"format: 1\nname: r\n{text}")
    return "arm.yaml"


def spheres(far: Path) -> str:
    """The mesh is not needed, but pictures would show it."""
    arm_of(f"{far}/part.obj")
    return robot_file("urdf: arm.urdf\nspheres: {b: [[0, 0, 0, 0.1]]}")


def mjcf(what: str) -> str:
    arm = '<body><joint range="-1 1"/><geom size=".1"/></body>'
    Path("arm.xml").write_text(f"<mujoco>{what}<worldbody>{arm}</worldbody></mujoco>")
    return "arm.xml"


def include(far: Path) -> str:
    (far / "more.xml").write_text("<mujoco><option/></mujoco>")
    return mjcf(f'<include file="{far}/more.xml"/>')


HOLES: dict[str, Callable[[Path], str]] = {
    "absolute": lambda far: arm_of(f"{far}/part.obj"),
    "dots": lambda far: arm_of("../far/part.obj"),
    "URI": lambda far: arm_of(f"file://{far}/part.obj"),
    "link": linked,
    "package over the URDF": lambda far: arm_of("package://far/part.obj"),
    "spheres": spheres,
    "robot file's URDF": lambda far: robot_file(f"urdf: {far}/arm.urdf"),
    "robot file's SRDF": lambda far: robot_file(f"urdf: arm.urdf\nsrdf: {far}/arm.srdf"),
    "robot file's packages": lambda far: robot_file("urdf: arm.urdf\npackage_dirs: [../far]"),
    "MJCF, include": include,
    "MJCF, no XML": lambda far: mjcf('<include file="/etc/passwd"/>'),
    "MJCF, mesh": lambda far: mjcf(f'<asset><mesh file="{far}/part.obj"/></asset>'),
    "MJCF, folder": lambda far: mjcf(
        f'<compiler meshdir="{far}"/><asset><mesh file="part.obj"/></asset>'
    ),
    "MJCF, texture": lambda far: mjcf(
        f'<asset><texture type="cube" fileright="{far}/part.obj"/></asset>'
    ),
}


@pytest.mark.parametrize("hole", HOLES)
def test_a_robot_of_a_scene_reads_nothing_elsewhere(far, hole, monkeypatch):
    pytest.importorskip("mujoco")
    mesh(far)
    for name, text in (("arm.urdf", URDF), ("arm.srdf", '<robot name="r"/>')):
        (far / name).write_text(text)
        shutil.copy(far / name, name)
    read = load_scene(scene(HOLES[hole](far)))
    with pytest.raises(InvalidRobotError, match=r"outside the folder|not there or is no XML"):
        bare_robot(read)
    if "no XML" not in hole and "texture" not in hole:
        monkeypatch.setenv("OPTIPROMP_FOLDERS", str(far))
        assert bare_robot(read).n_joints == 1
        monkeypatch.delenv("OPTIPROMP_FOLDERS")
        load_robot(read.robot)  # which the user names; kept, but not for the scene
        with pytest.raises(InvalidRobotError, match="outside the folder"):
            bare_robot(read)


def test_packages_of_the_users_environment_are_allowed(far, monkeypatch):
    mesh(far / "my_arm")
    read = load_scene(scene(arm_of("package://my_arm/part.obj")))
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(far))
    assert bare_robot(read).n_joints == 1
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    assert load_arm("arm.urdf", None, Choice(package_dirs=(far,)))[0].n_joints == 1
    with pytest.raises(InvalidRobotError, match="no folder 'my_arm'"):
        load_arm("arm.urdf", None, UNTRUSTED)


def test_a_scene_names_no_file_elsewhere(far: Path) -> None:
    (far / "arm.urdf").write_text(URDF)
    Path("arm.urdf").write_text(URDF)
    Path("link.urdf").symlink_to(far / "arm.urdf")
    for robot in (
        f"{far}/arm.urdf", "../far/arm.urdf", "link.urdf",
        {"file": "arm.urdf", "srdf": f"{far}/arm.urdf"},
        {"file": "arm.urdf", "package_dirs": ["../far"]},
    ):  # fmt: skip
        with pytest.raises(InvalidSceneError, match="outside the folder"):
            load_scene(scene(robot))  # type: ignore[arg-type]
