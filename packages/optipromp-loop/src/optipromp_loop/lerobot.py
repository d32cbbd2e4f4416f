"""LeRobot: the closed loop as a policy, and the guard as a step of a pipeline of actions.

``import optipromp_loop.lerobot`` registers the policy ``optipromp`` and the step
``optipromp_guard``; where the distribution ``lerobot_policy_optipromp`` is installed, LeRobot's
own commands do. Both take numbers by name; no picture is needed:

- ``observation.state`` (n,): positions of the joints [rad or m].
- ``observation.camera`` (16,) and ``observation.environment_state`` (FRUITS, 6): the newest look,
  see :mod:`optipromp_loop.pilot`. Without them, nothing is seen.
- ``task``: what is to be done. One that is a scene in JSON replaces the scene of the policy.

Tested with LeRobot 0.6.
"""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.optim.optimizers import AdamConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    PolicyProcessorPipeline,
    ProcessorStep,
    ProcessorStepRegistry,
    TransitionKey,
)
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_STATE

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, check_one_of
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.io import scene_from_dict
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.guard import Guard, GuardParameters, Safe
from optipromp_loop.pilot import COMMANDS, FRUITS, Commands, Pilot, look_in, numbers_of

OBS_CAMERA = "observation.camera"


@PreTrainedConfig.register_subclass("optipromp")
@dataclass
class OptiPrompConfig(Commands, PreTrainedConfig):
    """Of :class:`OptiPrompPolicy`; see :class:`Commands`.

    Attributes:
        n_action_steps: actions of a chunk. A look counts from the next chunk on.
        seed: of the plans.
    """

    n_action_steps: int = 5
    seed: int = 0
    device: str | None = "cpu"
    normalization_mapping: dict[str, Any] = field(default_factory=dict)

    observation_delta_indices: ClassVar[None] = None
    action_delta_indices: ClassVar[None] = None
    reward_delta_indices: ClassVar[None] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_one_of("commands", self.commands, COMMANDS)
        if self.n_action_steps < 1 or not self.rate > 0.0:
            raise InvalidRequestError("n_action_steps must be at least 1, and rate above 0 [Hz]")

    def validate_features(self) -> None:
        """Those of the scene's robot are set by the policy."""

    def get_optimizer_preset(self) -> AdamConfig:
        """Of no use: nothing is learnt."""
        return AdamConfig()

    def get_scheduler_preset(self) -> None:
        """None."""


