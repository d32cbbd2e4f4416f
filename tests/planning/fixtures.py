"""Scenes and plans that the tests of planning share; a plan is made once and only read."""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import END, assert_success, block

from optipromp.core.geometry import Sphere
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.planners import make
from optipromp.core.planning.warming import warm_up
from optipromp.core.promp import Demonstrations, load_demonstrations, save_demonstrations
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes import JointGoal, Scene, Stem, load_scene
from optipromp.core.scenes.scene import bare_robot

RECORDED = (
    Path(__file__).resolve().parents[2] / "../shared/data/panda_demonstrations/demonstrations.npz"
)


@pytest.fixture(scope="session", autouse=True)
def compiled() -> None:
    """No test's clock runs while kernels are compiled."""
    warm_up()


@functools.cache
def made(scene: str, planner: str, settings: tuple[tuple[str, Any], ...]) -> Plan:
    if planner == "opti-promp":
        return plan(scene, options=PlanOptions(**dict(settings)))
    return plan(scene, planner=make(planner, **dict(settings)))


@pytest.fixture(scope="session")
def planned() -> Callable[..., Plan]:
    """planned(scene, planner, **settings) -> plan, from a cache."""

    def _planned(scene: str, planner: str = "opti-promp", **settings: Any) -> Plan:
        return made(scene, planner, tuple(sorted(settings.items())))

    return _planned


@pytest.fixture(scope="session")
def bare() -> Scene:
    """A turn of the arm's first joints from home, with nothing in its way."""
    known = load_scene("scenario-3")
    home = bare_robot(known).home
    goal = home + np.array([1.2, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    return replace(known, name="bare", objects=(), start=home, goal=JointGoal(goal))


@pytest.fixture
def three() -> Scene:
    return load_scene("scenario-3")


@pytest.fixture
def four() -> Scene:
    return load_scene("scenario-4")


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recorded demonstrations, named; they lie beside the repository where they are at all."""
    if not RECORDED.is_file():
        pytest.skip("no recorded demonstrations beside this repository")
    path = tmp_path_factory.mktemp("recorded") / "demonstrations.npz"
    joints = load_robot("panda").joint_names
    save_demonstrations(Demonstrations(load_demonstrations(RECORDED).items, joints), path)
    return path


def noisy(scene: Scene, seed: int, deviation: float = 0.005) -> Scene:
    """Every fruit moved by N(0, deviation), still hanging from its root."""
    rng = np.random.default_rng(seed)
    objects = []
    for obj in scene.objects:
        if obj.stem is None:
            objects.append(obj)
        else:
            off = rng.normal(0.0, deviation, 3)
            at = obj.position + off
            stem = Stem(np.array([at, obj.stem.root]))  # straight, to the same root
            objects.append(replace(obj, position=at, stem=stem))
    return replace(scene, objects=tuple(objects))


def moved(scene: Scene, seed: int, reach: float = 0.04) -> Scene:
    """The whole cluster elsewhere: every object moved alike, by up to ``reach`` along each axis."""
    off = np.random.default_rng(seed).uniform(-reach, reach, 3)
    return replace(scene, objects=tuple(obj.at(obj.position + off) for obj in scene.objects))


@pytest.fixture(scope="session", name="noisy")
def noisy_fixture() -> Callable[..., Scene]:
    return noisy


@pytest.fixture(scope="session", name="moved")
def moved_fixture() -> Callable[..., Scene]:
    return moved


@pytest.fixture
def obstructed(three: Scene) -> Scene:
    """A goal in joints, with a ball where the tool passes on the straight way there."""
    free = replace(three, objects=(), goal=JointGoal(END))
    straight = plan(free)
    assert_success(straight)
    tools = straight.robot.tool_pose(straight.trajectory.positions)[0]
    middle = tools[len(tools) // 2]
    return replace(free, objects=(block("static", Sphere(0.06), middle),))
