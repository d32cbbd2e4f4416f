"""Looks with hundreds of false fruits: tracks are bounded, in number and in memory."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.scenes import Pose, Scene, SceneObject
from optipromp_loop.control import Controller, Look, Tracker, TrackerParameters
from optipromp_sim.generate import generate

MOST = TrackerParameters.most
LOW, HIGH = [0.2, -0.4, 0.6], [0.7, 0.4, 1.1]  # [m] where false fruits are


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate("cluster", 172003)


def cluttered(
    when: float, scene: Scene, rng: np.random.Generator, false: int
) -> tuple[Look, set[str]]:
    """A look at the scene's fruits among false ones; the ids of the true ones."""
    true = [
        replace(o, id=f"true-{k}", position=o.position + rng.normal(0.0, 0.001, 3),
                covariance=1e-6 * np.eye(3), stem=None)
        for k, o in enumerate(scene.objects) if o.role in ("target", "pushable")
    ]  # fmt: skip
    ball, places = Sphere(0.015), rng.uniform(LOW, HIGH, (false, 3))
    wrong = (SceneObject(f"f{k}", "pushable", ball, places[k], sigma=0.003) for k in range(false))
    return Look(when, Pose(), (*true, *wrong), view=3.1), {item.id for item in true}


def test_tracks_are_bounded_and_the_true_fruits_among_them(scene: Scene) -> None:
    rng, tracker = np.random.default_rng(3), Tracker(scene)
    tracker.add(cluttered(-0.06, scene, rng, 0)[0])
    assert tracker.left == 0
    tracemalloc.start()
    try:
        for k in range(30):
            tracker.add(cluttered(0.06 * k, scene, rng, 400)[0])
            assert len(tracker.at(0.06 * k).ids) <= MOST
            assert tracker.left >= 400 - 3 * MOST
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100e6  # [bytes]
    found = tracker.at(1.8)
    for item in (o for o in scene.objects if o.role in ("target", "pushable")):
        away = np.linalg.norm(found.positions - item.position, axis=1)
        row = int(away.argmin())
        assert away[row] < 0.01
        assert found.confirmed[row]
        assert found.existence[row] > 0.99
        assert (found.roles[row] == "target") == (item.role == "target")


def test_fruits_beyond_the_bound_are_avoided_and_not_tracked(scene: Scene) -> None:
    far = tuple(
        SceneObject(f"far-{k}", "pushable", Sphere(0.015), np.array([0.1, 0.5 + 0.05 * k, 1.2]))
        for k in range(MOST)
    )
    controller = Controller(replace(scene, objects=(*scene.objects, *far)))
    known = [o.id for o in scene.objects if o.role in ("target", "pushable")]
    tracked = controller.tracker.at(0.0).ids
    assert len(tracked) == MOST
    assert set(known) <= set(tracked)
    roles = {item.id: item.role for item in controller.scene.objects}
    assert [roles[item.id] for item in far[-len(known) :]] == ["avoid"] * len(known)
    first = [replace(far[0], id=f"n{k}", covariance=1e-6 * np.eye(3)) for k in range(MOST + 1)]
    with pytest.raises(InvalidRequestError, match=f"first objects: must be {MOST} at most"):
        Tracker(scene, first=first)
