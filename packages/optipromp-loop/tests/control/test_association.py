"""Pairs of detections and tracks, and which fruits a look should have seen."""

from itertools import permutations

import numpy as np
import pytest
from tests.control.plants import UP, camera, detection, hanging

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import Box
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp_loop.control.belief import common_shift, pairing, target_of, visible
from optipromp_loop.control.motion import Oscillators, PlantState, bare_plant
from optipromp_loop.control.tracks import Frame, Seen, Track, TrackerParameters, new_track

NONE = np.zeros((0, 4)), None
GIVEN = TrackerParameters()
UNSEEN = np.zeros(9, dtype=bool)  # no track, as from another side
PLANT = bare_plant(UP, GIVEN.frequencies, GIVEN.damping, GIVEN.sway)


def of(places: FloatArray) -> tuple[PlantState, tuple[Track, ...]]:
    """Tracks at ``places``; the first is the target."""
    count, same = len(places), np.ones(2 * len(places))
    spread = np.tile(25e-6 * np.eye(3), (count, 1, 1))
    swings = Oscillators(8.0 * same, 0.15 * same, 0.002 * same)
    state = PLANT.with_fruits(swings, places, spread)
    look = look_at(places)
    frame = Frame(UP, PLANT.layout.axes)
    tracks = [new_track(f"t{k}", d, None, frame) for k, d in enumerate(look.detections)]
    return state, tuple(tracks)


def look_at(places: FloatArray, target: int = 0) -> Look:
    pose = camera()
    roles = ["target" if k == target else "pushable" for k in range(len(places))]
    items = [
        detection(f"d{k}", at, pose, role, sigma=0.005)
        for k, (at, role) in enumerate(zip(places, roles, strict=True))
    ]
    return Look(0.0, pose, tuple(items))


def pairs(places: FloatArray, found: FloatArray, target: int = 0) -> dict[int, int]:
    """Track to detection, in the order of ``found``."""
    state, tracks = of(places)
    seen = Seen.of(look_at(found, target))
    noise = np.broadcast_to(seen.covariances, (len(tracks), len(found), 3, 3))
    result = pairing(state, places, noise, tracks, seen, GIVEN, UNSEEN[: len(tracks)])
    rows = [int(seen.items[k].id[1:]) for k in result.detections]
    return dict(zip(result.tracks.tolist(), rows, strict=True))


@pytest.mark.parametrize("seed", range(8))
def test_pairs_have_the_least_total_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([0.5, 0.0, 0.5]) + 0.02 * rng.standard_normal((4, 3))
    found = (places + 0.006 * rng.standard_normal((4, 3)))[order := rng.permutation(4)]
    got = pairs(places, found, int(np.flatnonzero(order == 0)[0]))
    assert len(got) == 4

    def total(which: tuple[int, ...]) -> float:
        # all covariances are equal here, so that the distance of a pair is that of its spread
        state, _ = of(places)
        looked = state.layout.position[:3]
        joint = looked @ state.covariance @ looked.T + 25e-6 * np.eye(3)
        off = found[list(which)] - places
        wrong = sum((k == 0) != (order[d] == 0) for k, d in enumerate(which))
        return float((off * np.linalg.solve(joint, off.T).T).sum()) + GIVEN.conflict * wrong

    best = min(permutations(range(4)), key=total)
    assert total(tuple(got[k] for k in range(4))) == pytest.approx(total(best))


def test_a_role_decides_between_two_as_near() -> None:
    places = np.array([[0.5, 0.0, 0.5], [0.52, 0.0, 0.5]])
    middle = np.array([[0.51, 0.004, 0.5], [0.51, -0.004, 0.5]])
    assert pairs(places, middle, target=0) == {0: 0, 1: 1}
    assert pairs(places, middle, target=1) == {0: 1, 1: 0}


