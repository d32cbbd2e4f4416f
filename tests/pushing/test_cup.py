"""The cup's shape as fruits meet it."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optipromp.pushing.cup import Mouth, cup_distance

CUPS = st.builds(
    lambda inner, wall, base, rim, neck: Mouth(inner, inner + wall, base, rim, 0.002, neck * inner),
    st.floats(0.015, 0.04), st.floats(0.001, 0.01), st.floats(-0.06, -0.02), st.floats(0.0, 0.03),
    st.floats(0.2, 0.8),
)  # fmt: skip


def outline(cup: Mouth, spacing: float = 2e-4) -> np.ndarray:
    """Points on the edges of wall, floor and neck, in the half-plane and mirrored."""
    boxes = (
        (cup.inner, cup.outer, cup.base, cup.rim),
        (-cup.outer, cup.outer, cup.base, cup.base + cup.floor),
        (-cup.neck, cup.neck, cup.base - 0.2, cup.base),
    )
    edges = []
    for left, right, low, high in boxes:
        x = np.linspace(left, right, int((right - left) / spacing) + 2)
        y = np.linspace(low, high, int((high - low) / spacing) + 2)
        edges += [np.stack([x, np.full_like(x, v)], axis=1) for v in (low, high)]
        edges += [np.stack([np.full_like(y, v), y], axis=1) for v in (left, right)]
    return np.vstack(edges)


def solid(cup: Mouth, rho: float, h: float) -> bool:
    wall = cup.inner <= rho <= cup.outer and cup.base <= h <= cup.rim
    floor = rho <= cup.outer and cup.base <= h <= cup.base + cup.floor
    return wall or floor or (rho <= cup.neck and h <= cup.base)


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_the_distance_to_the_cup_is_that_to_its_outline(cup: Mouth, rho: float, h: float) -> None:
    d = cup_distance(rho, h, cup)[0]
    if solid(cup, rho, h):
        assert d <= 1e-15
        return
    brute = np.linalg.norm(outline(cup) - [rho, h], axis=1).min()
    assert d <= brute + 1e-12
    # half the spacing of the samples along an edge that is d away
    assert np.hypot(d, 1e-4) >= brute - 1e-12


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_its_gradient_is_that_of_finite_differences(cup: Mouth, rho: float, h: float) -> None:
    eps = 1e-7
    d, *gradient = cup_distance(rho, h, cup)
    assume(abs(d) > 1e-4)
    assert np.linalg.norm(gradient) == pytest.approx(1.0)
    found = np.empty(2)
    for c, way in enumerate(eps * np.eye(2)):
        high, *other = cup_distance(rho + way[0], h + way[1], cup)
        assume(np.allclose(other, gradient, atol=1e-2))  # not across a kink
        low, *other = cup_distance(rho - way[0], h - way[1], cup)
        assume(np.allclose(other, gradient, atol=1e-2))
        found[c] = (high - low) / (2.0 * eps)
    # an edge's curvature is 1/d where it ends, none before
    np.testing.assert_allclose(found, gradient, atol=1e-6 + eps / abs(d))
