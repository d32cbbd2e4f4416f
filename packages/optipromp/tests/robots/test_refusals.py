"""Every bad robot description is one InvalidRobotError that says where and what would be right."""

import math
import os
import re
import struct
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from numba import config
from tests.refusals import assert_refused
from tests.robots.links import BALL, Writer, joint
from tests.robots.meshes import misnamed

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import load_robot
from optipromp.readers.urdf import read_urdf


def refused(path: Path, *words: str) -> None:
    assert_refused(InvalidRobotError, [path.name, *words], load_robot, path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["empty"]),
        (b"<robot name='r'><link name='a'>", ["robot.urdf:1:", "not well-formed"]),
        (b"\x00\x01\x02\x7fELF", ["robot.urdf:1:", "not well-formed"]),
        (b"<?xml version='1.0' encoding='no-such'?><robot/>", ["encoding"]),
        (b"<sdf><model/></sdf>", ["<sdf>", "<robot>"]),
        (b"<robot name='r'/>", ["no <link>"]),
        (
            "<robot name='a\u202eb'><link name='a'/><link name='b'/><joint name='j' "
            "type='continuous'><parent link='a'/><child link='b'/></joint></robot>".encode(),
            ["name 'a\\u202eb' holds control characters"],
        ),
        (b"<robot><link name='a'/></robot>", ["no movable joint", "'a'"]),
        (b"<robot><link/></robot>", ["<link> has no name"]),
        (b"<robot>\n<xacro:macro name='x'/></robot>", [":2", "xacro:macro", "expand"]),
        (b"<robot>\n\n<link name='${prefix}a'/></robot>", [":3", "${prefix}", "expand"]),
        (b"<robot>\n<link name='$(arg n)a'/></robot>", [":2", "$(arg n)", "expand"]),
    ],
)
def test_content(write: Writer, content: bytes, words: list[str]) -> None:
    refused(write(content), *words)


def test_entity_bomb(write: Writer) -> None:
    body = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 10))
    bomb = f'<!DOCTYPE robot [<!ENTITY e0 "ha">{body}]><robot name="&e9;"/>'
    refused(write(bomb), "entities")


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "{secret}">]><robot name="r">&x;</robot>',
        '<!DOCTYPE robot [<!ENTITY % x SYSTEM "{secret}"> %x;]><robot name="r"/>',
        '<!DOCTYPE robot SYSTEM "{secret}"><robot name="r"/>',
    ],
)
def test_external_entity_is_not_read(write, tmp_path, doctype, monkeypatch):
    secret = tmp_path / "secret"
    secret.write_text("<!ENTITY leaked 'secret'>")
    path = write(doctype.format(secret=secret))
    opened: list[str] = []
    monkeypatch.setattr("builtins.open", lambda *args, **_: opened.append(str(args[0])))
    monkeypatch.setattr("urllib.request.urlopen", lambda *args, **_: opened.append(str(args[0])))
    with pytest.raises(InvalidRobotError) as caught:
        load_robot(path)
    assert "leaked" not in caught.value.message
    assert not opened


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "hinge"}, ["'ab'", "'hinge'", "revolute, continuous, prismatic, fixed"]),
        ({"origin": '<origin xyz="nan 0 0"/>'}, ["'ab'", "nan", "finite"]),
        ({"origin": '<origin xyz="0,1 0 0"/>'}, ["0,1", "decimal point"]),
        ({"origin": '<origin xyz="1_0 0 0"/>'}, ["1_0"]),
        ({"origin": '<origin xyz="0 0"/>'}, ["2 numbers", "needs 3"]),
        ({"origin": '<origin xyz="0 0 333"/>'}, ["333 m", "20 m", "millimetres"]),
        ({"origin": '<origin rpy="0 90 0"/>'}, ["90", "degrees"]),
        ({"origin": "<origin/><origin/>"}, ["2 <origin>"]),
        ({"axis": '<axis xyz="0 0 0"/>'}, ["'ab'", "zero axis"]),
        ({"axis": '<axis xyz="1e-200 0 0"/>'}, ["zero axis"]),
        ({"axis": "<axis/>"}, ["no xyz"]),
        ({"limit": '<limit lower="1" upper="-1"/>'}, ["lower 1", "upper -1"]),
        ({"limit": '<limit lower="-180" upper="180"/>'}, ["180 rad", "degrees"]),
        ({"limit": ""}, ["'ab'", "no limits", "continuous"]),
        ({"kind": "prismatic", "limit": ""}, ["prismatic", "no limits"]),
        (
            {"kind": "prismatic", "limit": '<limit lower="0" upper="510"/>'},
            ["510 m", "millimetres"],
        ),
        ({"limit": '<limit lower="-1" upper="1" velocity="-2"/>'}, ["velocity is -2", "positive"]),
        ({"limit": '<limit lower="a" upper="1"/>'}, ['"a"']),
        ({"more": '<mimic joint="ab"/>'}, ["'ab'", "mimics itself"]),
        ({"more": '<mimic joint="zz"/>'}, ["'ab'", "'zz'", "not defined"]),
        ({"more": "<mimic/>"}, ["names no joint"]),
    ],
)
def test_joint(urdf: Writer, changes: dict[str, str], words: list[str]) -> None:
    refused(urdf(joint("ab", "a", "b", **changes) + joint("bc", "b", "c")), *words)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([("ab", "a", "b"), ("ab", "b", "c")], ["joint 'ab'", "twice"]),
        ([("ac", "a", "c"), ("bc", "b", "c")], ["'c'", "two parents", "'ac'", "'bc'"]),
        ([("ab", "a", "b"), ("bc", "b", "c"), ("ca", "c", "a")], ["cycle"]),
        ([("bc", "b", "c"), ("cb", "c", "b")], ["cycle", "'b'", "'c'"]),
        ([("ab", "a", "b")], ["2 roots", "'a'", "'c'"]),
        ([("ab", "a", "b"), ("bz", "b", "z")], ["'bz'", "child", "'z'", "not defined"]),
        ([("ab", "a", "b"), ("zc", "z", "c")], ["'zc'", "parent", "'z'"]),
        ([("ab", "a", "b"), ("bc", "b", "")], ["'bc'", "<child"]),
    ],
)
def test_tree(urdf: Writer, joints: list[tuple[str, str, str]], words: list[str]) -> None:
    refused(urdf("".join(joint(*ends) for ends in joints)), *words)


