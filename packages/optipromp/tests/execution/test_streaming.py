"""Curves that a source replaces in motion: which are taken, when, and how the motion ends."""

import numpy as np
import pytest
from tests.execution.arms import PANDA, PERIOD, Controlled, once
from tests.execution.streams import WHOLE, between, giving, quiet, rest, wanted

from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.executor import Stretch
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes import load_scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_sim.simulation import SimulatedArm


def tail(after: float) -> Trajectory:
    """What is left of WHOLE ``after`` a time."""
    times = np.linspace(after, WHOLE.duration, 60)
    return Trajectory(times - after, *WHOLE.sample(times), PANDA.joint_names)


def further_on(curve: Trajectory, after: float) -> Trajectory:
    """The same curve, led 0.02 rad further from ``after`` a time on, within 0.8 s."""
    shift = between(State(np.zeros(7)), State(np.full(7, 0.02)), 0.8)
    more = zip(curve.rows(), shift.sample(curve.times - after), strict=True)
    return Trajectory(curve.times, *(a + b for a, b in more), PANDA.joint_names)


def test_one_stretch_is_followed_as_a_curve_is_executed() -> None:
    arm, other = Controlled(quiet, wait=0.5), Controlled(quiet)
    done, same = arm.follow(giving((0.0, Stretch(WHOLE, 0.0)))), other.execute(WHOLE)
    assert done.finished
    assert (done.reason, done.refused, done.missed) == ("", (), 0)
    n = len(same.times)
    np.testing.assert_array_equal(done.reference[:n], same.reference)
    assert arm.at[-1] == pytest.approx(2.0, abs=0.03)  # and one question more


def test_the_source_is_asked_every_period_with_what_was_commanded() -> None:
    asked, given = list[tuple[float, State, State]](), giving((0.0, Stretch(WHOLE, 0.1)))
    far = State(PANDA.home + 0.01)

    def source(now: float, measured: State, reference: State) -> Stretch | None:
        asked.append((now, measured, reference))
        np.testing.assert_array_equal(arm.asked[-1].q, reference.q)
        return given(now, measured, reference)

    arm = Controlled(once("state", 0.5, lambda _: far))
    assert arm.follow(source, period=0.05).finished
    times = np.array([now for now, _, _ in asked])
    np.testing.assert_allclose(times, 0.05 * np.arange(len(times)), atol=1.1 * PERIOD)
    assert times[-1] == pytest.approx(2.1, abs=0.05 + PERIOD)
    for now, _, reference in asked:
        np.testing.assert_allclose(reference.q, WHOLE.at(now - 0.1).q, atol=1e-12)


def test_many_stretches_join_one_another() -> None:
    """Twenty replacements a second, each led on from the last: no reference jumps."""
    given = [Stretch(WHOLE, 0.0)]
    rng = np.random.default_rng(5)

    def source(now: float, _: State, __: State) -> Stretch | None:
        if now >= 1.5:
            return None
        begins = now + 0.1 if now else 0.0
        further = State(WHOLE.positions[-1] + rng.uniform(-0.05, 0.05))
        made = given[0] if not now else Stretch(between(given[-1].at(begins), further, 2.0), begins)
        given.append(made)
        return made

    arm = Controlled(quiet)
    done = arm.follow(source, period=0.05)
    assert done.finished
    assert (done.refused, done.missed) == ((), 0)
    assert len(given) > 25
    np.testing.assert_allclose(arm.asked[-1].q, given[-1].curve.positions[-1], atol=1e-9)
    q = np.array([one.q for one in arm.asked])
    velocity = np.array([one.velocity for one in arm.asked])
    assert np.abs(np.diff(q, axis=0)).max() < 1.0 * PERIOD
    assert np.abs(np.diff(velocity, axis=0)).max() < 3.0 * PERIOD
    np.testing.assert_allclose(done.reference, wanted(done, *given), atol=1e-6)


