"""LeRobot: the environment ``optipromp``, for ``lerobot-eval``.

``import optipromp_bench.lerobot`` registers it; where the distribution ``lerobot_env_optipromp`` is
installed, LeRobot's own commands do. Its observations, actions and tasks are those of the policy
``optipromp`` (:mod:`optipromp_loop.lerobot`). Tested with LeRobot 0.6.
"""

import json
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import NEW_ROLLOUT_OPTION, freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from optipromp.core.errors import check_one_of
from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.scenes.scene import bare_robot
from optipromp_bench.env import TRAINING, PickEnv
from optipromp_bench.episode import RATE, joints_for
from optipromp_loop.lerobot import OBS_CAMERA, features
from optipromp_loop.pilot import COMMANDS, Commands, numbers_of
from optipromp_sim.generate import generate

NAMES = {"agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE, "camera": OBS_CAMERA}
"""What LeRobot calls an observation of the environment."""
FASTEST = 1.0  # [m/s] of the tool point, to which its space of actions goes: a choice


@EnvConfig.register_subclass("optipromp")
@dataclass
class OptiPrompEnv(EnvConfig):
    """Of the environment; see :class:`optipromp_bench.env.PickEnv`.

    Attributes:
        presets: of the scenes, with commas.
        condition: under which they are seen.
        commands: what actions are; see :class:`optipromp_loop.pilot.Commands`.
    """

    task: str | None = "pick"
    fps: int = round(RATE)
    presets: str = "cluster"
    condition: str = "none"
    commands: str = "positions"
    features_map: dict[str, str] = field(default_factory=lambda: {**NAMES, ACTION: ACTION})

    def __post_init__(self) -> None:
        check_one_of("commands", self.commands, COMMANDS)
        robot = bare_robot(generate(self._presets[0], TRAINING[0]))
        seen, count = features(robot), len(Commands(commands=self.commands).names(robot))
        self.features = {name: seen[told] for name, told in NAMES.items()}
        self.features[ACTION] = PolicyFeature(FeatureType.ACTION, (count,))

    @property
    def _presets(self) -> tuple[Any, ...]:
        return tuple(self.presets.split(","))

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Of :class:`optipromp_bench.env.PickEnv`."""
        action = "tool" if self.commands == "tool" else "joints"
        told = {"presets": self._presets, "condition": self.condition, "action": action}
        return {**told, "render_mode": "rgb_array"}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """``n_envs`` at once; one whose episode is over waits for the others."""
        made = [freeze_after_episode_end(partial(_made, self.gym_kwargs, self.commands))] * n_envs
        rest: dict[str, Any] = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        if use_async_envs and n_envs > 1:
            several: Any = gymnasium.vector.AsyncVectorEnv(made, context="forkserver", **rest)
        else:
            several = gymnasium.vector.SyncVectorEnv(made, **rest)
        return {self.type: {0: several}}


def _made(kwargs: dict[str, Any], commands: str) -> "Told":
    return Told(gymnasium.make("optipromp_bench:optipromp/Pick-v0", **kwargs), commands)


class Told(gymnasium.Wrapper[Any, Any, Any, Any]):
    """``optipromp/Pick-v0`` in the numbers of the policy ``optipromp``, in SI units.

    Attributes:
        task: what LeRobot calls the task.
        task_description: the scene as first seen, in JSON.
    """

    task, task_description = "pick", ""

    def __init__(self, env: gymnasium.Env[Any, Any], commands: str = "positions") -> None:
        super().__init__(env)
        self._commands = commands
        robot = bare_robot(generate(self._pick().presets[0], TRAINING[0]))
        known = features(robot)
        self.observation_space = spaces.Dict(
            {k: spaces.Box(-np.inf, np.inf, known[told].shape) for k, told in NAMES.items()}
        )
        most = np.full(3, FASTEST) if commands == "tool" else robot.velocity
        low, high = (robot.lower, robot.upper) if commands == "positions" else (-most, most)
        self.action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))

    def _pick(self) -> PickEnv:
        assert isinstance(self.env.unwrapped, PickEnv)
        return self.env.unwrapped

    def _seen(self) -> dict[str, Any]:
        episode = self._pick().episode
        assert episode is not None
        seen = episode.observe()
        camera, fruits = numbers_of(seen.look, seen.time)
        return {
            name: value.astype(np.float32)
            for name, value in zip(NAMES, (seen.q, fruits, camera), strict=True)
        }

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; LeRobot's own options are not passed on."""
        known = {k: v for k, v in (options or {}).items() if k != NEW_ROLLOUT_OPTION}
        _, info = self.env.reset(seed=seed, options=known or None)
        episode = self._pick().episode
        assert episode is not None
        self.task_description = json.dumps(scene_to_dict(episode.scene))
        return self._seen(), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One period of 20 ms."""
        episode = self._pick().episode
        assert episode is not None
        asked, robot = np.asarray(action, dtype=np.float64), episode.robot
        if self._commands == "positions":
            asked = (asked - episode.reference.q) / episode.period
        elif self._commands == "tool":
            asked = joints_for(robot, episode.state.q, asked, episode.scene.frame[2])
        _, *rest = self._pick().act(asked)
        return self._seen(), *rest
