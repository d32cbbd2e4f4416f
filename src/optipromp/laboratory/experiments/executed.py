"""The curve that a closed loop executed: stretches that took over from one another."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.execution.streaming import Stretch
from optipromp.core.judging import extremes
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import SHORTEST_STEP, State, Trajectory


@dataclass(frozen=True)
class Smoothness:
    """How smooth an executed curve is.

    Attributes:
        takeovers: number of stretches that took over.
        jumps: largest jump of a joint's position [rad or m], velocity [rad/s or m/s] and
            acceleration [rad/s² or m/s²] at a takeover.
        shares: largest share of the robot's limits of velocity, acceleration and jerk.
    """

    takeovers: int
    jumps: tuple[float, float, float]
    shares: tuple[float, float, float]

    @property
    def worst_jump(self) -> float:
        """Largest of ``jumps`` in its own unit."""
        return max(self.jumps)

    @property
    def worst_limit(self) -> float:
        """Largest of ``shares``."""
        return max(self.shares)


def executed(
    stretches: Sequence[Stretch], robot: Robot, start: State, until: float = np.inf
) -> Smoothness:
    """The jumps and the rates of the parts of stretches that were executed.

    A stretch runs from its begin until the next begins, by the executor's times.

    Args:
        stretches: in the order in which they took over.
        robot: whose limits hold.
        start: of the arm before the first stretch.
        until: executor's time at which the run ended [s].
    """
    jumps, shares = np.zeros(3), np.zeros(3)
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    taken = [stretch for stretch in stretches if stretch.begins < until]
    ends = [*(one.begins for one in taken[1:]), until][: len(taken)]
    for k, (stretch, end) in enumerate(zip(taken, ends, strict=True)):
        before = start if k == 0 else taken[k - 1].at(stretch.begins)
        jumps = np.maximum(jumps, _jumps(before, stretch.at(stretch.begins)))
        part = cut(stretch.curve, end - stretch.begins)
        if part is not None:
            shares = np.maximum(shares, (extremes(part).largest / limits).max(axis=1))
    return Smoothness(len(taken), _three(jumps), _three(shares))


def cut(curve: Trajectory, length: float) -> Trajectory | None:
    """The first ``length`` seconds of a curve, exactly; None where nothing is left."""
    if length >= curve.duration:
        return curve
    if length < 2.0 * SHORTEST_STEP:
        return None
    times = curve.times[curve.times < length - SHORTEST_STEP]
    kept = len(times)
    q, v, a = (
        np.concatenate([whole[:kept], end])
        for whole, end in zip(curve.rows(), curve.sample(length), strict=True)
    )
    return Trajectory(np.append(times, length), q, v, a, curve.joint_names)


def _jumps(before: State, after: State) -> np.ndarray:
    pairs = (
        (before.q, after.q),
        (before.velocity, after.velocity),
        (before.acceleration, after.acceleration),
    )
    return np.array([np.abs(b - a).max() for a, b in pairs])


def _three(values: np.ndarray) -> tuple[float, float, float]:
    a, b, c = (float(value) for value in values)
    return a, b, c
