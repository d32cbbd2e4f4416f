"""xacro: its arguments, where it runs, and how often."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from tests.cli.fixtures import completed, invoke, refused
from tests.robots.links import joint
from tests.scenes.six_joints import six

from optipromp.core.errors import InvalidRobotError, InvalidSceneError
from optipromp.core.robots import load_robot
from optipromp.core.robots.library import Choice, load_arm
from optipromp.core.scenes import load_scene, save_scene
from optipromp.core.scenes.scene import bare_robot
from optipromp.readers import packages

pytest.importorskip("xacrodoc")

ARM = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="length" default="0.3"/><xacro:arg name="twice" default="false"/>
<xacro:arg name="upper" default="1"/>
<xacro:property name="both" value="$(arg twice)"/><xacro:include filename="parts.xacro"/>
<link name="a"/><link name="b"><collision><geometry><sphere radius="$(arg radius)"/></geometry>
</collision></link>
<xacro:hinge name="ab" z="${$(arg length) * (2 if both else 1)}"/></robot>"""
PARTS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="radius" default="0.1"/>
<xacro:macro name="hinge" params="name z">%s</xacro:macro></robot>"""
HINGE = joint("${name}", "a", "b", origin='<origin xyz="0 0 ${z}"/>')
HINGE = HINGE.replace('upper="1"', 'upper="$(arg upper)"')
GOAL = {"format": 1, "name": "s", "goal": {"joints": [0.5]}, "objects": []}


@pytest.fixture
def arm(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("parts.xacro").write_text(PARTS % HINGE)
    path = Path(getattr(request, "param", "arm.urdf.xacro"))
    path.write_text(ARM)
    return path


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the xacro files that are expanded."""
    done: list[str] = []

    def run(program: str, path: Path, *rest: object) -> bytes:
        done.append(path.name)
        return real(program, path, *rest)  # type: ignore[arg-type]

    real: Callable[..., bytes] = packages.run_limited
    monkeypatch.setattr(packages, "run_limited", run)
    return done


def height(path: Path, **choice: object) -> float:
    return float(load_robot(path, **choice).kinematics.translation[0, 2])  # type: ignore[arg-type]


@pytest.mark.parametrize("arm", ["arm.urdf.xacro", "arm.urdf"], indirect=True)
def test_arguments_replace_the_defaults(arm: Path) -> None:
    assert height(arm) == pytest.approx(0.3)
    assert height(arm, args={"length": 0.5}) == pytest.approx(0.5)
    assert height(arm, args={"length": "0.5", "twice": True}) == pytest.approx(1.0)
    wide = load_robot(arm, args={"radius": 0.2})  # declared by the file that is included
    assert wide.spheres.radius.max() == pytest.approx(0.2)


def test_an_unknown_argument_is_refused(arm: Path) -> None:
    with pytest.raises(InvalidRobotError, match=r"'lenght': valid are .*did you mean 'length'"):
        load_robot(arm, args={"lenght": 0.5})
    Path("plain.urdf").write_text(ARM.split("<xacro")[0] + '<link name="a"/></robot>')
    with pytest.raises(InvalidRobotError, match=r"plain\.urdf: takes no args \(length\)"):
        load_robot("plain.urdf", args={"length": 0.5})


def test_the_command_line_gives_arguments(arm: Path) -> None:
    check = "check", arm, "--json", "--robot-arg"

    def upper(*more: str) -> object:
        return json.loads(invoke(*check[:3], *more).stdout)["upper"]

    assert upper() == [1.0]
    assert upper("--robot-arg", "upper:=1.5", "--robot-arg", "length:=0.5") == [1.5]
    assert "must be name:=value" in refused("check", arm, "--robot-arg", "length=0.5")


