"""Signed distances of the primitives: against coal, by finite differences, in every corner."""

import math
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.refusals import assert_refused

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Sphere,
    distances,
    near,
    pack,
    signed_distance,
)
from optipromp.core.geometry.obstacles import measures
from optipromp.core.judging.distances import to_surface

SHAPES = {
    "sphere": Sphere(0.2),
    "box": Box((0.3, 0.5, 0.8)),
    "flat box": Box((1.0, 1.0, 0.01)),
    "cylinder": Cylinder(0.2, 0.6),
    "disc": Cylinder(0.5, 0.02),
    "capsule": Capsule(0.1, 0.5),
    "half-space": HalfSpace(),
    "ellipsoid": Ellipsoid((0.2, 0.3, 0.5)),
    "flat ellipsoid": Ellipsoid((0.4, 0.4, 0.02)),
    "cone": Cone(0.2, 0.05, 0.4),
    "turned cone": Cone(0.1, 0.25, 0.2),
}
EYE = np.eye(3)
ORIGIN = np.zeros(3)

coordinate = st.floats(-1.5, 1.5)
point = st.tuples(coordinate, coordinate, coordinate)
quaternion = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: math.hypot(*q) > 0.1)


def rotation_of(wxyz):
    w, x, y, z = np.array(wxyz) / math.hypot(*wxyz)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return EYE + 2 * w * cross + 2 * cross @ cross


def distance_at(obstacles, x, k=0):
    gradient = np.full(3, np.nan)
    place = map(float, x)  # the kernel is compiled once more for each mixture of types
    return signed_distance(obstacles, k, *place, gradient), gradient


@pytest.mark.parametrize("name", SHAPES)
@settings(max_examples=60, deadline=None)
@given(x=point, turn=quaternion, at=point)
def test_gradient_is_that_of_the_distance(name, x, turn, at):
    obstacles = pack([(SHAPES[name], at, rotation_of(turn))])
    _, gradient = distance_at(obstacles, x)
    assert abs(np.linalg.norm(gradient) - 1.0) < 1e-9
    step = 1e-6
    forward, backward = np.zeros(3), np.zeros(3)
    for i in range(3):
        shift = step * EYE[i]
        here = distance_at(obstacles, x)[0]
        forward[i] = (distance_at(obstacles, np.add(x, shift))[0] - here) / step
        backward[i] = (here - distance_at(obstacles, np.subtract(x, shift))[0]) / step
    if np.abs(forward - backward).max() < 1e-3:  # no kink within a step
        np.testing.assert_allclose(gradient, 0.5 * (forward + backward), atol=1e-4)


def special(shape):
    """Coordinates of faces, edges, axes and centres, and what is a rounding away from them."""
    sizes = [0.0, *(getattr(shape, "size", ())), getattr(shape, "radius", 0.0)]
    sizes = [*(0.5 * s for s in sizes), getattr(shape, "radius", 0.3)]
    sizes += [0.5 * getattr(shape, "length", 0.4), 0.7]
    return sorted({sign * s + off for s in sizes for sign in (-1, 1) for off in (0.0, 1e-16, 1e-9)})


@pytest.mark.parametrize("name", SHAPES)
@settings(max_examples=int(os.environ.get("GRADIENTS", "40")), deadline=None)
@given(data=st.data(), along=point.filter(lambda d: math.hypot(*d) > 0.1))
def test_on_faces_edges_and_axes_the_slope_is_that_of_one_side(name, data, along):
    x = np.array([data.draw(st.sampled_from(special(SHAPES[name]))) for _ in range(3)])
    obstacles = pack([(SHAPES[name], ORIGIN, EYE)])
    here, gradient = distance_at(obstacles, x)
    assert np.isfinite(here)
    assert abs(np.linalg.norm(gradient) - 1.0) < 1e-9
    way = np.array(along) / math.hypot(*along)
    step = 1e-5
    before, after = ((distance_at(obstacles, x + s * step * way)[0] - here) / (s * step)
                     for s in (-1.0, 1.0))  # fmt: skip
    assert min(before, after) - 1e-3 <= gradient @ way <= max(before, after) + 1e-3


@pytest.mark.parametrize("name", SHAPES)
@settings(max_examples=30, deadline=None)
@given(x=point, turn=quaternion, at=point)
def test_a_rigid_motion_changes_no_distance(name, x, turn, at):
    rotation = rotation_of(turn)
    here, gradient = distance_at(pack([(SHAPES[name], ORIGIN, EYE)]), x)
    moved = rotation @ x + at
    there, turned = distance_at(pack([(SHAPES[name], at, rotation)]), moved)
    assert there == pytest.approx(here, abs=1e-12)
    # on a kink rounding may take another limit
    if np.linalg.norm(turned - rotation @ gradient) > 1e-6:
        along = moved + 1e-6 * rotation @ gradient
        assert distance_at(pack([(SHAPES[name], at, rotation)]), along)[0] <= there + 1.1e-6


