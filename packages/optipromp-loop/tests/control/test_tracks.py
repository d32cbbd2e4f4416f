"""Identities, births, deaths, roles, stems and pushes of tracks; looks late and out of order."""

from dataclasses import replace

import numpy as np
import pytest
from tests.control.plants import (
    FIELD,
    UP,
    Eye,
    camera,
    detection,
    empty,
    hanging,
    look,
    looks,
    nearest,
    still,
    swaying,
)  # fmt: skip

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, Sphere
from optipromp.core.scenes.objects import SceneObject, Stem
from optipromp_loop.control import Look, Tracker
from optipromp_sim.generate.generator import generate
from optipromp_sim.generate.noise import Noise, noisy


def test_a_fruit_is_confirmed_by_its_third_look_and_what_was_found_once_is_none() -> None:
    rng, plant, tracker = np.random.default_rng(2), still(5), Tracker(empty())
    once = np.array([[0.5, 0.1, 0.42]])
    for k in range(13):
        places = plant.rest[: 4 if k < 10 else 5]
        tracker.add(look(0.05 * k, np.concatenate([places, once[: k == 3]]), rng, Eye()))
        tracked = tracker.at(0.05 * k)
        assert tracked.confirmed.sum() == (5 if k == 12 else 4)
        assert len(tracked.ids) == (5 if 3 <= k < 6 or k >= 10 else 4)


def test_a_fruit_that_is_gone_dies_and_one_out_of_sight_does_not() -> None:
    rng, plant, tracker = np.random.default_rng(2), still(4), Tracker(empty())
    for k in range(5):
        tracker.add(look(0.05 * k, plant.rest, rng, Eye()))
    begin = tracker.at(0.2)
    away = camera(below=2.0)
    for k in range(5, 40):
        tracker.add(look(0.05 * k, plant.rest[:0], rng, Eye(), away))
    assert tracker.at(2.0).ids == begin.ids
    assert (tracker.at(2.0).existence == begin.existence).all()
    gone = nearest(begin, plant.rest)[0][3]
    for k in range(40, 51):
        tracker.add(look(0.05 * k, plant.rest[:3], rng, Eye()))
    assert begin.ids[gone] in tracker.at(2.6).ids
    assert tracker.at(2.6).existence[gone] < 1e-3
    tracker.add(look(2.6, plant.rest[:3], rng, Eye()))
    assert begin.ids[gone] not in tracker.at(2.6).ids
    assert len(tracker.at(2.6).ids) == 3


def test_a_fruit_behind_the_tool_for_a_second_keeps_its_track_and_moves_with_the_plant() -> None:
    rng = np.random.default_rng(6)
    plant = swaying(rng, 6, 0.015, np.array([0.7]))
    eye = camera().position

    def tool(at: float) -> FloatArray:
        if not 2.0 <= at < 3.0:
            return np.zeros((0, 4))
        return np.array([[*(0.5 * eye + 0.5 * plant.rest[2]), 0.02]])

    tracker = Tracker(empty(), tool=tool)
    for k in range(80):
        now = 0.05 * k
        places = plant.at(now)
        if tool(now).size:
            places = np.delete(places, 2, axis=0)
        tracker.add(look(now, places, rng, Eye()))
        if k == 39:
            before = tracker.at(now)
        if k == 58:
            hidden = tracker.at(now)
            rows, away = nearest(hidden, plant.at(now))
            assert away[2] < 0.010
            assert hidden.last_seen[rows[2]] == pytest.approx(1.95)
    after = tracker.at(3.95)
    assert after.ids == before.ids
    assert (nearest(after, plant.at(3.95))[0] == nearest(before, plant.at(1.95))[0]).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_plant_that_is_moved_at_once_keeps_its_tracks(seed: int) -> None:
    """30 mm aside between two looks, of which a gate of 5 mm noise knows nothing."""
    rng, tracker = np.random.default_rng(seed), Tracker(empty())
    places, turn = hanging(7), rng.uniform(0.0, 2 * np.pi)
    aside = 0.03 * np.array([np.cos(turn), np.sin(turn), 0.0])
    for k in range(60):
        now = places + (aside if k >= 30 else 0.0)
        tracker.add(look(0.05 * k, now, rng, Eye(missed=0.05)))
        if k == 29:
            before = tracker.at(0.05 * k)
        if k == 31:
            moved = tracker.at(0.05 * k)
    after = tracker.at(2.95)
    assert moved.ids == after.ids == before.ids
    order = nearest(before, places)[0]
    for tracked in (moved, after):
        rows, away = nearest(tracked, now)
        assert (rows == order).all()
        assert np.median(away) < 0.007


