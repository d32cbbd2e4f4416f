"""MJCF files: the same kinematics, limits, bodies and masses that MuJoCo itself has."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.refusals import assert_refused

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots import load_robot
from optipromp.core.robots.library import load_arm
from optipromp.readers import mjcf, packages, reading
from optipromp.readers.mjcf import mjcf_files, read_mjcf

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="stock">
  <compiler angle="degree"/>
  <asset><mesh name="wedge" vertex="0 0 0  .1 0 0  0 .08 0  0 0 .06  .1 .08 .06"/></asset>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="base" pos=".1 -.2 .3" euler="10 20 -30">
      <geom type="cylinder" size=".06 .05"/>
      <body name="shoulder" pos="0 0 .12" euler="0 0 90">
        <joint name="turn" axis="0 0 1" range="-170 170" actuatorfrcrange="-87 87"/>
        <geom type="capsule" size=".05 .04" contype="0" conaffinity="0"/>
        <geom type="sphere" size=".06" mass="2"/>
        <body name="upper" pos="0 .05 .1" euler="90 0 0">
          <joint name="lift" axis="0 1 0" pos=".02 0 -.01" ref="25" range="-100 100"/>
          <joint name="twist" axis="1 0 0" pos="0 .03 0"/>
          <geom type="box" size=".04 .05 .15" pos="0 0 .15" euler="0 15 0"/>
          <body name="fore" pos="0 0 .32">
            <joint name="slide" type="slide" axis="0 0 2" ref=".02" range="-.05 .2"/>
            <geom type="mesh" mesh="wedge" pos="0 .01 0" euler="0 90 0"/>
            <body name="wrist" pos="0 0 .2" euler="0 -90 0">
              <joint name="roll" axis="1 0 0" range="-90 90"/>
              <geom type="ellipsoid" size=".03 .04 .05"/>
              <site name="attachment_site" pos="0 0 .06" euler="0 0 45"/>
              <body name="left_finger" pos="0 .02 .08">
                <joint name="left_finger_joint" type="slide" axis="0 1 0" range="0 .04"/>
                <geom type="box" size=".01 .01 .03"/>
              </body>
              <body name="right_finger" pos="0 -.02 .08">
                <joint name="right_finger_joint" type="slide" axis="0 -1 0" range="0 .04"/>
                <geom type="box" size=".01 .01 .03"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
    <body name="cube" pos="1 0 0"><freejoint/><geom type="box" size=".02 .02 .02"/></body>
  </worldbody>
  <equality>
    <joint joint1="right_finger_joint" joint2="left_finger_joint" polycoef="0 1 0 0 0"/>
  </equality>
  <actuator>
    <motor joint="lift" gear="50" forcerange="-2 2" forcelimited="true"/>
    <motor joint="twist" gear="2" ctrllimited="true" ctrlrange="-14 10"/>
    <position joint="roll" kp="100" ctrllimited="true" ctrlrange="-2 2"/>
  </actuator>
</mujoco>"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    out = tmp_path / "stock.xml"
    out.write_text(ARM)
    return out


def test_the_arm_and_its_limits(path: Path) -> None:
    robot, arm = load_arm(path)
    assert robot.name == "stock"
    assert robot.joint_names == ("turn", "lift", "twist", "slide", "roll")
    assert arm.tip == "attachment_site"
    assert np.allclose(np.rad2deg(robot.upper[[0, 1, 4]]), [170.0, 100.0, 90.0])
    assert np.isinf(robot.upper[2])
    assert (robot.lower[3], robot.upper[3]) == (-0.05, 0.2)
    assert "cube" not in robot.link_names
    assert robot.held_joints == ("left_finger_joint", "right_finger_joint")
    assert robot.dynamics.effort[:3].tolist() == [87.0, 100.0, 28.0]
    assert np.isinf(robot.dynamics.effort[3:]).all()  # a position's control is no force


def test_servos_narrow_the_limits_of_their_joints(path: Path) -> None:
    """By gear; a joint without limits has those of a servo that reaches no more than two turns."""
    servos = """<position joint="roll" kp="100" gear="4" ctrlrange="-1 2"/>
    <velocity joint="lift" kv="10" gear="2" ctrlrange="-3 3"/>
    <intvelocity joint="twist" kp="5" actrange="-5 6" ctrlrange="-1 1"/></actuator>"""
    path.write_text(ARM.replace("</actuator>", servos))
    for _ in range(2):  # the second robot is from the cache
        reading._held.clear()
        with pytest.warns(UserWarning, match="stock.xml") as told:
            robot = load_robot(path)
        words = " ".join(str(each.message) for each in told)
        assert (
            "'roll': actuator 3 by its range narrows its limits to [-0.25, 0.5] from [-1.5" in words
        )
        assert (robot.lower[[2, 4]].tolist(), robot.upper[[2, 4]].tolist()) == (
            [-5, -0.25],
            [6, 0.5],
        )
        assert (robot.velocity[1], robot.velocity[0]) == (1.5, np.inf)


def test_forward_kinematics_and_masses_of_mujoco(path: Path) -> None:
    """Flange, tool axis and centres of mass at random configurations."""
    robot = load_robot(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    bodies = ["shoulder", None, "upper", "fore", "wrist"]
    for _ in range(50):
        low, high = np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0)
        q = rng.uniform(low, high)
        for name, value in zip(robot.joint_names, q, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_forward(model, data)
        point, axis = robot.tool_pose(q)
        site = data.site("attachment_site")
        assert np.abs(point - site.xpos).max() < 1e-9
        assert np.abs(axis - site.xmat.reshape(3, 3)[:, 2]).max() < 1e-9
        origins, turns = robot.segment_frames(q)
        for s, body in enumerate(bodies[:-1]):  # the last also carries the fingers
            center = origins[s] + turns[s] @ robot.dynamics.center[s]
            if body is not None:
                assert np.abs(center - data.body(body).xipos).max() < 1e-9
                here = turns[s] @ robot.dynamics.inertia[s] @ turns[s].T
                turn = data.body(body).ximat.reshape(3, 3)
                theirs = turn @ np.diag(model.body(body).inertia) @ turn.T
                assert np.allclose(here, theirs, atol=1e-12)
    carried = model.body("wrist").subtreemass[0]
    assert robot.dynamics.mass[-1] == pytest.approx(carried)


def test_the_spheres_cover_the_geoms(path: Path) -> None:
    """Points of the mesh and of the box, where MuJoCo has them."""
    robot = load_robot(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data, q = mujoco.MjData(model), np.array([0.3, 0.5, -0.4, 0.05, 0.2])
    for name, value in zip(robot.joint_names, q, strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_forward(model, data)
    centers, radius = robot.sphere_centers(q), robot.spheres.radius
    for g in range(model.ngeom):
        kind, at, turn = int(model.geom_type[g]), data.geom_xpos[g], data.geom_xmat[g]
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            local = model.mesh_vert
        elif kind == mujoco.mjtGeom.mjGEOM_BOX and model.geom_bodyid[g] != model.body("cube").id:
            local = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * model.geom_size[g]
        else:
            continue
        points = at + local @ turn.reshape(3, 3).T
        away = np.linalg.norm(points[:, None] - centers, axis=2) - radius
        assert away.min(axis=1).max() < 1e-6


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('type="slide" axis="0 0 2" ref=".02" range="-.05 .2"', 'type="slide"', "has no range"),
        ('name="twist" axis="1 0 0" pos="0 .03 0"', 'name="twist" type="ball"', "ball joint"),
        ("</worldbody>", "", "stock.xml"),
    ],
)
def test_what_is_refused(path: Path, old: str, new: str, told: str) -> None:
    assert old in ARM
    path.write_text(ARM.replace(old, new))
    with pytest.raises(InvalidRobotError, match=told):
        load_robot(path)


BODY = """<mujocoinclude><default><geom rgba="1 0 0 1"/></default>
  <worldbody><body name="base"><body name="upper" pos="0 0 {height}">
    <joint name="turn" axis="0 0 1" range="-1 1" limited="true"/>
    <geom type="mesh" mesh="cube"/></body></body></worldbody></mujocoinclude>"""
WHOLE = """<mujoco><compiler meshdir="assets"/><asset><mesh name="cube" file="cube.stl"/></asset>
  <include file="parts/body.xml"/></mujoco>"""


@pytest.fixture
def scattered(tmp_path: Path) -> Path:
    """An arm whose body and mesh are in files of their own."""
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "assets").mkdir()
    (tmp_path / "parts").mkdir()
    trimesh.creation.box([0.1, 0.1, 0.2]).export(tmp_path / "assets" / "cube.stl")
    (tmp_path / "parts" / "body.xml").write_text(BODY.format(height=0.3))
    out = tmp_path / "arm.xml"
    out.write_text(WHOLE)
    return out


def test_a_file_read_before_needs_no_mujoco(path, scattered, monkeypatch):
    for each in (path, scattered):
        first = load_robot(each)
        reading._held.clear()
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, "mujoco", None)
            again = load_robot(each)
            assert again is not first
            assert [link.shapes for link in again.geometry] == [g.shapes for g in first.geometry]
            with pytest.raises(InvalidRobotError, match="needs MuJoCo"):
                load_robot(each.rename(each.with_stem("other")))  # its name may be the robot's


def test_a_change_of_any_file_is_read(scattered, tmp_path, monkeypatch):
    """A mesh that changes within a second too, which MuJoCo's own cache does not see."""
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    trimesh = pytest.importorskip("trimesh")
    mesh, second = scattered.parent / "assets" / "cube.stl", 1_700_000_000 * 10**9
    os.utime(mesh, ns=(second, second))
    files = mjcf_files(scattered)
    assert files is not None
    assert [file.name for file in files] == ["arm.xml", "cube.stl", "body.xml"]
    before = load_robot(scattered)
    (scattered.parent / "parts" / "body.xml").write_text(BODY.format(height=0.4))
    raised = load_robot(scattered)
    trimesh.creation.box([0.1, 0.1, 0.4]).export(mesh)
    os.utime(mesh, ns=(second, second + 10**8))
    longer = load_robot(scattered)
    at_zero = [robot.segment_frames(np.zeros((1, 1)))[0][0, 0, 2] for robot in (before, raised)]
    assert at_zero == pytest.approx([0.3, 0.4])
    tops = [(r.spheres.center[:, 2] + r.spheres.radius).max() for r in (raised, longer)]
    assert tops[1] - tops[0] > 0.08


