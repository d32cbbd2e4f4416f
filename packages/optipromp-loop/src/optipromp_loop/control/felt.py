"""What the arm feels: whether what it took out of the plant weighs what the fruit weighs."""

from collections import deque

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.objects import SceneObject, mass_of
from optipromp.core.values import array
from optipromp_loop.control.parameters import LoopParameters

FEWEST = 5  # readings of which a mean is taken: a choice


class Felt:
    """Forces of the world on the tool, in the frame of the base, without the tool's own weight.

    Attributes:
        empty: (3,) mean of what was felt while the tool was empty and stood [N]; None: unknown.
    """

    def __init__(self, up: FloatArray, parameters: LoopParameters) -> None:
        self._up, self._parameters = up, parameters
        self._readings = deque[tuple[float, FloatArray]](maxlen=1000)
        self.empty: FloatArray | None = None

    def feel(self, time: float, force: FloatArray) -> None:
        """Take a reading in: ``force`` (3,) at a ``time`` [N].

        Raises:
            InvalidRequestError: no three finite values.
        """
        self._readings.append((time, array("force", force, 3)))

    def mean(self, now: float, stood: float) -> FloatArray | None:
        """Mean (3,) of the last readings of an arm that stands since ``stood`` [N].

        None: it has not stood for long enough, or too few readings came.
        """
        since = now - self._parameters.weighed
        if stood > since:
            return None
        late = [force for time, force in self._readings if since <= time <= now]
        return np.mean(late, axis=0) if len(late) >= FEWEST else None

    def stands_empty(self, now: float, stood: float) -> None:
        """Note what an arm feels that stands outside of the plant, since ``stood`` [s]."""
        mean = self.mean(now, stood)
        self.empty = self.empty if mean is None else mean

    @staticmethod
    def weight(target: SceneObject) -> float:
        """What a target weighs [N]."""
        return mass_of(target) * PUSH.beam.gravity

    def tells(self, weight: float) -> bool:
        """Whether a target of a ``weight`` [N] can be told from none."""
        least = 2.0 * self._parameters.weight_error
        return self.empty is not None and weight >= least

    def against(self, mean: FloatArray, weight: float) -> str:
        """Why a target of a ``weight`` [N] is not free in a tool that feels ``mean`` (3,)."""
        assert self.empty is not None
        load, error = mean - self.empty, self._parameters.weight_error
        pull = float(np.linalg.norm(load + weight * self._up))
        if pull > weight + 2.0 * error:
            return f"its stem still holds the target, by {pull:.1f} N"
        if -float(load @ self._up) < 0.5 * weight:
            return f"the tool is empty: the target would weigh {weight:.2f} N"
        return ""
