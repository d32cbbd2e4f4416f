"""LeRobot: the environment ``optipromp``, for ``lerobot-eval``.

``import optipromp_bench.lerobot`` registers it; where the distribution ``lerobot_env_optipromp`` is
installed, LeRobot's own commands do. It is ``optipromp/Pick-v0`` with looks for observations and
positions for actions, as the policy ``optipromp`` (:mod:`optipromp_loop.lerobot`) has them. Tested
with LeRobot 0.6.
"""

import json
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from optipromp.core.scenes.io import scene_to_dict
from optipromp_bench.env import PickEnv
from optipromp_bench.episode import RATE
from optipromp_loop.lerobot import OBS_CAMERA, features

NAMES = {"agent_pos": OBS_STATE, "environment_state": OBS_ENV_STATE, "camera": OBS_CAMERA}
"""What LeRobot calls an observation of the environment."""


@EnvConfig.register_subclass("optipromp")
@dataclass
class OptiPrompEnv(EnvConfig):
    """Of the environment; see :class:`optipromp_bench.env.PickEnv`.

    Attributes:
        presets: of the scenes, with commas.
        condition: under which they are seen.
    """

    task: str | None = "pick"
    fps: int = round(RATE)
    presets: str = "cluster"
    condition: str = "none"
    features_map: dict[str, str] = field(default_factory=lambda: {**NAMES, ACTION: ACTION})

    def __post_init__(self) -> None:
        seen = features(PickEnv(**self.gym_kwargs).robot)
        self.features = {name: seen[told] for name, told in NAMES.items()}
        self.features[ACTION] = PolicyFeature(FeatureType.ACTION, seen[OBS_STATE].shape)

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Of :class:`optipromp_bench.env.PickEnv`."""
        told = {"presets": tuple(self.presets.split(",")), "condition": self.condition}
        kinds = {"observation": "look", "action": "positions", "render_mode": "rgb_array"}
        return {**told, **kinds}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """``n_envs`` at once; one whose episode is over waits for the others."""
        rest: dict[str, Any] = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        kind: Any = gymnasium.vector.SyncVectorEnv
        if use_async_envs and n_envs > 1:
            kind, rest["context"] = gymnasium.vector.AsyncVectorEnv, "forkserver"
        made = freeze_after_episode_end(partial(Instructed.of, self.gym_kwargs))
        return {self.type: {0: kind([made] * n_envs, **rest)}}


class Instructed(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment with the words of a task, which are the scene as first seen, in JSON."""

    task, task_description = "pick", ""

    @classmethod
    def of(cls, kwargs: dict[str, Any]) -> "Instructed":
        """``optipromp/Pick-v0`` made with ``kwargs``."""
        return cls(gymnasium.make("optipromp_bench:optipromp/Pick-v0", **kwargs))

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; the options are LeRobot's own, and mean nothing here."""
        seen, info = self.env.reset(seed=seed)
        pick: Any = self.env.unwrapped
        self.task_description = json.dumps(scene_to_dict(pick.episode.scene))
        return seen, info
