"""The arm's side of the controller: what runs, what takes over, and when nothing does."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import State
from optipromp_loop.control import Tracker
from optipromp_loop.control.courses import Route, path_back
from optipromp_loop.control.driver import Driver
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.picks import to_camera_point
from optipromp_loop.control.tracker import Tracked
from optipromp_sim.generate import generate
from optipromp_sim.simulation.records import used

LEAD = CONTROL.lead


@pytest.fixture(scope="module")
def made() -> Plan:
    made = plan(generate("cluster", 0), unhurried=True)  # as the loop plans
    assert made.success
    return made


def seen(scene: Scene, moved: FloatArray | None = None) -> Tracked:
    """A still plant, as tracked; ``moved`` (3,) since the scene was planned in [m]."""
    by = np.zeros(3) if moved is None else moved
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    sure = [
        replace(o, position=o.position + by, stem=None, covariance=1e-6 * np.eye(3)) for o in fruits
    ]
    return Tracker(scene, first=sure).at(0.0)


def driver(made: Plan, scene: Scene | None = None) -> Driver:
    start = State(made.trajectory.positions[0])
    return Driver(scene or made.scene, made.robot, start, CONTROL)


def test_among_fruits_that_hang_still_nothing_takes_over_after_the_first(made: Plan) -> None:
    drive, route, tracked = driver(made), Route.of(made), seen(made.scene)
    assert drive.rests(0.0)
    assert drive.phase(7.0) == 0.0
    first = drive.set_out(route, 1.0, tracked)
    assert first.begins == 1.0 + LEAD
    assert not drive.rests(1.0)
    end = 1.0 + LEAD + route.duration
    later = np.arange(1.02, end - 2.0 * LEAD, 0.02)
    assert all(drive.go_on(float(now), tracked) is None for now in later)
    assert drive.phase(2.0 + LEAD) == pytest.approx(1.0)
    assert drive.state(2.0).near(first.at(2.0), 0.0)
    held = drive.go_on(end, tracked)  # at the target it moves with the plant
    assert held.at(held.begins).near(first.at(held.begins), 1e-9)


def test_a_plant_that_moved_asks_for_another_course(made: Plan) -> None:
    drive, tracked = driver(made), seen(made.scene)
    before = drive.set_out(Route.of(made), 0.0, tracked)
    now = made.trajectory.times[made.first] + 0.4
    small, large = np.array([1e-4, 0.0, 0.0]), np.array([0.0, 4e-3, 0.0])
    assert drive.go_on(now, seen(made.scene, small)) is None
    after = drive.go_on(now, seen(made.scene, large))
    assert after.at(after.begins).near(before.at(after.begins), 1e-9)
    assert max(used(made.robot, after.curve).values()) <= 1.0
    end, _ = made.robot.tool_pose(after.curve.positions[-1])
    planned, _ = made.robot.tool_pose(made.trajectory.positions[-1])
    assert end - planned == pytest.approx(large, abs=2e-4)
    assert drive.go_on(now + 0.02, seen(made.scene, large)) is None


def test_a_tool_that_holds_its_target_follows_no_fruit_that_moves(made: Plan) -> None:
    """What moves by then is what it presses: the plant stays where it was when it was taken."""
    drive, moved, end = driver(made), np.array([0.0, 4e-3, 0.0]), made.trajectory.duration
    drive.set_out(Route.of(made), 0.0, seen(made.scene))
    now = end + 1.0
    assert drive.go_on(now, seen(made.scene, moved)) is not None
    drive.hold(now, seen(made.scene, moved))
    back = path_back(made.robot, made.trajectory.positions[:-10:-1], 0.1)
    out = Route.along(made.robot, back, made.scene, came=(Route.of(made), end))
    leaving = drive.take(out, 0.0, now, seen(made.scene, -moved))
    assert leaving is not None
    away = made.robot.tool_pose(leaving.curve.positions[-1])[0] - out.points[-1]
    assert away == pytest.approx(moved, abs=2e-4)
    assert drive.go_on(now + 0.1, seen(made.scene, -2.0 * moved)) is None


def test_a_course_never_swings_past_the_end_of_its_path(made: Plan) -> None:
    """Short before the end of a fast path a plant moves, which asks for another course."""
    robot, ahead = made.robot, to_camera_point(made)
    assert ahead is not None
    route = Route.along(robot, ahead, made.scene)
    axis, found = route.axes[-1], 0
    for left in (0.45, 0.35, 0.25, 0.15, 0.08, 0.03):
        for moved in ([0.002, 0.0, 0.0], [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]):
            drive = driver(made)
            drive.set_out(route, 0.0, seen(made.scene))
            now = route.duration - left - LEAD
            course = drive.go_on(now, seen(made.scene, np.array(moved)))
            if course is None:
                continue
            found += 1
            times = np.linspace(course.curve.times[0], course.curve.times[-1], 100)
            tips, _ = robot.tool_pose(np.array([course.curve.at(t).q for t in times]))
            assert ((tips - route.points[-1] - moved) @ axis).max() < 0.005
    assert found >= 3


def test_a_path_that_is_not_moved_with_the_plant_stays_as_it_is(made: Plan) -> None:
    drive, ahead = driver(made), to_camera_point(made)
    assert ahead is not None
    drive.set_out(Route.along(made.robot, ahead, made.scene, np.inf), 0.0, seen(made.scene))
    for now in (0.1, 0.3, ahead.duration - 0.1):
        assert drive.go_on(now, seen(made.scene, np.array([0.0, now, 0.0]))) is None


def test_a_braked_arm_comes_to_rest_and_then_waits_where_it_is_in_its_route(made: Plan) -> None:
    drive = driver(made)
    before = drive.set_out(Route.of(made), 0.0, seen(made.scene))
    at = 0.5 * float(made.trajectory.times[made.first])
    assert before.at(at).moving
    braked = drive.brake(at)
    assert braked.at(at).near(before.at(at), 1e-9)
    assert max(used(made.robot, braked.curve).values()) <= 1.0 + 1e-6
    last = braked.at(at + braked.curve.duration)
    assert np.abs([last.velocity, last.acceleration]).max() < 1e-9
    rest = at + braked.curve.duration
    assert not drive.rests(rest - 0.01)
    assert drive.rests(rest + 1e-9)  # rounding
    assert drive.phase(rest + 5.0) == at - LEAD
    assert not drive.stuck(at + CONTROL.stuck)
    assert drive.stuck(at + CONTROL.stuck + 0.1)


def test_an_arm_that_stands_stands(made: Plan) -> None:
    drive, away = driver(made), made.trajectory.positions[0] + 0.01
    drive.stands_at(away)
    stood = drive.stand(3.0)
    for time in (2.0, 3.0, 3.1, 9.0):
        assert stood.at(time).near(State(away), 0.0)
    drive.set_out(Route.of(made), 3.0, seen(made.scene))
    drive.stands_at(made.trajectory.positions[-1])  # too late: a course runs
    assert drive.state(3.0).q == pytest.approx(away, abs=1e-9)


def test_an_arm_that_reaches_nothing_waits_where_it_is_until_the_plant_comes_back(made):
    drive, far = driver(made), seen(made.scene, np.array([2.0, 0.0, 0.0]))
    stood = drive.set_out(Route.of(made), 0.0, far)
    assert np.ptp(stood.curve.positions, axis=0).max() < 1e-9
    assert drive.go_on(0.5, far) is None
    assert drive.stuck(CONTROL.stuck + 0.02)
    back = drive.go_on(0.6, seen(made.scene))
    assert back is not None
    assert not drive.stuck(CONTROL.stuck + 0.1)
    assert drive.phase(0.6 + LEAD) == 0.0


def test_no_course_leads_through_what_stands(made: Plan) -> None:
    """An obstacle 10 mm beside the end of the path, into which or away from which it moves."""
    tip, _ = made.robot.tool_pose(made.trajectory.positions[-1])
    swept = made.robot.sphere_centers(made.trajectory.positions)
    for aside in np.arange(0.02, 0.1, 1e-3):
        ball = tip + [0.0, aside, 0.0]
        gaps = np.linalg.norm(swept - ball, axis=-1) - made.robot.spheres.radius - 0.01
        if gaps.min() > 0.01:
            break
    wall = SceneObject("wall", "static", Sphere(0.01), ball)
    drive = driver(made, replace(made.scene, objects=(*made.scene.objects, wall)))
    free, route = driver(made), Route.of(made)
    for moved, blocked in ((0.0, False), (0.02, True), (-0.02, False)):
        tracked = seen(made.scene, np.array([0.0, moved, 0.0]))
        assert free.take(route, 0.0, 0.0, tracked) is not None
        assert (drive.take(route, 0.0, 0.0, tracked) is None) == blocked


def test_the_way_back_leads_through_its_points_at_its_speed(made: Plan) -> None:
    q = made.trajectory.positions[made.first : -20][::-1]
    back = path_back(made.robot, q, 0.1)
    assert np.array_equal(back.positions[0], q[0])
    assert np.array_equal(back.positions[-1], q[-1])
    assert max(used(made.robot, back).values()) <= 1.0
    times = np.arange(0.0, back.duration, 2e-3)
    points, _ = made.robot.tool_pose(back.sample(times)[0])
    passed, _ = made.robot.tool_pose(q)
    away = np.linalg.norm(points[:, None] - passed, axis=2).min(axis=1)
    assert away.max() < 5e-3
    speeds = np.linalg.norm(np.diff(points, axis=0), axis=1) / 2e-3
    assert np.median(speeds) > 0.08
    assert speeds.max() < 0.13
    still = path_back(made.robot, np.tile(q[0], (3, 1)), 0.1)  # nothing was passed yet
    assert np.ptp(still.positions, axis=0).max() == 0.0
