"""What a cup does to fruits on stems: its distances, its forces, and what becomes of the fruits."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from optipromp.geometry.obstacles import pack
from optipromp.geometry.shapes import Box
from optipromp.pushing import swinging
from optipromp.pushing.bending import Stems, bent
from optipromp.pushing.swinging import CONTACT, Cup, cup_distance, harm, push
from optipromp.robots.ik import cholesky_solve

CUP = Cup(inner=0.023, outer=0.025, base=-0.03, rim=0.02, floor=0.002, neck=0.01)
UP = np.array([0.0, 0.0, 1.0])
DT = 0.04  # [s]
NOTHING = pack([])
TARGET = np.array([0.4, 0.1, 0.9])


def hung(*fruits: tuple[Any, Any], radius: float = 0.015) -> Stems:
    """Fruits at places relative to the target's, on stems ``vector`` to their roots."""
    fruit = TARGET + np.array([place for place, _ in fruits], dtype=float)
    root = fruit + np.array([vector for _, vector in fruits], dtype=float)
    return bent(root, fruit, np.full(len(fruit), radius), np.full(len(fruit), 0.0015))


def along(*corners: Any, step: float = 0.003) -> np.ndarray:
    """Points every ``step`` through corners relative to the target's place."""
    places = TARGET + np.array(corners, dtype=float)
    parts = [
        a + np.linspace(0.0, 1.0, int(np.linalg.norm(b - a) / step) + 2)[:-1, None] * (b - a)
        for a, b in itertools.pairwise(places)
    ]
    return np.ascontiguousarray(np.vstack([*parts, places[-1:]]))