@pytest.mark.parametrize("name", ["sphere", "box", "cylinder", "capsule"])
def test_agrees_with_coal(name):
    coal = pytest.importorskip("coal")
    shape = SHAPES[name]
    other = {
        "sphere": lambda: coal.Sphere(shape.radius),
        "box": lambda: coal.Box(*shape.size),
        "cylinder": lambda: coal.Cylinder(shape.radius, shape.length),
        "capsule": lambda: coal.Capsule(shape.radius, shape.length),
    }[name]()
    rng = np.random.default_rng(3)
    obstacles = pack([(shape, [0.1, -0.2, 0.3], rotation_of((0.5, 0.4, -0.6, 0.2)))])
    pose = coal.Transform3s(obstacles.rotation[0], obstacles.position[0])
    probe, radius = coal.Sphere(1e-3), 1e-3
    inside = 0
    for x in obstacles.position[0] + rng.uniform(-0.4, 0.4, (300, 3)):
        result = coal.DistanceResult()
        request = coal.DistanceRequest()
        request.enable_signed_distance = True
        theirs = coal.distance(other, pose, probe, coal.Transform3s(EYE, x), request, result)
        ours = distance_at(obstacles, x)[0]
        inside += ours < 0
        if name == "cylinder" and ours < 0:  # coal's depth is an upper bound there, not exact
            assert theirs <= ours - radius + 2e-5
        else:
            assert ours - radius == pytest.approx(theirs, abs=2e-5)
    assert inside > 5


@pytest.mark.parametrize(
    ("name", "x", "expected"),
    [
        ("sphere", (0, 0, 0), -0.2),
        ("sphere", (0, 0, 0.2), 0.0),
        ("sphere", (1e-320, 0, 0), -0.2),
        ("sphere", (1e-160, 1e-160, 0), -0.2),
        ("box", (0, 0, 0), -0.15),
        ("box", (0.15, 0.25, 0.4), 0.0),
        ("box", (0.15, 0.25, 0), 0.0),
        ("box", (0.15, 0, 0), 0.0),
        ("box", (np.nextafter(0.15, 1), 0, 0), 0.0),
        ("box", (0.45, 0.65, 0), 0.5),
        ("cylinder", (0, 0, 0), -0.2),
        ("cylinder", (0, 0, 0.3), 0.0),
        ("cylinder", (0.2, 0, 0.3), 0.0),
        ("cylinder", (0.5, 0, 0.7), 0.5),
        ("cylinder", (0, 0, 0.5), 0.2),
        ("capsule", (0, 0, 0), -0.1),
        ("capsule", (0, 0, 0.25), -0.1),
        ("capsule", (0, 0, 0.35), 0.0),
        ("capsule", (0, 1e-200, 0), -0.1),
        ("half-space", (5, 5, 0), 0.0),
        ("half-space", (1, 1, -2), -2.0),
    ],
)
def test_centres_edges_and_surfaces(name, x, expected):
    distance, gradient = distance_at(pack([(SHAPES[name], ORIGIN, EYE)]), x)
    assert distance == pytest.approx(expected, abs=1e-15)
    assert np.isfinite(gradient).all()
    assert np.linalg.norm(gradient) == pytest.approx(1.0)


def test_batched_equals_looped_and_leaves_inputs_alone():
    rng = np.random.default_rng(1)
    obstacles = pack([(shape, rng.normal(size=3), EYE) for shape in SHAPES.values()])
    points = rng.normal(size=(20, 3))
    before = points.copy()
    found, gradients = distances(obstacles, points)
    assert found.shape == (20, len(SHAPES))
    assert gradients.shape == (20, len(SHAPES), 3)
    for n, x in enumerate(points):
        for k in range(len(SHAPES)):
            alone, gradient = distance_at(obstacles, x, k)
            assert found[n, k] == pytest.approx(alone, abs=1e-14)
            np.testing.assert_allclose(gradients[n, k], gradient, atol=1e-12)
    np.testing.assert_array_equal(points, before)


def arrays(obstacles):
    *own, cells = obstacles
    return [*own, cells.start, cells.member]


def test_no_obstacles_and_no_points():
    empty = pack([])
    one = pack([(Sphere(1.0), ORIGIN, EYE)])
    assert [array.dtype for array in arrays(empty)] == [array.dtype for array in arrays(one)]
    assert [array.ndim for array in arrays(empty)] == [array.ndim for array in arrays(one)]
    assert distances(empty, np.zeros((4, 3)))[1].shape == (4, 0, 3)
    assert distances(pack([(Sphere(1.0), ORIGIN, EYE)]), np.zeros((0, 3)))[0].shape == (0, 1)


