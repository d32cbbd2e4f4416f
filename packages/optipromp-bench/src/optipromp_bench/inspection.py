"""inspect-robots: the simulation, the closed loop, the guard and the score, found by their names.

Its entry points are in this package's ``pyproject.toml``, so that after an installation
``inspect-robots run --task optipromp-pick --policy optipromp --embodiment optipromp`` picks. The
guard is one of the embodiment's guardrails. Tested with inspect-robots 0.60.

A state has ``joint_pos`` (n,) [rad], and ``camera`` and ``fruits`` of the newest look, see
:mod:`optipromp_loop.pilot`. ``extra["scene"]`` is the scene as first seen. Times are since the
begin of a pick [s]. Actions are velocities (n,) of the joints [rad/s].
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from inspect_robots.approver import GuardrailContribution
from inspect_robots.embodiment import (
    PRIVILEGED_SUCCESS,
    RESETTABLE,
    SEEDABLE,
    EmbodimentBase,
    EmbodimentInfo,
)
from inspect_robots.policy import PolicyBase, PolicyConfig, PolicyInfo
from inspect_robots.rollout import TrialRecord
from inspect_robots.scene import Scene as Trial
from inspect_robots.scene import Target
from inspect_robots.scorer import Score, Scorer
from inspect_robots.spaces import ActionSemantics, Box, ObservationSpace, StateField, StateSpec
from inspect_robots.task import Task
from inspect_robots.types import Action, ActionChunk, StepResult
from inspect_robots.types import Observation as Told

from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import scene_from_dict, scene_to_dict
from optipromp.core.scenes.scene import bare_robot
from optipromp_bench.env import TRAINING, PickEnv
from optipromp_bench.episode import LONGEST, RATE, Episode, guarded, score
from optipromp_loop.guard import Guard
from optipromp_loop.pilot import FRUITS, Commands, Pilot, look_in
from optipromp_sim.generate import generate

STEPS = 2  # actions of a chunk: a choice; a look counts from the next chunk on
STATE = "joint_pos", "camera", "fruits"
GUARD = "optipromp_guard"  # of a trial's store: the guard of its episode


def state_spec(robot: Robot) -> ObservationSpace:
    """What a state has."""
    fields = zip(STATE, ((robot.n_joints,), (16,), (FRUITS, 6)), ("rad", "", ""), strict=True)
    return ObservationSpace(state=StateSpec(tuple(StateField(*each) for each in fields)))


def velocities(robot: Robot) -> Box:
    """Actions, within the joints' limits."""
    most = robot.velocity
    meaning = ActionSemantics("joint_vel", dim_labels=tuple(robot.joint_names))
    return Box((robot.n_joints,), -most, most, meaning)


class Plant(EmbodimentBase):
    """The simulated arm before a plant: :class:`optipromp_bench.env.PickEnv` of a preset.

    ``metadata`` of a trial may name another ``preset``, and ``scene``, a seed. The guard is one of
    the guardrails.
    """

    def __init__(self, *, preset: str = "cluster", condition: str = "none") -> None:
        self.env = PickEnv(preset, condition, action="joints", observation="look")
        robot = self.env.robot
        self.info = EmbodimentInfo(
            "optipromp", velocities(robot), state_spec(robot), RATE, True,
            frozenset({SEEDABLE, RESETTABLE, PRIVILEGED_SUCCESS}),
            docs="An arm reaches for the ripe fruit of a plant and may harm nothing. fruits has a "
            "row a fruit: place [m], deviation, radius, role (1 ripe, 2 unripe).",
        )  # fmt: skip

    @property
    def episode(self) -> Episode:
        """The pick that is under way."""
        assert self.env.episode is not None
        return self.env.episode

    def reset(self, scene: Trial, *, seed: int | None = None) -> Told:
        """Begin a pick."""
        asked = {k: v for k, v in scene.metadata.items() if k in ("preset", "scene")}
        seen, _ = self.env.reset(seed=seed, options=asked)
        return self._told(seen, scene.instruction)

    def step(self, action: Action) -> StepResult:
        """One period of 20 ms."""
        seen, reward, terminated, truncated, info = self.env.act(np.asarray(action.data))
        outcome = info.pop("outcome", None)
        why = None
        if outcome is not None:
            info |= {"result": outcome.result, "score": score(outcome)}
            why = "success" if outcome.success else info["cause"]
        return StepResult(self._told(seen), reward, terminated, why, truncated, info)

    def contribute_guardrails(self, action_space: Box) -> GuardrailContribution:
        """The guard: the action nearest to the wished one that harms nothing."""
        return GuardrailContribution((("optipromp guard", Guarding(self)),))

    def _told(self, seen: dict[str, Any], instruction: str | None = None) -> Told:
        state = {**seen, "joint_pos": seen["agent_pos"], "fruits": seen["environment_state"]}
        state = {name: np.asarray(state[name], dtype=np.float64) for name in STATE}
        extra = {"scene": scene_to_dict(self.episode.scene)}
        now = self.episode.time
        return Told(state=state, instruction=instruction, state_time=now, extra=extra)


