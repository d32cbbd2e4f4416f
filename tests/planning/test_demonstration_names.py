"""Columns of demonstrations and joints of primitives are told by name, never by place."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.errors import InvalidDemonstrationError
from optipromp.planning.primitive import BASIS, learnt
from optipromp.planning.task import resolve
from optipromp.promp import fit, load_demonstrations
from optipromp.robots.library import load_robot
from optipromp.scenes import Scene


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
    for given in (path, saved, promp):
        found = learnt(task, given)
        assert found.joint_names == joints
        np.testing.assert_allclose(found.mean, right.mean, atol=1e-9)
        np.testing.assert_allclose(found.covariance, right.covariance, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "wrist"],
         "the robot has no joint wrist; joint joint7 is missing"),
        (None, "its 7 joints have no names. Name each joint of the robot once: joint1, joint2,"),
    ],
)  # fmt: skip
def test_unknown_missing_and_no_names_are_refused(
    names: list[str] | None, message: str, three: Scene, tmp_path: Path
) -> None:
    task = resolve(three)
    path = written(tmp_path / "demos.npz", task.robot.joint_names, names)
    with pytest.raises(InvalidDemonstrationError, match=rf"demos\.npz: {message}"):
        learnt(task, path)
    with pytest.raises(InvalidDemonstrationError, match=message):
        learnt(task, fit(load_demonstrations(path)))


def test_built_in_demonstrations_are_for_robots_with_their_joints(three: Scene) -> None:
    """Another robot called panda starts from the smooth prior, not from the Panda's motions."""
    task = resolve(three)
    robot = task.robot
    others = tuple(f"other_{name}" for name in robot.joint_names)
    stranger = replace(robot, joint_names=others)
    found = learnt(replace(task, robot=stranger), None)
    assert found.joint_names == others
    home = np.repeat(robot.home[:, None], found.basis.count, axis=1)
    np.testing.assert_array_equal(found.mean, home)
    assert not np.allclose(learnt(task, None).mean, home)
