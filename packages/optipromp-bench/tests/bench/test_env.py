"""The Gymnasium environments: as Gymnasium wants them, the same by seed, and won by the planner.

Rewards add up to the benchmark's score less a little for time, whatever the arm does.
"""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import plan
from optipromp.core.robots.library import load_robot
from optipromp.core.trajectory import State
from optipromp_bench.env import HARM, SPEED, TIME, PickEnv, PickProMPEnv
from optipromp_bench.episode import HELD, LONGEST, RATE, Episode, driven, joints_for, score
from optipromp_bench.episodes import follower
from optipromp_bench.flight import Word
from optipromp_bench.primitive import COUNT, OfWeights, weights_of
from optipromp_sim.generate import generate
from optipromp_sim.situations import CONDITIONS

pytest.importorskip("mujoco")
SCENE = {"preset": "cluster", "scene": 61_000}


@pytest.mark.parametrize(
    "modules", ["optipromp_bench, gymnasium", "gymnasium, optipromp_bench.env"]
)
def test_the_import_alone_registers_both_in_either_order(modules: str) -> None:
    code = f"""
import {modules}
for name in ("Pick-v0", "PickProMP-v0"):
    print(gymnasium.spec(f"optipromp/{{name}}").id)
"""
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert told.stdout.split() == ["optipromp/Pick-v0", "optipromp/PickProMP-v0"], told.stderr


def test_the_import_loads_no_gymnasium() -> None:
    code = "import sys, optipromp_bench; print([m for m in sys.modules if 'gymnasium' in m])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["optipromp/Pick-v0", "optipromp/PickProMP-v0"])
def test_gymnasium_checks_both(name: str) -> None:
    """Its own checker has no warning, which would be an error here; all bounds are finite."""
    env = gymnasium.make(f"optipromp_bench:{name}", render_mode="rgb_array")
    check_env(env.unwrapped)
    assert env.spec.max_episode_steps == (1 if "ProMP" in name else LONGEST * RATE)
    env.close()


