"""What a cup does to fruits on stems: forces, motion, and what becomes of the fruits."""

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.pushing.fruits import CUP, DT, NOTHING, TARGET, UP, along, hung, led

from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import Box
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import swinging
from optipromp.core.pushing.stems.bending import Stems
from optipromp.core.pushing.stems.cup import cup_distance
from optipromp.core.pushing.stems.swinging import Harm


def predicted(stems: Stems, points: np.ndarray) -> Harm:
    return swinging.led(stems, points, np.tile(UP, (len(points), 1)), DT, CUP, NOTHING).harm


def gaps(positions: np.ndarray, points: np.ndarray, radius: float = 0.015) -> np.ndarray:
    """Distance (P, N) of the fruits' surfaces to the cup."""
    off = positions - points[:, None]
    rho, h = np.linalg.norm(off[..., :2], axis=2), off[..., 2]
    flat = [cup_distance(r, z, CUP)[0] for r, z in zip(rho.ravel(), h.ravel(), strict=True)]
    return np.array(flat).reshape(rho.shape) - radius


# --- forces and motion -------------------------------------------------------------------------


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
    h = predicted(s, points)
    assert h == Harm(0.0, 0.0, 0.0, 0.0, 0.0, False)


def test_straight_under_a_neighbour_the_cup_takes_it_in() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.003, 0, -0.08), (0.0, 0.0, 0.2)))
    h = predicted(s, along((0, 0, -0.25), (0, 0, -0.065)))
    assert h.inside > 0.1
    assert h.missed  # the cup ends before the target


@pytest.mark.parametrize("aside", [0.022, 0.025, 0.028])
def test_a_cone_slides_off_a_fruit_on_which_a_flat_floor_lies(aside: float) -> None:
    """On the way out a cup comes down on a fruit that hangs beside its neck."""
    s, points = hung(((0, 0, 0), (0.0, 0.0, 0.15))), along((aside, 0, 0.06), (aside, 0, -0.03))
    flat, cone = (led(s, points, cup=CUP._replace(cone=high))[1].max() for high in (0.0, 0.015))
    assert flat > 2.0
    assert cone < 0.4 * flat


def test_past_it_the_floor_carries_it_up_or_presses_it() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.003, 0, -0.08), (0.0, 0.0, 0.2)))
    h = predicted(s, along((0, 0, -0.25), (0, 0, 0)))
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
    h = predicted(s, points)
    assert h.inside == 0.0
    assert not h.missed
    # nothing ends in the wall: as deep as the force needs, and no more
    assert gaps(positions, points)[-1].min() > -1e-3
    assert gaps(positions, points).min() > -0.008


@pytest.mark.parametrize("seed", range(12))
def test_nothing_ends_inside_the_cups_wall(seed: int) -> None:
    nothing_in_the_wall(seed)


@cache
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
    assert (depth <= forces[-1] / PUSH.swing.stiffness + 5e-5)[still].all()
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


def test_a_stem_that_the_wall_meets_near_its_middle_does_not_slide_round_it() -> None:
    """Within the angle of friction; without friction the fruit would be 17 mm farther aside."""
    s = hung(((0, 0.003, -0.12), (0.0, 0.0, 0.25)))
    positions, _, forces = led(s, along((0.05, 0, 0), (-0.01, 0, 0)))
    moved = positions[-1, 0] - positions[0, 0]
    assert forces.max() > 0.1
    assert moved[0] < -0.03
    assert abs(moved[1]) < 0.001


def test_a_stem_that_the_wall_meets_near_its_side_slides_round_it() -> None:
    """Beyond the angle of friction."""
    s = hung(((0, 0.012, -0.12), (0.0, 0.0, 0.25)))
    positions, _, _ = led(s, along((0.05, 0, 0), (-0.01, 0, 0)))
    assert positions[-1, 0, 1] - positions[0, 0, 1] > 0.005


def test_a_stem_is_pressed_where_the_rim_meets_it() -> None:
    """The cup, on a neck too thin to reach the fruit below it, moves at its stem."""
    s = hung(((0, 0, 0.2), (0, 0, 0.05)), ((0, 0, -0.1), (0, 0, 0.2)))
    points = along((0.06, 0, -0.03), (0.02, 0, -0.03))
    points = np.vstack([points, np.tile(points[-1:], (30, 1))])
    positions, forces, stem_forces = led(s, points, cup=CUP._replace(neck=0.003))
    assert stem_forces[-1, 1] > 0.01
    assert forces[-1, 1] == 0.0
    assert positions[-1, 1, 0] < positions[0, 1, 0]
    assert predicted(s, points).stem > 1e-3


def test_the_target_is_inside_at_the_end_or_missed() -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)))
    assert not predicted(s, along((0, 0, -0.2), (0, 0, 0))).missed
    assert predicted(s, along((0, 0, -0.2), (0, 0, -0.03))).missed
    assert predicted(s, along((0.05, 0, -0.2), (0.05, 0, 0))).missed


def test_a_short_blow_is_no_lasting_force() -> None:
    """Of stems and the target the force counts that lasts; of the others the largest."""
    steps = 60
    s = hung(((0, 0, 0), (0, 0, 0.1)), ((0.1, 0, 0), (0, 0, 0.1)))
    far, near = TARGET + [0.0, 0.3, 0.0], TARGET + [0.034, 0.0, 0.0]
    points = np.tile(far, (steps, 1))
    points[4] = near  # one step only
    _, forces, _ = led(s, points)
    assert (forces[:, 0] > 0.0).sum() * DT < PUSH.harm.lasting
    assert predicted(s, points).target == 0.0
    points[4:] = near
    assert predicted(s, points).target > 0.0


