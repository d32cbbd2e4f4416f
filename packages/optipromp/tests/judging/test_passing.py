"""On which side the tool passes each pushable, and how far from it."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from tests.judging.builders import moving, obj, to

from optipromp.core import judging
from optipromp.core.geometry import Box, Cylinder, Shape, Sphere
from optipromp.core.judging.speed import between
from optipromp.core.judging.speed import passages as judged_passing
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import Approach, Scene, SceneObject, Stem
from optipromp.core.trajectory import State, Trajectory
from optipromp_paper.paper_costs import paper_violations

FRUIT = np.array([0.0, 0.0, 0.6])
TARGET = np.array([0.0, 0.0, 0.75])
BALL = Sphere(0.015)


def fruit_before(stem: Any, fruit: Any = FRUIT, shape: Shape = BALL) -> Scene:
    """A fruit that hangs by a stem along ``stem``, before the target."""
    hung = None if stem is None else Stem(np.array([fruit, fruit + np.asarray(stem)]))
    return to(
        None,
        obj("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject("n", "pushable", shape, np.asarray(fruit), stem=hung),
    )


def upward(gantry: Robot, aside: Callable[[Any], Any], fruit: Any = FRUIT) -> Trajectory:
    """The tool goes up past a fruit with lateral offsets ``aside(height over the fruit)``."""
    height = np.linspace(0.2, 0.75, 56)
    path = np.zeros((56, 3))
    path[:, 2] = height
    path[:, :2] += np.asarray([aside(h) for h in height - fruit[2]])
    path[-1] = TARGET
    # the ball of the y carriage hangs 0.5 under the fruit's height, out of the way
    return moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0)


def passages(
    gantry: Robot, stem: Any, aside: Callable[[Any], Any], fruit: Any = FRUIT, shape: Shape = BALL
) -> judging.Judgement:
    return judging.judge(fruit_before(stem, fruit, shape), gantry, upward(gantry, aside, fruit))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_m_p_is_the_offset_where_the_tool_passes(side: float, gantry: Robot) -> None:
    judgement = passages(gantry, (0.0, 0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert judgement.metrics.M_p["n"] == pytest.approx(side * 0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    wrong = side > 0.0  # the stem leans to +y: the tool must pass at -y
    assert (judgement.message == "the tool passes n on the side of its stem") == wrong
    mirrored = passages(gantry, (0.0, -0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert mirrored.metrics.stem_projection["n"] == pytest.approx(-0.05)
    assert bool(mirrored.violations) != wrong


def test_a_stem_that_leans_along_x_has_a_side_too(gantry: Robot) -> None:
    """The paper's figure, along y_g, says nothing here; the stem still must not be met."""
    for x in (-0.06, 0.06):
        judgement = passages(gantry, (0.05, 0.0, 0.2), lambda h, x=x: (x, 0.0))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(0.0, abs=1e-12)
        assert judgement.metrics.stem_projection["n"] == pytest.approx(0.0, abs=1e-12)
        assert bool(judgement.violations) == (x > 0.0)


@pytest.mark.parametrize("stem", [None, (0.0, 0.0, 0.2), (0.0, 0.002, 0.2)])
def test_without_a_lean_either_side_will_do(stem: Any, gantry: Robot) -> None:
    for y in (-0.06, 0.06):
        judgement = passages(gantry, stem, lambda h, y=y: (0.0, y))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(y)
        assert judgement.violations == ()
    assert (judgement.metrics.stem_projection["n"] is None) == (stem is None)


def test_a_fruit_that_is_not_passed_has_no_m_p(gantry: Robot) -> None:
    judgement = passages(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.06), np.array([0, 0, 0.9]))
    assert judgement.metrics.M_p["n"] is None
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.violations == ()


def test_a_fruit_far_from_the_path_and_the_line_has_no_side(gantry: Robot) -> None:
    away = np.array([0.0, -0.4, 0.6])
    judgement = passages(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.0), away)
    assert judgement.metrics.M_p["n"] == pytest.approx(0.4)  # reported,
    assert judgement.violations == ()  # but nothing is pushed


def test_passing_holds_in_any_frame(gantry: Robot) -> None:
    """Sideways approach: along x, drifting along z."""
    target, fruit = np.array([0.75, 0.0, 0.1]), np.array([0.6, 0.0, 0.1])
    path = np.zeros((56, 3))
    path[:, 0], path[:, 2] = np.linspace(0.2, 0.75, 56), 0.1 - 0.06
    path[-1] = target
    scene = Scene(
        "s", "robot",
        (
            obj("target", Sphere(0.015), target, name="ripe"),
            SceneObject(
                "n", "pushable", Sphere(0.015), fruit,
                stem=Stem(np.array([fruit, fruit + [0.0, 0.1, 0.05]])),
            ),
        ),
        approach=Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    )  # fmt: skip
    judgement = judging.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.metrics.goal_axis_error == pytest.approx(np.pi / 2)


