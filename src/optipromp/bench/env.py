"""Gymnasium environments of the simulation: ``optipromp/Pick-v0`` and ``optipromp/PickProMP-v0``.

Importing this module registers both: ``gymnasium.make("optipromp.bench.env:optipromp/Pick-v0")``
does so by itself.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from optipromp.bench.drive import joints_for
from optipromp.bench.episode import Episode
from optipromp.bench.primitive import COUNT, OfWeights
from optipromp.bench.senses import MOST, WIDTH, objects_of, state_of
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.planning import Plan, plan
from optipromp.laboratory.experiments.conditions import CONDITIONS, Situation
from optipromp.laboratory.generate import Preset, generate
from optipromp.laboratory.simulation import Outcome, Simulation, simulate

SPEED = 0.15  # [m/s] of the tool at an action of 1: a choice; plans push at 0.1 m/s
JOINTS = 0.5  # share of the joints' largest velocities at an action of 1: a choice
PROGRESS, HARM, TIME, WON = 5.0, 1.0, 0.02, 5.0
"""Rewards: by metre nearer to the target, by share of harm, by second, and of a clean pick."""
CURRICULUM: tuple[Preset, ...] = ("limp", "cluster", "elongated", "tight", "truss", "field", "wild")
"""Presets of hanging fruit, the easiest first."""
TRAINING = 200_000, 1_000_000
"""Seeds of scenes of episodes; those of benchmarks and studies are below."""
HELD = 2_000  # scenes in memory at most, some 300 MB: a choice


@lru_cache(maxsize=HELD)
def _situation(condition: str, preset: Preset, number: int) -> Situation:
    return CONDITIONS[condition](generate(preset, number), number)


class _Scenes(gymnasium.Env[Any, Any]):
    """Scenes by preset and condition; each episode has a scene of its own.

    Args:
        presets: of the scenes, one is drawn for each episode.
        condition: of :data:`optipromp.laboratory.experiments.conditions.CONDITIONS`.
        seeds: first of the scenes' seeds, and the last plus one. A few hundred of them are made
            once and held, which saves three quarters of the time of an action of a primitive.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (as Gymnasium declares it)

    def __init__(
        self, presets: str | Sequence[str] = "cluster", condition: str = "none",
        seeds: tuple[int, int] = TRAINING,
    ) -> None:  # fmt: skip
        self.presets = (presets,) if isinstance(presets, str) else tuple(presets)
        if condition not in CONDITIONS:
            raise InvalidRequestError(f"condition is {condition!r}; valid: {', '.join(CONDITIONS)}")
        self.condition, self.seeds = condition, seeds
        few = len(self.presets) * (seeds[1] - seeds[0]) <= HELD
        self._made = _situation if few else _situation.__wrapped__  # others hardly come again
        self.render_mode: str | None = None

    def _drawn(self, options: dict[str, Any] | None) -> tuple[Situation, int]:
        given = options or {}
        preset = given.get("preset", self.presets[int(self.np_random.integers(len(self.presets)))])
        number = int(given.get("scene", self.np_random.integers(*self.seeds)))
        return self._made(self.condition, preset, number), number


