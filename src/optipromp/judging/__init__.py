"""The judge: checks any trajectory, with code that shares nothing with the planners."""

from optipromp.judging.clearance import Overlap, clearances, pushed_away, swept
from optipromp.judging.curve import Extremes, extremes
from optipromp.judging.kinematics import centers, refined
from optipromp.judging.validator import (
    AXIS_TOLERANCE,
    GOAL_TOLERANCE,
    RATES,
    RATIO_TOLERANCE,
    Judgement,
    Metrics,
    Violation,
    judge,
    paper_violations,
)

__all__ = [
    "AXIS_TOLERANCE",
    "GOAL_TOLERANCE",
    "RATES",
    "RATIO_TOLERANCE",
    "Extremes",
    "Judgement",
    "Metrics",
    "Overlap",
    "Violation",
    "centers",
    "clearances",
    "extremes",
    "judge",
    "paper_violations",
    "pushed_away",
    "refined",
    "swept",
]
