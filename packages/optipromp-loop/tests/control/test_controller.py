"""The controller's decisions, with an arm that is where it is told and fruits that are not pushed.

Picks in the physics are in ``packages/optipromp-sim/tests/simulation/test_loop.py``.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.control.benches import Picked, eye_of, in_order, pick, still

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.planning.task import posed
from optipromp.core.scenes.look import HIDDEN, Look, points_of
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control import picks as module
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.driver import views
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.plant import without_fruits
from optipromp_loop.control.stages import BLOCKED, LoopStage
from optipromp_sim.generate import generate
from optipromp_sim.situations import executed

OBSERVE, TRAVEL, PUSH, TAKE, LEAVE, DONE, GAVE_UP = LoopStage
OUT = [TAKE, LEAVE, DONE]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return generate("cluster", 101)


@pytest.fixture(scope="module")
def usual(scene: Scene) -> Picked:
    """A pick with looks that have zero-mean errors."""
    return pick(Controller(scene), scene, eye_of(scene))


def assert_sound(done: Picked) -> None:
    """Its stages are in order, and its curves have no jump and keep the limits."""
    assert in_order(done.stages)
    assert len(done.controller.cycles) == len(done.references)
    times = [event.time for event in done.controller.events]
    assert times == sorted(times)
    robot = done.controller.robot
    found = executed(done.stretches, robot, done.references[0], done.time)
    assert found.jumps.max() <= 1e-6
    assert found.shares.max() <= 1.0
    for one, other in zip(done.references, done.references[1:], strict=False):
        assert (np.abs(other.q - one.q) <= 0.0201 * robot.velocity).all()


def test_a_pick_looks_goes_looks_again_and_goes(usual: Picked, scene: Scene) -> None:
    assert_sound(usual)
    assert usual.stages == [TRAVEL, OBSERVE, PUSH, *OUT]
    told = "at the camera point", "at the target", "out with the target", "outside with the target"
    assert (usual.reasons[1], *usual.reasons[3:]) == told
    assert usual.nearest(scene) < 0.012
    assert usual.away(scene) > 0.1
    assert usual.controller.holding
    assert len(usual.controller.plans) == 2  # one from the start, one from the camera point
    assert usual.controller.tries == usual.controller.parameters.tries


def test_a_fruit_that_is_first_seen_on_the_way_is_planned_for(scene: Scene) -> None:
    """A look after the arm set out shows a fruit that hid; the pick from near knows it."""
    hidden = scene.pushables[0]
    seen = replace(scene, objects=tuple(o for o in scene.objects if o.id != hidden.id))

    def filtered(looks: tuple[Look, ...]) -> Iterable[Look]:
        for look in looks:
            shown = [o for o in look.detections if look.time > 0.3 or o.id != hidden.id]
            yield replace(look, detections=tuple(shown))

    done = pick(Controller(seen), scene, eye_of(scene), filtered=filtered)
    assert_sound(done)
    assert done.stages == [TRAVEL, OBSERVE, PUSH, *OUT]
    first, second = done.controller.plans[:2]
    assert len(second.scene.pushables) == len(first.scene.pushables) + 1
    assert done.controller.tries == done.controller.parameters.tries


def showing(points: FloatArray, begun: float) -> Callable[[tuple[Look, ...]], Iterable[Look]]:
    """Looks that show a thing of points (k, 3) [m] after a time [s]."""

    def filtered(looks: tuple[Look, ...]) -> Iterable[Look]:
        for look in looks:
            cloud = PointCloudShape(look.camera.inverse() @ points, 0.005)
            thing = SceneObject("unknown1", "static", cloud, np.zeros(3))
            yield replace(look, solids=(thing,) if look.time > begun else ())

    return filtered


def away_from(points: FloatArray, done: Picked) -> float:
    """Least distance of the arm on its way from points (k, 3) [m]."""
    robot = done.controller.robot
    centers = np.array([robot.sphere_centers(state.q) for state in done.references])
    return float((cKDTree(points).query(centers)[0] - robot.spheres.radius).min())


def test_a_thing_that_appears_in_a_look_is_an_obstacle(usual: Picked, scene: Scene) -> None:
    """A post stands beside the way that was taken; looks show its front after the arm set out."""
    first = usual.controller.plans[-1]
    points, _ = first.robot.tool_pose(first.trajectory.positions)
    up = 0.005 * np.arange(-12, 13)[:, None] * scene.up
    post = points[len(points) // 2] + 0.05 * scene.approach.frame[0] + up
    done = pick(Controller(scene), scene, eye_of(scene), filtered=showing(post, 0.3))
    assert_sound(done)
    last = done.controller.plans[-1]
    (seen,) = [item for item in last.scene.static if item.id.startswith("seen")]
    gaps = np.linalg.norm(points_of(seen)[:, None] - post, axis=2)
    assert gaps.min(axis=0).max() < 1e-9  # and what nobody saw behind it
    assert 0.05 < gaps.min(axis=1).max() < HIDDEN + 0.01
    assert not any(o.id.startswith("seen") for o in done.controller.plans[0].scene.static)
    assert away_from(post, done) > 0.0


def test_a_thing_that_appears_during_the_push_ends_it(usual: Picked, scene: Scene) -> None:
    """A thing is where the hand would come last; looks show it once the tool is among fruits."""
    made, robot = usual.controller.plans[-1], usual.controller.robot
    begun = next(event.time for event in usual.controller.events if event.stage == PUSH)
    first, last = robot.sphere_centers(made.trajectory.positions[[made.first, -1]])
    arm = (np.linalg.norm(last[:, None] - first, axis=2) - robot.spheres.radius).min(axis=1)
    fruits = np.array([item.position for item in scene.objects if item.stem is not None])
    far = np.linalg.norm(last[:, None] - fruits, axis=2).min(axis=1) - 0.05
    thing = last[np.argmax(np.minimum(arm, far))] + 0.005 * np.arange(-2, 3)[:, None] * scene.up
    done = pick(Controller(scene), scene, eye_of(scene), filtered=showing(thing, begun))
    assert_sound(done)
    assert done.stages[:4] == [TRAVEL, OBSERVE, PUSH, LEAVE]
    assert done.reasons[3] == BLOCKED
    assert away_from(thing, done) > 0.0


def test_a_target_that_the_start_does_not_show_is_looked_for(scene: Scene) -> None:
    """The tool is turned away by 50°; its camera sees 40° to each side."""
    robot, state = posed(scene)
    away_from = views(robot, state.q, replace(CONTROL, views=(50.0,)))
    assert len(away_from) >= 2
    turned = replace(scene, start=away_from[1])
    done = pick(Controller(without_fruits(turned)), turned, eye_of(turned))
    assert_sound(done)
    assert done.stages[-6:] == [TRAVEL, OBSERVE, PUSH, *OUT]
    assert done.controller.events[0].time >= done.controller.parameters.first_look
    assert done.reasons[0] == "the target is not seen: to another view"
    assert "at another view" in done.reasons
    assert done.nearest(scene) < 0.012


def test_a_plan_whose_way_out_harms_is_none() -> None:
    """With the target in the tool a fruit presses a stem on the way out."""
    scene = generate("cluster", 183_000)
    given = replace(CONTROL, tries=0)
    left = pick(Controller(scene, parameters=given), scene, eye_of(scene, "perfect"))
    assert left.stages[-2:] == [OBSERVE, GAVE_UP]
    assert left.reasons[-1].startswith("no pick: retreat: harm is predicted")


def test_a_share_of_the_clock_decides_nothing_else(scene: Scene) -> None:
    done = pick(Controller(scene, real_time=True), scene, eye_of(scene))
    assert_sound(done)
    assert done.stages == [TRAVEL, OBSERVE, PUSH, *OUT]


AWAY = np.array([0.035, 0.0, 0.0])  # [m]


def test_the_tool_comes_to_where_the_plant_is_now(scene: Scene) -> None:
    """35 mm within 0.4 s, after the tool left the camera point."""
    left = list[float]()

    def moves(time: float) -> FloatArray:
        if controller.stage is PUSH and not left:
            left.append(time)
        return AWAY * np.clip((time - left[0]) / 0.4, 0.0, 1.0) if left else np.zeros(3)

    controller = Controller(scene)
    done = pick(controller, scene, eye_of(scene), moves)
    assert_sound(done)
    assert done.stages[-4:] == [PUSH, *OUT]
    assert done.nearest(scene, AWAY) < 0.01  # the cup has room for 15 mm to each side


# --- looks --------------------------------------------------------------------------------------


def lost(looks: tuple[Look, ...]) -> Iterable[Look]:
    """Looks that do not show the target."""
    return [
        replace(one, detections=tuple(x for x in one.detections if x.role != "target"))
        for one in looks
    ]


def blank(looks: tuple[Look, ...]) -> Iterable[Look]:
    return [replace(one, detections=()) for one in looks]


@pytest.mark.parametrize(("filtered", "known"), [(lost, True), (blank, False)])
def test_without_a_target_it_gives_up_away_from_the_fruits(scene, filtered, known):
    first = scene if known else without_fruits(scene)
    done = pick(Controller(first), scene, eye_of(scene), still, 40.0, filtered)
    assert_sound(done)
    turns = (len(done.stages) - 1) // 2
    assert done.stages == [TRAVEL, OBSERVE] * turns + [GAVE_UP]
    assert turns == 1 if known else turns >= 4  # it has looked from other views
    assert done.reasons[-1] == "the target is not seen"
    assert done.time < (8.0 if known else 18.0)
    assert done.nearest(scene) > 0.05
    assert not done.references[-1].moving


def test_a_target_that_is_gone_when_the_tool_is_there_is_not_picked(scene: Scene) -> None:
    """It is lost from sight on the way: the tool retreats, and gives up where it looks."""

    def later(looks: tuple[Look, ...]) -> Iterable[Look]:
        return [look if look.time < 2.3 else next(iter(lost((look,)))) for look in looks]

    done = pick(Controller(scene), scene, eye_of(scene), still, 40.0, later)
    assert_sound(done)
    assert LEAVE in done.stages
    assert done.stages[-1] is GAVE_UP
    assert done.away(scene) > 0.04


@pytest.mark.parametrize("known", [True, False])
def test_without_a_look_nothing_moves_and_the_fault_says_why(scene: Scene, known: bool) -> None:
    first = scene if known else without_fruits(scene)
    done = pick(Controller(first), scene, eye_of(scene), still, 5.0, lambda _: ())
    assert done.stages == []
    assert all(not np.ptp(one.curve.positions, axis=0).any() for one in done.stretches)
    assert done.controller.fault == "no look has come for 1 s"
    (said,) = done.controller.noticed
    assert (said.why, said.time) == (done.controller.fault, pytest.approx(1.02))


def rests(done: Picked, begin: float, end: float) -> bool:
    """Whether the arm stands from a time to another [s]."""
    period = done.controller.parameters.period
    states = done.references[round(begin / period) : round(end / period)]
    return not any(state.moving for state in states)


@pytest.mark.parametrize("gone", [1.0, 3.5])
def test_while_no_look_comes_the_arm_stands_and_then_it_goes_on(scene: Scene, gone: float) -> None:
    """None for 4 s, on the way to the camera point or in the push."""

    def silent(looks: tuple[Look, ...]) -> Iterable[Look]:
        return [look for look in looks if not gone < look.time < gone + 4.0]

    done = pick(Controller(scene), scene, eye_of(scene), filtered=silent)
    assert_sound(done)
    fault = gone + CONTROL.look_age + 0.15  # the last look came 0.06 s after its time, or less
    assert not rests(done, gone, fault)
    assert rests(done, fault + 0.2, gone + 4.0)
    assert [one.why for one in done.controller.noticed] == ["no look has come for 1 s"]
    assert done.controller.fault == ""
    assert done.stages[-1] is DONE
    assert done.nearest(scene) < 0.012


class Behind:
    """A controller whose arm tells it other states."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)


