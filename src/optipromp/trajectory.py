"""Trajectories: joint positions at uniformly spaced waypoints."""

import math
from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray, frozen
from optipromp.errors import InvalidRequestError


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Joint positions at T uniformly spaced waypoints.

    Args:
        positions: (T, n) [rad, or m for a prismatic joint].
        dt: time between two waypoints [s].
        joint_names: n names.

    Raises:
        InvalidRequestError: fewer than 3 waypoints, a value that is not finite, a ``dt``
            that is not positive, or a wrong number of names.
    """

    positions: FloatArray
    dt: float
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        positions = frozen(self.positions)
        if positions.ndim != 2 or positions.shape[0] < 3:
            raise InvalidRequestError(
                f"a trajectory needs at least 3 waypoints as (T, n); got shape {positions.shape}"
            )
        if positions.shape[1] != len(self.joint_names):
            raise InvalidRequestError(
                f"{len(self.joint_names)} joint names for {positions.shape[1]} columns"
            )
        if not np.isfinite(positions).all():
            waypoint, joint = (int(i) for i in np.argwhere(~np.isfinite(positions))[0])
            raise InvalidRequestError(
                f"position at waypoint {waypoint}, joint {joint} is not finite"
            )
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise InvalidRequestError(f"dt is {self.dt}; it must be positive [s]")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "joint_names", tuple(self.joint_names))

    @property
    def n_waypoints(self) -> int:
        """T, the number of waypoints."""
        return int(self.positions.shape[0])

    @property
    def duration(self) -> float:
        """Time from the first waypoint to the last [s]."""
        return self.dt * (self.n_waypoints - 1)

    @property
    def times(self) -> FloatArray:
        """Time of each waypoint (T,) [s]."""
        return np.asarray(np.arange(self.n_waypoints) * self.dt, dtype=np.float64)

    @property
    def velocities(self) -> FloatArray:
        """Velocity of each interval (T-1, n) [rad/s or m/s]."""
        return np.asarray((self.positions[1:] - self.positions[:-1]) / self.dt)

    @property
    def accelerations(self) -> FloatArray:
        """Acceleration at each waypoint (T, n); at rest before the first and after the last."""
        steps = _steps(self.positions)
        return np.asarray((steps[1:] - steps[:-1]) / self.dt**2)

    def with_dt(self, dt: float) -> "Trajectory":
        """The same waypoints at another spacing [s]."""
        return Trajectory(self.positions, dt, self.joint_names)


def shortest_dt(positions: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> float:
    """The smallest waypoint spacing at which velocity and acceleration limits hold.

    Args:
        positions: (T, n).
        velocity: (n,) limits, may be infinite.
        acceleration: (n,) limits, may be infinite; motion starts and ends at rest.

    Returns:
        dt [s]; 1e-3 for a trajectory that does not move or has no limits.
    """
    steps = _steps(positions)
    by_velocity = (np.abs(steps) / velocity).max()
    by_acceleration = (np.abs(steps[1:] - steps[:-1]) / acceleration).max()
    return max(float(by_velocity), math.sqrt(by_acceleration), 1e-3)


def _steps(positions: FloatArray) -> FloatArray:
    """From each waypoint to the next (T+1, n), at rest before the first and after the last."""
    still = np.zeros_like(positions[:1])
    return np.concatenate([still, positions[1:] - positions[:-1], still])
