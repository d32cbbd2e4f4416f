"""Probabilistic movement primitives: learn, condition, combine.

>>> import numpy as np
>>> from optipromp.promp import Basis, JointPoint, condition, fit
>>> rng = np.random.default_rng(0)
>>> phase = np.linspace(0, 1, 100)[:, None]
>>> promp = fit([phase * goal for goal in rng.normal(1.0, 0.2, (20, 1, 3))], Basis(count=8))
>>> reached = condition(promp, [JointPoint(1.0, [1.1, 0.9, 1.0])])
>>> reached.mean_trajectory(100)[-1].round(6).tolist()
[1.1, 0.9, 1.0]
"""

from optipromp.promp.basis import Basis
from optipromp.promp.checks import (
    ConditioningWarning,
    ConvergenceWarning,
    RegularisedWarning,
    UnitsWarning,
)
from optipromp.promp.conditioning import ConditioningReport, condition, condition_with_report
from optipromp.promp.demonstrations import (
    Demonstration,
    Demonstrations,
    load_demonstrations,
    save_demonstrations,
)
from optipromp.promp.em import fit_em
from optipromp.promp.learning import fit, held_out_residuals, residuals
from optipromp.promp.model import ProMP
from optipromp.promp.operations import (
    Marginals,
    Timing,
    blend,
    coactivate,
    coactivate_marginals,
    modulate,
)
from optipromp.promp.points import JointPoint, TaskPoint
from optipromp.promp.tasks import TaskMap

__all__ = [
    "Basis",
    "ConditioningReport",
    "ConditioningWarning",
    "ConvergenceWarning",
    "Demonstration",
    "Demonstrations",
    "JointPoint",
    "Marginals",
    "ProMP",
    "RegularisedWarning",
    "TaskMap",
    "TaskPoint",
    "Timing",
    "UnitsWarning",
    "blend",
    "coactivate",
    "coactivate_marginals",
    "condition",
    "condition_with_report",
    "fit",
    "fit_em",
    "held_out_residuals",
    "load_demonstrations",
    "modulate",
    "residuals",
    "save_demonstrations",
]
