"""Streams of curves for an arm."""

from typing import Any

import numpy as np
from tests.execution.arms import PANDA, step

from optipromp.core.execution import Executed
from optipromp.core.execution.executor import Source, Stretch
from optipromp.core.trajectory import State, Trajectory

WHOLE = step()


def quiet(*_: Any) -> None:
    """Spoil nothing."""


def rest(after: float, further: float = 0.0, duration: float = 2.0) -> Trajectory:
    """From WHOLE's state ``after`` a time to ``further`` than its end."""
    return between(WHOLE.at(after), State(WHOLE.positions[-1] + further), duration)


def between(begin: State, end: State, duration: float) -> Trajectory:
    rows = zip(vars(begin).values(), vars(end).values(), strict=True)
    q, velocity, acceleration = (np.array(pair) for pair in rows)
    times = np.array([0.0, duration])
    return Trajectory(times, q, velocity, acceleration, PANDA.joint_names)


def giving(*stretches: tuple[float, Stretch | None]) -> Source:
    """Each stretch once, at the first question at or after its time."""
    waiting = list(stretches)

    def source(now: float, _: State, __: State) -> Stretch | None:
        return waiting.pop(0)[1] if waiting and now >= waiting[0][0] - 1e-9 else None

    return source


def wanted(done: Executed, *stretches: Stretch) -> np.ndarray:
    """Positions of the stretches, each until the next begins, at the records."""
    out = stretches[0].curve.sample(done.times - stretches[0].begins)[0]
    for one in stretches[1:]:
        then = one.curve.sample(done.times - one.begins)[0]
        out = np.where(done.times[:, None] < one.begins - 1e-9, out, then)
    return out
