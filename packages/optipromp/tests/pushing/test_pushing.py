"""Which neighbours, on which side, pushed how far: the rules of method §4 and §5 by hand."""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.pushing import drift_choices, neighbours, pushes
from optipromp.core.pushing.path import evenly, length
from optipromp.core.pushing.rules import RULE, passing_windows, path_past
from optipromp.core.scenes import Approach, PoseGoal, Scene, SceneObject, Stem, load_scene

TARGET = np.array([0.4, 0.1, 0.9])
R = 0.05


def fruit(
    name: str, off: Sequence[float], stem: Sequence[float] | None = None, role: Any = "pushable",
    frame: np.ndarray | None = None,
) -> SceneObject:  # fmt: skip
    """A fruit at ``off`` from the target, its stem along ``stem``; both in the target frame."""
    rows = np.eye(3) if frame is None else frame
    at = TARGET + rows.T @ np.asarray(off, dtype=float)
    hung = None if stem is None else Stem(np.array([at, at + rows.T @ np.asarray(stem)]))
    return SceneObject(name, role, Sphere(0.015), at, stem=hung)


def scene(*objects: SceneObject, approach: Approach | None = None) -> Scene:
    ripe = SceneObject("ripe", "target", Sphere(0.015), TARGET)
    return Scene("s", "panda", (ripe, *objects), approach=approach or Approach())


APPROACHES = [
    Approach(),
    Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    Approach(np.array([1.0, 2.0, 2.0]), np.array([0.3, 1.0, -0.5])),
]


# --- neighbours --------------------------------------------------------------------------------


@pytest.mark.parametrize("approach", APPROACHES)
def test_neighbours_are_before_the_target_near_the_line_first_met_first(approach: Approach) -> None:
    f = approach.frame
    objects = [
        fruit("high", (0.0, 0.01, -0.04), frame=f),
        fruit("low", (0.0, 0.0, -0.18), frame=f),
        fruit("tie-far", (0.0, 0.07, -0.1), frame=f),
        fruit("tie-near", (0.02, 0.0, -0.1), frame=f),
        fruit("behind", (0.0, 0.0, 0.03), frame=f),
        fruit("beside", (0.0, 0.0, 0.0), frame=f),
        fruit("too far", (0.0, 0.0, -0.21), frame=f),
        fruit("off the line", (0.054, 0.054, -0.1), frame=f),
        fruit("avoided", (0.0, 0.0, -0.1), role="avoid", frame=f),
    ]
    found = neighbours(scene(*objects, approach=approach), R)
    assert [n.id for n in found] == ["low", "tie-near", "tie-far", "high"]


def test_the_limits_of_the_search_are_inclusive() -> None:
    beside = scene(fruit("n", (0.0, 0.0749, -0.1)))
    assert [n.id for n in neighbours(beside, R)] == ["n"]  # D_plane = 1.5 · 0.05
    assert neighbours(beside, 0.0499) == ()
    for depth in (0.199, 0.201):
        below = neighbours(scene(fruit("n", (0.0, 0.0, -depth))), R)
        assert len(below) == (depth < RULE.search_radius)


def test_what_was_detected_may_hang_nearer_than_it_was_seen() -> None:
    """Two standard deviations of the distance from target to pushable are added to D_plane."""
    beside = scene(fruit("n", (0.08, 0, -0.1)))
    deviation = 0.005
    doubtful = replace(
        beside,
        objects=tuple(replace(t, covariance=deviation**2 / 2 * np.eye(3)) for t in beside.objects),
    )
    assert neighbours(beside, R) == ()
    assert [n.id for n in neighbours(doubtful, R)] == ["n"]  # 0.075 + 2 · 0.005
    assert neighbours(doubtful, R - 0.0034) == ()


# --- sides -------------------------------------------------------------------------------------


