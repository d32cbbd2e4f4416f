"""The Gymnasium environments: as Gymnasium wants them, the same by seed, and won by the planner."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from optipromp.bench.drive import driven, joints_for
from optipromp.bench.env import CURRICULUM, PickEnv, PickProMPEnv
from optipromp.bench.episode import Episode
from optipromp.bench.primitive import COUNT, OfWeights, weights_of
from optipromp.bench.senses import MOST, WIDTH
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import plan
from optipromp.core.robots.library import load_robot
from optipromp.core.trajectory import State
from optipromp.laboratory.experiments.conditions import CONDITIONS
from optipromp.laboratory.generate import PRESETS, generate

pytest.importorskip("mujoco")
SCENE = {"preset": "cluster", "scene": 61_000}


@pytest.mark.filterwarnings("ignore:.*Box")
def test_gymnasium_finds_and_checks_both() -> None:
    for name in ("optipromp.bench.env:optipromp/Pick-v0", "optipromp/PickProMP-v0"):
        env = gymnasium.make(name, disable_env_checker=True)
        check_env(env.unwrapped, skip_render_check=True)
        env.close()
    assert set(CURRICULUM) <= set(PRESETS)


def test_several_at_once() -> None:
    several = gymnasium.make_vec(
        "optipromp/Pick-v0", num_envs=2, vectorization_mode="sync", presets=("cluster", "limp")
    )
    seen, _ = several.reset(seed=3)
    assert seen["objects"].shape == (2, MOST, WIDTH)
    _, reward, *_ = several.step(several.action_space.sample())
    assert np.isfinite(reward).all()
    several.close()


def test_the_same_seed_and_actions_give_the_same_episode() -> None:
    runs = []
    for _ in range(2):
        env = PickEnv(condition="zero-mean", action="joints")
        rng = np.random.default_rng(0)
        seen, _ = env.reset(seed=5, options=SCENE)
        for _ in range(20):
            seen, reward, *_ = env.step(rng.uniform(-1.0, 1.0, 7))
        runs.append((seen["arm"], seen["objects"], reward))
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one, other)


def test_pictures_are_seen() -> None:
    env = PickEnv(observation="picture", size=(64, 48))
    seen, _ = env.reset(seed=1, options=SCENE)
    assert seen["rgb"].shape == (48, 64, 3)
    assert seen["rgb"].std() > 5.0
    assert env.observation_space.contains(seen)
    env.close()


def test_an_arm_that_keeps_still_is_cut_off_and_harms_nothing() -> None:
    env = PickEnv()
    env.reset(seed=1, options=SCENE)
    assert env.episode is not None
    ended: tuple[bool, bool] = (False, False)
    count = 0
    info: dict[str, Any] = {}
    while not any(ended):
        _, reward, *rest, info = env.step(np.zeros(3))
        ended, count = (rest[0], rest[1]), count + 1
        assert abs(reward) < 0.1
    assert ended == (False, True)
    assert count == 1000
    assert info["cause"] == "not_picked"


def test_the_planner_is_a_policy_that_picks() -> None:
    """Its trajectory, tracked by joint velocities from what the environment shows."""
    env = PickEnv(action="joints")
    env.reset(seed=1, options=SCENE)
    episode = env.episode
    assert episode is not None
    curve = plan(episode.scene).trajectory
    info, reward, ended = {}, 0.0, False
    total = 0.0
    while not ended:
        ahead = curve.at(min(episode.time + episode.period, curve.duration))
        wanted = (ahead.q - episode.reference.q) / episode.period
        action = wanted / (0.5 * episode.robot.velocity)
        _, reward, terminated, truncated, info = env.step(action)
        total, ended = total + reward, terminated or truncated
    assert info["is_success"], info["cause"]
    assert total > 5.0


def test_the_arm_keeps_its_limits_whatever_is_asked() -> None:
    robot = load_robot("panda")
    rng, before = np.random.default_rng(0), State(robot.home)
    for _ in range(300):
        wanted = rng.choice([-10.0, 10.0], 7)
        states = driven(robot, before, wanted, 0.02, 20)
        last = before
        for each in states:
            assert (np.abs(each.velocity) <= robot.velocity + 1e-9).all()
            assert (np.abs(each.acceleration) <= robot.acceleration + 1e-9).all()
            assert (each.q >= robot.lower).all()
            assert (each.q <= robot.upper).all()
            step = last.q + 0.001 * last.velocity + 0.5 * 0.001**2 * each.acceleration
            assert each.q == pytest.approx(step, abs=1e-9)
            last = each
        before = last
    point, axis = robot.tool_pose(robot.home)
    velocity = joints_for(robot, robot.home, np.array([0.0, 0.0, 0.1]))
    after, turned = robot.tool_pose(robot.home + 1e-3 * velocity)
    assert after - point == pytest.approx([0.0, 0.0, 1e-4], abs=3e-6)
    assert turned == pytest.approx(axis, abs=3e-5)


def test_one_action_is_a_primitive() -> None:
    """The weights that are nearest to the planner's own path pick where the planner picks."""
    scene = generate("cluster", 61_000)
    weights = weights_of(plan(scene))
    assert np.abs(weights).max() < 1.0
    env = PickProMPEnv()
    seen, _ = env.reset(seed=0, options=SCENE)
    assert env.observation_space.contains(seen)
    _, reward, terminated, truncated, info = env.step(weights.ravel())
    assert terminated
    assert not truncated
    assert info["is_success"], info["cause"]
    assert reward > 3.0
    again = plan(scene, planner=OfWeights(weights=weights))
    assert np.abs(weights_of(again) - weights).max() < 0.25
    with pytest.raises(InvalidRequestError, match="must be"):
        plan(scene, planner=OfWeights(weights=np.zeros((2, COUNT + 1))))


def test_scenes_are_held() -> None:
    env = PickProMPEnv("limp", seeds=(200_000, 200_001), simulated=False)
    env.reset(seed=0)
    first = env.situation
    env.reset()
    assert env.situation is first  # the one scene of these seeds is not made again
    env.reset(options={"scene": 200_001})
    assert env.situation is not first


def test_an_episode_needs_a_rate_that_divides_the_controllers() -> None:
    setting = CONDITIONS["none"](generate("cluster", 61_000), 0)
    with pytest.raises(InvalidRequestError, match="divide"):
        Episode(setting, rate=37.0)