def test_a_scene_states_arguments_and_runs_no_xacro(arm, runs, monkeypatch):
    robot = {"file": str(arm), "args": {"length": 0.5, "twice": True}}
    Path("scene.yaml").write_text(yaml.safe_dump(GOAL | {"robot": robot}))
    scene = load_scene("scene.yaml")
    save_scene(scene, "again.yaml")
    assert yaml.safe_load(Path("again.yaml").read_text())["robot"] == robot
    with pytest.raises(InvalidRobotError, match="named by a file"):
        bare_robot(scene)
    assert not runs
    monkeypatch.setenv("OPTIPROMP_ALLOW_XACRO", "1")
    assert bare_robot(scene).kinematics.translation[0, 2] == pytest.approx(1.0)
    Path("scene.yaml").write_text(yaml.safe_dump(GOAL | {"robot": robot | {"arg": {}}}))
    with pytest.raises(InvalidSceneError, match="did you mean 'args'"):
        load_scene("scene.yaml")


def test_a_robot_file_states_arguments(arm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPTIPROMP_ALLOW_XACRO", "1")
    Path("mine.yaml").write_text(f"format: 1\nname: r\nurdf: {arm}\nargs: {{length: 0.5}}\n")
    assert height(Path("mine.yaml")) == pytest.approx(0.5)
    assert height(Path("mine.yaml"), args={"twice": "true"}) == pytest.approx(1.0)


def test_xacro_runs_once_a_process(arm: Path, runs: list[str]) -> None:
    """Until a file that it read, an argument or a variable of the environment changes."""
    first = load_robot(arm)
    assert load_robot(arm) is first
    assert len(runs) == 1
    load_robot(arm, args={"length": 0.5})
    load_robot(arm, args={"length": 0.5})
    assert len(runs) == 2
    included = Path("parts.xacro")
    included.write_text(included.read_text().replace('default="0.1"', 'default="0.25"'))
    assert load_robot(arm).spheres.radius.max() == pytest.approx(0.25)
    assert len(runs) == 3
    os.environ["OPTIPROMP_TEST_OF_XACRO"] = "1"
    try:
        load_robot(arm)
    finally:
        del os.environ["OPTIPROMP_TEST_OF_XACRO"]
    assert len(runs) == 4


def test_scenes_of_a_xacro_keep_its_arguments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
    text = six(0.6).replace("<robot ", head).replace('upper="3"', 'upper="$(arg upper)"')
    declared = '<xacro:arg name="upper" default="2"/><link name="base"/>'
    Path("six.urdf").write_text(text.replace('<link name="base"/>', declared))
    command = ["generate", "--preset", "cluster", "--robot", "six.urdf", "--out", "scenes"]
    result = completed(*command, "--robot-arg", "upper:=3.1")
    assert "OPTIPROMP_ALLOW_XACRO=1" in result.output
    stated = yaml.safe_load(Path("scenes/cluster-0.yaml").read_text())
    assert stated["robot"] == {"file": "../six.urdf", "args": {"upper": "3.1"}}
    refused("check", "scenes/cluster-0.yaml")
    monkeypatch.setenv("OPTIPROMP_ALLOW_XACRO", "1")
    assert bare_robot(load_scene("scenes/cluster-0.yaml")).upper[0] == pytest.approx(3.1)


def test_xacro_in_a_comment_is_no_xacro(arm: Path, runs: list[str]) -> None:
    """As in every file that xacro has written."""
    text = packages.expanded(arm, [], {}, named_by_user=True)[0].decode()
    done = Path("done.urdf")
    text = text.replace("<robot", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"', 1)
    done.write_text(text.replace("<link", "<!-- <xacro:hinge/> --><link", 1))
    runs.clear()
    assert height(done) == pytest.approx(0.3)
    assert not runs


def test_an_argument_may_be_used_that_no_file_declares(arm: Path) -> None:
    arm.write_text(ARM.replace('name="r"', 'name="$(arg model)"'))
    with pytest.raises(InvalidRobotError, match="argument model: give it, as --robot-arg model:="):
        load_robot(arm)
    assert load_arm(str(arm), choice=Choice(args={"model": "mine"}))[0].name == "mine"
