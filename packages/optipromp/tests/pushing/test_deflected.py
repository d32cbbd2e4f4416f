"""One deflected stem: where its points are, and the energy that a step minimises."""

from typing import Any

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from tests.pushing.fruits import CUP, DT, TARGET, UP, hung

from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import contacts as c
from optipromp.core.pushing.stems.bending import Stems, bowed
from optipromp.core.pushing.stems.contacts import Descent, freely
from optipromp.core.pushing.stems.cup import MouthPose, fruit_gap, stem_gap

begin, place, press, shortened = (k.py_func for k in (c.begin, c.place, c.press, c.shortened))


def energy(s: Stems, u: np.ndarray, ahead: np.ndarray, inertia: float, share: float, point: Any,
           within: bool | None) -> tuple[float, float]:  # fmt: skip
    """The energy that a step minimises, and the gap: of the fruit, or of a piece of its stem."""
    loaded = s.stiffness.shape[1]
    both = u.reshape(2, loaded)
    bent = both - s.rest.reshape(2, loaded)
    total = sum(0.5 * w @ s.stiffness[0] @ w for w in bent)
    slip = u[[loaded - 1, -1]] - ahead[[loaded - 1, -1]]
    total += 0.5 * inertia * slip @ slip
    up = 0.5 * sum(w @ s.shortening[0] @ w for w in both) - s.lifted[0]
    n = s.shape.shape[1] - 1
    w = [np.interp(share * n, np.arange(n + 1), s.shape[0] @ part) for part in both]
    x = s.root[0] + w @ s.axes[0, :2] + (s.length[0] - up) * share * s.axes[0, 2]
    gap, _ = gap_of(s, x, point, within)
    return total + 0.5 * PUSH.swing.stiffness * max(0.0, -gap) ** 2, gap


def gap_of(s: Stems, x: Any, point: Any, within: bool | None) -> tuple[float, tuple[float, ...]]:
    """Gap to the cup, and the way it is pushed, of the fruit or of a piece of its stem at ``x``."""
    at = MouthPose(*point, *UP)
    if within is None:
        gap, *normal = fruit_gap(*x, s.radius[0], at, CUP)
    else:
        gap, *normal = stem_gap(*x, s.thickness[0], within, at, CUP)
    return gap, tuple(normal)


def stepped(s: Stems, u: np.ndarray, ahead: np.ndarray, inertia: float, share: float, point: Any,
            within: bool | None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Gradient (2L,) and inverse Hessian (2L, 2L) as a step puts them together."""
    d = descent(s, inertia)
    begin(s, u[None], ahead[None], 0, d)
    gap, normal = gap_of(s, at_share(s, u, share), point, within)
    if gap < 0.0:
        press(s, u[None], 0, share, normal, -gap, PUSH.swing.stiffness, d)
    return d.gradient, d.inverse


@settings(max_examples=100, deadline=None)
@given(st.floats(0.001, 0.05), st.floats(-0.1, -0.0301), st.floats(0.0, 0.05))
def test_a_stem_beside_the_cone_meets_its_radius_there(rho: float, h: float, cone: float) -> None:
    cup, at = CUP._replace(cone=cone), MouthPose(0.0, 0.0, 0.0, *UP)
    gap, *way = stem_gap(0.6 * rho, 0.8 * rho, h, 0.001, False, at, cup)
    wide = cup.neck
    if cone:
        wide = np.interp(h, [cup.base - cone, cup.base], [cup.neck, cup.outer])
    assert abs(gap - (rho - wide - 0.001)) < 1e-12
    np.testing.assert_allclose(way, [0.6, 0.8, 0.0])


def descent(s: Stems, inertia: float) -> Descent:
    """Before the first step of one stem."""
    loads, count = s.stiffness.shape[1], 2 * s.stiffness.shape[1]
    d = Descent(
        np.array([inertia]), np.empty((1, loads, loads)), np.empty(count),
        np.empty((count, count)), np.empty(count), np.empty(count), np.ones(1),
        np.zeros((1, count)),
    )  # fmt: skip
    freely(s, 0, d)
    return d


def at_share(s: Stems, u: np.ndarray, share: float) -> np.ndarray:
    up = shortened(s, u[None], 0) - s.lifted[0]
    return np.array(place(s, u[None], 0, s.length[0] - up, share))


PIECES = st.sampled_from([(1.0, None), (0.6, False), (0.8, True), (0.45, False)])


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), PIECES)
def test_the_force_is_the_gradient_of_the_energy(seed: int, piece: tuple[float, Any]) -> None:
    """With stem, inertia and a contact of the fruit or of a piece of its stem."""
    share, within = piece
    rng = np.random.default_rng(seed)
    s = hung(((0, 0, 0), (*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.06, 0.3))))
    s = bowed(s, rng.uniform(0.0, 0.06, 1), rng.uniform(-np.pi, np.pi, 1))
    u, ahead = 0.01 * rng.standard_normal((2, 6))
    inertia = s.mass[0] / DT**2
    x = at_share(s, u, share)
    beside = rng.uniform(0.012, 0.04)
    turn = rng.uniform(-np.pi, np.pi)
    point = x + [beside * np.cos(turn), beside * np.sin(turn), rng.uniform(-0.03, 0.04)]
    args = ahead, inertia, share, point, within
    gradient, inverse = stepped(s, u, *args)
    _, gap = energy(s, u, *args)
    assume(gap < -1e-4)
    assume(gap > -0.02)
    found, eps = np.empty(6), 1e-7
    for a in range(6):
        way = eps * np.eye(6)[a]
        (high, above), (low, below) = energy(s, u + way, *args), energy(s, u - way, *args)
        assume(abs(above + below - 2.0 * gap) < 1e-11)  # not across a kink
        found[a] = (high - low) / (2.0 * eps)
    np.testing.assert_allclose(found, gradient, rtol=1e-4, atol=1e-4 * np.abs(gradient).max())
    assert np.linalg.eigvalsh(inverse).min() > 0.0


def test_a_step_down_the_gradient_lowers_the_energy() -> None:
    s = hung(((0, 0, 0), (0.02, 0.0, 0.15)))
    u = ahead = np.zeros(6)
    args = ahead, s.mass[0] / DT**2, 1.0, TARGET + [0.035, 0.0, 0.0], None
    before, gap = energy(s, u, *args)
    assert gap < 0.0
    gradient, inverse = stepped(s, u, *args)
    after, _ = energy(s, u - inverse @ gradient, *args)
    assert after < 0.5 * before


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 5))
def test_the_inverse_is_that_of_the_hessian(seed: int, contacts: int) -> None:
    """Stiffness and inertia, and a rank more for every contact."""
    rng = np.random.default_rng(seed)
    s = hung(((0, 0, 0), (*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.06, 0.3))))
    u, ahead = 0.01 * rng.standard_normal((2, 1, 6))
    inertia = s.mass[0] / DT**2
    hessian = np.zeros((6, 6))
    hessian[:3, :3] = hessian[3:, 3:] = s.stiffness[0]
    hessian[2, 2] += inertia
    hessian[5, 5] += inertia
    d = descent(s, inertia)
    begin(s, u, ahead, 0, d)
    for _ in range(contacts):
        normal = rng.standard_normal(3)
        x, y, z = (normal / np.linalg.norm(normal)).tolist()
        press(s, u, 0, rng.uniform(0.3, 1.0), (x, y, z), 1e-3, PUSH.swing.stiffness, d)
        hessian += PUSH.swing.stiffness * np.outer(d.j, d.j)
    np.testing.assert_allclose(d.inverse @ hessian, np.eye(6), atol=1e-7)