def led(
    stems: Stems, points: np.ndarray, axis: np.ndarray = UP, cup: Cup = CUP
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (P, N, 3), forces (P, N) on fruits and on stems."""
    count, steps = len(stems.root), len(points)
    out = np.zeros((steps, count, 3)), np.zeros((steps, count)), np.zeros((steps, count))
    push(stems, points, np.tile(axis, (steps, 1)), DT, cup, NOTHING, *out)
    return out


def foreseen(stems: Stems, points: np.ndarray) -> swinging.Harm:
    return harm(stems, points, np.tile(UP, (len(points), 1)), DT, CUP, NOTHING)


def gaps(positions: np.ndarray, points: np.ndarray, radius: float = 0.015) -> np.ndarray:
    """Distance (P, N) of the fruits' surfaces to the cup."""
    off = positions - points[:, None]
    rho, h = np.linalg.norm(off[..., :2], axis=2), off[..., 2]
    grad = np.empty(2)
    flat = [cup_distance(r, z, CUP, grad) for r, z in zip(rho.ravel(), h.ravel(), strict=True)]
    return np.array(flat).reshape(rho.shape) - radius


# --- the cup -----------------------------------------------------------------------------------

CUPS = st.builds(
    lambda inner, wall, base, rim, neck: Cup(inner, inner + wall, base, rim, 0.002, neck * inner),
    st.floats(0.015, 0.04), st.floats(0.001, 0.01), st.floats(-0.06, -0.02), st.floats(0.0, 0.03),
    st.floats(0.2, 0.8),
)  # fmt: skip


def outline(cup: Cup, spacing: float = 2e-4) -> np.ndarray:
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


def solid(cup: Cup, rho: float, h: float) -> bool:
    wall = cup.inner <= rho <= cup.outer and cup.base <= h <= cup.rim
    floor = rho <= cup.outer and cup.base <= h <= cup.base + cup.floor
    return wall or floor or (rho <= cup.neck and h <= cup.base)


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_the_distance_to_the_cup_is_that_to_its_outline(cup: Cup, rho: float, h: float) -> None:
    d = cup_distance(rho, h, cup, np.empty(2))
    if solid(cup, rho, h):
        assert d <= 1e-15
        return
    brute = np.linalg.norm(outline(cup) - [rho, h], axis=1).min()
    assert d <= brute + 1e-12
    # half the spacing of the samples along an edge that is d away
    assert np.hypot(d, 1e-4) >= brute - 1e-12


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_its_gradient_is_that_of_finite_differences(cup: Cup, rho: float, h: float) -> None:
    eps, gradient, other = 1e-7, np.empty(2), np.empty(2)
    d = cup_distance(rho, h, cup, gradient)
    assume(abs(d) > 1e-4)
    assert np.linalg.norm(gradient) == pytest.approx(1.0)
    found = np.empty(2)
    for c, way in enumerate(eps * np.eye(2)):
        high = cup_distance(rho + way[0], h + way[1], cup, other)
        assume(np.allclose(other, gradient, atol=1e-2))  # not across a kink
        low = cup_distance(rho - way[0], h - way[1], cup, other)
        assume(np.allclose(other, gradient, atol=1e-2))
        found[c] = (high - low) / (2.0 * eps)
    # an edge's curvature is 1/d where it ends, none before
    np.testing.assert_allclose(found, gradient, atol=1e-6 + eps / abs(d))


# --- energy and forces -------------------------------------------------------------------------


def energy(s: Stems, u: np.ndarray, ahead: np.ndarray, inertia: float, share: float, point: Any,
           within: bool | None) -> tuple[float, float]:  # fmt: skip
    """The energy that a step minimises, and the gap: of the fruit, or of a piece of its stem."""
    loaded = s.stiffness.shape[1]
    both = u.reshape(2, loaded)
    total = sum(0.5 * w @ s.stiffness[0] @ w for w in both)
    slip = u[[loaded - 1, -1]] - ahead[[loaded - 1, -1]]
    total += 0.5 * inertia * slip @ slip
    up = 0.5 * sum(w @ s.shortening[0] @ w for w in both)
    n = s.shape.shape[1] - 1
    w = [np.interp(share * n, np.arange(n + 1), s.shape[0] @ part) for part in both]
    x = s.root[0] + w @ s.axes[0, :2] + (s.length[0] - up) * share * s.axes[0, 2]
    normal = np.empty(3)
    if within is None:
        gap = swinging._fruit_gap(x, s.radius[0], point, UP, CUP, normal, np.empty(2))
    else:
        gap = swinging._stem_gap(x, s.thickness[0], within, point, UP, CUP, normal)
    return total + 0.5 * CONTACT * max(0.0, -gap) ** 2, gap


def stepped(s: Stems, u: np.ndarray, ahead: np.ndarray, inertia: float, share: float, point: Any,
            within: bool | None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Gradient (2L,) and Hessian (2L, 2L) as a step puts them together."""
    count = 2 * s.stiffness.shape[1]
    gradient, hessian = np.empty(count), np.empty((count, count))
    swinging._begin(s.stiffness[0], u, ahead, inertia, gradient, hessian)
    x, normal = np.empty(3), np.empty(3)
    up = swinging._shortened(s.shortening[0], u)
    swinging._place(s.root[0], s.axes[0], s.shape[0], u, s.length[0] - up, share, x)
    if within is None:
        gap = swinging._fruit_gap(x, s.radius[0], point, UP, CUP, normal, np.empty(2))
    else:
        gap = swinging._stem_gap(x, s.thickness[0], within, point, UP, CUP, normal)
    if gap < 0.0:
        swinging._press(
            s.axes[0], s.shape[0], s.shortening[0], u, share, normal, -gap, CONTACT,
            np.empty(count), gradient, hessian,
        )  # fmt: skip
    return gradient, np.tril(hessian) + np.tril(hessian, -1).T


PIECES = st.sampled_from([(1.0, None), (0.6, False), (0.8, True), (0.45, False)])


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), PIECES)
def test_the_force_is_the_gradient_of_the_energy(seed: int, piece: tuple[float, Any]) -> None:
    """With stem, inertia and a contact of the fruit or of a piece of its stem."""
    share, within = piece
    rng = np.random.default_rng(seed)
    s = hung(((0, 0, 0), (*rng.uniform(-0.06, 0.06, 2), rng.uniform(0.06, 0.3))))
    u, ahead = 0.01 * rng.standard_normal((2, 6))
    inertia = s.mass[0] / DT**2
    x = np.empty(3)
    up = swinging._shortened(s.shortening[0], u)
    swinging._place(s.root[0], s.axes[0], s.shape[0], u, s.length[0] - up, share, x)
    beside = rng.uniform(0.012, 0.04)
    turn = rng.uniform(-np.pi, np.pi)
    point = x + [beside * np.cos(turn), beside * np.sin(turn), rng.uniform(-0.03, 0.04)]
    args = ahead, inertia, share, point, within
    gradient, hessian = stepped(s, u, *args)
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
    assert np.linalg.eigvalsh(hessian).min() > 0.0


def test_a_step_down_the_gradient_lowers_the_energy() -> None:
    s = hung(((0, 0, 0), (0.02, 0.0, 0.15)))
    u = ahead = np.zeros(6)
    args = ahead, s.mass[0] / DT**2, 1.0, TARGET + [0.035, 0.0, 0.0], None
    before, gap = energy(s, u, *args)
    assert gap < 0.0
    gradient, hessian = stepped(s, u, *args)
    cholesky_solve(hessian, gradient)
    after, _ = energy(s, u - gradient, *args)
    assert after < 0.5 * before


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 8), st.integers(0, 10**6))
def test_the_linear_solve(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((n, n))
    a, b = a @ a.T + np.eye(n), rng.standard_normal(n)
    x = b.copy()
    lower = np.tril(a)  # nothing else is read
    cholesky_solve(lower, x)
    np.testing.assert_allclose(a @ x, b, atol=1e-9)


def test_a_cup_held_against_a_fruit_presses_as_hard_as_the_stem_resists() -> None:
    """At rest: the contact's force is the beam's under a load at its tip."""
    s = hung(((0, 0, 0), (0.0, 0.0, 0.2)))
    points = np.vstack([along((0.06, 0, 0), (0.03, 0, 0)), np.tile(TARGET + [0.03, 0, 0], (60, 1))])
    positions, forces, _ = led(s, points)
    away = positions[-1, 0] - TARGET
    tip = np.linalg.inv(s.stiffness[0])[-1, -1]
    assert away[0] == pytest.approx(-0.01, abs=2e-4)  # 0.025 + 0.015 - 0.03
    assert abs(away[1]) < 1e-4
    assert forces[-1, 0] == pytest.approx(-away[0] / tip, rel=0.05)
    assert np.linalg.norm(positions[-1] - positions[-2]) < 1e-5


def test_a_fruit_pushed_aside_is_drawn_up_by_its_stem() -> None:
    """Nearly on the arc about the root, and above the chord: the stem keeps its length."""
    s = hung(((0, 0, 0), (0.0, 0.0, 0.15)))
    positions, _, _ = led(s, along((0.06, 0, 0), (0.0, 0, 0)))
    away = positions[-1, 0] - TARGET
    assert away[0] < -0.035
    assert away[2] > 0.0
    reach = np.linalg.norm(positions[-1, 0] - s.root[0])
    assert reach < s.length[0]
    assert reach > 0.97 * s.length[0]


def test_a_fruit_that_is_let_go_swings_back_to_rest() -> None:
    s = hung(((0, 0, 0), (0.0, 0.0, 0.15)))
    points = np.vstack(
        [along((0.06, 0, 0), (0.02, 0, 0), (0.1, 0, 0)), np.tile(TARGET + [0.1, 0, 0], (120, 1))]
    )
    positions, forces, _ = led(s, points)
    assert np.linalg.norm(positions[:, 0] - TARGET, axis=1).max() > 0.015
    assert np.linalg.norm(positions[-1, 0] - TARGET) < 1e-3
    assert forces[-1, 0] == 0.0


# --- what a cup does ---------------------------------------------------------------------------

BELOW = (0.0, 0.0, -0.08)  # where a neighbour hangs
LEANING = (0.03, 0.0, 0.2)


def test_well_beside_a_fruit_nothing_happens() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.07, 0, -0.08), LEANING))
    points = along((0, 0, -0.25), (0, 0, 0))
    positions, forces, stem_forces = led(s, points)
    np.testing.assert_array_equal(positions[:, 1], np.tile(positions[0, 1], (len(points), 1)))
    np.testing.assert_allclose(positions[0], TARGET + [[0, 0, 0], [0.07, 0, -0.08]], atol=1e-12)
    assert not forces.any()
    assert not stem_forces.any()
    h = foreseen(s, points)
    assert h == swinging.Harm(0.0, 0.0, 0.0, 0.0, False)


def test_straight_under_a_neighbour_the_cup_takes_it_in() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.003, 0, -0.08), (0.0, 0.0, 0.2)))
    h = foreseen(s, along((0, 0, -0.25), (0, 0, -0.065)))
    assert h.inside > 0.1
    assert h.missed  # the cup ends before the target


def test_past_it_the_floor_carries_it_up_or_presses_it() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.003, 0, -0.08), (0.0, 0.0, 0.2)))
    h = foreseen(s, along((0, 0, -0.25), (0, 0, 0)))
    assert h.inside > 0.1 or h.fruit > 5.0


@pytest.mark.parametrize("turn", np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False))
def test_beside_it_the_cup_pushes_it_away(turn: float) -> None:
    """Led past on the side away from the stem: the fruit swings aside and stays out."""
    c, si = np.cos(turn), np.sin(turn)
    way = np.array([c, si, 0.0])
    s = hung(((0, 0, 0), (0, 0, 0.1)), (BELOW, tuple(0.05 * way + [0, 0, 0.2])))
    aside = -0.03 * way
    points = along(
        (0, 0, -0.25), (*aside[:2], -0.13), (*aside[:2], -0.06), (0, 0, -0.025), (0, 0, 0)
    )
    positions, forces, _ = led(s, points)
    swung = (positions[:, 1] - positions[0, 1]) @ way
    assert swung.max() > 0.008
    assert forces[:, 1].max() > 0.0
    h = foreseen(s, points)
    assert h.inside == 0.0
    assert not h.missed
    # nothing ends in the wall: as deep as the force needs, and no more
    assert gaps(positions, points)[-1].min() > -1e-3
    assert gaps(positions, points).min() > -0.008


@pytest.mark.parametrize("seed", range(12))
def test_nothing_ends_inside_the_cups_wall(seed: int) -> None:
    nothing_in_the_wall(seed)


def nothing_in_the_wall(seed: int) -> np.ndarray:
    """Whatever hangs there and however the cup comes, upright; (4,) what hangs still at the end."""
    rng = np.random.default_rng(seed)
    count = 3
    places = np.column_stack(
        [rng.uniform(-0.03, 0.03, (count, 2)), -0.05 - 0.04 * np.arange(count)]
    )
    roots = np.column_stack([rng.uniform(-0.06, 0.06, (count, 2)), rng.uniform(0.1, 0.3, count)])
    s = hung(((0, 0, 0), (0, 0, 0.1)), *zip(places, roots, strict=True))
    aside = rng.uniform(-0.03, 0.03, 2)
    points = along((0, 0, -0.3), (*aside, -0.12), (*aside, -0.05), (0, 0, 0))
    points = np.vstack([points, np.tile(points[-1:], (40, 1))])
    positions, forces, stem_forces = led(s, points)
    assert np.isfinite(positions).all()
    assert (forces >= 0.0).all()
    assert (stem_forces >= 0.0).all()
    # to second order in its deflection a stem does not stretch
    off = positions - s.root
    far = np.linalg.norm(off, axis=2) / s.length
    aside = off - np.einsum("pni,ni->pn", off, s.axes[:, 2])[..., None] * s.axes[:, 2]
    bent_little = np.linalg.norm(aside, axis=2) < 0.25 * s.length
    assert far[bent_little].max() < 1.01
    # a wall yields by what presses it, F = k · depth, once the fruit hangs still
    still = np.linalg.norm(np.diff(positions[-6:], axis=0), axis=2).max(axis=0) < 5e-5
    depth = -gaps(positions, points)[-1]
    assert (depth <= forces[-1] / CONTACT + 5e-5)[still].all()
    return still


def test_most_fruits_come_to_rest() -> None:
    """Not all: what is jammed between cup and stems trembles by millimetres in the model."""
    assert np.mean([nothing_in_the_wall(seed) for seed in range(12)]) > 0.5


def test_a_pushed_fruit_pushes_its_neighbour() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.15)), ((-0.035, 0, 0), (0, 0, 0.15)))
    positions, forces, _ = led(s, along((0.06, 0, 0), (0.01, 0, 0)))
    assert positions[-1, 1, 0] < positions[0, 1, 0] - 0.01
    assert np.linalg.norm(positions[-1, 0] - positions[-1, 1]) > 0.029
    assert forces[-1, 1] > 0.0


def test_a_stem_is_pressed_where_the_rim_meets_it() -> None:
    """The cup, on a neck too thin to reach the fruit below it, moves at its stem."""
    s = hung(((0, 0, 0.2), (0, 0, 0.05)), ((0, 0, -0.1), (0, 0, 0.2)))
    points = along((0.06, 0, -0.03), (0.02, 0, -0.03))
    points = np.vstack([points, np.tile(points[-1:], (30, 1))])
    positions, forces, stem_forces = led(s, points, cup=CUP._replace(neck=0.003))
    assert stem_forces[-1, 1] > 0.01
    assert forces[-1, 1] == 0.0
    assert positions[-1, 1, 0] < positions[0, 1, 0]
    assert foreseen(s, points).stem > 1e-3


def test_the_target_is_inside_at_the_end_or_missed() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)))
    assert not foreseen(s, along((0, 0, -0.2), (0, 0, 0))).missed
    assert foreseen(s, along((0, 0, -0.2), (0, 0, -0.03))).missed
    assert foreseen(s, along((0.05, 0, -0.2), (0.05, 0, 0))).missed


def test_a_short_blow_is_no_lasting_force() -> None:
    """Of stems and the target the force counts that lasts; of the others the largest."""
    steps = 60
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.1, 0, 0), (0, 0, 0.1)))
    far, near = TARGET + [0.0, 0.3, 0.0], TARGET + [0.034, 0.0, 0.0]
    points = np.tile(far, (steps, 1))
    points[4] = near  # one step only
    _, forces, _ = led(s, points)
    assert (forces[:, 0] > 0.0).sum() < swinging.HELD
    assert foreseen(s, points).target == 0.0
    points[4:] = near
    assert foreseen(s, points).target > 0.0


@settings(max_examples=25, deadline=None)
@given(st.floats(-np.pi, np.pi), st.integers(0, 1000))
@example(np.pi / 2, 0)
def test_it_is_the_same_from_every_side(turn: float, seed: int) -> None:
    """Turned about the vertical, fruits, stems and path: what happens turns with them."""
    rng = np.random.default_rng(seed)
    c, si = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -si, 0.0], [si, c, 0.0], [0.0, 0.0, 1.0]])
    roots = np.column_stack([rng.uniform(-0.06, 0.06, (2, 2)), rng.uniform(0.15, 0.25, 2)])
    places = np.array([[0.0, 0.0, 0.0], [*rng.uniform(-0.015, 0.015, 2), -0.08]])
    corners = np.array([[0, 0, -0.25], [0.03, 0.01, -0.13], [0.03, 0.01, -0.06], [0, 0, 0]])
    plain = led(hung(*zip(places, roots, strict=True)), along(*corners))
    places, roots = places @ rotation.T, roots @ rotation.T
    turned = led(hung(*zip(places, roots, strict=True)), along(*(corners @ rotation.T)))
    back = (turned[0] - TARGET) @ rotation
    error = np.linalg.norm(back - (plain[0] - TARGET), axis=2).max(axis=1)
    # rounding grows where a fruit may slip off either way: not before the cup has come half way
    assert error[: len(error) // 2].max() < 1e-7
    assert np.median(error) < 1e-4


def test_the_same_push_twice_is_the_same_to_the_bit() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.01, 0, -0.05), LEANING), ((-0.01, 0, -0.1), LEANING))
    points = along((0, 0, -0.25), (-0.03, 0, -0.13), (-0.03, 0, -0.06), (0, 0, 0))
    for first, second in zip(led(s, points), led(s, points), strict=True):
        np.testing.assert_array_equal(first, second)
    assert foreseen(s, points) == foreseen(s, points)


def test_neither_stems_nor_path_are_written_to() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), (BELOW, LEANING))
    points = along((0, 0, -0.25), (0, 0, 0))
    kept = [np.array(values) for values in s], points.copy()
    led(s, points)
    for before, after in zip(kept[0], s, strict=True):
        np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(kept[1], points)


def test_a_fruit_is_pressed_against_what_stands_firm() -> None:
    """Between a cup and a wall beside it a fruit is crushed; without the wall it swings away."""
    stems = hung(((0, 0, 0), (0, 0, 0.2)), ((0.03, 0, -0.05), (0, 0, 0.2)))
    points = along((0.0, 0, -0.12), (0.0, 0, -0.04), (0.02, 0, -0.04))
    axes = np.tile(UP, (len(points), 1))
    middle = TARGET + np.array([0.05 + 0.02, 0.0, -0.05])
    wall = pack([(Box((0.04, 0.2, 0.2)), middle, np.eye(3))])
    free = harm(stems, points, axes, DT, CUP, NOTHING)
    jammed = harm(stems, points, axes, DT, CUP, wall)
    assert free.fruit < 20.0
    assert jammed.fruit > 2.0 * free.fruit


def test_a_fruit_between_cup_and_wall_shares_what_is_left() -> None:
    """It cannot swing through a wall, and is squeezed between it and the cup."""
    s = hung(((0, 0, 0), (0, 0, 0.2)))
    points = np.vstack([along((0.06, 0, 0), (0.03, 0, 0)), np.tile(TARGET + [0.03, 0, 0], (40, 1))])
    wall = pack([(Box((0.01, 0.2, 0.2)), TARGET + [-0.023, 0.0, 0.0], np.eye(3))])
    axes, shape = np.tile(UP, (len(points), 1)), (len(points), 1)
    positions, forces = np.zeros((*shape, 3)), np.zeros(shape)
    push(s, points, axes, DT, CUP, wall, positions, forces, np.zeros(shape))
    free, loose, _ = led(s, points)
    assert free[-1, 0, 0] < TARGET[0] - 0.009
    # 3 mm of room: what is left of 10 mm is shared by the two contacts
    assert positions[-1, 0, 0] == pytest.approx(TARGET[0] - 0.0065, abs=5e-4)
    assert forces[-1, 0] == pytest.approx(0.0035 * CONTACT, rel=0.1)
    assert forces[-1, 0] > 10.0 * loose[-1, 0]