def test_a_far_detection_is_new_and_a_near_one_is_the_fruit_that_moved() -> None:
    places = np.array([[0.5, 0.0, 0.5]])
    assert pairs(places, places + [[0.1, 0.0, 0.0]]) == {}
    state, tracks = of(places)
    state = PlantState(state.layout, state.oscillators, state.mean, 1e-4 * state.covariance)
    seen = Seen.of(look_at(places + [[0.02, 0.0, 0.0]]))
    tight = np.full((1, 1, 1, 1), 1e-6) * np.eye(3)
    result = pairing(state, places, tight, tracks, seen, GIVEN, UNSEEN[: len(tracks)])
    assert result.jumped.tolist() == [True]
    assert not len(result.new)
    seen = Seen.of(look_at(places + [[0.03, 0.0, 0.0]]))  # above 0.6 of 36 mm
    result = pairing(state, places, tight, tracks, seen, GIVEN, UNSEEN[: len(tracks)])
    assert not len(result.tracks)
    assert result.new.tolist() == [0]


def test_the_target_is_the_track_with_most_votes() -> None:
    _, tracks = of(np.eye(3))
    votes = [(3, 0, 1), (5, 0, 9), (4, 0, 1)]
    given = tuple(
        Track(t.id, t.shape, t.orientation, {}, v, t.tilts, 0.0, 0, t.spread)
        for t, v in zip(tracks, votes, strict=True)
    )
    assert target_of(given).tolist() == [False, False, True]
    assert target_of(given[1:2]).tolist() == [False]
    assert target_of(()).tolist() == []


def test_a_common_displacement_is_found_whatever_is_missing() -> None:
    rng = np.random.default_rng(4)
    places, shift = hanging(7), np.array([0.02, -0.025, 0.004])
    seen = np.concatenate([places[2:] + shift, [[0.7, 0.2, 0.5]]])
    seen += 0.003 * rng.standard_normal(seen.shape)
    assert common_shift(places, seen, 0.005, GIVEN) == pytest.approx(shift, abs=0.005)
    order = rng.permutation(len(seen))
    assert common_shift(places, seen[order], 0.005, GIVEN) == pytest.approx(shift, abs=0.005)


def test_what_few_fruits_share_is_no_common_displacement() -> None:
    places = hanging(7)
    still = places + [[0.001, 0.0, 0.0]]
    assert not common_shift(places, still, 0.005, GIVEN).any()
    two = places.copy()
    two[:2] += [0.0, 0.03, 0.03]
    assert not common_shift(places, two, 0.005, GIVEN).any()
    assert not common_shift(places[:2], places[:2] + [[0.03, 0.0, 0.0]], 0.005, GIVEN).any()
    assert not common_shift(places, places + [[0.08, 0.0, 0.0]], 0.005, GIVEN).any()


BALL, BEHIND = np.array([[0.06, 0.0, 0.3, 0.01]]), np.array([[0.12, 0.0, 0.6, 0.03]])
BOARD = pack([(Box((0.05, 0.05, 0.01)), np.array([0.0, 0.0, 0.2]), np.eye(3))])
EDGE = 0.5 * np.tan(0.5)  # [m] of a cone of 1 rad


@pytest.mark.parametrize(
    ("places", "hiding", "wanted"),
    [
        ([[0, 0, 0.5], [EDGE - 0.01, 0, 0.5], [EDGE + 0.01, 0, 0.5]], NONE, [True, True, False]),
        ([[0, 0, 0.79], [0.3, 0, 0.81], [0, 0, -0.5]], NONE, [True, False, False]),  # far, behind
        ([[0, 0, 0.3], [0.02, 0, 0.5], [0.05, 0, 0.5]], NONE, [True, False, True]),  # by another
        ([[0, 0, 0.5], [0.1, 0, 0.5]], (BALL, None), [True, False]),  # of the tool
        ([[0, 0, 0.5], [0.1, 0, 0.5]], (BEHIND, None), [True, True]),
        ([[0, 0, 0.5], [0.1, 0, 0.5]], (NONE[0], BOARD), [False, True]),  # static
    ],
)
def test_a_fruit_outside_the_cone_or_far_or_hidden_is_not_missed(places, hiding, wanted):
    look, radii = Look(0.0, Pose(), (), 1.0), np.full(len(places), 0.02)
    assert visible(look, np.array(places, dtype=float), radii, 0.8, hiding).tolist() == wanted
