"""A scene's objects as arrays: the same numbers, and what may be near is never left out."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from optipromp.core.geometry import Box, Capsule, HalfSpace, Sphere, distances, pack
from optipromp.core.scenes import JointGoal, Scene, SceneObject
from optipromp.core.scenes.scene import ROLES, measures_of, obstacles_of, packed, rows_around

SHAPES = (Sphere(0.05), Box((0.1, 0.4, 0.02)), Capsule(0.03, 0.6), Sphere(1.0))
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def scene(count: int, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    roles = rng.choice(ROLES[1:], count)
    objects = [
        SceneObject(
            f"o{i}", role, SHAPES[int(rng.integers(4))], rng.uniform(-3.0, 3.0, 3),
            TURN if rng.random() < 0.5 else np.eye(3),
        )
        for i, role in enumerate(roles)
    ]  # fmt: skip
    floor = SceneObject("floor", "static", HalfSpace(), np.array([0.0, 0.0, -9.0]))
    return Scene("s", "panda", (*objects, floor), goal=JointGoal(np.zeros(7)))


@given(count=st.integers(0, 60), seed=st.integers(0, 10**6), reach=st.floats(0.0, 3.0))
@settings(max_examples=50, deadline=None)
def test_what_is_within_reach_is_around(count: int, seed: int, reach: float) -> None:
    made = scene(count, seed)
    center = np.random.default_rng(seed + 1).uniform(-2.0, 2.0, 3)
    for role in ROLES:
        mine = [k for k, obj in enumerate(made.objects) if obj.role == role]
        rows = rows_around(made, center, reach, role).tolist()
        assert set(rows) <= set(mine)
        assert rows == sorted(rows)
        away, _ = distances(obstacles_of(made), center[None])
        near = {k for k in mine if away[0, k] <= reach}
        assert near <= set(rows)
        balls = [np.linalg.norm(made.objects[k].position - center) - made.objects[k].radius
                 for k in rows]  # fmt: skip
        assert all(gap <= reach + 1e-8 for gap in balls)


@given(count=st.integers(0, 60), seed=st.integers(0, 10**6))
@settings(max_examples=50, deadline=None)
def test_arrays_are_the_objects(count: int, seed: int) -> None:
    made = scene(count, seed)
    _, _, bounds = measures_of(made)
    for k, obj in enumerate(made.objects):
        np.testing.assert_array_equal(made.positions[k], obj.position)
        np.testing.assert_array_equal(made.rotations[k], obj.rotation)
        np.testing.assert_allclose(bounds[k], obj.radius, rtol=1e-15)
        assert k in made.rows(obj.role)
    for array in (made.positions, made.rotations, bounds, made.rows("static")):
        assert not array.flags.writeable
    rows = np.random.default_rng(seed).permutation(len(made.objects))
    chosen = [made.objects[k] for k in rows]
    ours = packed(made, rows)
    plain = pack([(obj.shape, obj.position, obj.rotation) for obj in chosen])
    for a, b in zip(ours[:-1], plain[:-1], strict=True):
        np.testing.assert_array_equal(a, b)
