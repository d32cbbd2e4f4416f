"""Which neighbours, which side, which way: pushing by geometry."""

from optipromp.pushing.interactive import Push, pushes
from optipromp.pushing.neighbours import neighbours
from optipromp.pushing.sides import Drift, DriftRule, drift_choices

__all__ = ["Drift", "DriftRule", "Push", "drift_choices", "neighbours", "pushes"]