def test_the_side_of_a_stem_may_be_a_note(gantry: Robot) -> None:
    """Where pushes were predicted it is a note, not a violation; all else is judged alike."""
    scene, motion = fruit_before((0.0, 0.05, 0.2)), upward(gantry, lambda h: (0.01, 0.06))
    strict = judging.judge(scene, gantry, motion)
    lenient = judging.judge(scene, gantry, motion, stem_side=False)
    assert [*map(str, strict.violations)] == ["the tool passes n on the side of its stem"]
    assert strict.notes == ()
    assert lenient.violations == ()
    assert lenient.notes == (strict.message,)
    assert lenient.metrics == strict.metrics
    assert lenient.contacts == strict.contacts
    # what else is wrong stays wrong
    astray = judging.judge(scene, gantry, motion, State(np.ones(3)), stem_side=False)
    assert [*map(str, astray.violations)] == ["the trajectory does not begin at the start"]
    assert astray.notes == (strict.message,)


def test_drift_shortfall_counts_from_the_camera_point_on(gantry: Robot) -> None:
    """Down past the fruit on its stem's side, then from the camera point up on the other side."""
    down, up = np.linspace(0.7, 0.485, 40), np.linspace(0.485, 0.75, 40)
    path = np.zeros((80, 3))
    path[:, 2] = np.concatenate([down, up])
    path[:, 1] = np.where(np.arange(80) < 40, np.interp(path[:, 2], [0.485, 0.6], [0.0, 0.3]),
                          np.interp(path[:, 2], [0.485, 0.58], [0.0, -0.045]))  # fmt: skip
    path[-1] = TARGET
    scene = fruit_before((0.0, 0.05, 0.2))
    motion = moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0)
    for options, short in (
        ({}, 0.005),  # of the gripper's radius, 0.05
        ({"drift_offset": 0.047}, 0.002),
        ({"drift_offset": {"n": 0.01}}, 0.0),
        ({"drift_offset": {}}, 0.005),
    ):
        found = judging.judge(replace(scene, options=options), gantry, motion).metrics
        assert found.drift_shortfall["n"] == pytest.approx(short, abs=1e-9), options
        assert found.M_p["n"] == pytest.approx(-0.045)


@pytest.mark.parametrize("shape", [Cylinder(0.05, 0.03), Box((0.14, 0.02, 0.03))])
def test_the_window_is_the_extent_along_the_approach(shape: Shape, gantry: Robot) -> None:
    """15 mm over and under a flat thing's centre, however wide the thing is."""
    for height, short in ((0.0051, 0.05), (0.0149, 0.0)):  # a waypoint every 10 mm

        def aside(h: float, far: float = height) -> tuple[float, float]:
            return 0.0, -0.06 if abs(h) < far else 0.0

        metrics = passages(gantry, (0.0, 0.05, 0.2), aside, shape=shape).metrics
        assert metrics.drift_shortfall["n"] == pytest.approx(short)


@pytest.mark.parametrize("stem", [None, (0.0, 0.0, 0.2), (0.05, 0.0, 0.2)])
@pytest.mark.parametrize("y", [-0.03, 0.03])
def test_where_no_stem_decides_the_side_that_is_passed_counts(stem, y, gantry):
    metrics = passages(gantry, stem, lambda h: (-0.01, y)).metrics
    assert metrics.drift_shortfall["n"] == pytest.approx(0.02)
    assert (metrics.stem_gap["n"] is None) == (stem is None)


@pytest.mark.parametrize("fruit", [[0.0, 0.0, 0.9], [0.0, -0.4, 0.6]])
def test_what_is_not_passed_or_far_off_has_no_shortfall(fruit: Any, gantry: Robot) -> None:
    metrics = passages(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.0), np.array(fruit)).metrics
    assert metrics.drift_shortfall["n"] is None
    assert metrics.stem_gap["n"] is None


