"""Which moving link comes nearest to something static, and what the judge says of it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.judging.builders import box_mesh, moving, obj, to

from optipromp.core import judging
from optipromp.core.geometry import Box, HalfSpace, PointCloudShape, Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import JointGoal, SceneObject


@given(seed=st.integers(0, 10**6), mesh=st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_nearest_is_that_of_all_moving_spheres(panda: Robot, seed: int, mesh: bool) -> None:
    """Balls and boxes by the formula, over every sphere that moves and every configuration."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(panda.lower, panda.upper, (2, panda.n_joints))
    q = ends[0] + np.linspace(0.0, 1.0, 9)[:, None] * (ends[1] - ends[0])
    shape = box_mesh((0.1, 0.1, 0.1)) if mesh else Box((0.1, 0.1, 0.1))
    static = [
        obj("static", Sphere(0.05), rng.normal(0.0, 0.6, 3), name="ball"),
        obj("static", shape, rng.normal(0.0, 0.6, 3), name="cube"),
        obj("static", HalfSpace(), [0.0, 0.0, -0.001], name="floor"),  # just under the fixed base
        obj("avoid", Sphere(0.3), [0.3, 0.0, 0.5], name="nothing static"),
    ]
    found = judging.nearest_static(to(JointGoal(q[0]), *static), panda, q, np.arange(9.0))
    own = np.asarray(panda.spheres.segment) >= 0
    x, radius = panda.sphere_centers(q)[:, own], np.asarray(panda.spheres.radius)[own]
    link = np.asarray(panda.spheres.link)[own]
    ball, cube = (x - item.position for item in static[:2])
    over = np.abs(cube) - 0.05
    apart = {
        "ball": np.linalg.norm(ball, axis=2) - 0.05 - radius,
        "cube": np.linalg.norm(np.maximum(over, 0.0), axis=2)
        + np.minimum(over.max(axis=2), 0.0)
        - radius,
        "floor": x[..., 2] + 0.001 - radius,
    }
    name = min(apart, key=lambda key: float(apart[key].min()))
    assert found.other == name
    assert found.role == "static"
    assert -found.depth == pytest.approx(apart[name].min(), abs=1e-9)
    assert found.time is not None
    there = apart[name][int(found.time), link == panda.link_names.index(found.link)]
    assert there.min() == pytest.approx(apart[name].min(), abs=1e-9)


def test_nothing_static_is_near_nothing(panda: Robot) -> None:
    scene = to(JointGoal(panda.home), obj("avoid", Sphere(0.1), [0.5, 0.0, 0.5]))
    assert judging.nearest_static(scene, panda, panda.home[None]) is None


def wall(panda: Robot, q: np.ndarray, room: float) -> SceneObject:
    """A wall before the foremost sphere of the arm in motion."""
    x = panda.sphere_centers(q)[..., 0] + np.asarray(panda.spheres.radius)
    return obj("static", Box((0.1, 4.0, 4.0)), [x.max() + 0.05 + room, 0.0, 0.0], name="wall")


@pytest.mark.parametrize(("room", "told"), [(0.0017, True), (0.0045, True), (0.0055, False)])
def test_the_judge_remarks_on_what_comes_too_near(panda: Robot, room: float, told: bool) -> None:
    """A remark, no violation: nothing is touched."""
    q = np.array([panda.home, panda.home + 0.02])
    scene = replace(to(JointGoal(q[-1]), wall(panda, q, room)), start=q[0])
    found = judging.judge(scene, panda, moving(panda, q))
    assert found.violations == ()
    notes = [note for note in found.notes if "of wall; a controller needs about 5 mm" in note]
    assert len(notes) == told
    if told:
        assert f" comes within {1e3 * room:.1f} mm" in notes[0]
        assert f" comes within {1e3 * found.metrics.clearance_static:.1f} mm" in notes[0]


def test_the_volume_that_no_picture_shows_and_the_robot_sweeps_is_told(panda: Robot) -> None:
    """Against spheres at a thousand instants; cells that are just grazed may differ."""
    q = np.array([panda.home, panda.home + 0.2])
    points, _ = panda.tool_pose(q)
    ticks = np.mgrid[-8:9, -8:9, -8:9].reshape(3, -1).T * 0.01
    unseen = obj("static", PointCloudShape(ticks, 0.005), points[-1])
    scene = replace(to(JointGoal(q[-1])), start=q[0], unseen=unseen)
    found = judging.judge(scene, panda, moving(panda, q))
    x = panda.sphere_centers(q[0] + np.linspace(0.0, 1.0, 1000)[:, None] * (q[1] - q[0]))
    inside = [
        (np.linalg.norm(x - cell, axis=2) < panda.spheres.radius).any()
        for cell in points[-1] + ticks
    ]
    assert found.metrics.unseen == pytest.approx(1e-6 * sum(inside), rel=0.02)
    assert found.metrics.unseen > 1e-4
    assert any(f"{1e6 * found.metrics.unseen:.0f} cm³ that no" in note for note in found.notes)
    assert judging.judge(replace(scene, unseen=None), panda, moving(panda, q)).notes == ()


def test_a_base_that_stands_on_something_is_not_remarked_on(panda: Robot) -> None:
    q = np.array([panda.home, panda.home + 0.02])
    floor = obj("static", HalfSpace(), [0.0, 0.0, -0.001], name="floor")
    low = (panda.sphere_centers(q)[..., 2] - np.asarray(panda.spheres.radius)).min()
    assert low < 0.004  # of the fixed base: it would be remarked on
    found = judging.judge(to(JointGoal(q[-1]), floor), panda, moving(panda, q))
    assert found.notes == ()