@pytest.mark.parametrize(("dt", "short", "long"), [(0.04, 4, 5), (0.08, 2, 3)])
def test_a_force_lasts_in_time_however_long_the_steps_are(dt: float, short: int, long: int) -> None:
    s = hung(((0, 0, 0), (0, 0, 0.1)))
    for steps, lasts in ((short, False), (long, True)):
        points = np.tile(TARGET + [0.0, 0.3, 0.0], (30, 1))
        points[4 : 4 + steps] = TARGET + [0.034, 0.0, 0.0]
        found = swinging.led(s, points, np.tile(UP, (30, 1)), dt, CUP, NOTHING).harm
        assert (found.target > 0.0) == lasts


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
    free = swinging.led(stems, points, axes, DT, CUP, NOTHING).harm
    jammed = swinging.led(stems, points, axes, DT, CUP, wall).harm
    assert free.fruit < 20.0
    assert jammed.fruit > 2.0 * free.fruit
    assert free.pinched == 0.0
    assert jammed.pinched > 0.1


def test_a_fruit_between_cup_and_wall_shares_what_is_left() -> None:
    """It cannot swing through a wall, and is squeezed between it and the cup."""
    s = hung(((0, 0, 0), (0, 0, 0.2)))
    points = np.vstack([along((0.06, 0, 0), (0.03, 0, 0)), np.tile(TARGET + [0.03, 0, 0], (40, 1))])
    wall = pack([(Box((0.01, 0.2, 0.2)), TARGET + [-0.023, 0.0, 0.0], np.eye(3))])
    positions, forces, _ = led(s, points, solid=wall)
    free, loose, _ = led(s, points)
    assert free[-1, 0, 0] < TARGET[0] - 0.009
    # 3 mm of room: what is left of 10 mm is shared by the two contacts
    assert positions[-1, 0, 0] == pytest.approx(TARGET[0] - 0.0065, abs=5e-4)
    assert forces[-1, 0] == pytest.approx(0.0035 * PUSH.swing.stiffness, rel=0.1)
    assert forces[-1, 0] > 10.0 * loose[-1, 0]


# --- roots that drift --------------------------------------------------------------------------


def drifting(s: Stems, by: np.ndarray) -> Stems:
    """The stems whose roots all drift by (P, 3) [m]."""
    return s._replace(drift=np.tile(by, (len(s.root), 1, 1)))


@settings(max_examples=8, deadline=None)
@given(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))
def test_a_root_that_drifts_and_a_cup_that_comes_are_alike(x: float, y: float) -> None:
    """What counts is their motion relative to each other; friction alone knows a difference."""
    s = hung(((0, 0, 0), (0.0, 0.0, 0.2)))
    points = along((0.06, 0, 0), (0.03, 0, 0))
    by = np.linspace(0.0, 1.0, len(points))[:, None] * [x, y, 0.0]
    positions, forces, _ = led(drifting(s, by), points)
    other, pressed, _ = led(s, points - by)
    np.testing.assert_allclose(positions - by[:, None], other, atol=1e-3)
    assert abs(forces.max() - pressed.max()) <= 0.1 * pressed.max() + 0.02


def test_a_fruit_is_led_by_its_root_into_one_that_hangs_still() -> None:
    s = hung(((0, 0, 0), (0.0, 0.0, 0.2)), ((0.06, 0, 0), (0.06, 0.0, 0.2)))
    points = np.tile(TARGET - [0.0, 0.0, 0.3], (80, 1))  # the cup is far below
    by = np.zeros((2, 80, 3))
    by[0, :, 0] = np.linspace(0.0, 0.05, 80)
    positions, forces, _ = led(s._replace(drift=by), points)
    between = np.linalg.norm(positions[:, 1] - positions[:, 0], axis=1)
    assert between.min() > 0.028  # two radii of 15 mm, pressed a little
    assert positions[-1, 1, 0] - positions[0, 1, 0] > 0.002
    assert positions[-1, 0, 0] - positions[0, 0, 0] < 0.035  # it hangs back from its root
    assert forces[-1].min() > 0.0


def test_a_stem_on_the_cup_slips_by_its_own_drift_alone() -> None:
    """A contact's partner is a piece of the stem here, and no fruit that drifts, too."""
    s = hung(((0, 0, 0), (0.0, 0.0, 0.2)))
    points = along((0.06, 0, 0.05), (0.01, 0, 0.05))
    held = np.full((64, len(points), 3), np.nan)  # what lies behind the drift of the one fruit
    held[0] = np.linspace(0.0, 0.02, len(points))[:, None] * [0.0, 1.0, 0.0]
    found, wanted = (led(s._replace(drift=by), points) for by in (held[:1], held[:1].copy()))
    for one, other in zip(found, wanted, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)
    assert wanted[2].max() > 0.1  # the cup presses the stem


def test_no_drift_and_a_drift_of_zero_are_the_same_push() -> None:
    s = hung(((0, 0, 0), (0.0, 0.0, 0.2)), ((0.04, 0, 0), (0.06, 0.0, 0.2)))
    points = along((0.06, 0.01, 0), (0.0, 0, 0))
    for mine, plain in zip(led(drifting(s, np.zeros((len(points), 3))), points), led(s, points),
                           strict=True):  # fmt: skip
        np.testing.assert_array_equal(mine, plain)