def test_the_papers_constraints_as_a_check(gantry: Robot) -> None:
    """Each breach names the fruit; a plan that keeps both has none."""
    rows: list[tuple[float, list[str]]] = [
        (-0.06, []),
        (-0.03, ["drift"]),
        (0.06, ["drift", "stem"]),
    ]
    for y, kinds in rows:
        stem = (0.0, 0.1, 0.0)
        judgement = passages(gantry, stem, lambda h, y=y: (0.0, y))  # type: ignore[misc]
        found = paper_violations(fruit_before(stem), judgement.metrics)
        assert [violation.kind for violation in found] == kinds
        assert all(v.subject == "n" and " n" in str(v) for v in found)
        if kinds == ["drift"]:
            assert found[0].amount == pytest.approx(0.02)
            assert str(found[0]) == "the tool passes n 20.0 mm nearer than constraint 1 asks for"


def independent(a: Any, b: Any, c: Any, d: Any) -> float:
    """Distance of two segments as a bounded least-squares problem, by SciPy."""
    matrix = np.column_stack([b - a, c - d])
    found = lsq_linear(matrix, c - a, bounds=(0.0, 1.0), method="bvls", tol=1e-14)
    return float(np.linalg.norm(matrix @ found.x - (c - a)))


@given(seed=st.integers(0, 10**6), flat=st.booleans(), size=st.sampled_from([1e-3, 0.1, 10.0]))
@settings(max_examples=200, deadline=None)
def test_segments_are_as_far_apart_as_scipy_says(seed: int, flat: bool, size: float) -> None:
    a, b, c, d = size * np.random.default_rng(seed).normal(size=(4, 3))
    if flat:  # nearly parallel, or crossing in a plane
        d = c + (b - a) if seed % 2 else d
        a[2] = b[2] = c[2] = d[2] = 0.0
    assert between(a, b, c, d) == pytest.approx(independent(a, b, c, d), abs=1e-8 * size)
    assert between(a, a, c, d) == pytest.approx(independent(a, a + 1e-300, c, d), abs=1e-8 * size)
    assert between(c, d, a, a) == pytest.approx(between(a, a, c, d))
    assert between(a, a, c, c) == pytest.approx(np.linalg.norm(c - a))


@given(seed=st.integers(0, 10**6), pieces=st.integers(1, 4))
@settings(max_examples=60, deadline=None)
def test_constraints_1_and_2_are_those_of_every_waypoint(seed: int, pieces: int) -> None:
    """Against the method's formulas at every waypoint of the window, in a turned frame."""
    rng = np.random.default_rng(seed)
    approach = Approach(rng.normal(size=3), rng.normal(size=3))
    x, y, z = approach.frame
    target, radius, gripper = rng.normal(size=3), 0.02, 0.05
    fruit = target - 0.1 * z + rng.uniform(-0.07, 0.07) * y  # in the way: 1.5 R = 0.075
    stem = fruit + np.vstack([np.zeros(3), rng.normal(0.0, 0.05, (pieces, 3)).cumsum(axis=0)])
    hung = SceneObject("n", "pushable", Sphere(radius), fruit, stem=Stem(stem))
    scene = Scene(
        "s", "robot", (obj("target", Sphere(0.02), target, name="ripe"), hung), approach=approach
    )
    steps = np.linspace(-0.2, 0.0, 60)
    aside = np.cumsum(rng.normal(0.0, 0.004, (60, 2)), axis=0)
    tips = target + steps[:, None] * z + aside @ np.array([x, y])
    found = judged_passing(scene, tips, tips, gripper)
    leaning = (stem[1] - stem[0]) @ y
    if abs(leaning) < 0.03 * np.linalg.norm(stem[1] - stem[0]):
        return  # no side, or nearly none
    within = tips[np.abs((tips - fruit) @ z) <= radius]
    least = min(-np.sign(leaning) * ((tip - fruit) @ y) for tip in within)
    assert found.drift_shortfall["n"] == pytest.approx(max(gripper - least, 0.0), abs=1e-12)
    gaps = []
    for tip in within:
        away = tip - fruit
        end = fruit + min(1.0, radius / np.linalg.norm(away)) * away
        gaps += [independent(tip, end, c, d) for c, d in itertools.pairwise(stem)]
    assert found.stem_gap["n"] == pytest.approx(min(gaps), abs=1e-8)


def test_the_passage_is_told_in_the_plane(gantry: Robot) -> None:
    """M_p is its part along y_g; what is not passed has none."""
    metrics = passages(gantry, (0.0, 0.05, 0.2), lambda h: (0.03, -0.06)).metrics
    assert metrics.passage["n"] == pytest.approx((0.03, -0.06), abs=1e-9)
    assert metrics.M_p["n"] == pytest.approx(-0.06)
