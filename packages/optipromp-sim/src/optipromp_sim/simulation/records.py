"""The records of a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.robots.model import Robot
from optipromp.core.trajectory import Trajectory


class StemCut(NamedTuple):
    """What a scissor did when it closed."""

    stems: tuple[str, ...]  # ids of the fruits whose stems were cut
    fruits: tuple[str, ...]  # ids of the fruits that were between the closing blades
    time: float  # at which it closed [s]


@dataclass(frozen=True, eq=False)
class Rollout:
    """The records of a run: R records at a fixed rate, of F targets and pushables.

    Attributes:
        times: (R,) [s].
        q, velocity, torque: (R, n) of the independent joints.
        reference: (R, n) reference positions of the controller.
        tool_point: (R, 3) [m], ``tool_axis`` (R, 3).
        fruit_ids: F ids; ``fruit_positions`` (R, F, 3) [m].
        attached: (R, F) whether each still hangs on its stem; False without a stem.
        fruit_force: (R, F) largest force of one other object on each since the last record [N].
        stem_force: (R, F) largest force of arm or tool on its stem since the last record [N].
        states: (R, nq) MuJoCo's generalised positions, for pictures.
        contacts: (C, 9) contact points at each record, those with static and avoid objects left
            out: record, indices of two entities, point (3,) [m], force of the first entity on the
            second (3,) [N].
        motion: time at which the trajectory ends and the hold begins [s].
        warnings: of MuJoCo, or the place of a NaN; not empty means a failed run.
        limit_use: largest share of each limit.
        tension: largest pull along each stem, by id [N].
        torn_at: time at which each torn fruit came off, by id [s].
        tracking_error: largest distance of the tool point from the reference [m].
        joint_error: largest distance of a joint from the reference [rad or m].
        cut: what a scissor did when it closed; None for another tool.
    """

    times: FloatArray
    q: FloatArray
    velocity: FloatArray
    torque: FloatArray
    reference: FloatArray
    tool_point: FloatArray
    tool_axis: FloatArray
    fruit_ids: tuple[str, ...]
    fruit_positions: FloatArray
    attached: BoolArray
    fruit_force: FloatArray
    stem_force: FloatArray
    states: FloatArray
    contacts: FloatArray
    motion: float
    warnings: tuple[str, ...]
    limit_use: Mapping[str, float] = field(default_factory=dict)
    tension: Mapping[str, float] = field(default_factory=dict)
    torn_at: Mapping[str, float] = field(default_factory=dict)
    tracking_error: float = 0.0
    joint_error: float = 0.0
    cut: StemCut | None = None

    def arrays(self) -> dict[str, FloatArray]:
        """The records as arrays by name, for an NPZ file."""
        names = (
            "times", "q", "velocity", "torque", "reference", "tool_point", "tool_axis",
            "fruit_positions", "attached", "fruit_force", "stem_force", "states", "contacts",
        )  # fmt: skip
        arrays = {name: getattr(self, name) for name in names}
        arrays["fruit_ids"] = np.array(self.fruit_ids, dtype=np.str_)
        arrays["motion"] = np.array(self.motion)
        return arrays


def used(robot: Robot, trajectory: Trajectory) -> dict[str, float]:
    """Largest share of the limits of velocity, acceleration and jerk."""
    limits = np.stack([robot.velocity, robot.acceleration, robot.jerk])
    shares = (judging.extremes(trajectory).largest / limits).max(axis=1)
    return dict(zip(judging.RATES, shares.tolist(), strict=True))