@pytest.mark.parametrize("held", [True, False])
def test_a_lost_mesh_of_the_cache_is_made_again(path: Path, held: bool) -> None:
    shapes = [shape for link in load_robot(path).geometry for shape in link.shapes]
    (mesh,) = {shape.mesh for shape in shapes if shape.mesh}
    Path(mesh).unlink()
    if not held:
        reading._held.clear()
    load_robot(path)
    assert Path(mesh).is_file()


BALL = '<geom size=".1"/>'
HEIGHTS = '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>'
TWIN = f"<body>{BALL}<body>{BALL}</body></body>"
ARM_FAR = f'<body name="far" pos="0 1e200 0">{BALL}</body>'


def minimal(geom: str = '<geom size=".1"/>', more: str = "", name: str = "a") -> str:
    body = f'<body name="{name}"><joint range="-1 1"/>{geom}</body>'
    return f"<mujoco>{more}<worldbody>{body}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (minimal('<geom size="1e300"/>'), "body 'a' size is 1e+300"),  # a segmentation fault
        (minimal('<geom size="1e100"/>'), "body 'a' size is 1e+100"),
        (minimal('<geom size=".1" pos="0 0 30"/>'), "body 'a' pos is 0 0 30, beyond 20 m"),
        (minimal(f'<geom size=".1"/>{ARM_FAR}'), "body 'far' pos is 0 1e+200 0"),
        (
            minimal(more=HEIGHTS),
            "<hfield> asks for 3.6e+09 of nrow x ncol",
        ),
        (
            minimal(f'<replicate count="100000" offset="0 0 1">{BALL}</replicate>{BALL}'),
            "<replicate> asks for 1e+05 of count: must be at most 1000",
        ),
        (
            minimal(f'<replicate count="999">{TWIN}</replicate>{BALL}'),
            "has 2000 bodies: must have at most 1000",
        ),
        (minimal(more='<asset><mesh name="m" file="pipe.stl"/></asset>'), "is a device or pipe"),
        (minimal(more='<asset><mesh name="m" file="/dev/zero"/></asset>'), "is a device or pipe"),
        (minimal(name="\xff"), "a name in it is no UTF-8"),
    ],
)  # fmt: skip
def test_what_would_end_the_process_or_never_end_is_refused(tmp_path, text, words):
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "arm.xml").write_bytes(text.encode("latin-1"))
    assert_refused(InvalidRobotError, ["arm.xml", words], load_robot, tmp_path / "arm.xml")


