"""What a controller does, decides, and counts as good enough."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from optipromp.control.parameters import LoopParameters
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Plan
from optipromp.core.scenes.scene import SceneObject


class LoopStage(StrEnum):
    """What the controller does."""

    LOOK = "look"  # it stands and looks, or plans
    GO = "go"  # the tool follows a plan, moved with the plant
    RETREAT = "retreat"  # the tool goes back along its path
    DONE = "done"  # the tool is at the target
    GAVE_UP = "gave_up"  # the tool stands away from the fruits


@dataclass(frozen=True)
class Decision:
    """A decision: its time by the controller's clock [s], the stage that begins, and the reason."""

    time: float
    stage: LoopStage
    why: str


def with_covariance(item: SceneObject, parameters: LoopParameters) -> SceneObject:
    """A fruit that was seen before, with a covariance."""
    if item.covariance is not None:
        return item
    return replace(item, covariance=parameters.known**2 * np.eye(3))


def excess(made: Plan | OptiPrompError) -> float:
    """Predicted harm over what a success may have; 0 without a model, infinite without a motion."""
    if isinstance(made, OptiPrompError) or not made.valid:
        return math.inf
    return 0.0 if made.prediction is None else made.prediction.harm / made.prediction.threshold
