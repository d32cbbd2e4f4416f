"""Gymnasium environments of the simulation: ``optipromp/Pick-v0`` and ``optipromp/PickProMP-v0``.

``gymnasium.make("optipromp_bench:optipromp/Pick-v0")`` imports and registers them.

Rewards are the benchmark's score: at the end 1 for a clean pick, -1 for harm, 0 for neither. On the
way ``Pick-v0`` pays the change of a potential (nearness to the target less harm), which is 0 at the
beginning and at the end: it adds up to nothing, whatever the arm does.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError, check_one_of
from optipromp.core.planning import Plan, plan
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject, bare_robot
from optipromp_bench.episode import LONGEST, RATE, Episode, Observation, guarded, joints_for, score
from optipromp_bench.primitive import COUNT, OfWeights
from optipromp_loop.guard import Guard, Safe
from optipromp_loop.pilot import FRUITS, numbers_of
from optipromp_sim.generate import PRESETS, Preset, generate
from optipromp_sim.simulation import Outcome, Run, Simulation, simulate
from optipromp_sim.situations import CONDITIONS, Situation

MOST = 24  # objects that are told; the nearest to the target first: a choice
KINDS = "target", "pushable", "avoid", "static"
WIDTH = 16
"""Numbers of an object: place (3), axis (3), half extents (3), stem's direction (3), stem's
length, and one of target, pushable or else."""
FAR, FORCE = 2.0, 500.0
"""[m] and [N]: where observations end, with their limits of joints and of times. What is beyond is
told as the end. Choices: places and sizes of all presets are within 0.6 m."""


def told(item: SceneObject, scene: Scene, origin: FloatArray) -> FloatArray:
    """An object as numbers (WIDTH,), in the frame of the scene's approach about ``origin`` (3,)."""
    turn = scene.frame
    surface = item.shape.surface().reshape(-1, 3)
    half = 0.5 * np.ptp(surface @ (turn @ item.rotation).T, axis=0)
    stem, long = np.zeros(3), 0.0
    if item.stem is not None:
        long = item.stem.length
        stem = turn @ (item.stem.points[-1] - item.stem.points[0]) / max(long, 1e-9)
    kind = [float(item.role == name) for name in KINDS[:2]]
    rest = [*kind, float(not any(kind))]
    place = turn @ (item.position - origin)
    return np.concatenate([place, turn @ item.rotation[:, 2], half, stem, [long], rest])


def objects_of(items: Sequence[SceneObject], scene: Scene, origin: FloatArray) -> FloatArray:
    """Objects as rows (MOST, WIDTH), the nearest to ``origin`` first; rows of zeros are none."""
    out = np.zeros((MOST, WIDTH))
    near = sorted(items, key=lambda item: float(np.linalg.norm(item.position - origin)))
    for row, item in enumerate(near[:MOST]):
        out[row] = told(item, scene, origin)
    return out


def objects_in(scene: Scene) -> FloatArray:
    """The objects of a scene about its target, as a network sees them."""
    return objects_of(
        scene.objects, scene, np.zeros(3) if scene.target is None else scene.target.position
    )


def state_of(seen: Observation, scene: Scene) -> dict[str, FloatArray]:
    """An observation as arrays: ``arm`` (2n + 11,) and ``objects`` (MOST, WIDTH).

    ``arm`` is joints, velocities, tool point and axis in the frame of the approach about the
    target as last seen, force on the tool, age of the look, and time. A target that is not seen is
    taken where the scene has it.
    """
    target = next((item for item in seen.fruits if item.role == "target"), scene.target)
    origin = seen.tool_point if target is None else target.position
    arm = np.concatenate(
        [
            seen.q, seen.velocity, scene.frame @ (seen.tool_point - origin),
            scene.frame @ seen.tool_axis, scene.frame @ seen.force, [seen.age, seen.time],
        ]
    )  # fmt: skip
    return {"arm": arm, "objects": objects_of((*seen.fruits, *scene.static), scene, origin)}


def box_of(ends: tuple[FloatArray, FloatArray]) -> spaces.Box:
    """What is between lowest and highest numbers."""
    low, high = ends
    return spaces.Box(low.astype(np.float32), high.astype(np.float32))