def test_a_fruit_that_is_moved_at_once_is_believed_the_second_time() -> None:
    rng, plant, tracker = np.random.default_rng(2), still(5), Tracker(empty())
    for k in range(40):
        tracker.add(look(0.05 * k, plant.rest, rng, Eye(noise=0.002)))
    before = tracker.at(1.95)
    row = nearest(before, plant.rest)[0][1]
    moved = plant.rest.copy()
    moved[1] += [0.0, 0.0, -0.018]
    tracker.add(look(2.0, moved, rng, Eye(noise=0.002)))
    assert tracker.at(2.0).positions[row, 2] > moved[1, 2] + 0.012
    for k in (41, 42):
        tracker.add(look(0.05 * k, moved, rng, Eye(noise=0.002)))
    after = tracker.at(2.1)
    assert after.ids == before.ids
    assert abs(after.positions[row, 2] - moved[1, 2]) < 0.005


def test_ids_and_order_of_detections_change_nothing_to_the_bit() -> None:
    plant = swaying(np.random.default_rng(6), 6, 0.015, np.array([0.7]))
    one, other, rng = Tracker(empty()), Tracker(empty()), np.random.default_rng(3)
    for each in looks(plant, np.random.default_rng(1), FIELD, 2.0):
        one.add(each)
        order = rng.permutation(len(each.detections))
        renamed = [replace(item, id=f"other-{k}") for k, item in enumerate(each.detections)]
        other.add(Look(each.time, each.camera, tuple(renamed[k] for k in order)))
    a, b = one.at(2.05), other.at(2.05)
    assert a.ids == b.ids
    assert a.roles == b.roles
    for name in ("positions", "covariance", "rest", "existence"):
        assert (getattr(a, name) == getattr(b, name)).all()
    for one_item, other_item in zip(a.objects(), b.objects(), strict=True):
        assert (one_item.stem.points == other_item.stem.points).all()


def test_looks_out_of_order_are_folded_in_where_they_belong() -> None:
    plant = swaying(np.random.default_rng(6), 6, 0.015, np.array([0.7]))
    every = list(looks(plant, np.random.default_rng(1), FIELD, 2.0))
    one, other = Tracker(empty()), Tracker(empty())
    for each in every:
        one.add(each)
    for k in range(0, len(every), 4):
        for each in (every[k], every[k + 3], every[k + 1], every[k + 2]):
            other.add(each)
    a, b = one.at(2.05), other.at(2.05)
    assert (a.positions == b.positions).all()
    assert a.ids == b.ids
    assert (one.statistics.squares == other.statistics.squares).all()
    assert other.statistics.dropped == 0


def test_a_look_that_is_too_old_is_dropped_and_counted() -> None:
    rng, plant, tracker = np.random.default_rng(2), still(4), Tracker(empty())
    for now in (0.0, 0.3, 0.6):
        tracker.add(look(now, plant.rest, rng, Eye()))
    before = tracker.at(0.6)
    tracker.add(look(0.39, plant.rest, rng, Eye()))
    assert tracker.statistics.dropped == 1
    assert (tracker.at(0.6).positions == before.positions).all()
    tracker.add(look(0.41, plant.rest, rng, Eye()))
    assert tracker.statistics.dropped == 1
    assert (tracker.at(0.6).positions != before.positions).any()
    assert tracker.time == 0.6


def test_a_pushed_fruit_keeps_its_rest() -> None:
    """Pushed 40 mm, of which the model predicts 32 to 48: the rest stays, the position follows."""
    rng, plant, tracker = np.random.default_rng(2), still(5), Tracker(empty())
    for k in range(40):
        tracker.add(look(0.05 * k, plant.rest, rng, Eye()))
    rows, _ = nearest(tracker.at(2.0), plant.rest)
    name, rest = tracker.at(2.0).ids[rows[1]], tracker.at(2.0).rest[rows[1]]
    push = np.array([0.04, 0.0, 0.01])
    for k in range(40, 80):
        moved = plant.rest.copy()
        moved[1] += push
        tracker.add(look(0.05 * k, moved, rng, Eye()), {name: rng.uniform(0.8, 1.2) * push})
    tracked = tracker.at(3.95)
    row = tracked.ids.index(name)
    assert len(tracked.ids) == 5
    assert np.linalg.norm(tracked.rest[row] - rest) < 1e-12
    assert np.linalg.norm(tracked.positions[row] - moved[1]) < 0.015
    sizes = tracked.covariance.trace(axis1=1, axis2=2)
    assert sizes[row] > 2.0 * np.median(sizes)
    for k in range(80, 90):
        tracker.add(look(0.05 * k, plant.rest, rng, Eye()))
    tracked = tracker.at(4.45)
    assert np.linalg.norm(tracked.positions[tracked.ids.index(name)] - plant.rest[1]) < 0.006


