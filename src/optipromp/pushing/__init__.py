"""Pushing: which objects are in the way, what the tool does to them, and the path of the tool.

Rules give a side to pass each neighbour on. A model of the push predicts the harm of a tool path,
and one search finds the path of least harm in it.
"""

from optipromp.pushing.hanging import Hanging
from optipromp.pushing.interactive import Push, pushes
from optipromp.pushing.model import Combined, Prediction, PushModel, Round, Schedule, search
from optipromp.pushing.path import ToolPath, through
from optipromp.pushing.rules import Drift, DriftRule, drift_choices, neighbours, rule_paths
from optipromp.pushing.standing import Standing

__all__ = [
    "Combined",
    "Drift",
    "DriftRule",
    "Hanging",
    "Prediction",
    "Push",
    "PushModel",
    "Round",
    "Schedule",
    "Standing",
    "ToolPath",
    "drift_choices",
    "neighbours",
    "pushes",
    "rule_paths",
    "search",
    "through",
]
