"""Arms with faults, and what they must end in."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from optipromp.core.errors import Code, ExecutionError
from optipromp.core.execution import Follower, Guard
from optipromp.core.robots.library import load_robot
from optipromp.core.trajectory import State, Trajectory

PANDA = load_robot("panda")
PERIOD = 1e-3  # [s]


class Controlled(Follower):
    """A controller at 1 kHz with a clock of its own, and an arm that is where it is asked to be.

    ``spoil(arm, what)`` is called before each ``tick``, ``state`` and ``command``; it may change
    ``now``, raise, or return another state.
    """

    def __init__(self, spoil: Callable[["Controlled", str], Any], **guard: float) -> None:
        super().__init__(PANDA, Guard(**guard))
        self.spoil, self.now, self.lost = spoil, 0.0, False
        self.asked = [State(PANDA.home)]
        self.at = [0.0]

    def state(self) -> State:
        return self.spoil(self, "state") or self.asked[-1]

    @contextmanager
    def stream(self) -> Iterator[Iterator[float]]:
        yield self._ticks()

    def _ticks(self) -> Iterator[float]:
        while self.now < 60.0:
            self.spoil(self, "tick")
            if self.lost:
                return
            yield self.now
            self.now += PERIOD

    def command(self, reference: State) -> None:
        self.spoil(self, "command")
        self.asked.append(reference)
        self.at.append(self.now)


def step(size: float = 0.6, duration: float = 2.0) -> Trajectory:
    s = np.linspace(0.0, 1.0, 41)[:, None]
    q = PANDA.home + size * s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * np.array([1, 0, 1, 0, 1, 0, 1])
    return Trajectory.through(q, duration / 40, PANDA.joint_names)


def once(what: str, after: float, effect: Callable[[Controlled], Any]) -> Any:
    """Spoil the first ``what`` after a time [s]."""
    done = list[float]()

    def spoil(arm: Controlled, which: str) -> Any:
        if which == what and arm.now > after and not done:
            done.append(arm.now)
            return effect(arm)
        return None

    return spoil


def always(what: str, after: float, effect: Callable[[Controlled], Any]) -> Any:
    return lambda arm, which: effect(arm) if which == what and arm.now > after else None


def late(by: float) -> Callable[[Controlled], None]:
    def effect(arm: Controlled) -> None:
        arm.now += by

    return effect


def throws(error: BaseException) -> Callable[[Controlled], Any]:
    def effect(_: Controlled) -> Any:
        raise error

    return effect


def no_number(_: Controlled) -> State:
    return State(np.full(7, np.nan))


def in_trouble(motion: Callable[..., object], *arguments: Any) -> ExecutionError:
    """The error of a motion that fails."""
    with pytest.raises(ExecutionError) as caught:
        motion(*arguments)
    assert caught.value.code is Code.EXECUTION_FAILED
    assert "\n" not in caught.value.message
    return caught.value


def assert_at_rest(arm: Controlled) -> None:
    """The last reference is at rest, and none jumps, in place or in speed."""
    last = arm.asked[-1]
    assert not last.velocity.any()
    assert not last.acceleration.any()
    q = np.array([one.q for one in arm.asked])
    v = np.array([one.velocity for one in arm.asked])
    assert np.abs(np.diff(q, axis=0)).max() < 0.6 * 1.875 / 2.0 * arm.guard.advance * 1.01
    assert np.abs(np.diff(v, axis=0)).max() < 15.0 * arm.guard.advance
    assert 0.05 < q[-1, 0] - PANDA.home[0] < 0.55  # on the way, not at an end