def test_the_paper_drifts_along_y_away_from_the_stem() -> None:
    s = load_scene("scenario-3")
    (drift,) = drift_choices(s, neighbours(s, R), "paper")
    assert drift.ids == ("n1", "n2")
    np.testing.assert_array_equal(drift.directions, [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(drift.centers, [t.position for t in neighbours(s, R)])


@pytest.mark.parametrize("approach", APPROACHES)
def test_the_general_rule_goes_straight_against_the_lateral_part(approach: Approach) -> None:
    f = approach.frame
    obj = fruit("n", (0.0, 0.0, -0.1), (0.03, -0.04, 0.2), frame=f)
    s = scene(obj, approach=approach)
    (general,) = drift_choices(s, [obj], "lateral-plane")
    np.testing.assert_allclose(f @ general.directions[0], [-0.6, 0.8, 0.0], atol=1e-12)
    (paper,) = drift_choices(s, [obj], "paper")
    np.testing.assert_allclose(f @ paper.directions[0], [0.0, 1.0, 0.0], atol=1e-12)


def test_a_stem_that_leans_along_x_only_decides_for_one_rule_alone() -> None:
    obj = fruit("n", (0.0, 0.0, -0.1), (0.05, 0.0, 0.2))
    s = scene(obj)
    (general,) = drift_choices(s, [obj], "lateral-plane")
    np.testing.assert_allclose(general.directions, [[-1.0, 0.0, 0.0]])
    both = drift_choices(s, [obj], "paper")
    np.testing.assert_allclose([c.directions[0] for c in both], [[0, 1, 0], [0, -1, 0]])


@pytest.mark.parametrize("rule", ["lateral-plane", "paper"])
@pytest.mark.parametrize("stem", [None, (0.0, 0.0, 0.2), (0.0, 0.2 * np.sin(np.deg2rad(0.9)), 0.2)])
def test_without_a_lean_both_sides_are_open(rule: Any, stem: Any) -> None:
    """The first choice leaves the approach line least: towards the target's side."""
    for aside, first in ((0.02, -1.0), (-0.02, 1.0)):
        obj = fruit("n", (0.0, aside, -0.1), stem)
        choices = drift_choices(scene(obj), [obj], rule)
        assert len(choices) == 2
        np.testing.assert_allclose(choices[0].directions, [[0.0, first, 0.0]])
        np.testing.assert_allclose(choices[1].directions, [[0.0, -first, 0.0]])


def test_one_degree_decides() -> None:
    for degrees, count in ((0.95, 2), (1.05, 1)):
        lean = np.deg2rad(degrees)
        obj = fruit("n", (0.0, 0.0, -0.1), (0.0, 0.2 * np.sin(lean), 0.2 * np.cos(lean)))
        assert len(drift_choices(scene(obj), [obj])) == count


def test_combinations_are_all_there_and_capped() -> None:
    objects = [fruit(str(i), (0.0, 0.001, -0.03 * (i + 1))) for i in range(6)]
    leaning = fruit("stem", (0.0, 0.0, -0.19), (0.0, 0.05, 0.2))
    choices = drift_choices(scene(*objects[:2], leaning), [leaning, *objects[:2]])
    sides = {tuple(c.directions[:, 1]) for c in choices}
    assert sides == {(-1.0, a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)}
    many = drift_choices(scene(*objects), objects)
    assert len(many) == RULE.most_choices
    assert len({tuple(c.directions[:, 1]) for c in many}) == RULE.most_choices


def test_many_undecided_neighbours_take_no_time() -> None:
    """2⁴⁰ combinations are not made to keep eight of them."""
    objects = [fruit(str(i), (0.0, 0.001, -0.004 * (i + 1))) for i in range(40)]
    began = time.perf_counter()
    assert len(drift_choices(scene(*objects), objects)) == RULE.most_choices
    assert time.perf_counter() - began < 1.0


def test_unknown_rules_are_refused() -> None:
    with pytest.raises(InvalidRequestError, match="shortest, lateral-plane, paper"):
        drift_choices(scene(), [], "left")  # type: ignore[arg-type]


def windows_of(objects: Sequence[SceneObject], *directions: Sequence[float]) -> np.ndarray:
    """The rim windows of pushables that the tool passes along ``directions``."""
    wanted = np.array(directions, dtype=float)
    return passing_windows(scene(*objects), objects, wanted, 0.02)


RIGHT, LEFT = (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)


def test_the_rim_meets_a_fruit_earlier_by_its_depth() -> None:
    ((low, high),) = windows_of([fruit("n", (0.0, 0.0, -0.1))], LEFT)
    assert low == pytest.approx(-0.035 - RULE.under)
    assert high == pytest.approx(0.015)  # far below the target nothing cuts it short


def test_the_window_ends_in_time_to_take_in_the_target() -> None:
    ((_, high),) = windows_of([fruit("n", (0.0, 0.0, -0.06))], LEFT)
    assert high == pytest.approx(0.06 - 0.02 - 0.015 - RULE.room_to_turn)
    ((_, high),) = windows_of([fruit("n", (0.0, 0.0, -0.03))], LEFT)
    assert high == pytest.approx(-0.02 + RULE.release * 0.015)  # but not before the rim is past


def test_the_window_ends_in_time_to_turn_to_another_side() -> None:
    low, high = fruit("low", (0.0, 0.0, -0.16)), fruit("high", (0.0, 0.0, -0.1))
    alike = windows_of([low, high], LEFT, LEFT)
    assert alike[0, 1] == pytest.approx(0.015)
    opposed = windows_of([low, high], LEFT, RIGHT)
    assert opposed[0, 1] == pytest.approx(0.06 - 0.02 - 0.015 - RULE.under - RULE.room_to_turn)


# --- I-ProMP -----------------------------------------------------------------------------------


def test_without_a_stem_the_push_is_straight() -> None:
    obj = fruit("n", (0.0, 0.02, -0.1))
    (push,) = pushes(scene(obj), [obj], R)
    np.testing.assert_allclose(push.direction, [0.0, 1.0, 0.0])  # away from the target
    np.testing.assert_allclose(push.pushed, obj.position + [0.0, R, 0.0])
    assert (push.id, push.swing) == ("n", 0.0)


@pytest.mark.parametrize(("lean", "swings"), [(0.0, True), (0.1, True), (-0.1, True), (0.4, False)])
def test_what_a_stem_leans_already_is_taken_off(lean: float, swings: bool) -> None:
    """Δθ = asin(R/L) − θ0: θ0 > 0 where the fruit already hangs towards where it is pushed."""
    length = 0.2
    stem = (0.0, -length * np.sin(lean), length * np.cos(lean))
    obj = fruit("n", (0.0, 0.12, -0.1), stem)
    (push,) = pushes(scene(obj), [obj], R)
    wanted = np.arcsin(R / length) - lean
    assert push.swing == pytest.approx(max(0.0, wanted))
    assert (push.swing > 0.0) == swings
    root = obj.position + np.array(stem)
    if swings:
        assert push.pushed[1] - root[1] == pytest.approx(R)  # clear of a gripper below the root
    else:
        np.testing.assert_allclose(push.pushed, obj.position, atol=1e-12)


lean = st.floats(-0.6, 0.6)


@settings(max_examples=80, deadline=None)
@given(
    x=lean, y=lean, length=st.floats(0.04, 0.5), radius=st.floats(0.01, 0.08),
    off=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), turn=st.integers(0, 2),
)  # fmt: skip
def test_a_pushed_fruit_stays_on_the_arc_of_its_stem(x, y, length, radius, off, turn):
    approach = APPROACHES[turn]
    direction = np.array([x, y, 1.0]) / np.linalg.norm([x, y, 1.0])
    obj = fruit("n", (*off, -0.1), length * direction, frame=approach.frame)
    s = scene(obj, approach=approach)
    (push,) = pushes(s, [obj], radius)
    root = obj.stem.root
    length = float(np.linalg.norm(obj.position - root))
    assert np.linalg.norm(push.pushed - root) == pytest.approx(length)
    assert np.linalg.norm(push.direction) == pytest.approx(1.0)
    assert push.direction @ obj.stem.vector == pytest.approx(0.0, abs=1e-12)
    assert 0.0 <= push.swing <= np.pi
    chord = np.linalg.norm(push.pushed - obj.position)
    assert chord == pytest.approx(2.0 * length * np.sin(push.swing / 2.0), abs=1e-12)
    moved = push.pushed - obj.position
    assert moved @ push.direction >= -1e-12


def test_all_but_the_last_go_towards_the_next_and_the_last_from_the_target() -> None:
    first = fruit("first", (0.0, 0.01, -0.15), (0.0, 0.0, 0.2))
    last = fruit("last", (0.0, -0.03, -0.05), (0.0, 0.0, 0.2))
    one, two = pushes(scene(first, last), [first, last], R)
    assert (one.id, two.id) == ("first", "last")
    assert one.direction[1] == -1.0  # the next one is at smaller y
    assert two.direction[1] == -1.0  # and the target at larger y than the last
    (alone,) = pushes(scene(first), [first], R)
    assert alone.direction[1] == 1.0


def test_of_two_tangents_the_one_with_the_larger_share_is_taken() -> None:
    stem = np.array([0.0, 0.05, 0.2])
    sideways = fruit("n", (0.04, 0.001, -0.1), stem)
    (push,) = pushes(scene(sideways), [sideways], R)
    across = np.cross(stem, [0.0, 0.0, 1.0])
    assert abs(push.direction @ across) == pytest.approx(np.linalg.norm(across))
    assert push.direction[0] > 0.0
    along = fruit("n", (0.001, 0.06, -0.05), stem)
    (push,) = pushes(scene(along), [along], R)
    assert push.direction @ across == pytest.approx(0.0, abs=1e-12)
    assert push.direction[1] > 0.9


def test_uncertain_directions_follow_the_generator() -> None:
    obj = fruit("n", (0.0, 0.02, -0.1), (0.0, 0.0, 0.2))
    s = scene(obj)

    def directions(seed: int, deviation: float) -> np.ndarray:
        rng = np.random.default_rng(seed)
        return np.array([pushes(s, [obj], R, rng, deviation)[0].direction for _ in range(400)])

    sampled = directions(0, 0.3)
    np.testing.assert_array_equal(sampled, directions(0, 0.3))
    angles = np.arctan2(-sampled[:, 0], sampled[:, 1])
    assert np.std(angles) == pytest.approx(0.3, rel=0.15)
    assert np.mean(angles) == pytest.approx(0.0, abs=0.06)
    np.testing.assert_allclose(sampled[:, 2], 0.0, atol=1e-12)
    sure = directions(1, 0.0)
    assert (sure == sure[0]).all()
    assert pushes(s, [obj], R)[0].direction[1] == 1.0


def test_a_gripper_wider_than_the_stem_is_long_swings_it_level() -> None:
    obj = fruit("n", (0.0, 0.02, -0.1), (0.0, 0.0, 0.03))
    (push,) = pushes(scene(obj), [obj], R)
    assert push.swing == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(push.pushed, obj.position + [0.0, 0.03, 0.03], atol=1e-12)


def test_nothing_in_the_way_is_no_push() -> None:
    assert pushes(scene(), [], R) == ()
    obj = fruit("n", (0.0, 0.0, -0.1))
    no_target = Scene("s", "panda", (obj,), goal=PoseGoal(TARGET, np.array([0.0, 0.0, 1.0])))
    assert pushes(no_target, [], R) == ()
    with pytest.raises(InvalidRequestError, match="a scene with a target"):
        pushes(no_target, [obj], R)


# --- the path past them ------------------------------------------------------------------------


def test_the_path_past_them_is_aside_in_every_window_and_ends_at_the_goal() -> None:
    objects = [
        fruit("n1", (0.01, -0.01, -0.14), (0.0, 0.05, 0.2)),
        fruit("n2", (-0.01, 0.01, -0.07), (0.0, -0.05, 0.2)),
    ]
    s = scene(*objects)
    (drift,) = drift_choices(s, objects, depth=0.02)
    offsets = np.full(2, 0.04)
    camera = TARGET - np.array([0.0, 0.0, 0.25])
    corners = path_past(
        drift.centers, drift.directions, drift.windows, offsets, TARGET, s.frame, camera, 0.035
    )
    np.testing.assert_allclose(corners[0], camera)
    np.testing.assert_allclose(corners[-1], TARGET)
    points = evenly(corners, 400)
    for n in range(2):
        off = points - drift.centers[n]
        inside = (off[:, 2] > drift.windows[n, 0] + 2e-3) & (off[:, 2] < drift.windows[n, 1] - 2e-3)
        assert inside.any()
        assert (off[inside] @ drift.directions[n]).min() >= 0.04 - 1e-6
    taken_in = points[:, 2] > TARGET[2] - 0.034
    np.testing.assert_allclose(points[taken_in, :2], np.tile(TARGET[:2], (taken_in.sum(), 1)))
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() <= length(corners) / 399 + 1e-9