def test_a_later_answer_replaces_the_stretches_that_have_not_begun() -> None:
    one, two = Stretch(WHOLE, 0.0), Stretch(rest(1.0, 0.1), 1.0)
    three = Stretch(rest(0.8, -0.1), 0.8)
    arm = Controlled(quiet)
    done = arm.follow(giving((0.0, one), (0.5, two), (0.6, three)))
    assert done.finished
    assert done.refused == ()
    np.testing.assert_allclose(done.reference, wanted(done, one, three), atol=1e-9)
    four = Stretch(between(two.at(1.5), State(PANDA.home), 2.0), 1.5)  # from one that waits
    done = Controlled(quiet).follow(giving((0.0, one), (0.5, two), (0.6, four)))
    assert done.finished
    np.testing.assert_allclose(done.reference, wanted(done, one, two, four), atol=1e-9)


def test_a_late_stretch_that_meets_the_motion_takes_over() -> None:
    """The rest of the running curve, led on: it differs only after the present time."""
    led = further_on(tail(0.5), after=0.7)
    one, two = Stretch(WHOLE, 0.0), Stretch(led, 0.5)
    done = Controlled(quiet).follow(giving((0.0, one), (1.0, two)))
    assert (done.finished, done.refused, done.missed) == (True, (), 0)
    np.testing.assert_allclose(done.reference, wanted(done, one, two), atol=1e-6)
    assert done.reference[-1, 0] == pytest.approx(WHOLE.positions[-1, 0] + 0.02, abs=1e-9)


def changed(**by: float) -> State:
    """WHOLE's state after 1 s, changed in the third joint."""
    there = vars(WHOLE.at(1.0))
    third = np.array([0, 0, 1, 0, 0, 0, 0])
    return State(**{name: values + by.get(name, 0.0) * third for name, values in there.items()})


REFUSED = [
    (between(changed(q=2e-4), State(WHOLE.positions[-1]), 2.0),
     "the curve begins with 0.0002 from the running one at joint3 (at most 0.0001)"),
    (between(changed(velocity=2e-3), State(WHOLE.positions[-1]), 2.0),
     "the curve begins with a velocity 0.002 from the running one at joint3 (at most 0.001)"),
    (between(changed(acceleration=-0.02), State(WHOLE.positions[-1]), 2.0),
     "with an acceleration 0.02 from the running one at joint3 (at most 0.01)"),
    (between(WHOLE.at(1.0), WHOLE.at(1.9), 2.0), "the curve does not end at rest"),
    (rest(1.0, 4.0, 20.0), "the curve leaves the limits of joint"),
    (rest(1.0, 0.0, 0.1), "of its limit"),
    (Trajectory(WHOLE.times, *WHOLE.rows(), tuple("abcdefg")), "the curve moves a, b, c"),
]  # fmt: skip


@pytest.mark.parametrize(("curve", "told"), REFUSED)
def test_a_stretch_is_refused_and_the_motion_goes_on(curve: Trajectory, told: str) -> None:
    one = Stretch(WHOLE, 0.0)
    done = Controlled(quiet).follow(giving((0.0, one), (0.9, Stretch(curve, 1.0))))
    assert (done.finished, done.missed) == (True, 0)
    assert len(done.refused) == 1
    assert done.refused[0].startswith("0.900 s: ")
    assert told in done.refused[0]
    np.testing.assert_allclose(done.reference, wanted(done, one), atol=1e-12)


def test_within_the_guard_a_stretch_joins() -> None:
    near = between(changed(q=9e-5, velocity=9e-4, acceleration=9e-3), State(PANDA.home), 2.0)
    done = Controlled(quiet).follow(giving((0.0, Stretch(WHOLE, 0.0)), (0.9, Stretch(near, 1.0))))
    assert (done.finished, done.refused) == (True, ())
    np.testing.assert_allclose(done.reference[-1], PANDA.home, atol=1e-9)