def arm_ends(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest ``arm`` of :func:`state_of`."""
    rest = np.array([*3 * [FAR], *3 * [1.0], *3 * [FORCE], LONGEST, LONGEST])
    low = np.concatenate([robot.lower, -robot.velocity, -rest[:-2], np.zeros(2)])
    return low, np.concatenate([robot.upper, robot.velocity, rest])


_TOP = np.tile([*3 * [FAR], *3 * [1.0], *3 * [FAR], *3 * [1.0], FAR, *3 * [1.0]], (MOST, 1))
OBJECTS_ENDS = _TOP * [*6 * [-1], *3 * [0], *3 * [-1], *4 * [0]], _TOP
"""Lowest and highest ``objects``."""
_CAMERA = np.array([*3 * [FAR], *9 * [1.0], 2.0 * np.pi, LONGEST, 10.0, 10.0])
_ROWS = np.tile([*5 * [FAR], 3.0], (FRUITS, 1))
LOOK_ENDS = {"camera": (-_CAMERA, _CAMERA), "environment_state": (-_ROWS, _ROWS)}
"""Lowest and highest numbers of a look."""


SPEED = 0.15  # [m/s] of the tool at an action of 1: a choice; plans push at 0.1 m/s
JOINTS = 0.5  # share of the joints' largest velocities at an action of 1: a choice
PROGRESS, HARM = 1.0, 0.25
"""Of the potential: by metre nearer to the target, and by share of harm (1 at most): choices."""
TIME = 0.01  # reward lost by second: 0.2 for an idle episode, less than missed is from clean
SHOWN = 640, 480  # [pixel] of rendered pictures: a choice
CURRICULUM: tuple[Preset, ...] = ("limp", "cluster", "elongated", "tight", "truss", "field", "wild")
"""Presets of hanging fruit, the easiest first."""
TRAINING = 200_000, 1_000_000
"""Seeds of scenes of episodes; those of benchmarks and studies are below."""
HELD = 2_000  # scenes in memory at most, some 300 MB: a choice


@lru_cache(maxsize=HELD)
def _situation(condition: str, preset: Preset, number: int) -> Situation:
    return CONDITIONS[condition](generate(preset, number), number)


def _whole(name: str, value: Any, least: int = 0) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise InvalidRequestError(f"{name} is {value!r}; must be a whole number from {least}")
    return int(value)


def _pair(name: str, value: Any, least: int) -> tuple[int, int]:
    if not (isinstance(value, Sequence) and len(value) == 2):
        raise InvalidRequestError(f"{name} is {value!r}; must be two whole numbers")
    return _whole(f"{name}[0]", value[0], least), _whole(f"{name}[1]", value[1], least)


class _Scenes(gymnasium.Env[Any, Any]):
    """Scenes by preset and condition; each episode has a scene of its own.

    Args:
        presets: of the scenes, one is drawn for each episode.
        condition: of :data:`optipromp_sim.situations.CONDITIONS`.
        seeds: first of the scenes' seeds, and the last plus one. A few hundred of them are made
            once and held, which saves three quarters of the time of an action of a primitive.
        render_mode: ``rgb_array``, or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(RATE)}  # noqa: RUF012

    def __init__(
        self, presets: str | Sequence[str], condition: str, seeds: tuple[int, int],
        render_mode: str | None,
    ) -> None:  # fmt: skip
        self.presets: tuple[Any, ...] = (presets,) if isinstance(presets, str) else tuple(presets)
        for each in self.presets or ("",):
            check_one_of("presets", each, PRESETS)
        check_one_of("condition", condition, CONDITIONS)
        if render_mode is not None:
            check_one_of("render_mode", render_mode, self.metadata["render_modes"])
        self.condition, self.render_mode = condition, render_mode
        self.seeds = _pair("seeds", seeds, 0)
        if self.seeds[0] >= self.seeds[1]:
            raise InvalidRequestError(f"seeds is {seeds!r}; the second must be above the first")
        few = len(self.presets) * (seeds[1] - seeds[0]) <= HELD
        self._made = _situation if few else _situation.__wrapped__  # others hardly come again
        self._onlooker: Any = None
        self._number: int | None = None
        self._begun = False

    def _drawn(self, options: dict[str, Any] | None) -> tuple[Situation, int]:
        """The scene of a new episode."""
        asked = {} if options is None else options
        if not isinstance(asked, Mapping):
            raise InvalidRequestError(f"options is {asked!r}; must be a dictionary, or None")
        for name in asked:
            check_one_of("options: name", name, ("preset", "scene"))
        preset = asked.get("preset", self.presets[int(self.np_random.integers(len(self.presets)))])
        number = asked.get("scene", self.np_random.integers(*self.seeds))
        check_one_of("options['preset']", preset, PRESETS)
        situation = self._made(self.condition, preset, _whole("options['scene']", number))
        self.close()
        self._begun, self._number = True, int(number)
        return situation, self._number

    def _asked(self, action: Any) -> FloatArray:
        """An action as numbers between -1 and 1."""
        if not self._begun:
            raise InvalidRequestError("no episode is under way: call reset first")
        shape = self.action_space.shape
        try:
            asked = np.asarray(action)
        except ValueError:  # lists of unlike lengths
            asked = np.empty((), dtype=object)
        if asked.shape != shape or asked.dtype.kind not in "fiu":
            words = f"{asked.dtype} of shape {asked.shape}" if asked.shape else repr(action)
            raise InvalidRequestError(f"action is {words}; must be numbers of shape {shape}")
        asked = asked.astype(np.float64)
        if not np.isfinite(asked).all():
            k = int(np.argmin(np.isfinite(asked)))
            raise InvalidRequestError(f"action[{k}] is {asked[k]}; must be finite")
        assert isinstance(self.action_space, spaces.Box)
        return np.asarray(np.clip(asked, self.action_space.low, self.action_space.high))

    def _within(self, seen: Mapping[str, Any]) -> dict[str, Any]:
        """An observation within the bounds of its space."""
        assert isinstance(self.observation_space, spaces.Dict)
        out = dict[str, Any]()
        for name, box in self.observation_space.items():
            assert isinstance(box, spaces.Box)
            out[name] = np.clip(seen[name], box.low, box.high).astype(box.dtype)
        return out

    def render(self) -> Any:
        """Arm and fruits now, (height, width, 3) of bytes; None without a mode of rendering."""
        if self._number is None:
            raise InvalidRequestError("no episode is under way: call reset first")
        if self.render_mode is None:
            return None
        simulation, state = self._now()
        if self._onlooker is None:
            from optipromp_sim.simulation.film import Onlooker

            self._onlooker = Onlooker(simulation.world, *SHOWN)
        return self._onlooker.picture(state)

    @abstractmethod
    def _now(self) -> tuple[Simulation, FloatArray]:
        """A simulation of the scene, and the state of its world that is shown."""

    def close(self) -> None:
        """Give the renderers back."""
        if self._onlooker is not None:
            self._onlooker.close()
            self._onlooker = None