def test_a_joint_far_from_its_parent_is_remarked_on(urdf: Writer) -> None:
    """12 m: a crane, or a robot in millimetres."""
    far = urdf(joint("ab", "a", "b", origin='<origin xyz="0 0 12"/>') + joint("bc", "b", "c"))
    with pytest.warns(UserWarning, match=r"joint 'ab' stands 12 m .*millimetres.*scale: 0\.001"):
        load_robot(far)


@pytest.mark.parametrize(("origin", "warned"), [('xyz="0 1.57 0"', 1), ('rpy="0 1.57 0"', 0)])
def test_a_mesh_that_is_solid_far_from_where_it_is_shown_is_remarked_on(urdf, origin, warned):
    """As in a file that its makers publish: a quarter turn stands in xyz."""
    mesh = '<geometry><mesh filename="nub.stl"/></geometry>'
    shown = f'<visual><origin rpy="0 1.57 0"/>{mesh}</visual>'
    solid = f"<collision><origin {origin}/>{mesh}</collision>"
    link = f'<link name="a"/><link name="b">{shown}{solid}</link>'
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        read_urdf(urdf(joint("ab", "a", "b"), link))
    assert ["link 'b': nub.stl is solid 1.57 m off" in str(each.message) for each in told] == (
        [True] * warned
    )


def test_mimics_in_a_ring_or_of_a_fixed_joint(urdf: Writer) -> None:
    first = joint("ab", "a", "b", more='<mimic joint="bc"/>')
    refused(urdf(first + joint("bc", "b", "c", more='<mimic joint="ab"/>')), "ring", "'ab', 'bc'")
    refused(urdf(first + joint("bc", "b", "c", kind="fixed")), "'ab'", "'bc'", "fixed")