def test_packed_arrays_are_read_only_and_bounds_hold():
    obstacles = pack([(shape, ORIGIN, EYE) for shape in SHAPES.values()])
    assert not any(array.flags.writeable for array in arrays(obstacles))
    np.testing.assert_allclose(
        obstacles.bound,
        [
            0.2,
            0.5 * math.hypot(0.3, 0.5, 0.8),
            0.5 * math.hypot(1, 1, 0.01),
            math.hypot(0.2, 0.3),
            math.hypot(0.5, 0.01),
            0.35,
            math.inf,
            0.5,
            0.4,
            0.4,
            0.35,
        ],
    )


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere(0.0), "sphere radius is 0"),
        (lambda: Sphere(math.nan), "sphere radius is nan"),
        (lambda: Box((0.1, -0.2, 0.3)), "box size[1] is -0.2"),
        (lambda: Cylinder(0.1, 0.0), "cylinder length"),
        (lambda: Capsule(-1.0, 0.1), "capsule radius"),
        (lambda: pack([(Sphere(1.0), [0, math.inf, 0], EYE)]), "obstacle 0: position[1]"),
        (lambda: pack([(Sphere(1.0), ORIGIN, 2 * EYE)]), "no rotation matrix"),
        (lambda: pack([(Sphere(1.0), ORIGIN, -EYE)]), "no rotation matrix"),
    ],
)
def test_refuses(make, words):
    assert_refused(InvalidSceneError, words, make)


@pytest.mark.parametrize(
    ("points", "words"),
    [(np.zeros(3), "(N, 3)"), (np.array([[0, 0, 0], [0, math.nan, 0]]), "points[1]")],
)
def test_refuses_points(points, words):
    assert_refused(InvalidRequestError, words, distances, pack([]), points)


@settings(max_examples=50, deadline=None)
@given(point, st.floats(0.0, 1.0))
def test_what_is_left_out_is_not_near(at, reach):
    """Every shape three times: distances within reach are the same with what is left."""
    rng = np.random.default_rng(0)
    shapes = [shape for shape in SHAPES.values() for _ in range(3)]
    everything = pack([(shape, rng.uniform(-2.0, 2.0, 3), EYE) for shape in shapes])
    some = near(everything, np.array(at), reach)
    for a, b in zip(everything[:-1], some[:-1], strict=True):
        assert a.dtype == b.dtype
        assert not b.flags.writeable
    assert some.cells.reach == 0.0
    before, _ = distances(everything, [at])
    after, _ = distances(some, [at])
    kept = np.sort(before[before <= reach])
    np.testing.assert_array_equal(np.sort(after[after <= reach]), kept)
    assert len(some.kind) < len(everything.kind) or reach > 0.5


@pytest.mark.parametrize("name", ["ellipsoid", "flat ellipsoid", "cone", "turned cone"])
@settings(max_examples=60, deadline=None)
@given(x=point)
def test_round_shapes_agree_with_the_judge_and_with_their_support(name, x):
    shape = SHAPES[name]
    ours, normal = distance_at(pack([(shape, ORIGIN, EYE)]), x)
    kind, size, _ = measures([shape])
    assert to_surface(kind[0], *size[0], *x) == pytest.approx(ours, abs=1e-8)
    # outside, the distance is the gap of the supporting plane across the gradient
    if isinstance(shape, Ellipsoid):
        support = math.hypot(*(np.array(shape.radii) * normal))
    else:
        half = 0.5 * shape.length * normal[2]
        support = max(half + shape.radius, shape.tip - half)
    if ours > 0.0:
        assert np.dot(x, normal) - support == pytest.approx(ours, abs=1e-9)


def test_a_cone_within_one_of_its_balls_is_refused():
    with pytest.raises(InvalidSceneError, match="must be above"):
        Cone(0.03, 0.01, 0.015)


@pytest.mark.parametrize("name", ["ellipsoid", "turned cone"])
def test_the_mesh_of_a_round_shape_lies_on_its_surface(name):
    mesh = SHAPES[name].mesh(48)
    away, _ = distances(pack([(SHAPES[name], ORIGIN, EYE)]), mesh.vertices)
    np.testing.assert_allclose(away, 0.0, atol=1e-9)
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    inner, _ = distances(pack([(SHAPES[name], ORIGIN, EYE)]), middles)
    assert inner.min() > -0.01 * SHAPES[name].measure.bound
