"""LeRobot's own classes with the closed loop as a policy and with the guard as a step."""

import site
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lerobot", exc_type=ImportError)

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import PolicyFeature
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import ProcessorStepRegistry, RobotProcessorPipeline, TransitionKey
from lerobot.processor.converters import (
    robot_action_observation_to_transition,
    transition_to_robot_action,
)

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes import Scene, load_scene
from optipromp.core.scenes.goals import JointGoal
from optipromp.core.scenes.look import Look
from optipromp_bench.episode import Episode, joints_for
from optipromp_loop.guard import Guard
from optipromp_loop.lerobot import (
    FRUITS,
    GuardStep,
    OptiPrompConfig,
    OptiPrompPolicy,
    batch_of,
    look_of,
)
from optipromp_sim.generate import generate
from optipromp_sim.situations import CONDITIONS

GOALS = {  # of free scenes: a place within the limits
    "panda": [0.0, -0.1, 0.1, -1.5, 0.0, 1.5, 0.0],
    "xarm7": [-0.1] * 7,
    "so101": [-0.1] * 5,
}
MODELS = Path("cmeel.prefix/share/example-robot-data/robots")
FILES = {"xarm7": "xarm_description/urdf/xarm7.urdf", "so101": "so_arm_description/urdf/so101.urdf"}
SO101 = "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"


def description(arm: str) -> str:
    """A built-in arm, or the file of one that example-robot-data brings."""
    if arm not in FILES:
        return arm
    found = [Path(p) / MODELS / FILES[arm] for p in site.getsitepackages()]
    if not any(map(Path.exists, found)):
        pytest.skip("example-robot-data is not installed")
    return str(next(filter(Path.exists, found)))


def free(arm: str) -> Scene:
    """A scene with nothing but an arm."""
    goal = JointGoal(np.array(GOALS[arm]))
    return Scene(name="free", robot=description(arm), objects=(), goal=goal)


def test_lerobot_finds_the_policy_by_name_saves_it_and_loads_it(tmp_path: Path) -> None:
    assert PreTrainedConfig.get_choice_class("optipromp") is OptiPrompConfig
    assert get_policy_class("optipromp") is OptiPrompPolicy
    policy = OptiPrompPolicy(OptiPrompConfig(n_action_steps=3, push_to_hub=False))
    assert isinstance(policy, PreTrainedPolicy)
    policy.save_pretrained(tmp_path)
    again = OptiPrompPolicy.from_pretrained(tmp_path)
    assert isinstance(again, OptiPrompPolicy)
    assert again.config.n_action_steps == 3
    assert all(isinstance(f, PolicyFeature) for f in again.config.input_features.values())
    assert again.config.robot_state_feature.shape == (again.controller.robot.n_joints,)
    assert again.config.env_state_feature.shape == (FRUITS, 6)
    assert again.config.action_feature.shape == (len(again.names),)
    assert not again.config.image_features
    with pytest.raises(InvalidRequestError, match="nothing to train"):
        again.forward({})


@pytest.mark.parametrize("commands", ["positions", "velocities", "tool"])
def test_chunks_have_the_stated_shape_and_actions_come_from_them(commands: str) -> None:
    policy = OptiPrompPolicy(OptiPrompConfig(n_action_steps=4, commands=commands))
    before, after = make_pre_post_processors(policy.config)
    robot, start = posed(load_scene("scenario-3"))
    seen = before({k: v[0] for k, v in batch_of(start.q).items()})
    chunk = policy.predict_action_chunk(seen)
    assert chunk.shape == (1, 4, 3 if commands == "tool" else robot.n_joints)
    assert chunk.dtype == torch.float32
    policy.reset()
    for k in range(4):  # no look has come: the arm stands
        action = after(policy.select_action(seen))
        assert torch.equal(action, chunk[:, k])
        assert action.numpy().ravel() == pytest.approx(
            start.q if commands == "positions" else 0.0, abs=1e-6
        )


def test_a_look_passes_through_numbers() -> None:
    scene = generate("cluster", 940_000)
    episode = Episode(CONDITIONS["none"](scene, 1), 1)
    look = episode.observe().look
    while look is None:
        episode.act(np.zeros(episode.robot.n_joints))
        look = episode.observe().look
    back = look_of(batch_of(episode.state.q, look, 5.0), scene, 5.0)
    assert isinstance(back, Look)
    assert back.time == pytest.approx(look.time, abs=1e-5)
    assert (back.view, back.near) == pytest.approx((look.view, look.near))
    assert back.far == pytest.approx(look.far)
    pairs = list(zip(look.in_base(), back.in_base(), strict=True))
    assert pairs
    for one, other in pairs:
        assert other.position == pytest.approx(one.position, abs=1e-5)
        assert other.role == one.role
        known = next(o for o in scene.objects if o.role == one.role
                     and np.linalg.norm(o.position - one.position) < 0.05)  # fmt: skip
        assert other.radius == pytest.approx(known.radius)


