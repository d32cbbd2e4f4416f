"""What a detector sees of a scene: errors of places and stems, fruits that are missed."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.scenes import SceneObject, scene_to_dict
from optipromp_sim.generate import NOISES, Noise, generate, perceived
from optipromp_sim.generate.noise import hidden_share


def test_perceived_moves_what_is_detected_and_nothing_else() -> None:
    scene = generate("mixed", 0)
    seen = perceived(scene, np.random.default_rng(1), NOISES["zero-mean"])
    again = perceived(scene, np.random.default_rng(1), NOISES["zero-mean"])
    assert scene_to_dict(seen) == scene_to_dict(again)
    for before, after in zip(scene.objects, seen.objects, strict=True):
        if before.role == "static":
            assert after is before
            continue
        assert np.linalg.norm(after.position - before.position) > 0
        np.testing.assert_allclose(after.covariance, 0.005**2 * np.eye(3))
        if before.stem is not None:
            assert after.stem.length == pytest.approx(before.stem.length)
            np.testing.assert_array_equal(after.stem.points[0], after.position)
    assert perceived(scene, np.random.default_rng(1), Noise()) is scene
    for bad in (-1.0, np.nan):
        for name in ("position", "angle", "missed", "hidden"):
            with pytest.raises(InvalidRequestError, match=f"noise_{name}"):
                Noise(**{name: bad})
    with pytest.raises(InvalidRequestError, match="0 to 1"):
        Noise(missed=1.5)


def test_fruits_are_seen_lower_than_they_hang_and_what_stands_is_not() -> None:
    scene, shelf = generate("mixed", 0), generate("shelf", 0)
    seen = [perceived(scene, np.random.default_rng(i), NOISES["low"]) for i in range(200)]
    off = np.array([s.positions - scene.positions for s in seen]).mean(axis=0)
    for item, error in zip(scene.objects, off, strict=True):
        wanted = [0.0, 0.0, 0.0 if item.role == "static" else -0.01]
        np.testing.assert_allclose(error, wanted, atol=0.0015)  # 4 of the mean's own deviations
    stood = perceived(shelf, np.random.default_rng(0), NOISES["low"])
    np.testing.assert_array_equal(stood.positions[:, 2], shelf.positions[:, 2])


def test_a_fruit_is_missed_more_often_the_more_of_it_is_hidden() -> None:
    scene = generate("cluster", 6)
    eye = scene.target.position - 0.3 * scene.frame[2]
    shares = {item.id: hidden_share(scene, item, eye) for item in scene.pushables}
    noise = Noise(missed=0.1, hidden=0.9)
    seen = [perceived(scene, np.random.default_rng(i), noise) for i in range(400)]
    for item in scene.pushables:
        missed = np.mean([item.id not in {o.id for o in s.objects} for s in seen])
        assert missed == pytest.approx(0.1 + 0.8 * shares[item.id], abs=0.1)
    assert all(s.target is not None for s in seen)


def test_what_stands_before_a_fruit_hides_it() -> None:
    scene = generate("cluster", 6)
    ball = scene.pushables[0]
    eye = ball.position - np.array([0.0, 0.0, 0.3])
    alone = replace(scene, objects=(scene.target, ball))
    aside = replace(scene.target, position=eye + [0.2, 0.0, 0.0], stem=None)
    away = replace(alone, objects=(aside, ball))
    half = eye + 0.5 * (ball.position - eye)
    for radius, wanted in ((ball.radius, 1.0), (0.5 * ball.radius * 0.5**0.5, 0.5)):
        front = SceneObject("leaf", "static", Sphere(radius), half)
        shown = replace(away, objects=(*away.objects, front))
        assert hidden_share(shown, ball, eye) == pytest.approx(wanted, abs=0.06)
    assert hidden_share(away, ball, eye) == 0.0


def test_errors_of_detection_have_the_deviation_asked_for() -> None:
    scene = generate("cluster", 2)
    rng = np.random.default_rng(0)
    seen = [perceived(scene, rng, NOISES["zero-mean"]) for _ in range(600)]
    errors = np.array([s.target.position - scene.target.position for s in seen])
    assert errors.std(axis=0) == pytest.approx([0.005] * 3, rel=0.15)
    way = scene.target.stem.vector / scene.target.stem.length
    tilts = [
        np.arccos(np.clip(way @ s.target.stem.vector / s.target.stem.length, -1, 1)) for s in seen
    ]
    # two independent angles: the mean square of the whole is twice that of each
    assert np.sqrt(np.mean(np.square(tilts)) / 2) == pytest.approx(np.deg2rad(5.0), rel=0.15)