@pytest.mark.parametrize("name", ["optipromp/Pick-v0", "optipromp/PickProMP-v0"])
def test_an_episode_is_rendered(name: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array")
    assert "rgb_array" in env.metadata["render_modes"]
    assert env.metadata["render_fps"] > 0
    env.reset(seed=1, options=SCENE)
    before: Any = env.render()
    assert before.shape == (480, 640, 3)
    assert before.dtype == np.uint8
    red, green, blue = (before[..., k].astype(int) for k in range(3))
    assert ((red > 150) & (green < 60) & (blue < 60)).sum() > 20  # the ripe fruit
    count = 1 if "ProMP" in name else 25
    for _ in range(count):
        env.step(np.ones(env.action_space.shape or ()))
    after: Any = env.render()
    assert (np.abs(after.astype(int) - before.astype(int)) > 30).any(axis=2).sum() > 500  # it moved
    env.close()


def test_without_a_mode_nothing_is_rendered() -> None:
    env = PickEnv()
    with pytest.raises(InvalidRequestError, match="reset"):
        env.render()
    env.reset(seed=1, options=SCENE)
    assert env.render() is None
    with pytest.raises(InvalidRequestError, match="render_mode is 'human'"):
        PickEnv(render_mode="human")
    with pytest.raises(InvalidRequestError, match="render_mode"):
        PickProMPEnv(simulated=False, render_mode="rgb_array")


Acting = Callable[[Episode], FloatArray]
"""Velocity (3,) of the tool along x_g, y_g, z_g [m/s] in an episode."""


def below_then_up() -> Acting:
    """To 25 cm below the target, then straight up through what hangs there."""
    state = {"up": False}

    def velocity(episode: Episode) -> FloatArray:
        scene = episode.scene
        point, _ = episode.robot.tool_pose(episode.state.q)
        off = scene.frame @ (point - scene.target.position)
        state["up"] |= bool(np.hypot(off[0], off[1]) < 0.006 and abs(off[2] + 0.25) < 0.03)
        wanted = np.zeros(3) if state["up"] else np.array([0.0, 0.0, -0.25])
        most = (0.6 if state["up"] else 1.0) * SPEED
        return np.clip(3.0 * (wanted - off), -most, most)

    return velocity


def our_plan(episode: Episode) -> Acting:
    expert = follower(plan(episode.scene))
    return lambda now: SPEED * expert(now.robot.tool_pose(now.state.q)[0])


def played(env: PickEnv, behaviour: str) -> tuple[float, int, dict[str, Any]]:
    """Return, steps and the last info of an episode."""
    env.reset(seed=0, options={"preset": "limp", "scene": 200_001})
    assert env.episode is not None
    acting: Acting = {
        "still": lambda _: np.zeros(3), "up": lambda _: np.array([0.0, 0.0, 0.6 * SPEED]),
        "through": below_then_up(), "ours": our_plan(env.episode),
    }[behaviour]  # fmt: skip
    total, count = 0.0, 0
    while True:
        _, reward, terminated, truncated, info = env.step(acting(env.episode) / SPEED)
        total, count = total + reward, count + 1
        if terminated or truncated:
            assert terminated == (behaviour != "still")
            return total, count, info


def test_returns_are_ordered_as_the_score_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Clean above idle above harmed; nothing that is paid on the way remains."""
    env, returns = PickEnv(), {}
    for behaviour, worth in {"ours": 1, "up": -1, "through": -1, "still": 0}.items():
        if behaviour == "still":
            monkeypatch.setattr("optipromp_bench.episode.LONGEST", 4.0)
        total, count, info = played(env, behaviour)
        assert score(info["outcome"]) == worth, info["cause"]
        assert total == pytest.approx(worth - TIME * 0.02 * count, abs=1e-9)
        returns[behaviour] = total
        if behaviour == "still":
            assert (count, info["cause"]) == (200, "not_picked")
        if behaviour == "through":
            assert info["cause"] == "swallowed_other"
            assert HELD < 0.02 * count < LONGEST - 1.0
            assert info["harm"] >= 1.0
            assert env.episode.harm().swallowed == 1
            assert len(env.episode.judged().swallowed_others) == 1
    assert returns["ours"] > returns["still"] > max(returns["up"], returns["through"])


def test_a_swallowed_neighbour_ends_an_episode_of_the_flying_cup_too() -> None:
    setting = CONDITIONS["none"](generate("limp", 200_001), 200_001)
    acting, episode = below_then_up(), Episode(setting, 200_001, engine="flight")
    while not (episode.done or episode.ended):
        velocity = acting(episode) @ episode.scene.frame
        episode.act(joints_for(episode.robot, episode.state.q, velocity, episode.scene.frame[2]))
    assert HELD < episode.time < LONGEST - 1.0
    harm = episode.harm()
    assert harm.swallowed == 1
    assert harm.done
    outcome = episode.judged()
    assert isinstance(outcome, Word)
    assert len(outcome.swallowed) == 1
    assert score(outcome) == -1


def test_one_action_is_a_primitive_that_is_paid_by_the_score() -> None:
    """The weights that are nearest to the planner's own path pick where the planner picks."""
    env = PickProMPEnv()
    env.reset(seed=0, options=SCENE)
    scene = env.situation.seen
    weights, rewards = weights_of(plan(scene)), {}
    assert np.abs(weights).max() < 1.0
    for name, action in (("ours", weights.ravel()), ("straight", 0.0 * weights.ravel())):
        seen, _ = env.reset(seed=0, options=SCENE)
        assert env.observation_space.contains(seen)
        _, rewards[name], terminated, truncated, info = env.step(action)
        assert (terminated, truncated) == (True, False)
        assert rewards[name] == pytest.approx(
            score(info["outcome"]) - HARM * min(info["harm"], 1.0)
        )
    assert rewards["ours"] >= 1.0 - HARM
    assert rewards["straight"] <= -1.0
    again = plan(scene, planner=OfWeights(weights=weights))
    assert np.abs(weights_of(again) - weights).max() < 0.25
    with pytest.raises(InvalidRequestError, match="must be"):
        plan(scene, planner=OfWeights(weights=np.zeros((2, COUNT + 1))))


def test_one_action_is_paid_by_the_push_models_word() -> None:
    env, told = PickProMPEnv(simulated=False), set()
    for scene, factor in ((200_003, 1.0), (200_001, 1.0), (200_002, 0.0)):
        env.reset(seed=0, options={"preset": "limp", "scene": scene})
        action = factor * weights_of(plan(env.situation.seen)).ravel()
        _, reward, *_, info = env.step(action)
        worth = info["is_success"] - (info["cause"] == "HARM_PREDICTED")
        assert reward == pytest.approx(worth - HARM * min(info["harm"], 1.0))
        told.add(worth)
    assert {1, -1} <= told


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"presets": "clustr"}, "presets is 'clustr'.*cluster"),
        ({"presets": ()}, "presets is ''"),
        ({"presets": (1,)}, "presets is 1"),
        ({"condition": ["none"]}, "condition is"),
        ({"seeds": (5, 5)}, "seeds is"),
        ({"seeds": (5, "6")}, r"seeds\[1\] is '6'"),
        ({"seeds": 5}, "seeds is 5"),
        ({"action": "tol"}, "action is 'tol'.*tool"),
        ({"observation": None}, "observation is None"),
        ({"size": (0, 10)}, r"size\[0\] is 0"),
    ],
)
def test_a_wrong_argument_is_refused_by_its_name(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        PickEnv(**asked)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"presett": "wild"}, "options: name is 'presett'.*preset"),
        ({"preset": "wld"}, "preset.*'wld'.*wild"),
        ({"preset": 3}, "preset.*is 3"),
        ({"scene": "a"}, "scene.*is 'a'"),
        ({"scene": 1.5}, "scene.*is 1.5"),
        ({"scene": True}, "scene.*is True"),
        ({"scene": -1}, "scene.*is -1"),
        ([("scene", 1)], "options is"),
    ],
)
@pytest.mark.parametrize("made", [PickEnv, PickProMPEnv])
def test_a_wrong_option_is_refused_by_its_name(made: Any, options: Any, words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        made().reset(seed=0, options=options)


@pytest.fixture(scope="module")
def begun() -> tuple[Any, ...]:
    """Both environments at the begin of an episode; a refused action changes nothing."""
    both = PickEnv(), PickProMPEnv()
    for env in both:
        env.reset(seed=0, options=SCENE)
    return both


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (lambda n: np.zeros(n + 1), r"must be numbers of shape"),
        (lambda n: np.zeros((1, n)), r"must be numbers of shape"),
        (lambda n: [[1.0], [1.0, 2.0]], "must be numbers of shape"),
        (lambda n: "fast", "action is 'fast'"),
        (lambda n: None, "action is None"),
        (lambda n: np.zeros(n, dtype=complex) + 1j, "must be numbers of shape"),
        (lambda n: np.eye(n)[1] * np.nan, r"action\[0\] is nan"),
        (lambda n: np.where(np.arange(n) == 2, np.inf, 0.0), r"action\[2\] is inf"),
    ],
)
def test_a_wrong_action_is_refused(begun: tuple[Any, ...], value: Any, words: str) -> None:
    for env in begun:
        with pytest.raises(InvalidRequestError, match=words):
            env.step(value(env.action_space.shape[0]))


