"""LeRobot's own commands find policy and environment, and its own rollout picks."""

import subprocess
import sys
from importlib import metadata
from typing import Any

import pytest

pytest.importorskip("lerobot", exc_type=ImportError)

from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.envs.utils import close_envs
from lerobot.policies.factory import make_policy, make_pre_post_processors
from lerobot.scripts.lerobot_eval import rollout

from optipromp_bench.lerobot import OptiPrompEnv
from optipromp_loop.lerobot import OptiPrompConfig


def test_lerobots_rollout_picks_in_each_row() -> None:
    """Two environments at once, of which one waits for the other."""
    config = OptiPrompEnv(presets="limp")
    assert EnvConfig.get_choice_class("optipromp") is OptiPrompEnv
    policy: Any = make_policy(OptiPrompConfig(push_to_hub=False), env_cfg=config)
    assert policy.config.action_feature == config.features["action"]
    before, after = make_pre_post_processors(policy.config)
    envs = make_env(config, n_envs=2)
    told = rollout(
        envs["optipromp"][0], policy, *make_env_pre_post_processors(config, policy.config),
        before, after, seeds=[5, 6],
    )  # fmt: skip
    close_envs(envs)
    ends = [pilot.controller.events for pilot in policy.pilots]
    assert told["success"].any(dim=1).tolist() == [True, True], ends
    assert told["done"][:, -1].all()


def test_lerobots_commands_find_the_distributions() -> None:
    """As `lerobot-eval` does it, in a process where nothing of ours is imported before."""
    for name in ("lerobot_policy_optipromp", "lerobot_env_optipromp"):
        try:
            metadata.distribution(name)
        except metadata.PackageNotFoundError:
            pytest.skip(f"{name} is not installed: pip install packages/*/sockets/*")
    code = """
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot.configs.policies import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
assert "optipromp" not in EnvConfig.get_known_choices()
register_third_party_plugins()
print(PreTrainedConfig.get_choice_class("optipromp").__name__)
print(EnvConfig.get_choice_class("optipromp").__name__)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["OptiPrompConfig", "OptiPrompEnv"], done.stderr
