"""Every entry of ours answers scenes by their seeds, with motions that a controller takes."""

import numpy as np
import pytest

from optipromp import Plan, Trajectory
from optipromp.bench.entrant import loaded
from optipromp.bench.entries import ENTRIES
from optipromp.bench.entries.motions import NEAR, gentle
from optipromp.bench.sets import scene_of
from optipromp.bench.tracks import against
from optipromp.core.arrays import lengths
from optipromp.core.planning.task import posed
from optipromp.core.pushing.parameters import PUSH

PLAN = [name for name, each in ENTRIES.items() if each.track == "plan"]


def curve(answer: Trajectory | Plan | None) -> Trajectory | None:
    return answer.trajectory if isinstance(answer, Plan) else answer


@pytest.mark.parametrize("name", PLAN)
def test_an_entry_answers_alike_each_time(name: str) -> None:
    if name.startswith("rrt"):
        pytest.importorskip("ompl")
    scene, _ = scene_of("cluster", 110_000)
    one, other = (curve(loaded(name, "plan").plan(scene, 3)) for _ in range(2))
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        assert np.array_equal(one.positions, other.positions)
        assert against(one, scene) == ""


@pytest.mark.parametrize("name", ["push-aside", "mppi", "episodic", "receding"])
def test_an_entry_pushes_something_aside(name: str) -> None:
    """In a scene that the straight way does not solve, the path is off the straight line."""
    scene, _ = scene_of("cluster", 110_001)
    told = curve(loaded(name, "plan").plan(scene, 0))
    assert told is not None
    robot, _ = posed(scene)
    points, _ = robot.tool_pose(told.positions)
    assert scene.target is not None
    off = (points - scene.target.position) @ scene.frame.T
    low = (off[:, 2] > -0.15) & (off[:, 2] < 0.0)
    assert np.hypot(*off[low, :2].T).max() > 0.01


def test_gentle_motions_are_slow_near_fruits() -> None:
    scene, _ = scene_of("field", 110_002)
    robot, state = posed(scene)
    q = state.q + np.linspace(0.0, 1.0, 60)[:, None] * (0.2 * np.ones(robot.n_joints))
    motion = gentle(scene, q)
    assert against(motion, scene) == ""
    times = np.linspace(0.0, motion.duration, 400)
    points, _ = robot.tool_pose(motion.sample(times)[0])
    speed = lengths(np.diff(points, axis=0)) / np.diff(times)
    away = np.min(
        [lengths(points - item.position) - item.radius for item in scene.objects if item.stem], 0
    )
    near = away[1:] < NEAR
    assert not near.any() or speed[near].max() < 1.1 * PUSH.hanging.speed