def test_before_a_reset_and_after_its_end_an_episode_goes_no_further() -> None:
    for fresh in (PickEnv(), PickProMPEnv()):
        with pytest.raises(InvalidRequestError, match="reset"):
            fresh.step(fresh.action_space.sample())
    env = PickProMPEnv(simulated=False)
    env.reset(seed=0, options=SCENE)
    env.step(np.zeros(2 * COUNT))
    with pytest.raises(InvalidRequestError, match="call reset first"):
        env.step(np.zeros(2 * COUNT))


def test_several_at_once() -> None:
    several = gymnasium.make_vec(
        "optipromp/Pick-v0", num_envs=2, vectorization_mode="sync", presets=("cluster", "limp")
    )
    seen, _ = several.reset(seed=3)
    assert len(seen["objects"]) == 2
    _, reward, *_ = several.step(several.action_space.sample())
    assert np.isfinite(reward).all()
    several.close()


def test_the_same_seed_and_actions_give_the_same_episode() -> None:
    runs = []
    for _ in range(2):
        env = PickEnv(condition="zero-mean", action="joints")
        rng = np.random.default_rng(0)
        seen, _ = env.reset(seed=5, options=SCENE)
        for _ in range(20):
            seen, reward, *_ = env.step(rng.uniform(-1.0, 1.0, 7))
        runs.append((seen["arm"], seen["objects"], reward))
    for one, other in zip(*runs, strict=True):
        assert np.array_equal(one, other)