def test_an_arm_that_does_not_follow_is_stopped_where_it_is(scene: Scene) -> None:
    stuck = posed(scene)[1]

    class Stuck(Behind):
        def __call__(self, now: float, _: State, reference: State) -> Any:
            return self.controller(now, stuck, reference)

    controller = Controller(scene)
    done = pick(Stuck(controller), scene, eye_of(scene), longest=4.0)
    far = [float(np.abs(state.q - stuck.q).max()) for state in done.references]
    (fault,) = controller.noticed
    at = round(fault.time / CONTROL.period)
    assert CONTROL.off_curve < far[at] < CONTROL.off_curve + 0.02
    assert max(far[:at]) < far[at]
    assert max(far[at + 10 :]) < 1e-9
    made = next(one for one in done.stretches if one.begins > fault.time)
    assert made.at(made.begins).near(State(stuck.q), 1e-9)
    assert not made.curve.at(made.curve.duration).moving
    assert controller.lost
    assert not controller.ended
    assert "from the curve (at most 0.1)" in controller.fault == fault.why


def test_a_cycle_without_a_state_comes_to_rest_and_the_next_goes_on(scene: Scene) -> None:
    """Of an arm in motion and of one that stands; time goes on."""
    controller = Controller(scene)
    assert controller.hold(0.0, "no state") is None  # it stands

    class Blinded(Behind):
        """The arm tells no state from 0.9 to 3 s."""

        def __call__(self, now: float, measured: State, reference: State) -> Any:
            if 0.9 <= now < 3.0:
                return controller.hold(now, "no state")
            return controller(now, measured, reference)

    done = pick(Blinded(controller), scene, eye_of(scene))
    period = CONTROL.period
    assert done.references[round(0.9 / period)].moving
    assert not any(r.moving for r in done.references[round(1.3 / period) : round(3.0 / period)])
    assert [one.why for one in controller.noticed] == ["no state", "no state"]
    assert controller.stage is DONE
    assert done.nearest(scene) < 0.012


