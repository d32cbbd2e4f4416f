"""Demonstrations and primitives beyond the joints' limits are refused."""

from pathlib import Path

import numpy as np
import pytest

from optipromp.core.errors import InvalidDemonstrationError
from optipromp.core.planning.primitive import BASIS, learnt
from optipromp.core.planning.task import resolve
from optipromp.core.promp import UnitsWarning, fit, load_demonstrations
from optipromp.core.promp.demonstrations import BEYOND_LIMITS
from optipromp.core.scenes import Scene
from optipromp_paper.paper import PAPER_BASIS


def written(path: Path, scene: Scene, offset: float = 0.0, scale: float = 1.0) -> Path:
    """Reaches of the Panda in which joint4 comes ``offset`` beyond its upper limit [rad]."""
    robot = resolve(scene).robot
    phase, spread = np.linspace(0.0, 1.0, 30)[:, None], np.random.default_rng(0)
    motions = np.array([robot.home + phase * spread.normal(0.0, 0.1, 7) for _ in range(5)])
    motions[2, :, 3] = robot.home[3] + phase[:, 0] * (robot.upper[3] + offset - robot.home[3])
    np.savez(path, positions=scale * motions, joint_names=robot.joint_names)
    return path


def test_a_little_beyond_a_limit_is_a_hand_guided_arm(three: Scene, tmp_path: Path) -> None:
    task = resolve(three)
    path = written(tmp_path / "near.npz", three, 0.9 * BEYOND_LIMITS)
    assert learnt(task, path).joint_names == task.robot.joint_names


def test_more_is_refused_by_file_joint_value_and_limit(three: Scene, tmp_path: Path) -> None:
    path = written(tmp_path / "far.npz", three, 1.1 * BEYOND_LIMITS)
    wanted = r"far\.npz: demonstration 2: joint4 is -0\.0148 at sample 29: .*\[-3\.0718, -0\.0698\]"
    with pytest.raises(InvalidDemonstrationError, match=wanted) as refused:
        learnt(resolve(three), path)
    assert "degrees" not in refused.value.message


def test_degrees_are_refused_as_such(three: Scene, tmp_path: Path) -> None:
    path = written(tmp_path / "degrees.npz", three, scale=180.0 / np.pi)
    task, saved = resolve(three), tmp_path / "saved.npz"
    with (
        pytest.warns(UnitsWarning),
        pytest.raises(InvalidDemonstrationError, match="degrees or millimetres"),
    ):
        learnt(task, path)
    with pytest.warns(UnitsWarning):
        promp = fit(load_demonstrations(path), BASIS)
    promp.save(saved)
    for given in (promp, saved):
        with pytest.raises(InvalidDemonstrationError, match=r"its mean .*degrees or"):
            learnt(task, given)


@pytest.mark.filterwarnings("ignore:.*stands still")
def test_the_mean_of_few_bases_may_overshoot_a_limit(three: Scene, tmp_path: Path) -> None:
    """A step to the limit, learnt with five bases: beyond it by more than demonstrations may be."""
    path, robot = tmp_path / "step.npz", resolve(three).robot
    steps = np.repeat(robot.home[None, None], 4, axis=0) + np.zeros((4, 30, 1))
    steps += np.random.default_rng(0).normal(0.0, 0.01, (4, 1, 7))
    steps[:, 15:, 3] = robot.upper[3]
    np.savez(path, positions=steps, joint_names=robot.joint_names)
    promp = fit(load_demonstrations(path), PAPER_BASIS)
    assert promp.mean_trajectory(101)[:, 3].max() > robot.upper[3] + BEYOND_LIMITS
    for given in (promp, path):
        assert learnt(resolve(three), given).n_joints == 7
