"""Environments behind a guard, and the labels that it gives."""

import gymnasium
import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.env import JOINTS, SPEED, Guarded, PickEnv
from optipromp_bench.episodes import EpisodeAsk, driven_episode


@pytest.mark.parametrize("action", ["tool", "joints"])
def test_actions_pass_the_guard_and_labels_are_those_executed(action: str) -> None:
    env = Guarded(gymnasium.make("optipromp/Pick-v0", presets="cluster", action=action))
    pick = env.unwrapped
    assert isinstance(pick, PickEnv)
    env.reset(seed=1, options={"preset": "cluster", "scene": 900_002})
    assert pick.episode is not None
    rng, acted = np.random.default_rng(0), 0
    for k in range(60):
        if k % 20 == 0:
            wish = rng.uniform(-1.0, 1.0, env.action_space.shape)
        q = pick.episode.reference.q
        _, _, terminated, _, info = env.step(wish)
        safe = info["guard"]
        for name in ("q", "velocity", "acceleration"):  # of a curve whose limits are proven
            told = getattr(pick.episode.reference, name)
            assert told == pytest.approx(getattr(safe.reference, name), abs=1e-9)
        assert info["action"].shape == env.action_space.shape
        acted += safe.acted
        if not safe.acted:
            assert info["action"] == pytest.approx(wish, abs=1e-6)
        elif action == "joints":
            label = JOINTS * pick.episode.robot.velocity * info["action"]
            assert label == pytest.approx(safe.velocity, abs=1e-6)
        else:
            along, _ = pick.episode.robot.tool_jacobian(q)
            wanted = pick.episode.scene.frame @ (along @ safe.velocity) / SPEED
            assert info["action"] == pytest.approx(np.clip(wanted, -1.0, 1.0), abs=1e-6)
        assert not terminated
    env.close()


def test_only_an_environment_of_steps_has_a_guard() -> None:
    env = Guarded(gymnasium.make("optipromp/PickProMP-v0", presets="limp"))
    with pytest.raises(InvalidRequestError, match="a guard is for optipromp/Pick-v0"):
        env.reset(seed=1)


def test_an_expert_behind_a_guard_picks_and_says_where_the_guard_acted() -> None:
    made = driven_episode(EpisodeAsk("limp", 300_004, guarded=True))
    assert made is not None
    assert made.success
    assert made.acted is not None
    assert made.acted.shape == (len(made.actions),)
    assert made.acted.mean() < 0.2


def test_a_policy_of_somebody_behind_a_guard_gives_labels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("optipromp_bench.episode.LONGEST", 1.0)
    ask = EpisodeAsk("limp", 300_000, policy="tests.bench.entrants:Follower", guarded=True)
    made = driven_episode(ask)
    assert made is not None
    assert made.actions.shape == (len(made.rewards), 3)
    assert np.abs(made.actions).max() <= 1.0