@dataclass(frozen=True)
class Guarding:
    """The guard as an approver of what a plant is to do."""

    plant: Plant

    def review(self, action: Action, store: dict[str, Any]) -> Action:
        """The action itself where it harms nothing, else the nearest one that does not."""
        episode = self.plant.episode
        if GUARD not in store:
            store[GUARD] = Guard(episode.scene, episode.robot)
        safe = guarded(store[GUARD], np.asarray(action.data, dtype=np.float64), episode)
        meta = {**action.meta, "clamped": True, "guard": safe.reason}
        return replace(action, data=safe.velocity, meta=meta) if safe.acted else action


class Loop(PolicyBase):
    """The closed loop."""

    def __init__(self, *, seed: int = 0) -> None:
        robot = bare_robot(generate("cluster", TRAINING[0]))
        self.seed = seed
        self.pilot: Pilot | None = None
        self.info = PolicyInfo("optipromp", velocities(robot), state_spec(robot), RATE)
        self.config = PolicyConfig(action_horizon=STEPS)

    def reset(self, scene: Trial) -> None:
        """Begin a pick, in the scene of the first observation."""
        self.pilot = None

    def act(self, observation: Told) -> ActionChunk:
        """The velocities of the next periods."""
        given = Commands(commands="velocities")
        pilot = self.pilot or Pilot(
            scene_from_dict(dict(observation.extra["scene"])), given, seed=self.seed, steps=STEPS
        )
        self.pilot, state, now = pilot, observation.state, observation.state_time
        camera, fruits = (np.asarray(state[n], dtype=np.float64) for n in ("camera", "fruits"))
        look = look_in(camera, fruits, pilot.scene, now)
        rows = pilot.chunk(now, np.asarray(state["joint_pos"]), look)
        return ActionChunk([Action(row) for row in rows], RATE)

    def transcript(self) -> Any | None:
        """The decisions of the loop, each with its time [s] and why."""
        events = self.pilot.controller.events if self.pilot else ()
        return [[each.time, str(each.stage), each.why] for each in events]


@dataclass(frozen=True)
class Outcome:
    """The benchmark's score: 1 clean, -1 harmed, 0 missed or broken off."""

    name: str = "optipromp"

    def __call__(self, record: TrialRecord, target: Target | None) -> Score:
        """Of a recorded pick."""
        info = record.steps[-1].result.info if record.steps else {}
        return Score(int(info.get("score", 0)), str(info.get("result", "missed")))


def picks(*, preset: str = "cluster", count: int = 4, first: int = TRAINING[0]) -> Task:
    """Picks of one preset, in ``count`` scenes from the seed ``first`` on."""
    trials = [
        Trial(f"{preset}-{k}", "pick the ripe fruit, harm nothing",
              metadata={"preset": preset, "scene": k})
        for k in range(first, first + count)
    ]  # fmt: skip
    scorers: list[Scorer | str] = ["success_at_end", Outcome()]
    return Task("optipromp-pick", trials, scorers, max_steps=round(LONGEST * RATE))
