"""``drift`` and ``i-promp-guard``: planners of the core with other settings."""

from dataclasses import dataclass

from optipromp.core.planning import IProMP, OptiProMP
from optipromp.core.pushing.rules import DriftRule


@dataclass(frozen=True)
class Drifting(OptiProMP):
    """The arm follows the tool path of the paper's drift rule, without a push prediction.

    The tool passes each neighbour along ±y_g at R_gripper and a clearance, on the side away from
    the neighbour's stem.
    """

    prediction: bool = False
    rule: DriftRule = "paper"


@dataclass(frozen=True)
class Guarded(IProMP):
    """i-promp with a tool whose mouth is closed until the last push is done.

    The path leads the rim under each neighbour; an open mouth would swallow the neighbour.
    """

    guard: bool = True
