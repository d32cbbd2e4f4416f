"""A push that goes on from where it is, is the push of the whole motion."""

from itertools import pairwise

import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import resolve
from optipromp.core.pushing import Hanging
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP
from optipromp.core.pushing.stems.hanging import after
from optipromp.core.scenes.scene import Scene
from optipromp_loop.guard.motion import sampled
from optipromp_sim.generate import NOISES, generate, noisy

STATES = 8  # of the harm, more than those of the search


def motion(scene: Scene, model: Hanging, share: float) -> tuple[FloatArray, FloatArray]:
    """A way in past the first neighbour, pressed against it, and straight out again (P, 3)."""
    target, up = scene.target, scene.frame[2]
    assert target is not None
    beside = model.fruits[1].position - target.position
    corners = [target.position - 0.12 * up + share * beside, target.position + share * beside,
               target.position, target.position - 0.1 * up]  # fmt: skip
    rows = []
    for low, high in pairwise(corners):
        far = float(np.linalg.norm(high - low))
        rows.append(low + np.arange(0.0, far, STEP)[:, None] / far * (high - low))
    points = np.concatenate(rows)
    return points, np.tile(up, (len(points), 1))


def model_of(scene: Scene) -> Hanging:
    task = resolve(scene)
    model = task.push_model(task.start)
    assert isinstance(model, Hanging)
    return model


@pytest.mark.parametrize(
    ("preset", "share"),
    [("cluster", -0.2), ("cluster", 0.4), ("truss", 0.6), ("cluster seen", 0.2), ("field", 0.6)],
)
def test_a_push_that_goes_on_is_the_push_of_the_whole_motion(preset: str, share: float) -> None:
    name, _, seen = preset.partition(" ")
    scene = generate(name, 7)
    scene = noisy(scene, 7, NOISES["zero-mean"]) if seen else scene
    model = model_of(scene)
    points, axes = motion(scene, model, share)
    every, turn = PUSH.hanging.every, len(points) - 100  # where the way out begins
    whole = model.harm(points[: turn + 1], axes[: turn + 1], STATES)
    back = model.leaving(turn).harm(points, axes, STATES)
    places = model.moved(points[: turn + 1], axes[: turn + 1]).positions
    assert whole > 0.0
    for steps in ([1], [10, 11, 13], [turn // every - 1], [*range(20, turn // every)]):
        on, out, seen_one, at = model, model.leaving(0), model, 0
        for step in steps:
            part = slice(at, every * step + 1)
            on = after(on, points[part], axes[part], STATES)
            out = after(out, points[part], axes[part], STATES)
            seen_one = after(seen_one, points[part], axes[part], 1)
            at = every * step
        rest, there = slice(at, turn + 1), slice(at, None)
        assert on.harm(points[rest], axes[rest], STATES) == pytest.approx(whole, abs=1e-9)
        assert on.harm(points[rest], axes[rest], STATES, 0.5 * whole) > 0.5 * whole
        begun = after(model, points[:1], axes[:1], STATES).harm(
            points[: turn + 1], axes[: turn + 1], 4
        )
        assert on.harm(points[rest], axes[rest], 4) == pytest.approx(begun, abs=1e-9)
        told = out.leaving(turn - at).harm(points[there], axes[there], STATES)
        assert told == pytest.approx(back, abs=1e-9)
        left = seen_one.moved(points[rest], axes[rest]).positions
        np.testing.assert_allclose(left, places, rtol=0, atol=1e-9)


def test_sampled_poses_stay_where_they_are_when_the_way_grows() -> None:
    rng = np.random.default_rng(3)
    steps = rng.uniform(-0.1, 1.0, (60, 3)) * 0.002
    axes = np.array([0.0, 0.0, 1.0]) + rng.uniform(-0.1, 0.1, (60, 3))
    way = np.hstack([np.cumsum(steps, axis=0), axes / np.linalg.norm(axes, axis=1)[:, None]])
    whole = sampled(way)
    assert np.linalg.norm(np.diff(whole[:, :3], axis=0), axis=1).max() <= STEP + 1e-12
    np.testing.assert_allclose(whole[-1], way[-1], rtol=0, atol=1e-12)
    for count in (1, 2, 30, 59):
        part = sampled(way[:count])[:-1]  # the last is the end of the way
        np.testing.assert_allclose(part, whole[: len(part)], rtol=0, atol=1e-12)