def test_the_role_is_what_most_looks_say_and_one_is_the_target() -> None:
    rng, plant, tracker = np.random.default_rng(2), still(4), Tracker(empty())
    pose = camera()
    for k in range(20):
        roles = ["target", "target" if k % 3 == 0 else "pushable", "avoid", "pushable"]
        if k % 5 == 4:
            roles = ["pushable", "pushable", "pushable", "target"]
        noise = 0.003 * rng.standard_normal((4, 3))
        items = tuple(
            detection(f"d{j}", plant.rest[j] + noise[j], pose, roles[j], sigma=0.003)
            for j in rng.permutation(4)
        )
        tracker.add(Look(0.05 * k, pose, items))
        tracked = tracker.at(0.05 * k)
        assert tracked.roles.count("target") <= 1
    rows, _ = nearest(tracked, plant.rest)
    assert [tracked.roles[k] for k in rows] == ["target", "pushable", "avoid", "pushable"]


def test_stems_are_means_of_what_was_seen_and_upright_where_not() -> None:
    rng, pose, tracker = np.random.default_rng(2), camera(), Tracker(empty())
    places, lean = hanging(2), np.array([np.sin(0.4), 0.0, np.cos(0.4)])
    for k in range(30):
        tilted = lean + 0.1 * rng.standard_normal(3)
        stem = Stem.along(places[0], tilted, 0.11)
        seen = detection("a", places[0], pose, "target", stem=stem, sigma=0.004)
        tracker.add(Look(0.05 * k, pose, (seen, detection("b", places[1], pose, sigma=0.004))))
    tracked = tracker.at(1.5)
    (one, other), _ = nearest(tracked, places)
    objects = tracked.objects()
    assert objects[one].stem.vector / 0.11 == pytest.approx(lean, abs=0.07)
    assert objects[one].stem.length == pytest.approx(0.11)
    assert objects[other].stem.vector == pytest.approx(0.15 * UP)
    assert objects[one].position == pytest.approx(tracked.rest[one])
    assert objects[one].role == "target"
    assert objects[one].covariance == pytest.approx(tracked.rest_covariance[one])


def test_first_objects_are_tracks_with_their_ids() -> None:
    """A generated scene, seen with errors, then looked at again from its camera's side."""
    scene = generate("cluster", 3)
    seen = noisy(scene, 3, Noise(0.005, 5.0))
    fruits = [item for item in seen.objects if item.role != "static"]
    tracker = Tracker(seen, first=fruits)
    before = tracker.at(0.0)
    assert before.ids == tuple(item.id for item in fruits)
    assert before.confirmed.all()
    assert before.rest == pytest.approx(np.array([item.position for item in fruits]))
    assert before.roles == tuple(item.role for item in fruits)
    rng = np.random.default_rng(1)
    lowest = min(item.position @ scene.up for item in fruits)
    base = scene.objects[0].position
    flat = base - (base @ scene.up) * scene.up
    pose = type(camera())(flat + (lowest - 0.3) * scene.up, np.eye(3))
    truths = [item for item in scene.objects if item.role != "static"]
    for k in range(40):
        items = tuple(
            detection(
                f"d{j}", t.position + 0.005 * rng.standard_normal(3), pose, t.role, sigma=0.005
            )
            for j, t in enumerate(truths)
        )
        tracker.add(Look(0.05 * k, pose, items))
    after = tracker.at(2.0)
    assert set(after.ids) == set(before.ids)
    for item in truths:
        row = after.ids.index(item.id)
        assert np.linalg.norm(after.rest[row] - item.position) < 0.006
        assert after.roles[row] == item.role


def test_wrong_input_is_refused() -> None:
    fruit = SceneObject("a", "pushable", Sphere(0.02), np.zeros(3))
    sure = SceneObject("a", "pushable", Sphere(0.02), np.zeros(3), sigma=0.004)
    wall = SceneObject("w", "static", Box((0.1, 0.1, 0.1)), np.zeros(3), sigma=0.004)
    for first, words in (((fruit,), "covariance"), ((sure, sure), "repeat"), ((wall,), "role")):
        with pytest.raises(InvalidRequestError, match=words):
            Tracker(empty(), first=first)
    tracker = Tracker(empty())
    with pytest.raises(InvalidRequestError, match="time"):
        tracker.add(Look(float("nan"), camera(), ()))
    with pytest.raises(InvalidRequestError, match="push of a"):
        tracker.add(Look(0.0, camera(), ()), {"a": np.array([np.nan, 0.0, 0.0])})
    mean, low, high, fits = tracker.statistics.consistent()
    assert (np.isnan(mean), low, high, fits) == (True, 0.0, np.inf, False)


def test_a_tracker_without_a_fruit_answers() -> None:
    tracker = Tracker(empty())
    for now in (0.0, 0.1):
        tracker.add(Look(now, camera(), ()))
        tracked = tracker.at(now)
        assert tracked.ids == ()
        assert tracked.positions.shape == (0, 3)
        assert tracked.covariance.shape == (0, 3, 3)
        assert tracked.objects() == ()
        assert tracked.moves(np.array([now, now + 1.0])).shape == (2, 0, 3)
