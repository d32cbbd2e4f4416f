"""Stems as few numbers, against the beam they stand for."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from optipromp.core.geometry import Sphere
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import bending
from optipromp.core.pushing.stems.bending import Stems, bent_stems, stems, stems_moved
from optipromp.core.scenes import SceneObject, Stem

BEAM = PUSH.beam
THIN = BEAM.youngs_modulus * np.pi / 64.0 * BEAM.diameter**4  # EI of a stem that hangs plumb [N m²]
AT = np.round(np.array(BEAM.loaded) * BEAM.elements).astype(int)  # the loaded points of the grid


class Beam(NamedTuple):
    """A clamped beam of length L under tension T."""

    length: float
    ei: float
    tension: float

    def deflection(self, load: float, s: np.ndarray) -> np.ndarray:
        """At ``s`` (n,) under 1 N across at ``load``: EI w'''' = T w'' either side of the load.

        w = (s - sinh(ks)/k + B (cosh(ks) - 1)/k) / T below the load. Beyond it the free end has
        neither moment nor shear: w' = C cosh(k(L - s)) / T. Slope and moment are continuous.
        """
        k = np.sqrt(self.tension / self.ei)
        below, beyond = np.minimum(s, load), np.maximum(s - load, 0.0)
        if k * self.length < 0.05:  # the terms above cancel: the cantilever without tension
            w = below**2 * (3.0 * load - below) / (6.0 * self.ei)
            return np.asarray(w + beyond * load**2 / (2.0 * self.ei))
        a, b = k * load, k * (self.length - load)
        b_, c = np.linalg.solve(
            [[np.sinh(a), -np.cosh(b)], [np.cosh(a), np.sinh(b)]], [np.cosh(a) - 1.0, np.sinh(a)]
        )
        w = below - np.sinh(k * below) / k + b_ * (np.cosh(k * below) - 1.0) / k
        w += c * (np.sinh(b) - np.sinh(b - k * beyond)) / k
        return np.asarray(w / self.tension)


def hanging(length: float, radius: float, lean: float, azimuth: float = 0.0) -> tuple[Stems, Beam]:
    """A fruit on a stem that leans, and the beam that it hangs on."""
    way = np.array([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), -np.cos(lean)])
    root = np.array([[0.3, -0.2, 1.1]])
    one = bent_stems(root, root + length * way, np.array([radius]), np.array([0.0015]))
    weight = BEAM.fruit_density * 4.0 / 3.0 * np.pi * radius**3 * BEAM.gravity
    # what carries the moment m g sinθ (L - s) with no more than the turn it may have grown by
    grown = weight * np.sin(lean) * length**2 / (2.0 * BEAM.grown_turn)
    return one, Beam(length, max(THIN, grown), weight * np.cos(lean))


def even(length: float, radius: float, lean: float, azimuth: float = 0.0) -> tuple[Stems, Beam]:
    """The same, the fruit no stiffer than its stem."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bending, "BEAM", BEAM._replace(stiff_end=1.0))
        return hanging(length, radius, lean, azimuth)


LENGTHS = st.floats(0.04, 0.3)  # as generated scenes have them, and shorter
RADII = st.floats(0.002, 0.02)
LEANS = st.floats(0.0, 1.0)
AZIMUTHS = st.floats(-np.pi, np.pi)


@pytest.mark.parametrize("length", [0.05, 0.12, 0.30])
def test_a_cantilever(length: float) -> None:
    """A fruit that weighs next to nothing: F L³ / 3EI, and the text-book's line elsewhere."""
    one, beam = even(length, 1e-4, 0.0)
    tip = np.linalg.inv(one.stiffness[0])[-1, -1]
    assert tip == pytest.approx(length**3 / (3.0 * THIN), rel=2e-3)
    s = length * np.arange(BEAM.elements + 1) / BEAM.elements
    line = s**2 * (3.0 * length - s) / (6.0 * THIN)
    found = one.shape[0] @ np.linalg.inv(one.stiffness[0])[:, -1]
    np.testing.assert_allclose(found, line, atol=2e-3 * line[-1])
    assert beam.tension * length**2 < 1e-4 * THIN


@settings(max_examples=100, deadline=None)
@given(LENGTHS, RADII, LEANS, AZIMUTHS)
@example(0.28125, 0.01953125, 0.0, 0.0)  # heavy on a long stem: it turns within 2 cm of the root
def test_loads_at_the_loaded_points_bend_it_as_a_beam_under_tension(length, radius, lean, azimuth):
    one, beam = even(length, radius, lean, azimuth)
    compliance = np.linalg.inv(one.stiffness[0])
    s = length * np.arange(BEAM.elements + 1) / BEAM.elements
    for k, at in enumerate(AT):
        exact = beam.deflection(s[at], s)
        found = one.shape[0] @ compliance[:, k]
        # what the grid costs
        np.testing.assert_allclose(found, exact, atol=0.005 * exact[-1])
        assert compliance[k, k] == pytest.approx(exact[at], rel=5e-3)
    assert compliance[-1, -1] == pytest.approx(beam.deflection(length, s)[-1], rel=1.5e-3)


@settings(max_examples=100, deadline=None)
@given(LENGTHS, RADII, LEANS, AZIMUTHS)
def test_the_stiffness_is_symmetric_and_positive_definite(length, radius, lean, azimuth):
    one, _ = hanging(length, radius, lean, azimuth)
    for matrix in (one.stiffness[0], one.shortening[0]):
        np.testing.assert_allclose(matrix, matrix.T, rtol=1e-9, atol=1e-9 * np.abs(matrix).max())
        assert np.linalg.eigvalsh(matrix).min() > 0.0
    np.testing.assert_allclose(one.shape[0, AT], np.eye(len(BEAM.loaded)), atol=1e-8)
    np.testing.assert_array_equal(one.shape[0, 0], 0.0)


@settings(max_examples=60, deadline=None)
@given(LENGTHS, RADII, LEANS, st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3))
def test_the_shortening_is_half_the_integral_of_the_squared_slope(length, radius, lean, u):
    one, _ = hanging(length, radius, lean)
    s = length * np.arange(BEAM.elements + 1) / BEAM.elements
    slope = np.diff(one.shape[0] @ u) / np.diff(s)
    assert 0.5 * np.array(u) @ one.shortening[0] @ u == pytest.approx(
        0.5 * (slope**2) @ np.diff(s), rel=1e-9, abs=1e-15
    )


@pytest.mark.parametrize(("length", "radius", "lean"), [(0.1, 0.01, 0.0), (0.25, 0.015, 0.3)])
def test_a_bent_stem_is_shorter_by_what_the_beam_loses(length, radius, lean):
    one, beam = even(length, radius, lean)
    force = 0.02
    u = force * np.linalg.inv(one.stiffness[0])[:, -1]
    s = np.linspace(0.0, length, 4001)
    slope = np.gradient(force * beam.deflection(length, s), s)
    lost = 0.5 * np.trapezoid(slope**2, s)
    assert 0.5 * u @ one.shortening[0] @ u == pytest.approx(lost, rel=0.01)


def test_the_fruit_itself_does_not_bend() -> None:
    """A fruit over half of its stem: F (L³ - r³) / 3EI, to half an element of where it begins."""
    length = 0.04
    light = 1e-9  # [kg/m³]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bending, "BEAM", BEAM._replace(fruit_density=light))
        one = bent_stems(
            np.zeros((1, 3)), np.array([[0.0, 0.0, -length]]), np.array([0.02]), np.array([0.001])
        )
    tip = np.linalg.inv(one.stiffness[0])[-1, -1]
    assert tip == pytest.approx((length**3 - 0.02**3) / (3.0 * THIN), rel=0.03)
    w = one.shape[0] @ np.linalg.inv(one.stiffness[0])[:, -1]
    turns = np.abs(np.diff(w, 2))
    assert turns[BEAM.elements // 2 + 1 :].max() < 0.02 * turns.max()


@settings(max_examples=60, deadline=None)
@given(LENGTHS, RADII, LEANS, AZIMUTHS)
def test_two_directions_across_and_one_along(length, radius, lean, azimuth):
    one, _ = hanging(length, radius, lean, azimuth)
    np.testing.assert_allclose(one.axes[0] @ one.axes[0].T, np.eye(3), atol=1e-12)
    assert one.length[0] == pytest.approx(length)
    way = [np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), -np.cos(lean)]
    np.testing.assert_allclose(one.axes[0, 2], way, atol=1e-9)


def test_a_stem_that_leans_is_as_stiff_as_its_fruit_asks_for() -> None:
    plumb, leaning = hanging(0.2, 0.015, 0.0)[0], hanging(0.2, 0.015, 0.5)[0]
    assert np.linalg.inv(leaning.stiffness[0])[-1, -1] < np.linalg.inv(plumb.stiffness[0])[-1, -1]


def test_stems_of_a_scene() -> None:
    """Root last, fruit first; what does not hang has no place among them."""
    fruit = np.array([0.4, 0.1, 0.9])
    points = np.array([fruit, fruit + [0.01, 0.0, 0.1], fruit + [0.05, 0.0, 0.2]])
    objects = [
        SceneObject("a", "target", Sphere(0.015), fruit, stem=Stem(points, 0.002)),
        SceneObject(
            "b", "pushable", Sphere(0.018), fruit - 0.1,
            stem=Stem(np.array([fruit - 0.1, fruit + 0.1]), 0.003),
        ),
    ]  # fmt: skip
    both = stems(objects)
    np.testing.assert_array_equal(both.root, [points[-1], fruit + 0.1])
    np.testing.assert_array_equal(both.radius, [0.015, 0.018])
    np.testing.assert_array_equal(both.thickness, [0.002, 0.003])
    np.testing.assert_allclose(both.length, [np.hypot(0.05, 0.2), 0.2 * np.sqrt(3.0)])
    np.testing.assert_allclose(both.mass, BEAM.fruit_density * 4.0 / 3.0 * np.pi * both.radius**3)
    fruits = both.root + both.length[:, None] * both.axes[:, 2]
    np.testing.assert_allclose(fruits, [obj.position for obj in objects], atol=1e-12)
    assert len(stems([]).root) == 0
    # each as if it were alone
    alone = stems(objects[1:])
    for name in Stems._fields:
        np.testing.assert_array_equal(getattr(both, name)[1:], getattr(alone, name))


def test_stems_that_hang_a_little_otherwise_bend_nearly_as_before() -> None:
    """Place, length and direction are exact; stiffness, by the length cubed, within a quarter."""
    rng = np.random.default_rng(0)
    root = np.array([[0.0, 0.0, 1.2], [0.05, 0.0, 1.15]])
    fruit = np.array([[0.02, 0.01, 1.0], [0.02, -0.03, 0.95]])
    radius, thickness = np.full(2, 0.016), np.full(2, 0.0015)
    here = bent_stems(root, fruit, radius, thickness)
    fruits = fruit + 0.003 * rng.standard_normal((3, 2, 3))
    roots = root + 0.003 * rng.standard_normal((3, 2, 3))
    there = stems_moved([here], roots, fruits)
    exact = bent_stems(
        roots.reshape(-1, 3), fruits.reshape(-1, 3), np.tile(radius, 3), np.tile(thickness, 3)
    )
    for name in ("root", "axes", "length", "mass", "radius", "thickness"):
        np.testing.assert_allclose(getattr(there, name), getattr(exact, name), atol=1e-15)
    np.testing.assert_allclose(there.stiffness, exact.stiffness, rtol=0.25)
    np.testing.assert_allclose(
        there.compliance @ there.stiffness, np.tile(np.eye(3), (6, 1, 1)), atol=1e-9
    )