class PickEnv(_Scenes):
    """A pick, step by step at 50 Hz.

    Observations: ``arm`` and ``objects`` of :func:`optipromp.bench.senses.state_of`; with
    ``observation="picture"`` also ``rgb`` (height, width, 3) and ``depth`` (height, width) [m] of
    the camera in the tool's mouth. Actions, each between -1 and 1: ``tool``: velocity of the tool
    point along x_g, y_g, z_g of the approach, whose axis the tool keeps; ``joints``: velocities.
    An episode ends when the tool holds the target, when something is harmed, or after 20 s. Its
    last ``info`` has ``is_success``, ``cause`` and ``outcome``, as the simulation judges.

    Args:
        presets, condition, seeds: see :class:`_Scenes`.
        action: ``tool`` or ``joints``.
        observation: ``state`` or ``picture``.
        size: width and height of pictures [pixel].
    """

    def __init__(
        self, presets: str | Sequence[str] = "cluster", condition: str = "none",
        seeds: tuple[int, int] = TRAINING, action: Literal["tool", "joints"] = "tool",
        observation: Literal["state", "picture"] = "state", size: tuple[int, int] = (96, 72),
    ) -> None:  # fmt: skip
        super().__init__(presets, condition, seeds)
        for name, value, valid in (
            ("action", action, ("tool", "joints")),
            ("observation", observation, ("state", "picture")),
        ):
            if value not in valid:
                raise InvalidRequestError(f"{name} is {value!r}; valid: {', '.join(valid)}")
        self.action, self.observation, self.size = action, observation, size
        robot = generate(self.presets[0], seeds[0]).load_robot()  # type: ignore[arg-type]
        count = robot.n_joints
        seen: dict[str, spaces.Space[Any]] = {
            "arm": spaces.Box(-np.inf, np.inf, (2 * count + 11,)),
            "objects": spaces.Box(-np.inf, np.inf, (MOST, WIDTH)),
        }
        if observation == "picture":
            width, height = size
            seen["rgb"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
            seen["depth"] = spaces.Box(0.0, np.inf, (height, width))
        self.observation_space = spaces.Dict(seen)
        self.action_space = spaces.Box(-1.0, 1.0, (3 if action == "tool" else count,))
        self.episode: Episode | None = None
        self._camera: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode. ``options`` may name its ``preset`` and its ``scene``, a seed."""
        super().reset(seed=seed)
        situation, number = self._drawn(options)
        self.close()
        self.episode = Episode(situation, number)
        if self.observation == "picture":
            self._camera = _camera(self.episode, self.size, number)
        self._away, self._harm = self._distance(), 0.0
        return self._seen(), {"scene": situation.scene.name, "is_success": False}

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One period of 20 ms."""
        episode = self.episode
        assert episode is not None, "call reset first"
        asked = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        if self.action == "tool":
            frame = episode.scene.frame
            q = episode.state.q
            velocity = joints_for(episode.robot, q, SPEED * asked @ frame, frame[2])
        else:
            velocity = JOINTS * episode.robot.velocity * asked
        episode.act(velocity)
        away, harm = self._distance(), episode.harm()
        worst = min(max(harm.fruit, harm.stem, harm.static, float(harm.torn)), 2.0)
        reward = PROGRESS * (self._away - away) - HARM * (worst - self._harm)
        reward -= TIME * episode.period
        self._away, self._harm = away, worst
        terminated = episode.done
        truncated = episode.ended and not terminated
        info: dict[str, Any] = {"is_success": False, "harm": worst}
        if terminated or truncated:
            outcome = episode.outcome()
            assert isinstance(outcome, Outcome)
            info = {
                **info, "is_success": bool(outcome.success), "outcome": outcome,
                "cause": "" if outcome.cause is None else str(outcome.cause),
            }  # fmt: skip
            reward += WON * outcome.success
        return self._seen(), float(reward), bool(terminated), bool(truncated), info

    def close(self) -> None:
        """Give the renderer back."""
        if self._camera is not None:
            self._camera.__exit__(None, None, None)
            self._camera = None

    def _distance(self) -> float:
        """Of the true target's centre from the tool point [m]."""
        assert self.episode is not None
        fruits, target = self.episode.simulation.fruits(), self.episode.situation.scene.target
        if target is None:
            return 0.0
        point, _ = self.episode.robot.tool_pose(self.episode.state.q)
        return float(np.linalg.norm(fruits.positions[fruits.ids.index(target.id)] - point))

    def _seen(self) -> dict[str, Any]:
        assert self.episode is not None
        state = state_of(self.episode.observe(), self.episode.scene)
        out: dict[str, Any] = {name: value.astype(np.float32) for name, value in state.items()}
        if self._camera is not None:
            picture = self._camera.take()
            out |= {"rgb": picture.rgb, "depth": picture.depth.astype(np.float32)}
        return out


def _camera(episode: Episode, size: tuple[int, int], seed: int) -> Any:
    from optipromp.laboratory.simulation.live_camera import LiveCamera
    from optipromp.laboratory.simulation.photograph import PhotoParameters

    width, height = size
    small = PhotoParameters(width=width, height=height, focal=0.75 * width)
    assert isinstance(episode.simulation, Simulation)
    return LiveCamera(episode.simulation, "palm", seed, small)


class PickProMPEnv(_Scenes):
    """A pick by one action: the weights of a primitive (:mod:`optipromp.bench.primitive`).

    Observation: ``objects`` of the scene as seen, about the target. Action: 2 × COUNT weights
    between -1 and 1. The motion is judged and, where the arm can follow it, simulated; with
    ``simulated=False`` the push model's word counts, which takes a hundredth of the time.
    """

    def __init__(
        self, presets: str | Sequence[str] = "cluster", condition: str = "none",
        seeds: tuple[int, int] = TRAINING, simulated: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(presets, condition, seeds)
        self.simulated = simulated
        self.observation_space = spaces.Dict(
            {"objects": spaces.Box(-np.inf, np.inf, (MOST, WIDTH))}
        )
        self.action_space = spaces.Box(-1.0, 1.0, (2 * COUNT,))
        self.situation: Situation | None = None
        self.made: Plan | None = None
        """The plan of the last action."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode of one step. ``options`` may name its ``preset`` and its ``scene``."""
        super().reset(seed=seed)
        self.situation, self._number = self._drawn(options)
        return self._seen(), {"scene": self.situation.scene.name, "is_success": False}

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Follow the path of the weights; the episode ends."""
        assert self.situation is not None, "call reset first"
        weights = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0).reshape(2, COUNT)
        info: dict[str, Any] = {"is_success": False, "cause": "", "harm": np.nan}
        reward = -HARM
        try:
            made = plan(self.situation.seen, planner=OfWeights(weights=weights))
        except OptiPrompError as error:
            info["cause"] = str(error.code)
            return self._seen(), reward, True, False, info
        if made.prediction is not None:
            info["harm"] = float(made.prediction.harm)
            reward -= min(info["harm"], 2.0) * HARM
        self.made = made
        if self.simulated and made.trajectory is not None:
            outcome = simulate(
                made.trajectory, self.situation.scene, robot=made.robot,
                parameters=self.situation.parameters, seed=self._number,
            ).outcome  # fmt: skip
            info |= {"is_success": bool(outcome.success), "outcome": outcome}
            info["cause"] = "" if outcome.cause is None else str(outcome.cause)
        elif not self.simulated:
            info |= {"is_success": made.success, "cause": "" if made.success else str(made.status)}
        return self._seen(), reward + WON * info["is_success"], True, False, info

    def _seen(self) -> dict[str, Any]:
        assert self.situation is not None
        scene = self.situation.seen
        origin = np.zeros(3) if scene.target is None else scene.target.position
        return {"objects": objects_of(scene.objects, scene, origin).astype(np.float32)}


gymnasium.register("optipromp/Pick-v0", entry_point="optipromp.bench.env:PickEnv")
gymnasium.register("optipromp/PickProMP-v0", entry_point="optipromp.bench.env:PickProMPEnv")