class Shuffled:
    """Delivers looks late and out of order: of two, the second first."""

    def __init__(self) -> None:
        self.held: list[Look] = []
        self.given: list[float] = []

    def __call__(self, looks: tuple[Look, ...]) -> Iterable[Look]:
        self.held += looks
        if len(self.held) < 2:
            return ()
        out, self.held = self.held[::-1], []
        self.given += [look.time for look in out]
        return out


def test_looks_that_are_late_and_out_of_order_do_no_harm(scene: Scene) -> None:
    eye, order = eye_of(scene), Shuffled()
    eye.detector.parameters = replace(eye.detector.parameters, latency=0.1)
    done = pick(Controller(scene), scene, eye, lambda t: AWAY * 0.3 * np.sin(5.0 * t), 40.0, order)
    assert_sound(done)
    assert done.stages[-1] is DONE
    assert (np.diff(order.given) < 0.0).sum() > 20
    assert done.controller.tracker.statistics.dropped == 0
    assert done.nearest(scene) < 0.02


def test_looks_from_a_clock_that_is_ahead_do_no_harm(scene: Scene) -> None:
    def ahead(looks: tuple[Look, ...]) -> Iterable[Look]:
        return [replace(look, time=look.time + 0.6) for look in looks]

    done = pick(Controller(scene), scene, eye_of(scene), still, 40.0, ahead)
    assert_sound(done)
    assert done.stages[-1] is DONE


