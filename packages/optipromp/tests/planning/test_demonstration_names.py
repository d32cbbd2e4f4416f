"""Columns of demonstrations and joints of primitives are told by name, never by place."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.planning.primitive import BASIS, _tell_unlearnt, learnt
from optipromp.core.planning.task import resolve
from optipromp.core.promp import fit, load_demonstrations
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import Scene
from optipromp.core.trajectory import State


def written(path: Path, joints: Sequence[str], names: Sequence[str] | None) -> Path:
    """Reaches of the Panda with the columns in the order of ``joints``, headed ``names``."""
    robot = load_robot("panda")
    order = [robot.joint_names.index(joint) for joint in joints]
    rng, phase = np.random.default_rng(0), np.linspace(0.0, 1.0, 30)[:, None]
    motions = [robot.home + phase * rng.normal(0.0, 0.3, 7) for _ in range(5)]
    extra = {} if names is None else {"joint_names": np.array(names)}
    np.savez(path, positions=np.array(motions)[:, :, order], **extra)
    return path


def test_columns_are_matched_to_joints_by_name(three: Scene, tmp_path: Path) -> None:
    task = resolve(three)
    joints = task.robot.joint_names
    mixed = tuple(joints[i] for i in (3, 0, 6, 1, 5, 2, 4))
    right = learnt(task, written(tmp_path / "right.npz", joints, joints))
    path = written(tmp_path / "mixed.npz", mixed, mixed)
    saved, promp = tmp_path / "saved.npz", fit(load_demonstrations(path), BASIS)
    promp.save(saved)
    assert promp.joint_names == mixed
    for given in (path, str(path), saved, promp):
        found = learnt(task, given)
        assert found.joint_names == joints
        np.testing.assert_allclose(found.mean, right.mean, atol=1e-9)
        np.testing.assert_allclose(found.covariance, right.covariance, atol=1e-9)


def others(robot: Robot) -> dict[str, Robot]:
    """Robots called panda that are not the Panda: other joint names, another arm, fewer joints."""
    kin = robot.kinematics
    longer = np.array(kin.translation)
    longer[2, 1] -= 0.05
    fewer = replace(
        robot, joint_names=robot.joint_names[:6], home=robot.home[:6],
        kinematics=type(kin)(*(values[:6] for values in kin)),
    )  # fmt: skip
    return {
        "names": replace(robot, joint_names=tuple(f"other_{name}" for name in robot.joint_names)),
        "places": replace(
            robot, kinematics=kin._replace(translation=longer), home=0.9 * robot.home
        ),
        "fewer": fewer,
    }


@pytest.mark.parametrize("what", ["names", "places", "fewer"])
def test_a_robot_is_known_by_its_joints(three: Scene, what: str) -> None:
    """Another robot called panda starts from the smooth prior, not from the Panda's motions."""
    task = resolve(three)
    stranger = others(task.robot)[what]
    task = replace(task, robot=stranger, state=State(0.5 * stranger.home))
    _tell_unlearnt.cache_clear()
    with pytest.warns(UserWarning, match="no built-in demonstrations are of the joints of robot"):
        found = learnt(task, None)
    assert found.joint_names == stranger.joint_names
    start = np.repeat(task.start[:, None], found.basis.count, axis=1)
    np.testing.assert_array_equal(found.mean, start)
    again = learnt(task, None)  # said once
    assert again is found


def test_the_panda_by_another_name(three: Scene) -> None:
    """The Panda's joints in a file of another name have the Panda's demonstrations."""
    task = resolve(three)
    renamed = replace(task.robot, name="left arm")
    assert learnt(replace(task, robot=renamed), None) is learnt(task, None)