def test_a_process_that_ends_early_or_goes_on_is_told_of(tmp_path, monkeypatch):
    """Limits so low that MuJoCo itself cannot start, or not end."""
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))

    def run(**limits: float) -> str:
        few = packages.Limits(**limits)
        monkeypatch.setattr(
            mjcf, "run_limited", lambda *args: packages.run_limited(*args, limits=few)
        )
        with pytest.raises(InvalidRobotError) as caught:
            read_mjcf(tmp_path / "arm.xml")
        return caught.value.message

    (tmp_path / "arm.xml").write_text(minimal())
    assert "cannot be read within 0.001 s" in run(time=0.001)
    assert "arm.xml: reading it ended with" in run(memory=6e7)
    assert "arm.xml: compiles to more than" in run(output=100)


CHAIN = """<mujoco model="chain"><compiler angle="radian"/><worldbody>
  <body name="mark" {mocap} pos="0.2 0 0"><geom type="box" size=".5 .01 .01" contype="0"
   conaffinity="0"/></body>
  <body name="base"><geom type="box" size=".06 .06 .05" contype="0" conaffinity="0"/>
    <body name="b1" pos="0 0 .1"><joint name="j1" axis="0 0 1" range="-3 3"/>
      <geom type="sphere" size=".05"/>
      <body name="b2" pos="0 0 .3"><joint name="j2" axis="0 1 0" range="-2 2"/>
        <geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>
        <body name="b3" pos=".3 0 0"><joint name="j3" axis="0 1 0" range="-2 2"/>
          <joint name="j4" axis="1 0 0" range="-2 2"/><geom type="sphere" size=".03"/>
          <site name="attachment_site" pos="0 0 .05"/></body>
      </body>
      <body name="rod" pos="-.1 0 .1"><joint name="rod" axis="0 1 0" range="-2 2"/>
        <geom type="capsule" size=".01" fromto="0 0 0 0 0 .2"/></body>
    </body>
  </body></worldbody>{more}</mujoco>"""