def test_pictures_are_seen() -> None:
    env = PickEnv(observation="picture", size=(64, 48))
    seen, _ = env.reset(seed=1, options=SCENE)
    assert seen["rgb"].shape == (48, 64, 3)
    assert seen["rgb"].std() > 5.0
    assert env.observation_space.contains(seen)
    env.close()


def test_the_planner_is_a_policy_that_picks() -> None:
    """Its trajectory, tracked by joint velocities from what the environment shows."""
    env = PickEnv(action="joints")
    env.reset(seed=1, options=SCENE)
    episode = env.episode
    curve = plan(episode.scene).trajectory
    info, reward, ended = {}, 0.0, False
    total = 0.0
    while not ended:
        ahead = curve.at(min(episode.time + episode.period, curve.duration))
        wanted = (ahead.q - episode.reference.q) / episode.period
        action = wanted / (0.5 * episode.robot.velocity)
        _, reward, terminated, truncated, info = env.step(action)
        total, ended = total + reward, terminated or truncated
    assert info["is_success"], info["cause"]
    assert total > 0.8


def test_the_arm_keeps_its_limits_whatever_is_asked() -> None:
    robot = load_robot("panda")
    rng, before = np.random.default_rng(0), State(robot.home)
    for _ in range(300):
        wanted = rng.choice([-10.0, 10.0], 7)
        states = driven(robot, before, wanted, 0.02, 20)
        last = before
        for each in states:
            assert (np.abs(each.velocity) <= robot.velocity + 1e-9).all()
            assert (np.abs(each.acceleration) <= robot.acceleration + 1e-9).all()
            assert (each.q >= robot.lower).all()
            assert (each.q <= robot.upper).all()
            step = last.q + 0.001 * last.velocity + 0.5 * 0.001**2 * each.acceleration
            assert each.q == pytest.approx(step, abs=1e-9)
            last = each
        before = last
    point, axis = robot.tool_pose(robot.home)
    velocity = joints_for(robot, robot.home, np.array([0.0, 0.0, 0.1]))
    after, turned = robot.tool_pose(robot.home + 1e-3 * velocity)
    assert after - point == pytest.approx([0.0, 0.0, 1e-4], abs=3e-6)
    assert turned == pytest.approx(axis, abs=3e-5)


def test_scenes_are_held() -> None:
    env = PickProMPEnv("limp", seeds=(200_000, 200_001), simulated=False)
    env.reset(seed=0)
    first = env.situation
    env.reset()
    assert env.situation is first  # the one scene of these seeds is not made again
    env.reset(options={"scene": 200_001})
    assert env.situation is not first