class OptiPrompPolicy(PreTrainedPolicy):
    """The controller of the closed loop, one pick at a time in each row of a batch.

    ``timestamp`` [s] of a batch may tell when it was observed; without it, the actions that were
    given tell the time.

    Attributes:
        pilots: of the rows; each has a controller with its stage, its events and its plans.
        names: of the numbers of an action.
    """

    config_class = OptiPrompConfig
    name = "optipromp"

    def __init__(
        self, config: OptiPrompConfig, *, scene: Scene | None = None, **ignored: Any
    ) -> None:
        super().__init__(config)
        self.register_buffer("nothing_learnt", torch.zeros(1))  # LeRobot saves weights
        self._scene = load_scene(config.scene) if scene is None else scene
        self.reset()
        robot = self.controller.robot
        self.names = config.names(robot)
        config.input_features = features(robot)
        config.output_features = {ACTION: PolicyFeature(FeatureType.ACTION, (len(self.names),))}

    @property
    def controller(self) -> Controller:
        """Of the first row."""
        return self.pilots[0].controller

    def reset(self) -> None:
        """Begin a pick."""
        self._queue: deque[torch.Tensor] = deque()
        self._given, self._begun, self.pilots = 0, False, [self._pilot("")]

    def _pilot(self, task: str) -> Pilot:
        """For a task, which may be a scene."""
        scene = scene_from_dict(json.loads(task)) if task.startswith("{") else self._scene
        return Pilot(scene, self.config, seed=self.config.seed, steps=self.config.n_action_steps)

    def get_optim_params(self) -> dict[str, Any]:
        """Nothing is learnt."""
        return {}

    def forward(self, batch: Mapping[str, torch.Tensor]) -> Any:
        """Nothing is learnt.

        Raises:
            InvalidRequestError: always.
        """
        raise InvalidRequestError("optipromp plans; there is nothing to train")

    @torch.no_grad()
    def select_action(self, batch: Mapping[str, Any], **ignored: Any) -> torch.Tensor:
        """The next actions (rows, k); a chunk is asked for where none is left."""
        if not self._queue:
            self._queue.extend(self.predict_action_chunk(batch).swapaxes(0, 1))
        self._given += 1
        return self._queue.popleft()

    @torch.no_grad()
    def predict_action_chunk(self, batch: Mapping[str, Any], **ignored: Any) -> torch.Tensor:
        """The actions (rows, n_action_steps, k) from a moment on, ``1 / rate`` apart."""
        states = torch.as_tensor(batch[OBS_STATE])
        states = states.reshape(-1, states.shape[-1])
        told = batch.get("task", "")
        tasks = [told] * len(states) if isinstance(told, str) else list(told)
        if not self._begun and (len(states) > 1 or tasks[0].startswith("{")):
            self.pilots = [self._pilot(task) for task in tasks]
        self._begun = True
        if len(states) != len(self.pilots):
            begun = f"the picks began with {len(self.pilots)}"
            raise InvalidRequestError(f"a batch of {len(states)} rows; {begun}: call reset first")
        chunks = [self._chunk(k, batch) for k in range(len(states))]
        return torch.tensor(np.array(chunks), dtype=torch.float32)

    def _chunk(self, k: int, batch: Mapping[str, Any]) -> FloatArray:
        """The actions (n_action_steps, k) of a row of a batch."""
        pilot, rows = self.pilots[k], len(self.pilots)
        names = OBS_CAMERA, OBS_ENV_STATE, "timestamp"
        row = {name: row_of(batch[name], None, k, rows) for name in names if name in batch}
        now = float(row["timestamp"][0]) if "timestamp" in row else self._given / self.config.rate
        q = row_of(batch[OBS_STATE], pilot.controller.robot.n_joints, k, rows)
        return pilot.chunk(now, q, look_of(row, pilot.scene, now))


def make_optipromp_pre_post_processors(
    config: OptiPrompConfig, dataset_stats: Any = None
) -> tuple[Any, Any]:
    """Numbers are in SI units on both sides; a batch dimension is added."""
    before = PolicyProcessorPipeline(
        steps=[AddBatchDimensionProcessorStep()], name="policy_preprocessor"
    )
    after = PolicyProcessorPipeline(
        steps=[],
        name="policy_postprocessor",
        to_transition=policy_action_to_transition,
        to_output=transition_to_policy_action,
    )
    return before, after