@pytest.mark.parametrize("mocap", ['mocap="true"', ""], ids=["mocap", "still"])
def test_marks_that_touch_nothing_are_no_obstacles(tmp_path: Path, mocap: str) -> None:
    path = tmp_path / "chain.xml"
    chain = CHAIN.format(mocap=mocap, more="")
    path.write_text(chain.replace('name="base"', f'name="base" {mocap}'))  # which carries the arm
    for _ in range(2):  # as two runs, the second of which could read the robot from the cache
        reading._held.clear()
        with pytest.warns(UserWarning, match="mark: left out, as it touches nothing"):
            robot = load_robot(path)
    assert "mark" not in robot.link_names
    assert {robot.link_names[k] for k in robot.spheres.link} >= {"base", "b1", "b2", "b3", "rod"}


@pytest.mark.filterwarnings("ignore:.*left out, as it touches nothing")
def test_an_arm_in_a_closed_loop_is_refused_by_name(tmp_path: Path) -> None:
    loop = '<equality><connect name="close" body1="rod" body2="b2" anchor="0 0 .2"/></equality>'
    path = tmp_path / "chain.xml"
    path.write_text(
        CHAIN.format(mocap="", more=loop).replace('<body name="mark"', '<body name="m"')
    )
    with pytest.raises(InvalidRobotError, match="joint 'j2' is in a loop that 'close' closes"):
        load_robot(path)
    led = '<equality><weld name="lead" body1="mark" body2="b3"/></equality>'
    path.write_text(CHAIN.format(mocap='mocap="true"', more=led))
    assert load_robot(path).joint_names == ("j1", "j2", "j3", "j4")