class PickEnv(_Scenes):
    """A pick, step by step at 50 Hz.

    Observations: ``arm`` and ``objects`` of :func:`optipromp_bench.env.state_of`; with
    ``observation="picture"`` also ``rgb`` (height, width, 3) and ``depth`` (height, width) [m] of
    the camera in the tool's mouth. With ``observation="look"``: joints as ``agent_pos`` (n,), and
    ``camera`` and ``environment_state`` of :mod:`optipromp_loop.pilot` (there ``fruits``). Actions,
    each between -1 and 1: ``tool``: velocity of the tool point along x_g, y_g, z_g of the approach,
    whose axis the tool keeps; ``joints``: velocities; or ``positions`` (n,) of the joints [rad]
    that are wanted a period later. ``act`` takes velocities [rad/s] in place of an action. An
    episode ends when the tool has held a fruit for 0.3 s, when something is harmed, or after
    20 s; unlike one of the board it has no way out. Its last ``info`` has ``is_success``, ``cause``
    and ``outcome``, as the simulation judges. The rewards of an episode add up to its score
    (1 clean, -1 harmed, 0 missed) less 0.01 a second.

    Args:
        presets, condition, seeds, render_mode: see :class:`_Scenes`.
        action: ``tool``, ``joints`` or ``positions``.
        observation: ``state``, ``picture`` or ``look``.
        size: width and height of pictures [pixel].
    """

    def __init__(
        self, presets: str | Sequence[str] = "cluster", condition: str = "none",
        seeds: tuple[int, int] = TRAINING, action: Literal["tool", "joints", "positions"] = "tool",
        observation: Literal["state", "picture", "look"] = "state",
        size: tuple[int, int] = (96, 72), render_mode: str | None = None,
    ) -> None:  # fmt: skip
        super().__init__(presets, condition, seeds, render_mode)
        check_one_of("action", action, ("tool", "joints", "positions"))
        check_one_of("observation", observation, ("state", "picture", "look"))
        self.action, self.observation, self.size = action, observation, _pair("size", size, 1)
        self.robot = robot = bare_robot(generate(self.presets[0], seeds[0]))
        ends = {"arm": arm_ends(robot), "objects": OBJECTS_ENDS}
        if observation == "look":
            ends = {"agent_pos": (robot.lower, robot.upper), **LOOK_ENDS}
        seen: dict[str, spaces.Space[Any]] = {name: box_of(pair) for name, pair in ends.items()}
        if observation == "picture":
            width, height = size
            seen["rgb"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
            seen["depth"] = spaces.Box(0.0, FAR, (height, width))
        self.observation_space = spaces.Dict(seen)
        self.action_space = spaces.Box(-1.0, 1.0, (3 if action == "tool" else robot.n_joints,))
        if action == "positions":
            self.action_space = box_of((robot.lower, robot.upper))
        self.episode: Episode | None = None
        self.guard: Guard | None = None
        """Through which actions pass, see :class:`Guarded`."""
        self.safe: Safe | None = None
        """What the guard made of the last action."""
        self._camera: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode. ``options`` may name its ``preset`` and its ``scene``, a seed."""
        super().reset(seed=seed)
        situation, number = self._drawn(options)
        self.episode = Episode(situation, number)
        if self.observation == "picture":
            self._camera = _camera(self.episode, self.size, number)
        self._raw, self._potential = self._worth(), 0.0
        return self._seen(), {"scene": situation.scene.name, "is_success": False}

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One period of 20 ms."""
        asked, episode = self._asked(action), self.episode
        assert episode is not None
        if self.action == "tool":
            frame = episode.scene.frame
            q = episode.state.q
            return self.act(joints_for(episode.robot, q, SPEED * asked @ frame, frame[2]))
        if self.action == "positions":
            return self.act((asked - episode.reference.q) / episode.period)
        return self.act(JOINTS * episode.robot.velocity * asked)

    def act(self, velocity: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """One period by velocities (n,) of the joints [rad/s]; see ``step``."""
        episode = self.episode
        if episode is None or not self._begun:
            raise InvalidRequestError("no episode is under way: call reset first")
        if self.guard is None:
            episode.act(velocity)
        else:
            self.safe = guarded(self.guard, velocity, episode)
            episode.lead(episode.toward(self.safe.velocity, self.safe.curve))
        terminated = episode.done
        truncated = episode.ended and not terminated
        info: dict[str, Any] = {"is_success": False, "harm": min(episode.harm().worst, 2.0)}
        potential = 0.0 if terminated or truncated else self._worth() - self._raw
        reward = potential - self._potential - TIME * episode.period
        self._potential = potential
        if terminated or truncated:
            self._begun = False
            outcome = episode.judged()
            assert isinstance(outcome, Outcome)
            info |= _told(outcome)
            reward += score(outcome)
        return self._seen(), float(reward), bool(terminated), bool(truncated), info

    def _now(self) -> tuple[Simulation, FloatArray]:
        assert self.episode is not None
        assert isinstance(self.episode.arena, Simulation)
        return self.episode.arena, np.array(self.episode.arena.data.qpos)

    def close(self) -> None:
        """Give the renderers back."""
        super().close()
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _worth(self) -> float:
        """The potential of the present state, up to a constant."""
        assert self.episode is not None
        fruits, target = self.episode.arena.fruits(), self.episode.situation.scene.target
        away, worth = 0.0, -HARM * min(self.episode.harm().worst, 1.0)
        if target is not None:
            point, _ = self.episode.robot.tool_pose(self.episode.state.q)
            away = float(np.linalg.norm(fruits.positions[fruits.ids.index(target.id)] - point))
        return worth - PROGRESS * away

    def _seen(self) -> dict[str, Any]:
        assert self.episode is not None
        told = self.episode.observe()
        if self.observation == "look":
            camera, fruits = numbers_of(told.look, told.time)
            told_by = {"agent_pos": told.q, "environment_state": fruits, "camera": camera}
            return self._within(told_by)
        state = state_of(told, self.episode.scene)
        if self._camera is not None:
            picture = self._camera.take()
            state |= {"rgb": picture.rgb, "depth": picture.depth}
        return self._within(state)


class Guarded(gymnasium.Wrapper[Any, Any, Any, Any]):
    """``optipromp/Pick-v0`` behind a guard, which prevents harm as far as it is predicted.

    Each ``info`` has ``guard``: what the guard made of the action
    (:class:`optipromp_loop.guard.Safe`), and ``action``: the action that was executed, in the
    environment's action space: a label for learners. ``takes_over``: of the guard, see
    :class:`optipromp_loop.guard.Guard`; ``guard.mover`` then says who moves the arm.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], takes_over: bool = False) -> None:
        super().__init__(env)
        self._takes_over = takes_over

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode, with a guard that knows the scene as first seen."""
        seen, info = self.env.reset(seed=seed, options=options)
        env = self._pick()
        assert env.episode is not None
        env.guard = Guard(env.episode.scene, env.episode.robot, takes_over=self._takes_over)
        return seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One period, in which the guard may act in place of the policy."""
        env, episode = self._pick(), self._pick().episode
        assert episode is not None
        q = episode.reference.q
        seen, reward, terminated, truncated, info = self.env.step(action)
        safe = env.safe
        assert safe is not None
        label = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        if safe.acted and env.action == "tool":
            along, _ = episode.robot.tool_jacobian(q)
            label = episode.scene.frame @ (along @ safe.velocity) / SPEED
        elif safe.acted:
            label = safe.velocity / (JOINTS * episode.robot.velocity)
        info |= {"guard": safe, "action": np.clip(label, -1.0, 1.0).astype(np.float32)}
        return seen, reward, terminated, truncated, info

    def _pick(self) -> PickEnv:
        env = self.env.unwrapped
        if not isinstance(env, PickEnv):
            raise InvalidRequestError(f"a guard is for optipromp/Pick-v0; this is {env}")
        return env


def _told(outcome: Outcome) -> dict[str, Any]:
    cause = "" if outcome.cause is None else str(outcome.cause)
    return {"is_success": bool(outcome.success), "outcome": outcome, "cause": cause}


def _camera(episode: Episode, size: tuple[int, int], seed: int) -> Any:
    from optipromp_sim.simulation.photograph import LiveCamera, PhotoParameters

    width, height = size
    small = PhotoParameters(width=width, height=height, focal=0.75 * width)
    assert isinstance(episode.arena, Simulation)
    return LiveCamera(episode.arena, "palm", seed, small)


class PickProMPEnv(_Scenes):
    """A pick by one action: the weights of a primitive (:mod:`optipromp_bench.primitive`).

    Observation: ``objects`` of the scene as seen, about the target. Action: 2 × COUNT weights
    between -1 and 1. The motion is judged and, where the arm can follow it, simulated; with
    ``simulated=False`` the push model's word counts, which takes a hundredth of the time. The
    reward is the score (1 clean, -1 harmed, 0 missed or not followed), less a quarter of the
    predicted harm (1 at most), which does not change the order of the three.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012

    def __init__(
        self, presets: str | Sequence[str] = "cluster", condition: str = "none",
        seeds: tuple[int, int] = TRAINING, simulated: bool = True, render_mode: str | None = None,
    ) -> None:  # fmt: skip
        super().__init__(presets, condition, seeds, render_mode)
        if render_mode is not None and not simulated:
            raise InvalidRequestError("render_mode: what is not simulated cannot be shown")
        self.simulated = simulated
        self.observation_space = spaces.Dict({"objects": box_of(OBJECTS_ENDS)})
        self.action_space = spaces.Box(-1.0, 1.0, (2 * COUNT,))
        self.situation: Situation | None = None
        self.made: Plan | None = None
        """The plan of the last action."""
        self._run: Run | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode of one step. ``options`` may name its ``preset`` and its ``scene``."""
        super().reset(seed=seed)
        (self.situation, _), self._run = self._drawn(options), None
        return self._seen(), {"scene": self.situation.scene.name, "is_success": False}

    def step(self, action: FloatArray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Follow the path of the weights; the episode ends."""
        weights = self._asked(action).reshape(2, COUNT)
        assert self.situation is not None
        assert self._number is not None
        self._begun = False
        info: dict[str, Any] = {"is_success": False, "cause": "", "harm": np.nan}
        try:
            made = plan(self.situation.seen, planner=OfWeights(weights=weights))
        except OptiPrompError as error:
            info["cause"] = str(error.code)
            return self._seen(), 0.0, True, False, info
        self.made, reward = made, 0.0
        if made.prediction is not None:
            info["harm"] = float(made.prediction.harm)
            reward -= HARM * min(info["harm"], 1.0)
        if self.simulated:
            self._run = simulate(
                made.trajectory, self.situation.scene, robot=made.robot,
                parameters=self.situation.parameters, seed=self._number,
            )  # fmt: skip
            outcome = self._run.outcome
            info |= _told(outcome)
            reward += score(outcome)
        else:
            info |= {"is_success": made.success, "cause": "" if made.success else str(made.status)}
            reward += made.success - (made.status == Code.HARM_PREDICTED)
        return self._seen(), float(reward), True, False, info

    def _now(self) -> tuple[Simulation, FloatArray]:
        assert self.situation is not None
        assert self._number is not None
        first = Simulation(self.situation.scene, self._number, self.situation.parameters)
        return first, np.array(self._run.rollout.states[-1] if self._run else first.data.qpos)

    def _seen(self) -> dict[str, Any]:
        assert self.situation is not None
        return self._within({"objects": objects_in(self.situation.seen)})
