"""Resolved robot files: the same robot to the bit without its description; refused if wrong."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.refusals import assert_refused
from tests.robots.links import Writer

from optipromp import load_scene
from optipromp.core.errors import InvalidRequestError, InvalidRobotError
from optipromp.core.files import npz
from optipromp.core.robots import Cup, Robot, load_robot, robot_names, save_robot, with_tool
from optipromp.core.robots.library import _DATA, NOTHING, READERS, _readers, load_arm
from optipromp.core.robots.resolved import ARRAYS
from optipromp.core.scenes.scene import bare_robot
from optipromp.readers.reading import read_description

BARE = """
import sys
for name in ("trimesh", "coal", "xacrodoc", "mujoco", "optipromp.readers"):
    sys.modules[name] = None
from optipromp.core.robots import load_robot
print(load_robot(sys.argv[1]).spheres.radius.tobytes().hex())
"""


def assert_same(one: Any, other: Any, atol: float = 0.0) -> None:
    """Whether two values are the same, arrays within them to the bit or within ``atol``."""
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=0.0, atol=atol)
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b, atol)
    else:
        assert one == other


def assert_same_robot(one: Robot, other: Robot, atol: float = 0.0) -> None:
    for each in fields(Robot):
        assert_same(getattr(one, each.name), getattr(other, each.name), atol)


@pytest.fixture
def meshed(urdf: Writer, tmp_path: Path) -> Path:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.capsule(0.2, 0.04).export(tmp_path / "b.stl")
    mesh = '<collision><geometry><mesh filename="b.stl"/></geometry></collision>'
    mass = '<inertial><mass value="2"/><origin xyz="0 0 0.1"/></inertial>'
    return urdf(links=f'<link name="a"/><link name="b">{mesh}{mass}</link><link name="c"/>')


def test_a_saved_robot_is_the_same_to_the_bit(meshed: Path, tmp_path: Path) -> None:
    first = load_robot(meshed, tip="c")
    save_robot(first, tmp_path / "arm.robot")
    again, arm = load_arm("arm.robot", tmp_path)
    assert_same_robot(first, again)
    assert arm == first.arm
    meshed.unlink()
    (tmp_path / "b.stl").unlink()
    command = [sys.executable, "-c", BARE, str(tmp_path / "arm.robot")]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert bytes.fromhex(told) == first.spheres.radius.tobytes()


@pytest.mark.parametrize("name", robot_names())
def test_a_built_in_robot_is_what_the_readers_give(name: str) -> None:
    """After a change of the readers or of robots/data: python scripts/built_in_robots.py."""
    made = read_description(_DATA / f"{name}.yaml", NOTHING, Path)
    assert_same_robot(load_robot(name), made, atol=1e-12)


def test_every_robot_file_of_the_package_is_resolved() -> None:
    assert {path.stem for path in _DATA.glob("*.yaml")} == set(robot_names())


def changed(key: str, change: Callable[[Any], Any]) -> Callable[[dict[str, Any]], None]:
    def _change(data: dict[str, Any]) -> None:
        data[key] = change(data[key])

    return _change


def worded(old: str, new: str) -> Callable[[dict[str, Any]], None]:
    return changed("robot", lambda text: np.array(str(text).replace(old, new)))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda data: data.pop("robot"), "lacks 'robot'"),
        (lambda data: data.pop("lower"), "lacks 'lower'"),
        (lambda data: data.pop("dynamics mass"), "lacks 'dynamics mass'"),
        (worded('"version": 1', '"version": 2'), "version: Input should be 1"),
        (worded('"held_joints"', '"more"'), "held_joints"),
        (worded('["joint1"', '["joint2"'), "names of joints and of links must differ"),
        (worded('["joint1"', '["a\\u001b[2J"'), "without control characters"),
        (worded('"why": "', '"why": "\\u001b[2J'), "a text in it holds control characters"),
        (changed("kinematics dof", lambda a: a + 1), "'kinematics dof' must lie in 0 to 6"),
        (changed("kinematics kind", lambda a: a + 5), "'kinematics kind' must lie in 0 to 1"),
        (changed("spheres segment", lambda a: a - 1), "'spheres segment' must lie in -1 to 6"),
        (changed("spheres link", lambda a: a + 99), "'spheres link' must lie in 0"),
        (changed("self_pairs", lambda a: a + 60), "'self_pairs' must lie in 0 to 59"),
        (changed("spheres center", lambda a: a * np.nan), "not finite"),
        (changed("spheres radius", lambda a: -a), "'spheres radius' must be positive"),
        (changed("spheres radius", lambda a: a[:-1]), "'spheres radius' must be float64 (60,)"),
        (changed("home", lambda a: a + 9.0), "'home' must lie within"),
        (changed("kinematics rotation", lambda a: 2.0 * a), "must hold rotations"),
        (changed("kinematics axis", lambda a: 2.0 * a), "vectors of length 1"),
        (changed("lower", lambda a: a.astype(np.float32)), "'lower' must be float64 (7,)"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path, change, told):
    data = dict(np.load(_DATA / "panda.robot"))
    assert set(data) == {"robot", *ARRAYS}
    change(data)
    (tmp_path / "arm.robot").write_bytes(npz(data))
    words = "arm.robot is no resolved robot file: ", told
    assert_refused(InvalidRobotError, words, load_robot, tmp_path / "arm.robot")


def test_what_cannot_be_saved_or_chosen(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequestError, match="without_tool"):
        save_robot(with_tool(load_robot("panda"), Cup(0.03)), tmp_path / "arm.robot")
    with pytest.raises(InvalidRequestError, match=r"must end in \.robot"):
        save_robot(load_robot("panda"), tmp_path / "arm.yaml")
    save_robot(load_robot("panda"), tmp_path / "arm.robot")
    with pytest.raises(InvalidRobotError, match="resolved: it takes no arm, tip"):
        load_robot(tmp_path / "arm.robot", tip="panda_link8")


def test_a_scene_names_no_resolved_robot_with_meshes_elsewhere(meshed, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    save_robot(load_robot(meshed), tmp_path / "here" / "arm.robot")
    scene = {"format": 1, "name": "s", "goal": {"joints": [0.5, -0.4]}, "objects": []}
    Path("scene.yaml").write_text(yaml.safe_dump(scene | {"robot": "arm.robot"}))
    with pytest.raises(InvalidRobotError, match="outside the folder"):
        bare_robot(load_scene("scene.yaml"))
    assert load_robot("arm.robot").n_joints == 2


READER = """
from optipromp.core.robots import load_robot
def read(path, choice, check):
    return load_robot(check(path.with_name(path.read_text())))
"""


def test_a_package_reads_another_format(meshed, tmp_path, monkeypatch):
    told = tmp_path / "theirs-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(f"[{READERS}]\nsdf = their_sdf:read\n")
    (tmp_path / "their_sdf.py").write_text(READER)
    (tmp_path / "arm.sdf").write_text(meshed.name)
    with pytest.raises(InvalidRobotError, match=r"no robot .* or the path of a file that ends in"):
        load_robot(tmp_path / "arm.sdf")
    monkeypatch.syspath_prepend(tmp_path)
    _readers.cache_clear()
    assert load_robot(tmp_path / "arm.sdf") is load_robot(meshed)
    _readers.cache_clear()