# --- picks that fail ----------------------------------------------------------------------------


def failing(
    monkeypatch: pytest.MonkeyPatch, name: str, when: Callable[[int], bool], error: Exception
) -> None:
    """Let a planner fail ``when`` the count of its calls so far says so."""
    count, real = [0], getattr(module, name)

    def made(scene: Scene, **more: Any) -> Any:
        count[0] += 1
        if when(count[0]):
            raise error
        return real(scene, **more)

    monkeypatch.setattr(module, name, made)


REFUSED = InvalidRequestError("nothing leads there")


def test_a_pick_that_is_refused_is_made_anew_where_something_differs(scene, monkeypatch):
    """The plant moves by 5 mm at 2 s; in a plant that stands still nothing is tried again."""
    failing(monkeypatch, "plan_whole", lambda count: count == 1, REFUSED)
    moves = lambda time: np.array([0.005, 0.0, 0.0]) * (time > 2.0)  # noqa: E731
    done = pick(Controller(scene), scene, eye_of(scene, "perfect"), moves)
    assert_sound(done)
    assert done.stages == [OBSERVE, TRAVEL, OBSERVE, PUSH, *OUT]
    assert done.reasons[0] == "no pick: nothing leads there"
    assert done.controller.events[1].time > 2.0
    assert done.controller.tries == done.controller.parameters.tries - 1