@pytest.mark.filterwarnings("ignore:no built-in demonstrations")
@pytest.mark.parametrize(
    ("arm", "commands"), [("xarm7", "velocities"), ("so101", "velocities"), ("panda", "tool")]
)
def test_the_policy_picks_by_velocities(arm: str, commands: str) -> None:
    """They go to the arm, of a description or built in, 50 times a second."""
    scene = generate("cluster", 77_000, description(arm))
    episode = Episode(CONDITIONS["none"](scene, 1), 1)
    policy = OptiPrompPolicy(OptiPrompConfig(n_action_steps=2, commands=commands), scene=scene)
    assert len(policy.names) == (3 if commands == "tool" else episode.robot.n_joints)
    while not (episode.done or episode.ended):
        seen = batch_of(episode.state.q, episode.observe().look, episode.time)
        asked = policy.select_action(seen).numpy()[0].astype(np.float64)
        if commands == "tool":
            asked = joints_for(episode.robot, episode.state.q, asked, scene.frame[2])
        episode.act(asked)
    assert episode.judged().result == "clean", policy.controller.history


@pytest.mark.parametrize("arm", ["panda", "xarm7", "so101"])
def test_the_guard_is_a_step_of_a_robots_pipeline(arm: str) -> None:
    scene = free(arm)
    step = GuardStep(commands="positions", rate=50.0)
    step.use(scene)
    robot = step.guard.robot
    if arm == "so101":
        assert robot.joint_names == SO101
    pipeline: Any = RobotProcessorPipeline(
        steps=[step], to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )  # fmt: skip
    q, sent = robot.home.copy(), [robot.home]
    rng = np.random.default_rng(1)
    goal = q
    for k in range(60):
        if k % 15 == 0:  # a policy that jumps
            goal = q + rng.uniform(-0.5, 0.5, q.shape)
        asked = {f"{name}.pos": float(v) for name, v in zip(robot.joint_names, goal, strict=True)}
        seen = {f"{name}.pos": float(v) for name, v in zip(robot.joint_names, q, strict=True)}
        out = pipeline(({**asked, "gripper.pos": 7.0}, seen))
        assert out["gripper.pos"] == 7.0
        q = np.array([out[f"{name}.pos"] for name in robot.joint_names])
        sent.append(q)
    speed = np.abs(np.diff(sent, axis=0)) * 50.0
    assert (speed <= robot.velocity * (1.0 + 1e-6)).all()
    assert (np.abs(np.diff(speed, axis=0)).max(axis=0) * 50.0 <= 2.0 * robot.acceleration).all()
    assert (np.array(sent) >= robot.lower - 1e-6).all()
    assert (np.array(sent) <= robot.upper + 1e-6).all()
    assert np.ptp(sent, axis=0).max() > 0.05  # it moves
    with pytest.raises(InvalidRequestError, match="the action lacks"):
        pipeline(({"gripper.pos": 1.0}, {}))


def test_a_position_that_is_asked_for_within_a_turn_is_the_near_one() -> None:
    step = GuardStep(commands="positions")
    step.use(free("panda"))
    robot = step.guard.robot
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[6], upper[6] = -np.inf, np.inf
    step.guard = Guard(free("panda"), replace(robot, lower=lower, upper=upper))
    names, q = step.names(robot), robot.home.copy()
    q[6] = np.pi - 0.05
    for _ in range(60):
        asked = [*q[:6], (q[6] + 0.006 + np.pi) % (2.0 * np.pi) - np.pi]
        seen = {name: float(v) for name, v in zip(names, q, strict=True)}
        action = {name: float(v) for name, v in zip(names, asked, strict=True)}
        out = step({TransitionKey.OBSERVATION: seen, TransitionKey.ACTION: action})
        there = np.array([out[TransitionKey.ACTION][name] for name in names])
        assert np.abs(there - q).max() < 0.007
        q = there
    assert q[6] > np.pi + 0.1


def test_a_pipeline_with_the_guard_is_saved_and_loaded(tmp_path: Path) -> None:
    assert ProcessorStepRegistry.get("optipromp_guard") is GuardStep
    made: Any = RobotProcessorPipeline(
        steps=[GuardStep("scenario-3", 25.0, "velocities")], name="guarded",
        to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )  # fmt: skip
    made.save_pretrained(tmp_path)
    again: Any = RobotProcessorPipeline.from_pretrained(
        tmp_path, config_filename="guarded.json",
        to_transition=robot_action_observation_to_transition,
        to_output=transition_to_robot_action,
    )  # fmt: skip
    (step,) = again.steps
    assert (step.scene, step.rate, step.commands) == ("scenario-3", 25.0, "velocities")
    assert step.guard.parameters.period == 0.04
    wild = {f"{name}.vel": 99.0 for name in step.guard.robot.joint_names}
    with pytest.raises(InvalidRequestError, match=r"the first action needs observation\.state"):
        again((wild, {}))
    seen = {f"{name}.pos": float(v) for name, v in
            zip(step.guard.robot.joint_names, step.guard.robot.home, strict=True)}  # fmt: skip
    out = again((wild, seen))
    assert max(out.values()) < 99.0
    assert step.safe.acted
