"""The plant in the frame of a plan, and what hides a fruit."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning import plan
from optipromp.core.scenes import Pose, Scene, SceneObject, Stem, ToolSpec
from optipromp_loop.control import Look, Tracker
from optipromp_loop.control.courses import MOVED, Route, pushed_by
from optipromp_loop.control.plant import (
    appeared,
    displaced,
    moved_by,
    target_row,
    tracked_scene,
    unseen,
)
from optipromp_sim.generate import generate

UP = np.array([0.0, 0.0, 1.0])


def fruit(name: str, role: str, at: list[float]) -> SceneObject:
    place = np.array(at)
    return SceneObject(
        name, role, Sphere(0.015), place, stem=Stem.along(place, UP, 0.2), sigma=0.002
    )  # type: ignore[arg-type]


FRUITS = (
    fruit("ripe", "target", [0.45, 0.0, 0.9]),
    fruit("n1", "pushable", [0.45, 0.0, 0.8]),
    fruit("n2", "pushable", [0.49, 0.03, 0.82]),
)
SCENE = Scene("three", "panda", FRUITS, tool=ToolSpec("cup", {"radius": 0.03}))
CAMERA = Pose([0.45, 0.0, 0.6], np.eye(3))


def looked(*names: str, moved: float = 0.0) -> Tracker:
    """A tracker that knew all fruits, and then saw some of them, ``moved`` aside [m]."""
    tracker = Tracker(SCENE, first=FRUITS)
    for k in range(20):
        seen = tuple(
            replace(item, position=item.position + [moved, 0.0, 0.0], stem=None).transformed(
                CAMERA.inverse()
            )
            for item in FRUITS
            if item.id in names
        )
        tracker.add(Look(0.05 * k, CAMERA, seen))
    return tracker


def test_a_fruit_that_no_look_showed_is_told_with_what_hides_it() -> None:
    tracked = looked("n1", "n2").at(1.0)
    assert unseen(tracked, CAMERA.position, 0.0) == {"ripe": "n1"}
    assert unseen(tracked, np.array([0.3, 0.0, 0.85]), 0.0) == {"ripe": None}
    assert target_row(tracked) == 0


def test_a_common_motion_is_no_change_of_the_fruits_against_each_other() -> None:
    tracked = looked("ripe", "n1", "n2", moved=0.004).at(1.0)
    places, moved, rows = displaced(SCENE, tracked)
    assert rows == [0, 1, 2]
    np.testing.assert_allclose(places, [item.position for item in FRUITS])
    np.testing.assert_allclose(moved[:, 0], 0.004, atol=0.003)
    assert moved_by(SCENE, tracked, apart=True) < 0.001
    bare = tracked_scene(SCENE, tracked, moved.mean(axis=0))
    for before, after in zip(FRUITS, bare.objects, strict=True):
        assert np.linalg.norm(after.position - before.position) < 0.001


def test_a_new_fruit_is_a_change() -> None:
    fewer = replace(SCENE, objects=FRUITS[:2])
    tracked = looked("ripe", "n1", "n2").at(1.0)
    assert moved_by(fewer, tracked) == np.inf
    assert appeared(fewer, tracked) == ["n2"]
    assert appeared(SCENE, tracked) == []


def test_a_push_is_told_of_the_fruits_that_it_moves() -> None:
    """The target, which the tool does not touch, counts as free: its rest may be learnt."""
    made = plan(generate("cluster", 101))
    route = Route.of(made)
    assert pushed_by(route, route.approach) == {}
    whole = pushed_by(route, route.duration)
    assert whole
    target = made.scene.target
    assert target.id not in whole
    assert all(np.linalg.norm(by) > MOVED for by in whole.values())
    model = made.push_model
    found = model.moved(route.points[made.first :], route.axes[made.first :])
    places = dict(zip(found.ids, found.positions, strict=True))
    for item in made.scene.objects:
        if item.id in whole:
            assert whole[item.id] == pytest.approx(places[item.id] - item.position, abs=2e-3)
    half = pushed_by(route, 0.5 * (route.approach + route.duration))
    assert set(half) <= {item.id for item in made.scene.pushables}
    back = Route.along(made.robot, made.trajectory, made.scene)
    assert pushed_by(back, route.duration) == {}