@ProcessorStepRegistry.register("optipromp_guard")
@dataclass
class GuardStep(Commands, ProcessorStep):
    """The guard, between a policy's action and the robot; see :class:`Commands`.

    Actions and observations are tensors, or dictionaries of a robot in which ``JOINT.pos`` or
    ``JOINT.vel`` belong to the joints; what is not the arm's passes. Without an observation the
    arm is taken to be where it was sent. The time is that of the actions.

    Attributes:
        takes_over: of the guard, see :class:`optipromp_loop.guard.Guard`; not for the commands
            ``tool``, as the loop moves joints.
        safe: what the guard made of the last action; its reason is in ``info["guard"]``, who moves
            the arm in ``info["mover"]``, too.
    """

    takes_over: bool = False
    safe: Safe | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        check_one_of("commands", self.commands, COMMANDS[: 2 if self.takes_over else 3])
        self.use(load_scene(self.scene))

    def use(self, scene: Scene) -> None:
        """Guard a scene that is in no file."""
        self._scene = scene
        self.reset()

    def reset(self) -> None:
        """Begin anew, at the first observation."""
        given = GuardParameters(period=1.0 / self.rate)
        self.guard = Guard(self._scene, parameters=given, takes_over=self.takes_over)
        self.safe, self._count = None, 0

    def __call__(self, transition: Any) -> Any:
        """The transition with the action that the guard gives."""
        self._current_transition = out = transition.copy()
        seen, action = out.get(TransitionKey.OBSERVATION) or {}, out[TransitionKey.ACTION]
        robot, now = self.guard.robot, self._count / self.rate
        names, self._count = self.names(robot), self._count + 1
        named = isinstance(action, Mapping)
        if named and (missing := [name for name in names if name not in action]):
            raise InvalidRequestError(f"the action lacks {', '.join(missing)}")
        asked = np.array([float(action[n]) for n in names]) if named else row_of(action, len(names))
        state = self._state(seen)
        wish = asked
        if self.commands == "positions":
            now_at = state.q if self.safe is None else self.safe.reference.q
            wish = robot.turns.apart(asked, now_at) * self.rate
        elif self.commands == "tool":
            wish = self.guard.tool(asked, state)
        look = look_of(seen, self._scene, now)
        looks = () if look is None or look.time <= self.guard.time else (look,)
        self.safe = safe = self.guard(wish, state, looks, now)
        given = safe.velocity
        if self.commands == "positions":
            given = safe.reference.q
        elif self.commands == "tool":
            given = robot.tool_jacobian(state.q)[0] @ safe.velocity if safe.acted else asked
        if named:
            new: Any = {**action, **dict(zip(names, given.tolist(), strict=True))}
        else:
            new = torch.as_tensor(given, dtype=torch.float32).reshape(torch.as_tensor(action).shape)
        out[TransitionKey.ACTION] = new
        told = {"guard": safe.reason, "mover": safe.mover}
        out[TransitionKey.INFO] = {**(out.get(TransitionKey.INFO) or {}), **told}
        return out

    def _state(self, seen: Mapping[str, Any]) -> State:
        """Of the arm, as observed, else as it was sent."""
        robot = self.guard.robot
        named = [f"{joint}.pos" for joint in robot.joint_names]
        if OBS_STATE in seen:
            return State(row_of(seen[OBS_STATE], robot.n_joints))
        if all(name in seen for name in named):
            return State(np.array([float(seen[name]) for name in named]))
        if self.safe is None:
            raise InvalidRequestError(f"the first action needs {OBS_STATE}, or {named[0]} and more")
        return self.safe.reference

    def get_config(self) -> dict[str, Any]:
        """As the step was made."""
        names = "scene", "rate", "commands", "takes_over"
        return {name: getattr(self, name) for name in names}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        """The same."""
        return features


def features(robot: Robot) -> dict[str, PolicyFeature]:
    """What an observation has, by name."""
    return {
        OBS_STATE: PolicyFeature(FeatureType.STATE, (robot.n_joints,)),
        OBS_CAMERA: PolicyFeature(FeatureType.STATE, (16,)),
        OBS_ENV_STATE: PolicyFeature(FeatureType.ENV, (FRUITS, 6)),
    }


def row_of(value: Any, size: int | None = None, k: int = 0, rows: int = 1) -> FloatArray:
    """Row ``k`` of the numbers of a batch of ``rows``, as (size,).

    Raises:
        InvalidRequestError: there are more or fewer.
    """
    out = torch.as_tensor(value).detach().cpu().numpy().astype(np.float64).reshape(rows, -1)[k]
    if size is not None and out.size != size:
        raise InvalidRequestError(f"{out.size} numbers came, {size} are needed")
    return np.asarray(out)


def batch_of(q: FloatArray, look: Look | None = None, now: float = 0.0) -> dict[str, torch.Tensor]:
    """An observation of joints (n,) and of a look at a time ``now`` [s], as LeRobot's tensors."""
    camera, fruits = numbers_of(look, now)
    numbers = {OBS_STATE: q, OBS_CAMERA: camera, OBS_ENV_STATE: fruits}
    return {k: torch.tensor(v, dtype=torch.float32)[None] for k, v in numbers.items()}


def look_of(seen: Mapping[str, Any], scene: Scene, now: float) -> Look | None:
    """The look in an observation at a time ``now`` [s]; None: there is none."""
    if OBS_CAMERA not in seen or OBS_ENV_STATE not in seen:
        return None
    fruits = row_of(seen[OBS_ENV_STATE], 6 * FRUITS)
    return look_in(row_of(seen[OBS_CAMERA], 16), fruits, scene, now)
