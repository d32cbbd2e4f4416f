"""Demonstrations recorded in the page: the tool is dragged, the joints follow."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import Basis, Demonstrations, ProMP, fit
from optipromp.core.promp.demonstrations import Demonstration, save_demonstrations
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot

MISSED = 1e-3  # [m] from the handle to the tool; a pose that misses by more is out of reach
SHORTEST = 1e-3  # [s] between two samples, at least
LONGEST_PAUSE = 0.2  # [s] between two samples, at most: longer pauses of the hand are shortened
FEWEST_SAMPLES = 5  # of a demonstration


@dataclass
class Recorder:
    """Demonstrations of one robot, and the one that is being recorded.

    Attributes:
        robot: whose joints are recorded.
        q: (n,) present configuration.
        times, rows: of the demonstration under way: [s] and (n,) each.
        kept: accepted demonstrations.
        last: time of the last sample [s].
    """

    robot: Robot
    q: FloatArray
    times: list[float] = field(default_factory=list)
    rows: list[FloatArray] = field(default_factory=list)
    kept: list[Demonstration] = field(default_factory=list)
    last: float = 0.0

    def begin(self, q: FloatArray) -> None:
        """Start anew from ``q`` (n,)."""
        self.q, self.times, self.rows = np.array(q), [], []

    def drag(self, point: FloatArray, now: float) -> bool:
        """Follow the handle to ``point`` (3,) [m] at the time ``now`` [s]; False if out of reach.

        The tool keeps its direction. Out of reach, the arm stays where it is.
        """
        if not self.times:
            self.times, self.rows, self.last = [0.0], [self.q], now - SHORTEST
        axis = self.robot.tool_pose(self.rows[0])[1]
        found, error = ik.track(self.robot, np.asarray(point)[None], axis[None], self.q)
        if error[0] > MISSED:
            return False
        self.q = found[0]
        if now >= self.last + SHORTEST:
            self.times.append(self.times[-1] + min(now - self.last, LONGEST_PAUSE))
            self.rows.append(self.q)
            self.last = now
        return True

    def accept(self) -> int:
        """Keep the demonstration under way; returns the number of demonstrations."""
        if len(self.times) < FEWEST_SAMPLES:
            raise InvalidRequestError(
                f"the recording has {len(self.times)} samples: drag the tool further"
            )
        self.kept.append(Demonstration(np.array(self.times), np.array(self.rows)))
        self.times, self.rows = [], []
        return len(self.kept)

    @property
    def demonstrations(self) -> Demonstrations:
        """The accepted demonstrations."""
        return Demonstrations(tuple(self.kept), self.robot.joint_names)

    def learn(self) -> ProMP:
        """A primitive learnt from the accepted demonstrations."""
        return fit(self.demonstrations, Basis())

    def save(self, path: Path) -> None:
        """Write the demonstrations as ``optipromp learn`` reads them."""
        save_demonstrations(self.demonstrations, path)
