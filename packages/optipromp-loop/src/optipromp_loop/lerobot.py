"""LeRobot: the closed loop as a policy, and the guard as a step of a pipeline of actions.

``import optipromp_loop.lerobot`` registers the policy ``optipromp`` and the step
``optipromp_guard``. Both take numbers by name; no picture is needed:

- ``observation.state`` (n,): positions of the joints [rad or m].
- ``observation.camera`` (16,): of the newest look: place of the camera (3) [m] and its rotation (9,
  row by row) in the robot's base frame, its full opening angle [rad], age of the look [s], nearest
  and farthest distance that the camera measures [m] (0: not known). An angle of 0: no look has
  come.
- ``observation.environment_state`` (FRUITS, 6): what the look shows: place in the base frame (3)
  [m], its deviation [m], radius [m], and its role: 1 target, 2 pushable, 3 avoid, 0 an empty row.

Without the last two, nothing is seen. Tested with LeRobot 0.4.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line
from optipromp.core.geometry import Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.guard import Guard, GuardParameters, Safe

OBS_CAMERA = "observation.camera"
ROLES = "target", "pushable", "avoid"
FRUITS = 32  # rows of detections: as many as the tracker follows, a choice
KNOWN = 0.1  # [m] from a detection to the fruit of the scene whose shape it takes: a choice
GAIN = 2.0  # [1/s] of the joints' error of position in commands of velocity: a choice
TURNED = 1.0  # [rad or m] of a joint whose arm follows the tool point alone: a choice
COMMANDS = "positions", "velocities", "tool"


@dataclass
class Commands:
    """What actions are.

    Attributes:
        scene: a built-in scene or a file, with robot and tool, what stands, and fruits if known.
        rate: of actions [Hz].
        commands: ``positions`` [rad or m] or ``velocities`` of the joints, or ``tool``: velocity
            (3,) of the tool point [m/s], whose axis is kept.
    """

    scene: str = "scenario-3"
    rate: float = 50.0
    commands: str = "positions"

    def names(self, robot: Robot) -> list[str]:
        """Of the numbers of an action."""
        if self.commands == "tool":
            return [f"tool.{axis}.vel" for axis in "xyz"]
        ending = "pos" if self.commands == "positions" else "vel"
        return [f"{joint}.{ending}" for joint in robot.joint_names]


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
    """The controller of the closed loop, one pick at a time.

    A batch has one row. Its ``timestamp`` [s] may tell when it was observed; without it, the
    actions that were given tell the time.

    Attributes:
        controller: with its stage, its events and its plans.
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

    def reset(self) -> None:
        """Begin a pick."""
        c = self.config
        cycles = max(c.n_action_steps / (c.rate * CONTROL.period), 1.0)  # of a chunk
        slices = replace(CONTROL, slice_steps=round(CONTROL.slice_steps * cycles))
        if c.commands == "tool":
            slices = replace(slices, off_curve=TURNED)
        self.controller = Controller(self._scene, seed=c.seed, parameters=slices)
        self._line: Line | None = None
        self._queue: deque[torch.Tensor] = deque()
        self._given, self._seen = 0, -np.inf

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
    def select_action(self, batch: Mapping[str, torch.Tensor], **ignored: Any) -> torch.Tensor:
        """The next action (1, k); a chunk is asked for where none is left."""
        if not self._queue:
            self._queue.extend(self.predict_action_chunk(batch)[0])
        self._given += 1
        return self._queue.popleft()[None]

    @torch.no_grad()
    def predict_action_chunk(
        self, batch: Mapping[str, torch.Tensor], **ignored: Any
    ) -> torch.Tensor:
        """The actions (1, n_action_steps, k) from a moment on, ``1 / rate`` apart."""
        c, robot = self.config, self.controller.robot
        q = row_of(batch[OBS_STATE], robot.n_joints)
        now = float(row_of(batch["timestamp"])[0]) if "timestamp" in batch else self._given / c.rate
        if self._line is None:
            self._line = Line.of(standing(robot, State(q)), now)
        look = look_of(batch, self._scene, now)
        if look is not None and look.time > self._seen:
            self._seen = look.time
            self.controller.see(look)
        reference = self._line.at(now)
        stretch = self.controller(now, State(q, reference.velocity), reference)
        if stretch is not None:
            self._line = self._line.take(stretch, now, anew=self.controller.lost)
        ahead = [self._line.at(now + k / c.rate) for k in range(1, c.n_action_steps + 1)]
        return torch.tensor(
            np.array([[self._command(state, q, reference.q) for state in ahead]]),
            dtype=torch.float32,
        )

    def _command(self, state: State, q: FloatArray, reference: FloatArray) -> FloatArray:
        """An action that leads to a state, of an arm at ``q`` (n,) in place of ``reference``."""
        robot = self.controller.robot
        if self.config.commands == "positions":
            return state.q
        if self.config.commands == "velocities":
            return np.asarray(state.velocity - GAIN * (q - reference))
        off = robot.tool_pose(q)[0] - robot.tool_pose(reference)[0]
        return np.asarray(robot.tool_jacobian(state.q)[0] @ state.velocity - GAIN * off)


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