def test_mimic_limits_with_nothing_in_common(urdf: Writer) -> None:
    follower = joint("bc", "b", "c", more='<mimic joint="ab" multiplier="1" offset="5"/>')
    refused(urdf(joint("ab", "a", "b") + follower), "'bc'", "'ab'", "[-1, 1]")
    still = joint("bc", "b", "c", more='<mimic joint="ab" multiplier="0" offset="5"/>')
    refused(urdf(joint("ab", "a", "b") + still), "'bc'", "stands at 5")


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<sphere radius="0"/>', ["'a'", "radius is 0", "positive"]),
        ('<mesh filename="x.stl" scale="0 1 1"/>', ["scale", "zero"]),
    ],
)
def test_shapes_without_size_are_left_out_where_they_only_show(urdf, shape, words):
    part = f"<{{0}}><geometry>{shape}</geometry></{{0}}>"
    links = f'<link name="a">{part}</link><link name="b">{BALL}</link><link name="c"/>'
    refused(urdf(links=links.format("collision")), *words)
    robot = load_robot(urdf(links=links.format("visual")))
    assert {robot.link_names[k] for k in robot.spheres.link} == {"b"}


def test_a_mesh_that_is_a_pointer_is_named(urdf: Writer, write: Writer) -> None:
    write("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 684\n", "a.stl")
    mesh = '<collision><geometry><mesh filename="a.stl"/></geometry></collision>'
    links = f'<link name="a">{mesh}</link><link name="b"/><link name="c"/>'
    refused(urdf(links=links), "a.stl", "pointer of Git LFS", "git lfs pull")


def test_duplicate_link(urdf: Writer) -> None:
    refused(urdf(links='<link name="a"/><link name="a"/>'), "link 'a'", "twice")


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('<sphere radius="1e-160"/>', ["radius is 1e-160", "positive, 1 nm at least"]),
        ('<box size="1 1e-160 1"/>', ["1 1e-160 1", "1 nm at least"]),
        ("<sphere/>", ["no radius"]),
        ('<sphere radius="60"/>', ["60 m", "millimetres"]),
        ('<cone radius="1"/>', ["<cone>", "known: box"]),
        ("", ["needs one <geometry>"]),
        ('<sphere radius="1"/><sphere radius="1"/>', ["one shape"]),
        ("<mesh/>", ["no filename"]),
        ('<mesh filename="missing.stl"/>', ["'a'", "missing.stl", "no such file"]),
        ('<mesh filename="package://pkg/meshes/a.stl"/>', ["package://pkg", "no such file"]),
    ],
)
@pytest.mark.parametrize("tag", ["collision", "visual"])
def test_geometry(urdf: Writer, tag: str, shape: str, words: list[str]) -> None:
    link = f'<link name="a"><{tag}><geometry>{shape}</geometry></{tag}></link>'
    refused(urdf(links=link + '<link name="b"/><link name="c"/>'), *words)


def test_no_geometry_at_all(urdf: Writer) -> None:
    refused(urdf(links='<link name="a"/><link name="b"/><link name="c"/>'), "no link has")


def test_unreadable(tmp_path: Path) -> None:
    (tmp_path / "folder.urdf").mkdir()
    refused(tmp_path / "folder.urdf", "no such file")
    refused(tmp_path / "none.urdf", "no such file", "fr3, panda, scara")
    with pytest.raises(InvalidRobotError, match="built-in: fr3, panda, scara"):
        load_robot("pandda")


# -- what is accepted ------------------------------------------------------------------------


def test_utf16_loads(write: Writer, urdf: Writer) -> None:
    text = urdf().read_text()
    path = write(text.encode("utf-16"), "wide.urdf")
    assert load_robot(path).joint_names == ("ab", "bc")


def test_unnormalised_axis_same_kinematics(urdf: Writer) -> None:
    q = np.array([0.4, -0.3])
    poses = []
    for axis in ("1 2 3", "0.1 0.2 0.3", "1e200 2e200 3e200"):
        first = joint("ab", "a", "b", axis=f'<axis xyz="{axis}"/>')
        path = urdf(first + joint("bc", "b", "c"))
        poses.append(np.concatenate(load_robot(path).tool_pose(q)))
    np.testing.assert_allclose(poses[1:], [poses[0]] * 2, atol=1e-12)


def test_continuous_needs_no_limits(urdf: Writer) -> None:
    path = urdf(joint("ab", "a", "b", kind="continuous", limit="") + joint("bc", "b", "c"))
    robot = load_robot(path)
    assert robot.lower[0] == -math.inf
    assert robot.upper[0] == math.inf
    assert robot.velocity[0] == math.inf
    assert robot.velocity[1] == 2.0


