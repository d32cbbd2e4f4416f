"""The exported MuJoCo model, in plain MuJoCo."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from tests.robots.meshes import FACES, TETRAHEDRON

from optipromp import load_scene, plan
from optipromp.core.geometry import HalfSpace, MeshShape
from optipromp.core.planning.task import resolve
from optipromp.core.scenes import JointGoal, Pose, Scene, SceneObject
from optipromp_sim.simulation import export
from optipromp_sim.simulation.world import build

LYING = Pose(np.array([0.0, 3.0, 0.0]), np.array([0.8, 0.6, 0.0, 0.0]))
CAMERA = Pose(np.array([0.3, -0.4, 0.5]), np.array([0.5, -0.5, 0.5, -0.5]))  # looks along x


def loaded(folder, scene):
    """Task, model and data at the keyframe."""
    task = resolve(scene)
    path = folder / "model.xml"
    path.write_text(export.mjcf(scene, task.robot, task.start))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(export.START).id)
    mujoco.mj_forward(model, data)
    return task, model, data


def fruits(data, scene):
    hung = [item for item in scene.objects if item.role in ("target", "pushable")]
    return np.array([data.body(f"fruit:{item.id}").xpos for item in hung])


@pytest.mark.parametrize(
    ("name", "pose"), [("scenario-1", Pose()), ("scenario-4", Pose()), ("scenario-4", LYING)]
)
def test_at_the_start_it_stays_as_the_scene_is(tmp_path, name, pose):
    scene = load_scene(name).transformed(pose)
    task, model, data = loaded(tmp_path, scene)
    n = task.robot.n_joints
    assert [model.actuator(k).name for k in range(model.nu)] == list(task.robot.joint_names)
    np.testing.assert_allclose(data.ctrl, task.start, atol=1e-9)
    begin = fruits(data, scene)
    there = [item.position for item in scene.objects if item.role in ("target", "pushable")]
    np.testing.assert_allclose(begin, there, atol=1e-5)  # MuJoCo writes six digits
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos[:n], task.start, atol=1e-4)
    assert np.linalg.norm(fruits(data, scene) - begin, axis=1).max() < 5e-4


def test_stems_hang_by_springs_that_carry_their_fruits(tmp_path):
    """Without gravity they rise: the rest pose is what carries them, not a force in Python."""
    scene = load_scene("scenario-4")
    _, model, data = loaded(tmp_path, scene)
    begin = fruits(data, scene)
    model.opt.gravity[:] = 0.0
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    (leaning,) = (
        k
        for k, item in enumerate(i for i in scene.objects if i.role in ("target", "pushable"))
        if item.id == "n1"
    )
    assert np.linalg.norm(fruits(data, scene) - begin, axis=1)[leaning] > 2e-3


def test_actuators_take_the_tool_along_a_plan_to_the_target(tmp_path):
    scene = load_scene("scenario-4")
    _, model, data = loaded(tmp_path, scene)
    motion = plan(scene).trajectory
    slower = 2.0
    columns = [model.actuator(name).id for name in motion.joint_names]
    while data.time < slower * motion.duration + 0.3:
        at = min(data.time / slower, motion.duration)
        data.ctrl[columns] = motion.sample(at)[0][0]
        mujoco.mj_step(model, data)
    site = data.site(export.TOOL_POINT)
    assert np.linalg.norm(site.xpos - scene.target.position) < 3e-3
    axis = site.xmat.reshape(3, 3)[:, 2]
    assert np.degrees(np.arccos(axis @ scene.approach.direction)) < 2.5
    # the fruit is in the cup, and the others hang
    assert np.linalg.norm(data.body("fruit:ripe").xpos - site.xpos) < 0.02


def test_it_is_the_world_of_the_simulation_in_one_file(tmp_path):
    scene = replace(load_scene("scenario-4"), camera=CAMERA)
    rock = SceneObject("rock", "static", MeshShape(TETRAHEDRON, FACES), np.array([1.0, 0.5, 0.0]))
    floor = SceneObject("floor", "static", HalfSpace(), np.array([0.0, 0.0, -0.3]))
    scene = replace(scene, objects=(*scene.objects, rock, floor))
    task, model, data = loaded(tmp_path, scene)
    assert [path.name for path in tmp_path.iterdir()] == ["model.xml"]
    own = build(scene, task.robot).model
    assert [model.geom(k).name for k in range(model.ngeom)] == [
        own.geom(k).name for k in range(own.ngeom)
    ]
    np.testing.assert_allclose(model.body_mass, own.body_mass, rtol=1e-4)
    np.testing.assert_allclose(model.geom_size, own.geom_size, rtol=1e-4)
    np.testing.assert_array_equal(model.geom_type, own.geom_type)
    q = task.robot.lower + 0.3 * (task.robot.upper - task.robot.lower)
    data.qpos[: task.robot.n_joints] = q
    mujoco.mj_forward(model, data)
    point, axis = task.robot.tool_pose(q)
    np.testing.assert_allclose(data.site(export.TOOL_POINT).xpos, point, atol=1e-5)
    np.testing.assert_allclose(
        data.site(export.TOOL_POINT).xmat.reshape(3, 3)[:, 2], axis, atol=1e-5
    )
    middle = rock.position + TETRAHEDRON.mean(axis=0)
    np.testing.assert_allclose(data.geom("static:rock").xpos, middle, atol=1e-4)
    camera = data.camera("camera").xmat.reshape(3, 3)
    np.testing.assert_allclose(-camera[:, 2], [1.0, 0.0, 0.0], atol=1e-5)  # looks ahead
    np.testing.assert_allclose(camera[:, 1], [0.0, 0.0, 1.0], atol=1e-5)  # upright


MIMIC = """<robot name="lift">
  <link name="base"/>
  <joint name="low" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="500"/></joint>
  <link name="a"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <joint name="high" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="500"/>
    <mimic joint="low" multiplier="0.5" offset="0.1"/></joint>
  <link name="b"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
</robot>"""


def test_a_joint_that_follows_another_does_so_there(tmp_path):
    (tmp_path / "lift.urdf").write_text(MIMIC)
    scene = Scene(
        "lift", "lift.urdf", (), start=np.array([0.2]), goal=JointGoal(np.array([0.5])),
        base_dir=tmp_path,
    )  # fmt: skip
    task, model, data = loaded(tmp_path, scene)
    assert (model.nu, model.actuator(0).name) == (1, "low")
    np.testing.assert_allclose(data.qpos, [0.2, 0.2], atol=1e-9)
    data.ctrl[:] = 0.5
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.qpos, [0.5, 0.35], atol=2e-3)
    point, _ = task.robot.tool_pose(np.array([0.5]))
    np.testing.assert_allclose(data.site(export.TOOL_POINT).xpos, point, atol=4e-3)
