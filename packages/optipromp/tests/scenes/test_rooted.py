"""Stems that are rooted where the tool must end or come by: recognised, and sampled again."""

import numpy as np
import pytest
from tests.scenes.sampled import made

from optipromp.core.geometry import Sphere
from optipromp.core.planning.task import posed
from optipromp.core.robots.tools import Cup, FrankaHand
from optipromp.core.scenes import Approach, Scene, SceneObject, Stem
from optipromp_sim.generate import generate
from optipromp_sim.generate.checks import _rooted_in_tool, unsolvable

ROOTED = "stem rooted where the tool must end"
CUP = Cup(radius=0.03, height=0.05, length=0.10, depth=0.02)  # rim 0.02 over the target's centre
THIN = 0.002  # [m] radius of the stem
AXES = [
    ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    ((0.6, 0.0, 0.8), (0.0, 1.0, 0.0)),
]


def rooted(aside: float, height: float, approach: Approach, tool: object = CUP) -> bool:
    """A pushable whose stem has its root so far off the approach line, over the target."""
    target = np.array([0.45, 0.0, 0.8])
    scene = Scene(
        "s", "panda", (SceneObject("ripe", "target", Sphere(0.015), target),), approach=approach
    )
    x_g, y_g, up = scene.frame
    found: set[bool] = set()
    for way in (x_g, -x_g, y_g, (x_g + y_g) / np.sqrt(2.0)):
        root = target + aside * way + height * up
        fruit = root - 0.2 * up + 0.1 * way
        obj = SceneObject(
            "n", "pushable", Sphere(0.015), fruit, stem=Stem(np.array([fruit, root]), THIN)
        )
        found.add(_rooted_in_tool(scene, obj, tool))  # type: ignore[arg-type]
    assert len(found) == 1  # the same on every side
    return found.pop()


@pytest.mark.parametrize(("direction", "lateral"), AXES)
@pytest.mark.parametrize(
    ("aside", "height", "inside"),
    [
        (0.0, 0.0, True),  # the cup at the goal: from 0.03 under the target to 0.02 over it
        (0.031, 0.0, True),
        (0.033, 0.0, False),
        (0.0, 0.021, True),
        (0.0, 0.023, False),
        (0.0316, 0.0216, False),  # past the rim's edge
        # the neck: of radius 0.01, down to the flange at -0.13
        (0.011, -0.10, True),
        (0.013, -0.10, False),
        (0.0, -0.131, True),
        (0.0, -0.133, False),
        # on its way from where the mouth takes the target in (0.035 lower), never more than
        # 0.015 off the line: what is within 0.03 - 0.015 of it
        (0.0165, -0.05, True),
        (0.015, -0.0665, True),
        (0.015, -0.068, False),
    ],
)
def test_a_root_in_the_tool(aside, height, inside, direction, lateral):
    approach = Approach(np.array(direction), np.array(lateral))
    assert rooted(aside, height, approach) is inside


def test_a_root_in_the_cone() -> None:
    """It goes from 0.03 beside the base, 0.03 under the target, to 0.01 and 0.05 under it."""
    tapered = Cup(radius=0.03, taper=45)
    for aside, height, inside in (
        (0.024, -0.035, True), (0.028, -0.035, False), (0.014, -0.049, True), (0.0, -0.131, True),
        (0.013, -0.10, False),
    ):  # fmt: skip
        assert rooted(aside, height, Approach(), tapered) is inside


def test_a_root_in_the_way_of_the_cup_by_brute_force() -> None:
    """Every way of the cup over the target's last stretch: none may miss what is refused."""
    rng = np.random.default_rng(0)
    play = CUP.radius - 0.015
    offsets = play * np.array([[np.cos(a), np.sin(a)] for a in np.linspace(0, 6.28, 60)])
    rises = np.linspace(-0.035, 0.0, 71)
    for _ in range(300):
        aside, height = rng.uniform(0.0, 0.05), rng.uniform(-0.08, 0.04)
        # how near the solid cup comes to the root at each height, and as far off as it may be
        beyond = np.maximum(np.maximum(rises - 0.03 - height, height - rises - 0.02), 0.0)
        off = np.linalg.norm(offsets - [aside, 0.0], axis=1).max()
        always = np.hypot(max(off - CUP.radius, 0.0), beyond).min() < THIN - 1e-4
        at_goal = np.hypot(max(aside - CUP.radius, 0.0), beyond[-1]) < THIN - 1e-4
        if always or at_goal:
            assert rooted(aside, height, Approach())


def test_an_opening_leaves_the_target_less_play() -> None:
    """The smaller the mouth the straighter the cup must come, and the more it surely sweeps."""
    wide, narrow = CUP, Cup(radius=0.03, opening=0.04)
    assert not rooted(0.022, -0.05, Approach(), wide)
    assert rooted(0.022, -0.05, Approach(), narrow)


def test_a_root_matters_to_a_cup_alone() -> None:
    assert not rooted(0.0, 0.0, Approach(), None)
    assert not rooted(0.0, 0.0, Approach(), FrankaHand())
    scene = generate("cluster", 0)
    bare = SceneObject("n", "pushable", Sphere(0.015), scene.target.position)
    assert not _rooted_in_tool(scene, bare, CUP)


def test_scenes_with_a_root_in_the_tool_are_drawn_again_and_counted() -> None:
    scene = generate("cluster", 0)
    fruit = scene.pushables[0]
    root = scene.target.position + [0.0, 0.0, -0.01]
    hung = SceneObject(
        fruit.id,
        "pushable",
        fruit.shape,
        fruit.position,
        stem=Stem(np.array([fruit.position, root])),
    )
    objects = tuple(hung if obj is fruit else obj for obj in scene.objects)
    assert unsolvable(scene) is None
    assert unsolvable(Scene(
        scene.name, scene.robot, objects, tool=scene.tool, start=scene.start,
        approach=scene.approach,
    )) == ROOTED  # fmt: skip
    found = {seed: made("cluster", seed) for seed in range(30)}
    assert sum(report.reasons.get(ROOTED, 0) for _, report in found.values()) > 0
    for sampled, report in found.values():
        assert report.redraws == sum(report.reasons.values())
        tool = posed(sampled)[0].tool
        assert not any(_rooted_in_tool(sampled, obj, tool) for obj in sampled.pushables)
