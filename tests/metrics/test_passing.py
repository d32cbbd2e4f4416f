"""On which side the tool passes each pushable, and how far from it."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.metrics.builders import moving, thing, to

from optipromp import metrics
from optipromp.geometry import Sphere
from optipromp.robots.model import Robot
from optipromp.scenes import Approach, Scene, SceneObject, Stem

FRUIT = np.array([0.0, 0.0, 0.6])
TARGET = np.array([0.0, 0.0, 0.75])


def passing(
    gantry: Robot, stem: Any, aside: Callable[[np.ndarray], Any], fruit: Any = FRUIT
) -> metrics.Judgement:
    """The tool goes up past a fruit with lateral offsets ``aside(height over the fruit)``."""
    height = np.linspace(0.2, 0.75, 56)
    path = np.zeros((56, 3))
    path[:, 2] = height
    path[:, :2] += np.asarray([aside(h) for h in height - fruit[2]])
    path[-1] = TARGET
    hung = None if stem is None else Stem(np.array([fruit, fruit + np.asarray(stem)]))
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject("n", "pushable", Sphere(0.015), np.asarray(fruit), stem=hung),
    )
    # the ball of the y carriage hangs 0.5 under the fruit's height, out of the way
    return metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_m_p_is_the_offset_where_the_tool_passes(side: float, gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert judgement.metrics.M_p["n"] == pytest.approx(side * 0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    wrong = side > 0.0  # the stem leans to +y: the tool must pass at -y
    assert (judgement.violations == ("the tool passes n on the side of its stem",)) == wrong
    mirrored = passing(gantry, (0.0, -0.05, 0.2), lambda h: (0.01, side * 0.06))
    assert mirrored.metrics.stem_projection["n"] == pytest.approx(-0.05)
    assert bool(mirrored.violations) != wrong


def test_the_offset_counts_at_the_fruit_not_elsewhere(gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, -0.06 if abs(h) < 0.02 else 0.06))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)
    assert judgement.violations == ()


def test_a_stem_that_leans_along_x_has_a_side_too(gantry: Robot) -> None:
    """The paper's figure, along y_g, says nothing here; the stem still must not be met."""
    for x in (-0.06, 0.06):
        judgement = passing(gantry, (0.05, 0.0, 0.2), lambda h, x=x: (x, 0.0))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(0.0, abs=1e-12)
        assert judgement.metrics.stem_projection["n"] == pytest.approx(0.0, abs=1e-12)
        assert bool(judgement.violations) == (x > 0.0)


@pytest.mark.parametrize("stem", [None, (0.0, 0.0, 0.2), (0.0, 0.002, 0.2)])
def test_without_a_lean_either_side_will_do(stem: Any, gantry: Robot) -> None:
    for y in (-0.06, 0.06):
        judgement = passing(gantry, stem, lambda h, y=y: (0.0, y))  # type: ignore[misc]
        assert judgement.metrics.M_p["n"] == pytest.approx(y)
        assert judgement.violations == ()
    assert (judgement.metrics.stem_projection["n"] is None) == (stem is None)


def test_the_last_passage_counts(gantry: Robot) -> None:
    """Up on the wrong side, down, and up again on the right one."""
    height = np.concatenate([np.linspace(0.5, 0.7, 20), np.linspace(0.7, 0.5, 20)])
    height = np.concatenate([height, np.linspace(0.5, 0.75, 25)])
    path = np.zeros((65, 3))
    path[:, 2] = height
    path[:20, 1], path[20:40, 1], path[40:, 1] = 0.06, 0.06, -0.06
    path[-1] = TARGET
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject(
            "n", "pushable", Sphere(0.015), FRUIT, stem=Stem(np.array([FRUIT, [0, 0.05, 0.8]]))
        ),
    )
    judgement = metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)


def test_a_fruit_that_is_not_passed_has_no_m_p(gantry: Robot) -> None:
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.06), np.array([0, 0, 0.9]))
    assert judgement.metrics.M_p["n"] is None
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.violations == ()


def test_a_fruit_far_from_the_path_and_the_line_has_no_side(gantry: Robot) -> None:
    away = np.array([0.0, -0.4, 0.6])
    judgement = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, 0.0), away)
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
            thing("target", Sphere(0.015), target, name="ripe"),
            SceneObject(
                "n", "pushable", Sphere(0.015), fruit,
                stem=Stem(np.array([fruit, fruit + [0.0, 0.1, 0.05]])),
            ),
        ),
        approach=Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    )  # fmt: skip
    judgement = metrics.judge(scene, gantry, moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0))
    assert judgement.metrics.M_p["n"] == pytest.approx(-0.06)
    assert judgement.metrics.stem_projection["n"] == pytest.approx(0.05)
    assert judgement.metrics.goal_axis_error == pytest.approx(np.pi / 2)


def test_the_side_of_a_stem_may_be_a_note(gantry: Robot) -> None:
    """Where pushes were foreseen it is told and makes nothing invalid; all else is judged alike."""
    fruit = FRUIT
    height = np.linspace(0.2, 0.75, 56)
    path = np.column_stack([np.full(56, 0.01), np.full(56, 0.06), height])
    path[-1] = TARGET
    scene = to(
        None,
        thing("target", Sphere(0.015), TARGET, name="ripe"),
        SceneObject(
            "n", "pushable", Sphere(0.015), fruit,
            stem=Stem(np.array([fruit, fruit + [0.0, 0.05, 0.2]])),
        ),
    )  # fmt: skip
    motion = moving(gantry, path - [0.0, 0.0, 0.13], dt=9.0)
    strict = metrics.judge(scene, gantry, motion)
    lenient = metrics.judge(scene, gantry, motion, stem_side=False)
    assert strict.violations == ("the tool passes n on the side of its stem",)
    assert strict.notes == ()
    assert lenient.violations == ()
    assert lenient.notes == strict.violations
    assert lenient.metrics == strict.metrics
    assert lenient.contacts == strict.contacts
    # what else is wrong stays wrong
    astray = metrics.judge(scene, gantry, motion, np.ones(3), stem_side=False)
    assert astray.violations == ("the trajectory does not begin at the start",)
    assert astray.notes == strict.violations


def test_to_dict_is_plain_and_complete(gantry: Robot) -> None:
    document = passing(gantry, (0.0, 0.05, 0.2), lambda h: (0.0, -0.06)).metrics.to_dict()
    assert json.loads(json.dumps(document)) == document
    assert set(document) >= {
        "M_c", "M_p", "stem_projection", "clearance_static", "clearance_avoid",
        "clearance_avoid_tool", "clearance_self", "goal_error", "goal_axis_error",
        "limit_violation", "max_step", "path_length", "smoothness", "duration",
        "velocity_ratio", "acceleration_ratio",
    }  # fmt: skip
