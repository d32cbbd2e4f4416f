"""Cameras as cameras are: limits, pictures that stand still, stamps that err, a target that falls.

Picks in the physics under the same faults are in
``packages/optipromp-sim/tests/simulation/test_loop.py``.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from tests.control.benches import Picked, pick
from tests.control.plants import camera, empty

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning.task import posed
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control import Look, Tracker, TrackerParameters
from optipromp_loop.control.belief import visible
from optipromp_loop.control.camera import CameraWatch, fitted
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.plant import mouth_balls
from optipromp_loop.control.stages import LoopStage
from optipromp_sim.generate import generate
from optipromp_sim.simulation.detector import DETECTORS, Detector, Eye, Truth

OBSERVE, TRAVEL, PUSH, TAKE, LEAVE, DONE, GAVE_UP = LoopStage
USUAL = [TRAVEL, OBSERVE, PUSH, TAKE, LEAVE, DONE]
WHITE, RADIUS = DETECTORS["zero-mean"], 0.018


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate("cluster", 101)


def looked(scene: Scene, **faults: float) -> Picked:
    """A pick by a camera with errors of 5 mm, 5° and ``faults``."""
    detector = Detector(scene, posed(scene)[0], replace(WHITE, **faults))
    return pick(Controller(scene), scene, Eye(detector))


def noticed(done: Picked) -> list[str]:
    return [event.why for event in done.controller.noticed]


def fruit(place: FloatArray, name: str = "f", role: str = "target") -> SceneObject:
    return SceneObject(name, role, Sphere(RADIUS), np.asarray(place, dtype=float), sigma=0.002)


# --- limits of the camera -------------------------------------------------------------------------


def test_limits_of_a_camera_leave_a_distance_between_them() -> None:
    for near, far in ((-0.1, 1.0), (0.5, 0.5), (math.nan, 1.0), (0.1, math.nan)):
        with pytest.raises(InvalidRequestError, match=r"(near|far) is .*: must be"):
            Look(0.0, Pose(), (), near=near, far=far)


def test_what_a_camera_does_not_measure_is_not_missed() -> None:
    """Fruits ahead of the camera at 5, 20 and 60 cm, the radius counts."""
    places = np.array([[0.0, 0.0, 0.05], [0.0, 0.0, 0.2], [0.03, 0.0, 0.6]])
    radii, nothing = np.full(3, RADIUS), (np.zeros((0, 4)), None)
    sight = [
        visible(Look(0.0, Pose(), (), near=near, far=far), places[[row]], radii[:1], 0.8, nothing)
        for near, far, row in (
            (0.03, 1.0, 0), (0.04, 1.0, 0), (0.07, 1.0, 0), (0.07, 1.0, 1), (0.07, 1.0, 2),
            (0.07, 0.6, 2),
        )
    ]  # fmt: skip
    assert [bool(one[0]) for one in sight] == [True, False, False, True, True, False]
    silent = Look(0.0, Pose(), ())
    close = TrackerParameters().close
    assert not visible(silent, places[:1], radii[:1], 0.8, nothing, close)[0]
    assert visible(silent, places[1:2], radii[:1], 0.8, nothing, close)[0]


def test_a_fruit_inside_a_ball_of_the_tool_is_not_missed() -> None:
    balls = np.array([[0.0, 0.0, 0.3, 0.03]])
    place = np.array([[0.0, 0.0, 0.29]])  # before the middle of the ball
    assert not visible(Look(0.0, Pose(), ()), place, np.array([RADIUS]), 0.8, (balls, None))[0]


def test_the_mouth_hides_from_a_camera_beside_the_tool_alone(scene: Scene) -> None:
    robot, state = posed(scene)
    point, axis = robot.tool_pose(state.q)
    across = np.cross(axis, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    beside, palm = point + 0.08 * across - 0.05 * axis, point - 0.01 * axis
    assert len(mouth_balls(robot, state.q, palm)) == 0
    assert len(mouth_balls(robot, state.q, None)) == 0
    balls = mouth_balls(robot, state.q, beside)
    rim, inner = robot.tool.depth, robot.tool.mouth[0]
    assert np.linalg.norm(balls[:, :3] - point, axis=1).max() < 3.0 * inner
    assert ((balls[:, :3] - point) @ axis + balls[:, 3]).max() <= rim + 0.5 * inner
    assert (np.linalg.norm(balls[:, :3] - point, axis=1) < balls[:, 3]).any()


@pytest.mark.parametrize(("near", "lives"), [(0.07, True), (0.0, True), (0.02, False)])
def test_a_target_nearer_than_the_limit_lives_on(near: float, lives: bool) -> None:
    """Seen for 1 s from afar, then for 1 s 5 cm before the camera, where looks are empty."""
    tracker, place = Tracker(empty()), np.array([0.5, 0.0, 0.5])
    for k in range(40):
        pose = camera(0.3 if k < 20 else 0.05)
        seen = (fruit(pose.inverse() @ place),) if k < 20 else ()
        tracker.add(Look(0.05 * k, pose, seen, near=near))
    tracked = tracker.at(2.0)
    assert bool(tracked.confirmed.any()) is lives
    if lives:
        np.testing.assert_allclose(tracked.positions[0], place, atol=0.005)


def test_a_pick_with_a_near_limit_and_stamps_that_are_right_is_as_usual(scene: Scene) -> None:
    done = looked(scene, near=0.07)
    assert done.stages == USUAL
    assert noticed(done) == []
    assert done.controller.camera.shift == 0.0
    assert done.nearest(scene) < 0.012


# --- pictures that stand still ----------------------------------------------------------------


def moving(watch: CameraWatch, q: FloatArray, speed: float) -> list[bool]:
    """Whether each of twelve looks with stamps that go on tells something; one picture a second."""
    out = []
    for k in range(12):
        time = 0.05 * k
        watch.follow(time, q)
        place = np.array([0.0, 0.0, 0.3 + 0.01 * (time >= 0.3)])
        pose = Pose(np.array([speed * time, 0.0, 0.2]))
        out.append(watch.checked(Look(time, pose, (fruit(place),)), still=False) is not None)
    return out


def test_an_equal_picture_of_a_camera_that_moved_tells_nothing(scene: Scene) -> None:
    robot, state = posed(scene)
    watch = CameraWatch(robot, CONTROL)
    assert moving(watch, state.q, 0.1) == [True, *[False] * 5, True, *[False] * 5]
    assert watch.standing == pytest.approx(0.35)
    assert watch.news == [
        "the camera's picture stands still while the camera moves", "the camera's pictures go on",
        "the camera's picture stands still while the camera moves",
    ]  # fmt: skip


def test_an_equal_picture_of_a_camera_that_stands_counts(scene: Scene) -> None:
    robot, state = posed(scene)
    watch = CameraWatch(robot, CONTROL)
    assert all(moving(watch, state.q, 0.0))
    assert watch.standing is None
    assert watch.news == []


@pytest.mark.parametrize("frozen", [0.15, 0.5])
def test_a_push_stops_while_pictures_stand_still_and_goes_on(scene: Scene, frozen: float) -> None:
    done = looked(scene, frozen=frozen)
    assert done.stages == USUAL
    robot, stopped, resumed = done.controller.robot, *done.controller.noticed
    speeds = [np.abs(state.velocity / robot.velocity).max() for state in done.references]
    began, ended = (round(event.time / CONTROL.period) for event in (stopped, resumed))
    assert frozen < 0.5 or min(speeds[began : ended + 5]) < 1e-6 < 0.005 < speeds[began]
    assert done.nearest(scene) < 0.012


def test_a_push_is_broken_off_where_pictures_stand_still_for_long(scene: Scene) -> None:
    done = looked(scene, frozen=1.5)
    assert done.stages == [*USUAL[:3], LEAVE, OBSERVE, *USUAL]
    assert done.reasons[3] == "the camera's pictures stand still"
    told = noticed(done)
    assert told == [
        "the camera's picture stands still while the camera moves", "the camera's pictures go on",
    ]  # fmt: skip
    assert done.nearest(scene) < 0.012


# --- stamps ---------------------------------------------------------------------------------------


def test_a_fit_finds_the_shift_of_curves() -> None:
    """Three things that seem to move by a shift of 80 ms, with errors of 2 mm."""
    rng, times = np.random.default_rng(4), np.linspace(0.0, 1.0, 20)
    owner, noise = np.repeat(np.arange(3), 20), 0.002 * rng.standard_normal((60, 3))
    rest = rng.standard_normal((3, 3))[owner]

    def points(shift: float) -> FloatArray:
        lag = 0.2 * (np.sin(2.0 * (times + shift)) - np.sin(2.0 * (times + 0.08)))
        return rest + noise + np.tile(lag, 3)[:, None] * np.array([1.0, 0.5, 0.2])

    fit = fitted(points, owner, 0.3)
    assert fit.shift == pytest.approx(0.08, abs=4.0 * fit.error)
    assert fit.error < 0.01
    assert fit.share > 0.6


@pytest.mark.parametrize("stamp", [-0.15, 0.1])
def test_stamps_that_err_are_estimated_told_and_corrected(scene: Scene, stamp: float) -> None:
    done = looked(scene, stamp=stamp)
    controller = done.controller
    assert controller.camera.shift == pytest.approx(-stamp, abs=0.02)
    (told,) = noticed(done)
    words = told.split()
    assert words[:2] == ["stamps", "are"]
    assert float(words[2]) == pytest.approx(1e3 * abs(stamp), abs=20.0)
    assert words[4] == ("early," if stamp < 0.0 else "late,")
    assert done.stages[-2:] == [LEAVE, DONE]
    assert done.nearest(scene) < 0.012


def test_stamps_without_the_pose_are_corrected_too(scene: Scene) -> None:
    """The pose is of the exposure, the stamp is 150 ms before: a driver that stamps the request."""

    def filtered(looks: tuple[Look, ...]) -> Iterable[Look]:
        return [replace(look, time=look.time - 0.15) for look in looks]

    done = pick(Controller(scene), scene, Eye(Detector(scene, posed(scene)[0], WHITE)),
                filtered=filtered)  # fmt: skip
    assert done.controller.camera.shift == pytest.approx(0.15, abs=0.02)
    assert "by the poses" in noticed(done)[0]
    assert done.stages[-1] == DONE
    assert done.nearest(scene) < 0.012


def test_stamps_beyond_what_is_corrected_are_refused(scene: Scene) -> None:
    done = looked(scene, stamp=-0.45)
    assert done.stages[-1] == GAVE_UP
    assert "synchronise the camera's clock" in done.reasons[-1]
    assert done.away(scene) > 0.08


# --- a target that falls --------------------------------------------------------------------------


def falling(scene: Scene, begins: float, caught: bool = False) -> Picked:
    """A pick whose target falls freely from ``begins`` [s] on; ``caught``: into the tool."""
    up, name = np.asarray(scene.up), scene.target.id

    def filtered(looks: tuple[Look, ...]) -> Iterable[Look]:
        for look in looks:
            t = max(look.time - begins, 0.0)
            turn, items = look.camera.rotation.T, []
            for item in look.detections:
                if item.id == name and t > 0.0:
                    place = item.position - turn @ (4.905 * t * t * up)
                    item = replace(item, position=place, stem=None)
                    if t > 0.2 and not caught:
                        continue
                    if t > 0.2:
                        q = controller.driver.state(look.time).q
                        item = replace(
                            item, position=look.camera.inverse() @ controller.robot.tool_pose(q)[0]
                        )
                items.append(item)
            yield replace(look, detections=tuple(items))

    eye = Eye(Detector(scene, posed(scene)[0], WHITE))
    controller = Controller(scene)
    return pick(controller, scene, eye, filtered=filtered)


def test_a_target_that_falls_into_the_tool_is_taken_out(scene: Scene) -> None:
    done = falling(scene, 4.0, caught=True)
    assert done.stages == USUAL
    assert done.controller.holding


def test_a_target_that_falls_ends_the_pick_away_from_the_fruits(scene: Scene) -> None:
    done = falling(scene, 4.0)
    assert done.stages == [*USUAL[:5], GAVE_UP]
    assert done.reasons[-1] == done.reasons[-2] == "the target falls: its stem broke"
    assert noticed(done) == ["the target falls: its stem broke"]
    begun = next(e.time for e in done.controller.events if e.stage is LEAVE)
    assert 4.0 < begun < 4.35 + CONTROL.hold
    assert done.away(scene) > 0.08


def test_eyes_hold_their_picture_and_state_poses_at_their_stamps(scene: Scene) -> None:
    """The simulated camera itself: stamps, poses at the stamps, pictures that stand still."""
    robot, state = posed(scene)
    place = scene.target.position
    truth = Truth((scene.target.id,), place[None], (np.eye(3),), (np.zeros((0, 3)),))

    def taken(**faults: float) -> tuple[Detector, list[Look]]:
        detector = Detector(scene, robot, replace(DETECTORS["perfect"], **faults))
        eye, out = Eye(detector), []
        for k in range(80):
            q = state.q + 0.3 * 0.02 * k
            eye.see(0.02 * k, q, truth)
            out += eye.delivered(0.02 * k)
        return detector, out

    for stamp in (-0.15, 0.1):
        detector, shifted = taken(stamp=stamp)
        for look in shifted[6:]:
            expected = detector.camera(state.q + 0.3 * look.time)
            np.testing.assert_allclose(look.camera.position, expected.position, atol=1e-4)
    _, usual = taken()
    _, held = taken(frozen=0.5, frozen_at=10.0)
    same = [_equal_places(held[0], look) for look in held]
    assert same == [look.time < 0.5 - 1e-9 for look in held]
    assert not _equal_places(usual[0], usual[5])
    assert [look.time for look in held] == [look.time for look in usual]
    _, near = taken(near=9.0)
    assert all(not look.detections and look.near == 9.0 for look in near)


def _equal_places(one: Look, other: Look) -> bool:
    pairs = list(zip(one.detections, other.detections, strict=False))
    return bool(pairs) and all(np.array_equal(a.position, b.position) for a, b in pairs)
