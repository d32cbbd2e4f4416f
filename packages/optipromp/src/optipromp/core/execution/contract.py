"""Tests that every executor must pass; subclass them to test your executor.

    # test_my_arm.py, for pytest
    from optipromp.core.execution.contract import ExecutorContract

    class TestMyArm(ExecutorContract):
        def executor(self):
            return MyArm("simulated")

A real arm moves in these tests: each joint by 0.05 rad over about 2 s, from where the arm stands,
and by 0.075 rad where a second curve replaces the first.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from unittest import SkipTest

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution.executor import Executed, Executor, Follower, Source, Stretch
from optipromp.core.trajectory import State, Trajectory

MOVED = 0.05  # [rad or m] motion of every joint, chosen


def _elsewhere(curve: Trajectory, by: float | FloatArray) -> Trajectory:
    """The same curve, each joint moved by ``by`` [rad or m], or each by one of (n,)."""
    q, velocities, accelerations = curve.rows()
    return Trajectory(curve.times, q + by, velocities, accelerations, curve.joint_names)


def _rest(curve: Trajectory, after: float, further: float = 0.0) -> Trajectory:
    """From the state of a curve ``after`` a time [s] to ``further`` [rad or m] than its end."""
    begin, end = curve.at(after), curve.at(curve.duration)
    still = np.zeros_like(end.q)
    return Trajectory(
        np.array([0.0, curve.duration]),
        np.array([begin.q, end.q + further]),
        np.array([begin.velocity, still]),
        np.array([begin.acceleration, still]),
        curve.joint_names,
    )


class ExecutorContract(ABC):
    """The contract, as test methods for pytest."""

    duration = 2.0
    """Duration of the tested motion [s]."""

    tolerance = 0.02
    """Largest distance of a joint from the curve [rad or m]; largest velocity at rest [rad/s or
    m/s]."""

    late = 0.5
    """Longest time beyond a curve's duration, and longest time to come to rest [s]."""

    stopping = 0.2
    """Longest time from a fault to the end of the reference at rest [s]."""

    lead = 0.2
    """Time from a call of a source to the begin of the stretch that it returns [s]."""

    @abstractmethod
    def executor(self) -> Executor:
        """An executor of an arm at rest, away from its limits and from obstacles."""

    def clock(self) -> float:
        """The arm's time [s]; the time of a simulation may run faster than real time."""
        return time.perf_counter()

    def curve(self, arm: Executor, step: float = MOVED) -> Trajectory:
        """A smooth step of every joint from where the arm is."""
        begin, s = arm.state().q, np.linspace(0.0, 1.0, 21)[:, None]
        q = begin + step * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        return Trajectory.through(q, self.duration / 20, arm.joint_names)

    def test_it_is_an_executor_with_a_state(self) -> None:
        """The executor has the methods; its state has a value for each joint, and is at rest."""
        arm = self.executor()
        assert isinstance(arm, Executor)
        state = arm.state()
        assert isinstance(state, State)
        assert state.q.shape == (len(arm.joint_names),)
        assert np.abs(state.velocity).max() < self.tolerance

    def test_a_curve_is_followed_in_its_own_time(self) -> None:
        """The arm ends at the curve's end, at rest, and is near the curve at every record."""
        arm = self.executor()
        arm.execute(Trajectory.still(arm.state().q, (0.0, 0.1), arm.joint_names))  # it compiles
        curve, began = self.curve(arm), self.clock()
        done = arm.execute(curve)
        took = self.clock() - began
        assert done.finished, done.reason
        assert done.reason == ""
        assert self.duration - 0.01 <= took <= self.duration + self.late
        assert np.abs(arm.state().q - curve.positions[-1]).max() < self.tolerance
        assert np.abs(arm.state().velocity).max() < self.tolerance
        wanted, _, _ = curve.sample(done.times)
        assert np.abs(done.reference - wanted).max() < 1e-9
        assert done.largest_error < self.tolerance
        assert done.times[-1] >= self.duration - 0.05

    def test_it_says_where_the_arm_is_on_the_way(self) -> None:
        """``watch`` is called with growing times and with states near the curve."""
        arm, seen = self.executor(), list[tuple[float, State]]()
        curve = self.curve(arm)
        arm.execute(curve, lambda now, state: seen.append((now, state)))
        times = np.array([now for now, _ in seen])
        assert len(times) > 5
        assert (np.diff(times) > 0.0).all()
        assert times[-1] > 0.8 * self.duration
        away = [np.abs(state.q - curve.at(now).q).max() for now, state in seen]
        assert max(away) < self.tolerance

    def _ended(self, arm: Executor, done: Executed, begins: float = 0.0) -> None:
        """The arm came to rest on the way along a curve, and its reference did not jump."""
        assert not done.finished
        assert done.reason
        assert np.abs(arm.state().velocity).max() < self.tolerance
        assert done.times[-1] < begins + 0.5 * self.duration + self.late
        progress = (done.reference[-1] - done.reference[0]) / MOVED
        assert progress.min() > 0.05
        assert progress.max() < 0.95
        speed = np.diff(done.reference, axis=0) / np.diff(done.times)[:, None]
        assert np.abs(speed).max() < 1.5 * MOVED * 1.875 / self.duration
        before = arm.state().q
        assert np.abs(before - done.reference[-1]).max() < self.tolerance
        time.sleep(0.05)
        assert np.abs(arm.state().q - before).max() < self.tolerance

    def test_what_watches_can_end_it_midway(self) -> None:
        """The arm comes to rest on the way; its reference does not jump."""
        arm = self.executor()
        done = arm.execute(self.curve(arm), lambda now, _: now > 0.5 * self.duration)
        self._ended(arm, done)
        assert ((done.reference[-1] - done.reference[0]) / MOVED).min() > 0.2

    def test_what_watches_may_fail(self) -> None:
        """The arm comes to rest on the way, then the error is raised."""
        arm = self.executor()

        def watch(now: float, _: State) -> bool:
            if now > 0.5 * self.duration:
                raise ArithmeticError
            return False

        done = None
        try:
            arm.execute(self.curve(arm), watch)
        except ExecutionError as error:
            done = error.executed
        assert isinstance(done, Executed)
        self._ended(arm, done)

    def _faulty(self, arm: Executor, tracking: float, state: Callable[[], State]) -> Executed:
        """A motion in which midway ``state`` is what the arm says, and its guard is narrower."""

        def watch(now: float, _: State) -> None:
            if now > 0.5 * self.duration:
                vars(arm)["state"] = state
                if isinstance(arm, Follower):
                    arm.guard = replace(arm.guard, tracking=tracking)

        done: object = None
        try:
            done = arm.execute(self.curve(arm), watch)
        except ExecutionError as error:
            done = error.executed
        vars(arm).pop("state")
        assert isinstance(done, Executed)
        self._ended(arm, done)
        assert done.times[-1] < 0.5 * self.duration + self.stopping
        return done

    def test_an_arm_away_from_its_curve_comes_to_rest(self) -> None:
        """Its state is 1 mrad (or mm) off, of which the guard allows a twentieth."""
        arm = self.executor()
        if not isinstance(arm, Follower):
            raise SkipTest("it has no guard that could be made narrower")
        state = arm.state
        done = self._faulty(arm, 5e-5, lambda: State(state().q + 1e-3, state().velocity))
        assert "from the curve" in done.reason

    def test_an_arm_without_a_state_comes_to_rest(self) -> None:
        """Its state cannot be read any more."""

        def gone() -> State:
            raise ConnectionError

        arm = self.executor()
        assert self._faulty(arm, 0.1, gone).reason

    def test_another_thread_can_abort(self) -> None:
        """``abort`` ends ``execute``; then the next curve can be executed."""
        arm = self.executor()

        def watch(now: float, _: State) -> None:
            if now > 0.3 * self.duration:
                thread = threading.Thread(target=arm.abort)
                thread.start()
                thread.join()

        self._ended(arm, arm.execute(self.curve(arm), watch))
        assert arm.execute(self.curve(arm, -0.5 * MOVED)).finished

    def test_to_abort_at_rest_does_nothing(self) -> None:
        """A later curve is followed."""
        arm = self.executor()
        arm.abort()
        assert arm.execute(self.curve(arm)).finished

    def test_a_curve_that_begins_elsewhere_is_refused(self) -> None:
        """The arm does not move."""
        arm = self.executor()
        self._refused(arm, _elsewhere(self.curve(arm), 0.2))

    def test_a_curve_that_begins_or_ends_in_motion_is_refused(self) -> None:
        """A curve must begin as the arm moves, here at rest, and must end at rest."""
        arm = self.executor()
        fine = self.curve(arm).resample(100.0)
        half = len(fine.times) // 2
        for part in (slice(0, half), slice(half, None)):
            times, rows = fine.times[part], fine.rows(part)
            q = rows[0] - rows[0][0] + arm.state().q
            self._refused(arm, Trajectory(times - times[0], q, rows[1], rows[2], fine.joint_names))

    def test_a_curve_of_other_joints_is_refused(self) -> None:
        """Joints are compared by name."""
        arm = self.executor()
        curve = self.curve(arm)
        names = tuple(f"other_{name}" for name in curve.joint_names)
        self._refused(arm, Trajectory(curve.times, *curve.rows(), names))

    def test_a_curve_beyond_the_limits_is_refused(self) -> None:
        """The curve is 50 times as fast, and ten times as long."""
        arm = self.executor()
        self._refused(arm, self.curve(arm, 0.5).slowed(0.02))

    def _refused(self, arm: Executor, curve: Trajectory) -> None:
        before, moved = arm.state().q, True
        with suppress(InvalidRequestError):
            arm.execute(curve)
            moved = False
        assert moved, "it was executed"
        assert np.abs(arm.state().q - before).max() < self.tolerance

    def _source(self, given: list[Stretch], whole: Trajectory, *later: Source) -> Source:
        """A source of ``whole`` at once, and of what each of ``later`` returns, asked midway.

        ``whole`` is moved to begin at the reference, which an arm at rest is near: its encoders
        are noisy. All that the source returns is put into ``given``.
        """
        waiting = list(later)

        def source(now: float, measured: State, reference: State) -> Stretch | None:
            found: Stretch | None = None
            if not given:
                begins = _elsewhere(whole, reference.q - whole.positions[0])
                found = Stretch(begins, now + self.lead)
            elif waiting and now > given[0].begins + 0.3 * self.duration:
                found = waiting.pop(0)(now, measured, reference)
            if found is not None:
                given.append(found)
            return found

        return source

    def _unchanged(self, arm: Executor, done: Executed, first: Stretch) -> None:
        """The motion was that of the first stretch, to its end."""
        assert done.finished, done.reason
        wanted, _, _ = first.curve.sample(done.times - first.begins)
        assert np.abs(done.reference - wanted).max() < 1e-9
        assert done.largest_error < self.tolerance
        assert np.abs(arm.state().q - first.curve.positions[-1]).max() < self.tolerance
        assert np.abs(arm.state().velocity).max() < self.tolerance

    def test_stretches_that_join_in_motion_are_followed_without_a_jump(self) -> None:
        """The second curve leads from the first, in motion, to another end."""
        arm, given = self.executor(), list[Stretch]()
        whole = self.curve(arm)

        def second(now: float, _: State, __: State) -> Stretch:
            begins = now + self.lead
            return Stretch(_rest(given[0].curve, begins - given[0].begins, 0.5 * MOVED), begins)

        done = arm.follow(self._source(given, whole, second))
        assert done.finished, done.reason
        assert (done.reason, done.refused, done.missed) == ("", (), 0)
        one, two = given
        assert np.abs(one.at(two.begins).velocity).max() > 0.1 * MOVED / self.duration
        first, _, _ = one.curve.sample(done.times - one.begins)
        then, _, _ = two.curve.sample(done.times - two.begins)
        wanted = np.where(done.times[:, None] < two.begins, first, then)
        assert np.abs(done.reference - wanted).max() < 1e-6
        assert done.largest_error < self.tolerance
        assert np.abs(arm.state().q - one.curve.positions[-1] - 0.5 * MOVED).max() < self.tolerance
        assert np.abs(arm.state().velocity).max() < self.tolerance

    def test_a_stretch_that_jumps_is_refused_in_motion(self) -> None:
        """The curve that runs goes on to its end."""
        arm, given = self.executor(), list[Stretch]()
        whole = self.curve(arm)

        def jump(now: float, _: State, __: State) -> Stretch:
            begins = now + self.lead
            return Stretch(
                _elsewhere(_rest(given[0].curve, begins - given[0].begins), 0.01), begins
            )

        done = arm.follow(self._source(given, whole, jump))
        assert len(given) == 2
        assert len(done.refused) == 1
        assert done.missed == 0
        self._unchanged(arm, done, given[0])

    def test_a_stretch_that_comes_late_is_missed(self) -> None:
        """Its begin has passed, and meanwhile it has left what runs."""
        arm, given = self.executor(), list[Stretch]()
        whole = self.curve(arm)

        def late(now: float, _: State, __: State) -> Stretch:
            begins = now - 0.2 * self.duration
            return Stretch(_rest(given[0].curve, begins - given[0].begins, 0.5 * MOVED), begins)

        done = arm.follow(self._source(given, whole, late))
        assert len(given) == 2
        assert (done.refused, done.missed) == ((), 1)
        self._unchanged(arm, done, given[0])

    def test_a_source_may_fail_in_motion(self) -> None:
        """The arm comes to rest on the way, then the error is raised."""
        arm, given = self.executor(), list[Stretch]()

        def broken(_: float, __: State, ___: State) -> Stretch:
            raise ArithmeticError

        done = None
        try:
            arm.follow(self._source(given, self.curve(arm), broken))
        except ExecutionError as error:
            done = error.executed
        assert isinstance(done, Executed)
        self._ended(arm, done, given[0].begins)

    def test_another_thread_can_abort_what_a_source_leads(self) -> None:
        """``abort`` ends ``follow`` on the way; then the next curve can be executed."""
        arm, given = self.executor(), list[Stretch]()

        def aborts(_: float, __: State, ___: State) -> None:
            thread = threading.Thread(target=arm.abort)
            thread.start()
            thread.join()

        done = arm.follow(self._source(given, self.curve(arm), aborts))
        self._ended(arm, done, given[0].begins)
        assert arm.execute(self.curve(arm, -0.5 * MOVED)).finished
