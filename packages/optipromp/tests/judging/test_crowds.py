"""Among many objects the judge says what looking at each of them, one by one, says."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.judging.builders import obj, to

from optipromp.core import judging
from optipromp.core.geometry import Box, Capsule, Cylinder, HalfSpace, Sphere
from optipromp.core.judging import clearance
from optipromp.core.judging.distances import BLOCK, objects_of
from optipromp.core.judging.speed import Passing, last_passages, passages
from optipromp.core.scenes import JointGoal, Scene, SceneObject, Stem

ROLES = ("static", "avoid", "pushable")


def turn(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def crowd(count: int, seed: int, spread: float) -> tuple[SceneObject, ...]:
    """Objects of every shape and role about the arm, and sizes from 5 mm to half a metre."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(count):
        r, half = 10.0 ** rng.uniform(-2.3, -1.3), 10.0 ** rng.uniform(-2.0, -0.6)
        shapes: tuple[Any, ...] = (
            Sphere(r), Box((r, half, 2 * r)), Cylinder(r, half), Capsule(r, half), Sphere(0.5),
        )  # fmt: skip
        kind = int(rng.choice(5, p=(0.3, 0.25, 0.2, 0.24, 0.01)))
        at = rng.normal(0.0, spread, 3) + [0.0, 0.0, 0.4]
        role = ROLES[int(rng.integers(3))]
        out.append(obj(role, shapes[kind], at, turn(rng), name=f"thing {i}"))
    floor = obj("static", HalfSpace(), [0.0, 0.0, -rng.uniform(0.05, 3.0)], name="floor")
    return (*out[: count // 2], floor, *out[count // 2 :])


@given(
    count=st.integers(0, 192), seed=st.integers(0, 10**6),
    spread=st.sampled_from([0.3, 1.0, 4.0]),
)  # fmt: skip
@settings(max_examples=20, deadline=None)
def test_all_together_they_are_as_near_as_the_nearest(panda, count, seed, spread):
    rng = np.random.default_rng(seed)
    ends = rng.uniform(panda.lower, panda.upper, (2, panda.n_joints))
    q = ends[0] + np.linspace(0.0, 1.0, 12)[:, None] * (ends[1] - ends[0])
    objects = crowd(count, seed, spread)
    found, contacts = judging.clearances(to(JointGoal(q[0]), *objects), panda, q)
    expected: dict[str, list[float]] = {key: [] for key in found}
    touched = []
    for one in objects:
        alone, touching = judging.clearances(to(JointGoal(q[0]), one), panda, q)
        touched += [contact for contact in touching if contact.other == one.id]
        for key, value in alone.items():
            if value is not None:
                expected[key].append(value)
    for key in ("M_c", "clearance_static", "clearance_avoid", "clearance_avoid_tool",
                "clearance_pushable"):  # fmt: skip
        assert found[key] == (min(expected[key]) if expected[key] else None), key
    own = [contact for contact in contacts if contact.role != "the robot itself"]
    assert own == touched  # in the order of the scene


@given(count=st.integers(0, 160), seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_blocks_hold_everything_but_the_target_once(count: int, seed: int) -> None:
    target = obj("target", Sphere(0.02), [0.0, 0.0, 0.5], name="target")
    scene = Scene("s", "panda", (*crowd(count, seed, 1.0), target))
    objects, rest = objects_of(scene)
    assert rest == ()
    assert sorted(objects.rows.tolist()) == list(range(count + 1))
    assert objects.block[0] == 0
    assert objects.block[-1] == count + 1
    assert ((np.diff(objects.block) > 0) & (np.diff(objects.block) <= BLOCK)).all()
    for c, (low, high) in enumerate(zip(objects.block[:-1], objects.block[1:], strict=True)):
        assert len(set(objects.role[low:high].tolist())) == 1
        away = np.linalg.norm(objects.position[low:high] - objects.block_middle[c], axis=1)
        assert (away + objects.bound[low:high] <= objects.block_bound[c] + 1e-12).all()


def plain_passage(path: np.ndarray, place: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """Where a path is at the waypoint nearest its last crossing of a place's level plane."""
    height = (path - place) @ up
    crossings = np.flatnonzero(np.sign(height[:-1]) != np.sign(height[1:]))
    if not len(crossings):
        return None
    waypoint = crossings[-1] + (abs(height[crossings[-1]]) > abs(height[crossings[-1] + 1]))
    return path[waypoint] - place - height[waypoint] * up


@given(count=st.integers(0, 40), waypoints=st.integers(2, 60), seed=st.integers(0, 10**6))
@settings(max_examples=60, deadline=None)
def test_last_passages_are_those_of_each_place(count: int, waypoints: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(0.0, 0.05, (waypoints, 3)), axis=0)
    places, up = rng.normal(0.0, 0.3, (count, 3)), rng.normal(size=3)
    up /= np.linalg.norm(up)
    waypoint, at = last_passages(path, places, up)
    for k in range(count):
        expected = plain_passage(path, places[k], up)
        assert (waypoint[k] >= 0) == (expected is not None)
        np.testing.assert_allclose(at[k], 0.0 if expected is None else expected, atol=1e-12)


@given(seed=st.integers(0, 10**6), aim=st.booleans())
@settings(max_examples=60, deadline=None)
def test_a_fruit_is_passed_alike_alone_and_among_others(seed: int, aim: bool) -> None:
    rng = np.random.default_rng(seed)
    fruits = []
    for i in range(20):
        at = rng.normal(0.0, 0.06, 3) + [0.0, 0.0, 0.6]
        lean = rng.normal(0.0, 0.1, 3) + [0.0, 0.0, 0.1]
        stem = Stem(np.array([at, at + lean, at + 2.0 * lean])) if rng.random() < 0.7 else None
        fruits.append(SceneObject(f"n{i}", "pushable", Sphere(0.02), at, stem=stem))
    ripe = obj("target", Sphere(0.02), [0.0, 0.0, 0.7], name="ripe")
    lowest = obj("pushable", Sphere(0.02), [0.0, 0.0, 0.5], name="lowest")  # decides t_1 for all
    tips = np.column_stack([*rng.normal(0.0, 0.03, (2, 50)), np.linspace(0.4, 0.7, 50)])
    rims = tips + [0.0, 0.0, 0.06]
    goal = {} if aim else {"goal": JointGoal(np.zeros(7))}

    def asked(*objects: SceneObject) -> Passing:
        return passages(
            Scene("s", "panda", (lowest, *objects, ripe) if aim else objects, **goal),
            tips, rims, 0.05,
        )  # fmt: skip

    together, each = asked(*fruits), [asked(fruit) for fruit in fruits]
    assert together.wrong == [wrong for alone in each for wrong in alone.wrong]
    for name in ("M_p", "stem_projection", "drift_shortfall", "stem_gap"):
        figures = getattr(together, name)
        assert [*figures][aim:] == [fruit.id for fruit in fruits]
        for fruit, alone in zip(fruits, each, strict=True):
            assert figures[fruit.id] == pytest.approx(getattr(alone, name)[fruit.id], abs=1e-12)


def test_a_crowd_that_was_pushed_away_is_known_one_by_one(gantry, monkeypatch):
    """Many boxes side by side in the way of cup and carriage: each as if it stood alone."""
    places = [(0.3 + 0.05 * i, 0.0, -0.2 + 0.002 * i) for i in range(64)]
    boxes = [
        obj("pushable", Box((0.04, 0.04, 0.9)), at, name=f"box {i}") for i, at in enumerate(places)
    ]
    q = np.column_stack([np.linspace(0.0, 0.6, 200), np.zeros((200, 2))])

    def judged(*objects: SceneObject) -> tuple[Any, Any]:
        scene = to(JointGoal(q[-1]), *objects)
        _, contacts = judging.clearances(scene, gantry, q)
        return judging.pushed_away(scene, gantry, q, contacts)

    kept, notes = judged(*boxes)
    alone = [judged(box) for box in boxes]
    assert kept == [contact for one, _ in alone for contact in one]
    assert notes == [note for _, some in alone for note in some]
    assert notes
    hung = replace(boxes[0], stem=Stem(np.array([[0.3, 0.0, 0.25], [0.3, 0.0, 0.5]])))
    again, fewer = judged(hung, *boxes[1:])
    assert len(again) == len(kept) + 1
    assert len(fewer) == len(notes) - 1
    monkeypatch.setattr(clearance, "CONFIGURATIONS", 7)  # of a long motion not all stand in memory
    assert judged(*boxes) == (kept, notes)