def test_an_arm_waits_at_the_end_of_a_curve_for_a_question_of_its_own() -> None:
    """A stretch that is answered to the question after the end goes on from there."""
    back = between(State(WHOLE.positions[-1]), State(PANDA.home), 2.0)
    one, two = Stretch(WHOLE, 0.005), Stretch(back, 2.5)
    arm = Controlled(quiet)
    done = arm.follow(giving((0.0, one), (2.01, two)))
    assert done.finished
    np.testing.assert_allclose(done.reference, wanted(done, one, two), atol=1e-12)
    assert arm.at[-1] == pytest.approx(4.5, abs=0.03)


def test_without_a_stretch_the_arm_waits_and_gives_up() -> None:
    arm = Controlled(quiet, wait=1.5)
    done = arm.follow(lambda *_: None)
    assert (done.finished, done.reason) == (False, "no stretch came")
    assert 1.5 <= arm.at[-1] < 2.0
    assert np.abs(np.array([one.q for one in arm.asked]) - PANDA.home).max() == 0.0
    far = Stretch(between(State(PANDA.home + 0.1), State(PANDA.home), 2.0), 0.1)
    done = Controlled(quiet, wait=0.5).follow(giving((0.0, far)))
    assert done.reason.startswith("no stretch came that can be taken; at 0.000 s: the curve begins")
    assert len(done.refused) == 1


def test_one_motion_at_a_time_from_rest_within_the_limits() -> None:
    arm, caught = Controlled(quiet), list[str]()

    def source(now: float, _: State, __: State) -> Stretch | None:
        for again in (lambda: arm.execute(WHOLE), lambda: arm.follow(giving())):
            with pytest.raises(InvalidRequestError, match="another curve is being executed"):
                again()
            caught.append("refused")
        return Stretch(WHOLE, 0.0) if not now else None

    assert arm.follow(source).finished
    assert len(caught) > 100
    for period in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidRequestError, match="period is"):
            arm.follow(giving(), period=period)
    with pytest.raises(InvalidRequestError, match="the source is a Stretch, not a function"):
        arm.follow(Stretch(WHOLE, 0.0))  # type: ignore[arg-type]
    arm.asked.append(State(PANDA.home, np.full(7, 0.1)))
    with pytest.raises(InvalidRequestError, match=r"cannot be held where it is: .*a velocity 0.1"):
        arm.follow(giving())
    arm.asked.append(State(PANDA.upper + 0.1))
    with pytest.raises(InvalidRequestError, match=r"cannot be held .* leaves the limits"):
        arm.follow(giving())


def test_what_is_no_stretch() -> None:
    with pytest.raises(InvalidRequestError, match=r"curve is .*: must be a Trajectory"):
        Stretch([PANDA.home], 0.0)  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match="begins is nan: must be finite"):
        Stretch(WHOLE, float("nan"))


def test_plans_that_are_made_again_in_motion_join() -> None:
    """The simulated arm is led by four plans, and picks as it does by one."""
    scene = load_scene("scenario-3")
    arm, ran = SimulatedArm(scene), list[tuple[Plan, float]]()

    def source(now: float, _: State, reference: State) -> Stretch | None:
        if not ran:
            ran.append((plan(scene, start_state=reference), now))
        elif len(ran) < 4 and now > len(ran):
            (running, began), begins = ran[-1], now + 0.2
            ran.append((plan(scene, previous=running, at=begins - began), begins))
        else:
            return None
        return Stretch(ran[-1][0].trajectory, ran[-1][1])

    done = arm.follow(source)
    assert (done.finished, done.refused, done.missed, len(ran)) == (True, (), 0, 4)
    stretches = [Stretch(made.trajectory, begins) for made, begins in ran]
    np.testing.assert_allclose(done.reference, wanted(done, *stretches), atol=1e-6)
    assert arm.outcome().success