def test_where_nothing_differs_it_gives_up_where_it_stands(scene, monkeypatch):
    failing(monkeypatch, "plan_whole", lambda _: True, REFUSED)
    done = pick(Controller(scene), scene, eye_of(scene, "perfect"))
    assert_sound(done)
    assert done.stages == [OBSERVE, GAVE_UP]
    assert done.reasons == ["no pick: nothing leads there"] * 2
    start = posed(scene)[1]
    assert all(state.near(State(start.q), 1e-9) for state in done.references)


def test_an_error_of_the_program_is_not_hidden(scene, monkeypatch):
    failing(monkeypatch, "plan_whole", lambda _: True, ZeroDivisionError("a defect"))  # type: ignore[arg-type]
    with pytest.raises(ZeroDivisionError, match="a defect"):
        pick(Controller(scene), scene, eye_of(scene))


@pytest.mark.parametrize(
    ("budget", "after"), [(1.0, OUT), (0.0, [LEAVE, GAVE_UP])]
)  # fmt: skip
def test_a_pick_whose_promise_breaks_gives_way_to_another_or_leaves(scene, budget, after):
    """As the tool sets out, a fruit jumps below the target; without a budget of harm it leaves."""
    begun, first = list[bool](), scene.pushables[0].id

    def shown(looks: tuple[Look, ...]) -> Iterable[Look]:
        for look in looks:
            if controller.stage is PUSH:
                begun.append(True)
            place = look.camera.inverse() @ (scene.target.position - np.array([0.0, 0.0, 0.03]))
            moved = [o.shifted(place - o.position) if o.id == first else o for o in look.detections]
            yield replace(look, detections=tuple(moved)) if begun else look

    controller = Controller(scene, parameters=replace(CONTROL, tries=0, budget=budget))
    done = pick(controller, scene, eye_of(scene, "perfect"), still, 40.0, shown)
    assert_sound(done)
    assert done.stages == [TRAVEL, OBSERVE, PUSH, *after]
    if after == OUT:
        assert len(controller.picks) == 3
    else:
        assert done.reasons[3].startswith("going on would do")


@pytest.mark.parametrize("limit", [np.inf, 2.0 * np.pi], ids=["without limits", "a turn each way"])
def test_an_arm_that_is_reported_a_turn_off_is_not_lost(scene: Scene, limit: float) -> None:
    robot, start = posed(scene)
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[6], upper[6] = -limit, limit
    loop = Controller(without_fruits(scene), robot=replace(robot, lower=lower, upper=upper))
    asked, told = np.array(start.q), np.array(start.q)
    asked[6], told[6] = np.pi + 0.01, 0.02 - np.pi
    assert loop(0.0, State(told), State(asked)) is not None
    assert (loop.lost, loop.fault) == (False, "")
    told[6] = 0.2 - np.pi
    loop(0.02, State(told), State(asked))
    assert (loop.lost, loop.fault) == (True, "joint7 is 0.19 from the curve (at most 0.1)")