def row_of(value: Any, size: int | None = None) -> FloatArray:
    """Numbers of a batch of one row, as (size,).

    Raises:
        InvalidRequestError: there are more or fewer.
    """
    out = torch.as_tensor(value).detach().cpu().numpy().astype(np.float64).ravel()
    if size is not None and out.size != size:
        raise InvalidRequestError(f"{out.size} numbers came, {size} are needed: one row a batch")
    return np.asarray(out)


def batch_of(q: FloatArray, look: Look | None = None, now: float = 0.0) -> dict[str, torch.Tensor]:
    """An observation of joints (n,) and of a look at a time ``now`` [s], as LeRobot's tensors.

    A look of more than FRUITS detections keeps the first.
    """
    camera, rows = np.zeros(16), np.zeros((FRUITS, 6))
    if look is not None:
        pose = look.camera
        far = look.far if look.far < np.inf else 0.0
        told = look.view, now - look.time, look.near, far
        camera = np.concatenate([pose.position, pose.rotation.ravel(), told])
        for row, item in zip(rows, look.in_base(), strict=False):
            deviation = np.sqrt(np.trace(np.asarray(item.covariance)) / 3.0)
            row[:] = *item.position, deviation, item.radius, 1 + ROLES.index(item.role)
    numbers = {OBS_STATE: q, OBS_CAMERA: camera, OBS_ENV_STATE: rows}
    return {k: torch.tensor(v, dtype=torch.float32)[None] for k, v in numbers.items()}


def look_of(seen: Mapping[str, Any], scene: Scene, now: float) -> Look | None:
    """The look in an observation at a time ``now`` [s]; None: there is none.

    A detection has the shape of the nearest fruit of the scene of its role, within KNOWN, else that
    of a ball.
    """
    if OBS_CAMERA not in seen or OBS_ENV_STATE not in seen:
        return None
    camera = row_of(seen[OBS_CAMERA], 16)
    if camera[12] <= 0.0:
        return None
    pose, items = Pose(camera[:3], rotation_of(camera[3:12])), list[SceneObject]()
    for k, row in enumerate(row_of(seen[OBS_ENV_STATE]).reshape(-1, 6)):
        if not 1 <= row[5] <= len(ROLES):
            continue
        role: Any = ROLES[int(row[5]) - 1]
        known = [o for o in scene.objects if o.role == role]
        known.sort(key=lambda o: float(np.linalg.norm(o.position - row[:3])))
        like = bool(known) and np.linalg.norm(known[0].position - row[:3]) < KNOWN
        made = known[0] if like else SceneObject(f"seen{k}", role, Sphere(row[4]), row[:3])
        spread = row[3] ** 2 * np.eye(3)
        item = replace(made, id=f"seen{k}", position=row[:3], covariance=spread, stem=None)
        items.append(item.transformed(pose.inverse()))
    view, age, near, far = camera[12:].tolist()
    return Look(now - age, pose, tuple(items), view, near, far or np.inf)


def rotation_of(numbers: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to nine numbers of single precision."""
    left, _, right = np.linalg.svd(numbers.reshape(3, 3))
    return np.asarray(left @ right)
