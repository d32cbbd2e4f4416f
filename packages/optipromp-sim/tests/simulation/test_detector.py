"""A camera and its detector without images: errors as stated, late, seeded."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, poisson
from tests.simulation.eyes import (
    CAMERA,
    HOME,
    ROBOT,
    UNLIKELY,
    WHITE,
    between,
    by_id,
    fruit,
    ids,
    looks,
    seen_by,
    truth,
)

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Cylinder
from optipromp.core.scenes.scene import SceneObject
from optipromp_sim.simulation.detector import DETECTORS, Detector, DetectorParameters, Eye

ONE = seen_by(fruit("ripe", [0.05, -0.03, 0.6], "target"))
TWO = seen_by(fruit("ripe", [0.0, 0.0, 0.45], "target"), fruit("n1", [0.1, 0.0, 0.45]))


@pytest.mark.parametrize(
    "more", [{}, {"steady": 1.0}, {"camera_offset": 0.004, "camera_turn": 0.8}]
)
def test_the_stated_covariance_is_that_of_the_errors(more):
    parameters, count, total = replace(WHITE, **more), 300, 0.0
    for seed in range(count):
        look = looks(ONE, parameters, seed)[0]
        item = by_id(look)["ripe"]
        error = item.position - ONE.target.position
        total += error @ np.linalg.solve(item.covariance, error)
    low, high = chi2.ppf([UNLIKELY / 2, 1 - UNLIKELY / 2], 3 * count)
    # the stated covariance of a turn depends on the place as seen: 2 % off at most
    assert 0.98 * low < total < 1.02 * high


def test_an_offset_that_is_not_told_is_in_no_covariance():
    item = looks(ONE, replace(WHITE, camera_offset=0.01, told=False))[0].detections[0]
    sigma = WHITE.sigma(float(np.linalg.norm(CAMERA.inverse() @ ONE.target.position)))
    assert item.covariance == pytest.approx(sigma**2 * np.eye(3))


def test_a_part_of_the_error_stays():
    errors = []
    for seed in range(400):
        pair = looks(ONE, WHITE, seed, 2)
        errors.append([by_id(look)["ripe"].position - ONE.target.position for look in pair])
    first, second = np.array(errors).transpose(1, 0, 2).reshape(2, -1)
    # 1200 pairs: the correlation has a standard deviation of 0.026
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(WHITE.steady, abs=4 * 0.026)


def test_errors_grow_with_the_square_of_the_distance():
    place = np.array([0.0, 0.0, 1.0])
    for far, sigma, bias in ((0.45, 0.005, 0.01), (0.9, 0.02, 0.04), (0.09, 0.001, 0.0004)):
        scene = seen_by(fruit("ripe", far * place, "target"))
        item = looks(scene, replace(WHITE, bias=0.01))[0].detections[0]
        assert np.sqrt(np.diag(item.covariance)) == pytest.approx(sigma)
        exact = looks(scene, DetectorParameters(mount="beside", bias=0.01))[0].detections[0]
        assert exact.position == pytest.approx((far + bias) * place)
        assert not exact.covariance.any()


def test_lower_is_down_in_the_world():
    seen = by_id(looks(ONE, DetectorParameters(mount="beside", lower=0.01))[0])["ripe"]
    assert seen.position - ONE.target.position == pytest.approx([0.0, 0.0, -0.01])


@pytest.mark.parametrize(("far", "angle"), [(0.45, 5.0), (0.6, 5.0 * (0.6 / 0.45) ** 2)])
def test_stems_tilt_by_the_angle_about_both_axes(far, angle):
    tilts, scene = [], seen_by(fruit("ripe", [0.0, 0.0, far], "target"))
    for seed in range(200):
        seen = by_id(looks(scene, WHITE, seed)[0])["ripe"]
        assert seen.stem.length == pytest.approx(0.15)
        assert seen.stem.points[0] == pytest.approx(seen.position)
        way = seen.stem.vector / 0.15
        tilt = np.degrees(np.arccos(way[2]))
        tilts.append(tilt * way[:2] / np.hypot(*way[:2]))
    rms = np.sqrt((np.array(tilts) ** 2).mean(axis=0))
    assert rms == pytest.approx([angle, angle], rel=4 / np.sqrt(2 * 200))


def test_the_lower_part_of_a_bent_stem_tells_its_direction():
    at = ONE.target.position
    bent = np.array([at + [0.15, 0.0, 0.05], at + [0.0, 0.0, 0.05], at])  # root first
    fruits = truth(ONE)._replace(stem_ends=(bent,))
    look = Detector(ONE, ROBOT, DetectorParameters(mount="beside")).expose(0.0, HOME, fruits)
    assert by_id(look)["ripe"].stem.vector == pytest.approx([0.0, 0.0, 0.15])


def test_a_stem_that_has_let_go_is_not_seen():
    fruits = truth(ONE)._replace(positions=ONE.target.position[None] - [0.0, 0.0, 0.3])
    look = Detector(ONE, ROBOT, DetectorParameters(mount="beside")).expose(0.0, HOME, fruits)
    assert look.detections[0].stem is None


def test_what_stands_keeps_its_height():
    at = CAMERA @ np.array([0.0, 0.0, 0.5])
    scene = seen_by(SceneObject("ripe", "target", Cylinder(0.02, 0.06), at))
    seen = looks(scene, replace(WHITE, lower=0.01))[0].in_base()[0]
    assert seen.position[2] == pytest.approx(at[2])
    assert seen.covariance[2] == pytest.approx(np.zeros(3))
    assert seen.position[0] != pytest.approx(at[0])


def test_rate_and_latency():
    eye = Eye(Detector(ONE, ROBOT, replace(WHITE, rate=20.0, latency=0.06)))
    got = []
    for tick in range(1000):  # 1 s at 1 kHz
        now = 5.0 + tick / 1000
        eye.see(now, HOME, truth(ONE))
        got += [(now, look.time) for look in eye.delivered(now)]
    assert len(got) == 19  # the 20th, of 5.95 s, is late
    times = np.array(got)
    assert times[:, 1] == pytest.approx(5.0 + 0.05 * np.arange(19))
    assert times[:, 0] - times[:, 1] == pytest.approx(0.06)


def test_a_slow_caller_gets_one_look_a_call():
    eye = Eye(Detector(ONE, ROBOT, WHITE))
    assert [eye.see(t, HOME, truth(ONE)) for t in (0.0, 0.02, 0.3, 0.31, 0.35)] == [
        True, False, True, False, True,
    ]  # fmt: skip
    assert [look.time for look in eye.delivered(1.0)] == [0.0, 0.3, 0.35]
    assert eye.delivered(1.0) == ()


def missed(parameters, count, pause):
    """Whether (count, 2) each fruit was missed in a picture."""
    got = looks(TWO, parameters, 4, count, pause)
    return ~np.array([[name in ids(look) for name in ("ripe", "n1")] for look in got])


def test_misses_have_their_share():
    parameters, count = replace(WHITE, missed=0.2, hidden=0.2), 600
    low, high = between(2 * count, 0.2)
    assert low <= missed(parameters, count, 0.5).sum() <= high  # a slot each
    low, high = between(count, 0.2)
    often = missed(replace(parameters, missed_steadily=0.0), count // 2, 0.05)
    assert low <= often.sum() <= high


def test_some_misses_stay():
    parameters = replace(WHITE, missed=0.2, hidden=0.2)
    # 9 of 10 pictures share their slot with the one before: 0.9 (s + (1 - s) 0.2) + 0.1·0.2
    for steadily, wanted, error in ((0.0, 0.2, 0.1), (0.5, 0.56, 0.2), (1.0, 0.92, 0.05)):
        gone = missed(replace(parameters, missed_steadily=steadily), 600, 0.05)
        stayed = (gone[1:] & gone[:-1]).sum() / gone[:-1].sum()
        assert stayed == pytest.approx(wanted, abs=error)


def test_stems_are_hidden_for_a_while():
    parameters = replace(WHITE, stem_seen=0.65)

    def shown(count, pause):
        got = looks(TWO, parameters, 2, count, pause)
        return np.array([[item.stem is not None for item in look.detections] for look in got])

    low, high = between(2 * 400, 0.65)
    assert low <= shown(400, 0.5).sum() <= high  # a slot each
    often = shown(400, 0.05)
    changes = (often[1:] != often[:-1]).sum()
    low, high = between(2 * 40, 2 * 0.65 * 0.35)  # where the next slot differs
    assert low <= changes <= high


def test_false_fruits():
    got = looks(TWO, replace(WHITE, false=0.5), 5, 300)
    false = [item for look in got for item in look.detections if item.id not in ("ripe", "n1")]
    low, high = poisson.ppf([UNLIKELY / 2, 1 - UNLIKELY / 2], 150)
    assert low <= len(false) <= high
    assert len({item.id for item in false}) == len(false)
    for item in false:
        assert item.role == "pushable"
        assert item.covariance[0, 0] > 0.0
        x, y, z = item.position
        assert np.arctan2(np.hypot(x, y), z) <= 0.5 * WHITE.view + 0.1  # error of the place
        assert item.shape in {each.shape for each in TWO.objects}
    # others are seen as without false ones
    plain = looks(TWO, WHITE, 5, 3)
    for one, other in zip(plain, got, strict=False):
        assert (by_id(one)["ripe"].position == by_id(other)["ripe"].position).all()


def test_nothing_hangs_where_things_stand():
    at = CAMERA @ np.array([0.0, 0.0, 0.5])
    scene = seen_by(SceneObject("ripe", "target", Cylinder(0.02, 0.06), at))
    look = looks(scene, replace(WHITE, false=3.0))[0]
    assert len(look.detections) > 1
    assert all(item.stem is None for item in look.detections)


def test_ids_are_exchanged():
    third = fruit("n2", [-0.3, 0.0, 0.45])
    scene = replace(TWO, objects=(*TWO.objects, third))
    got = looks(scene, replace(WHITE, swapped=0.3, position=0.0), 1, 300)
    places = {item.id: item.position for item in scene.objects}
    wrong = [
        {i for i, item in by_id(look).items() if np.linalg.norm(item.position - places[i]) > 0.01}
        for look in got
    ]
    low, high = between(300, 0.3)
    assert low <= sum(bool(w) for w in wrong) <= high
    assert {len(w) for w in wrong} == {0, 2}
    assert all(ids(look) == {"ripe", "n1", "n2"} for look in got)


def test_a_seed_gives_the_same_looks_and_another_others():
    p = replace(
        DETECTORS["detector"], mount="beside", leaf=0.5, false=0.5, camera_offset=0.003,
        camera_turn=0.5,
    )  # fmt: skip
    first, again, other = (
        [pickle.dumps(look) for look in looks(TWO, p, seed, 20)] for seed in (7, 7, 8)
    )
    assert first == again
    assert not set(first) & set(other)


def test_errors_of_a_fruit_do_not_depend_on_what_is_seen_of_others():
    p = replace(WHITE, hidden=0.5, missed=0.1, stem_seen=0.6)
    here, away = truth(TWO), truth(TWO)
    away.positions[1] = CAMERA @ np.array([0.0, 0.0, -1.0])  # out of view
    one, other = Detector(TWO, ROBOT, p, 3), Detector(TWO, ROBOT, p, 3)
    for k in range(40):
        a = by_id(one.expose(0.05 * k, HOME, here))
        b = by_id(other.expose(0.05 * k, HOME, away))
        assert "n1" not in b
        assert ("ripe" in a) == ("ripe" in b)
        if "ripe" in a:
            assert (a["ripe"].position == b["ripe"].position).all()
            assert (a["ripe"].stem is None) == (b["ripe"].stem is None)


def test_miscalibration_moves_with_the_camera():
    p = DetectorParameters(mount="hand", camera_offset=0.01, camera_turn=1.0)
    detector = Detector(TWO, ROBOT, p, 5)
    errors = []
    for turn in (0.0, 0.7):
        q = HOME.copy()
        q[0] += turn
        look = detector.expose(turn, q, truth(TWO))
        errors.append(detector.camera(q).inverse() @ look.camera)
    assert np.linalg.norm(errors[0].position) > 1e-3
    assert errors[0].position == pytest.approx(errors[1].position, abs=1e-12)
    assert errors[0].rotation == pytest.approx(errors[1].rotation, abs=1e-12)


@pytest.mark.parametrize(
    "more",
    [
        {"mount": "ceiling"}, {"rate": 0.0}, {"missed": 1.5}, {"steady": -0.1}, {"view": 3.5},
        {"bias": np.nan}, {"latency": np.inf},
    ],
)  # fmt: skip
def test_impossible_detectors_are_refused(more):
    with pytest.raises(InvalidRequestError, match=next(iter(more))):
        DetectorParameters(**more)
    assert DetectorParameters(bias=-0.01).bias == -0.01


def test_unknown_fruits_are_refused():
    fruits = truth(TWO)
    detector = Detector(TWO, ROBOT, WHITE)
    with pytest.raises(InvalidRequestError, match="'pear' is no fruit"):
        detector.expose(0.0, HOME, fruits._replace(ids=("ripe", "pear")))
    with pytest.raises(InvalidRequestError, match="repeat"):
        detector.expose(0.0, HOME, fruits._replace(ids=("ripe", "ripe")))