def long_chain(count: int, moving: int) -> str:
    """Links in a row, a ball on every tenth; the last ``moving`` joints turn."""
    ball = '<collision><geometry><sphere radius="0.001"/></geometry></collision>'
    links = "".join(f'<link name="l{i}">{ball if i % 10 == 0 else ""}</link>' for i in range(count))
    joints = "".join(
        joint(
            f"j{i}", f"l{i}", f"l{i + 1}", origin='<origin xyz="0 0 0.001"/>',
            kind="revolute" if i >= count - 1 - moving else "fixed",
        )
        for i in range(count - 1)
    )  # fmt: skip
    return f'<robot name="long">{links}{joints}</robot>'


def test_chain_of_3000_links(write: Writer) -> None:
    robot = load_robot(write(long_chain(3000, 200)))
    assert robot.n_joints == 200
    point, _ = robot.tool_pose(np.zeros(200))
    np.testing.assert_allclose(point, [0, 0, 2.999], atol=1e-9)


def test_more_than_a_robot_may_have(write: Writer) -> None:
    refused(write(long_chain(3000, 2999)), "2999 joints", "at most 200")
    refused(write(long_chain(10_001, 1)), "10001 links", "at most 10000")
    many = "format: 1\nname: n\nurdf: robot.urdf\nspheres: {b: [%s]}\n"
    write('<robot name="r"><link name="a"/><link name="b"/>' + joint("ab", "a", "b") + "</robot>")
    rows = ", ".join(["[0, 0, 0, 0.1]"] * 2001)
    with pytest.raises(InvalidRobotError, match=r"2001 spheres cover it: must be at most 2000"):
        load_robot(write(many % rows, "many.yaml"))


def sphere_stl(path: Path, sides: int) -> None:
    """A sphere of radius 0.1 m of 2 sides² triangles, some of them without area."""
    turn, down = np.meshgrid(np.linspace(0, 2 * np.pi, sides + 1), np.linspace(0, np.pi, sides + 1))
    ring = [np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)]
    at = 0.1 * np.stack(ring, axis=-1)
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 9)
    rows = np.zeros(len(corners), dtype=[("n", "<3f4"), ("corners", "<9f4"), ("m", "<u2")])
    rows["corners"] = corners
    path.write_bytes(bytes(80) + struct.pack("<I", len(corners)) + rows.tobytes())


MESH = (
    '<link name="a"/><link name="b"><{0}><geometry><mesh filename="{1}"/></geometry></{0}></link>'
)

LOADED = """
import re, sys
from optipromp.core.robots import load_robot
load_robot(sys.argv[1])
most = re.search(r"VmHWM:\\s+(\\d+) kB", open("/proc/self/status").read())
print(int(most[1]) // 1024)  # of this process alone: getrusage tells its parent's too
"""


def test_a_fine_mesh_takes_little_memory(urdf: Writer, tmp_path: Path) -> None:
    """320,000 triangles took 1.1 GB; twenty times as many, all there was."""
    pytest.importorskip("trimesh")
    sphere_stl(tmp_path / "ball.stl", 400)
    path = urdf(joint("ab", "a", "b"), MESH.format("collision", "ball.stl"))
    environment = os.environ | {
        "OPTIPROMP_CACHE": "", "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": config.CACHE_DIR,
        "OPENBLAS_NUM_THREADS": "1",
    }  # fmt: skip
    command = [sys.executable, "-c", LOADED, str(path)]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert int(found.stdout) < 600  # MB


def test_a_mesh_too_fine_too_large_or_folded_is_refused(urdf, tmp_path, monkeypatch):
    pytest.importorskip("trimesh")
    path = urdf(joint("ab", "a", "b"), MESH.format("collision", "part.stl"))
    sphere_stl(tmp_path / "part.stl", 710)
    refused(path, "part.stl", "1008200 triangles", "at most 1000000")
    with (tmp_path / "part.stl").open("r+b") as file:
        file.truncate(64_000_001)
    refused(path.rename(tmp_path / "big.urdf"), "part.stl: has 64 MB")
    rng = np.random.default_rng(0)
    lines = [f"v {x} {y} {z}" for x, y, z in rng.uniform(-0.1, 0.1, (36_000, 3))]
    lines += [f"f {i} {i + 1} {i + 2}" for i in range(1, 36_000, 3)]
    (tmp_path / "part.obj").write_text("\n".join(lines))
    folded = urdf(joint("ab", "a", "b"), MESH.format("visual", "part.obj"))
    refused(folded, "part.obj", "folds over and over")


