"""``drift`` and ``i-promp-guard``: planners of the core with other settings."""

from dataclasses import dataclass

from optipromp.core.planning.planners import IProMP, OptiProMP
from optipromp.core.pushing.rules import DriftRule


@dataclass(frozen=True)
class Drift(OptiProMP):
    """The arm follows the tool path that the paper's drift rule gives.

    It passes each neighbour by R_gripper and a clearance along ±y_g, on the side away from the
    stem.
    """

    prediction: bool = False
    rule: DriftRule = "paper"


@dataclass(frozen=True)
class Guarded(IProMP):
    """i-promp whose mouth is closed until the last push is done.

    Its closed rim is led under each neighbour. An open mouth swallows what it is led onto.
    """

    guard: bool = True