@pytest.mark.parametrize("word", ["nan", "inf", "1e400"])
@pytest.mark.parametrize("kind", ["obj", "stl", "ply"])
def test_a_vertex_that_is_not_finite_is_refused(urdf, tmp_path, word, kind):
    """The library that reads meshes leaves its triangles out, which would be free space."""
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    how = {"stl": {"file_type": "stl_ascii"}, "ply": {"encoding": "ascii"}}.get(kind, {})
    box.export(file := tmp_path / f"box.{kind}", **how)
    text, found = re.subn(r"0\.150*1?\b", word, file.read_text(), count=1)
    assert found
    file.write_text(text)
    refused(
        urdf(joint("ab", "a", "b"), MESH.format("collision", f"box.{kind}")), "'b'", f"box.{kind}"
    )


def test_an_open_mesh_is_covered_whole(urdf: Writer, tmp_path: Path) -> None:
    """A box without its lid, as a fifth of the arms' own collision meshes are open somewhere."""
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    assert not box.is_watertight
    box.export(tmp_path / "box.stl")
    robot = load_robot(urdf(joint("ab", "a", "b"), MESH.format("collision", "box.stl")))
    points = box.sample(2000, seed=0)
    place = robot.geometry[0]
    points = points @ place.rotation.T + place.translation
    away = np.linalg.norm(points[:, None] - robot.spheres.center, axis=2)
    assert (away - robot.spheres.radius).min(axis=1).max() < 1e-9


def test_mimic_is_no_independent_joint(urdf: Writer) -> None:
    follower = joint("bc", "b", "c", more='<mimic joint="ab" multiplier="-2" offset="0.5"/>')
    robot = load_robot(urdf(joint("ab", "a", "b") + follower))
    assert robot.joint_names == ("ab",)
    # the follower's own limits hold too: -1 <= -2 q + 0.5 <= 1
    np.testing.assert_allclose([robot.lower[0], robot.upper[0]], [-0.25, 0.75])
    assert robot.velocity[0] == 1.0


def test_leader_off_the_chain_drives_it(urdf: Writer) -> None:
    joints = joint("ab", "a", "b", more='<mimic joint="ac"/>') + joint("ac", "a", "c")
    robot = load_robot(urdf(joints), tip="b")
    assert robot.joint_names == ("ac",)
    assert robot.held_joints == ()


def test_branch_that_moves_with_the_chain_is_refused(urdf: Writer) -> None:
    links = f'<link name="a"/><link name="b">{BALL}</link><link name="c">{BALL}</link>'
    joints = joint("ab", "a", "b") + joint("ac", "a", "c", more='<mimic joint="ab"/>')
    refused(urdf(joints, links), "'c'", "'ac'", "serial chain")


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="pa" count="12">0 0 0 .1 0 0 0 .1 0 0 0 .1</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 2 1 0 1 {index} 0 3 2 1 2 3</p></triangles></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


@pytest.mark.parametrize(
    ("kind", "index", "words"),
    [
        ("off", 99, "outside the range"),
        ("off", -1, "outside the range"),
        ("dae", 99, "holds no triangles"),
        ("dae", -1, "an index of a face is -1: must be 0 or more"),
        ("glb", 99, "face 1 names vertex 99: must be 0 to 3"),
    ],
)
def test_an_index_of_a_face_that_names_no_vertex_is_refused(urdf, tmp_path, kind, index, words):
    """A negative index counts from the end for the library that reads meshes. Scenes' formats:
    ``tests/geometry/test_grids.py``."""
    pytest.importorskip("trimesh")
    if kind == "dae":
        pytest.importorskip("collada")
        (file := tmp_path / "part.dae").write_text(DAE.format(index=index))
    else:
        file = misnamed(tmp_path, kind, index)
    refused(urdf(joint("ab", "a", "b"), MESH.format("collision", file.name)), file.name, words)
