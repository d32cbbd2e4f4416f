"""Probabilistic movement primitives: learn and condition.

>>> import numpy as np
>>> from optipromp.promp import Basis, JointPoint, condition, fit
>>> rng = np.random.default_rng(0)
>>> phase = np.linspace(0, 1, 100)[:, None]
>>> promp = fit([phase * goal for goal in rng.normal(1.0, 0.2, (20, 1, 3))], Basis(count=8))
>>> reached = condition(promp, [JointPoint(1.0, [1.1, 0.9, 1.0])])
>>> reached.mean_trajectory(100)[-1].round(6).tolist()
[1.1, 0.9, 1.0]
"""

from optipromp.promp.basis import Basis as Basis
from optipromp.promp.checks import ConditioningWarning as ConditioningWarning
from optipromp.promp.checks import ConvergenceWarning as ConvergenceWarning
from optipromp.promp.checks import RegularisedWarning as RegularisedWarning
from optipromp.promp.checks import UnitsWarning as UnitsWarning
from optipromp.promp.conditioning import ConditioningReport as ConditioningReport
from optipromp.promp.conditioning import condition as condition
from optipromp.promp.conditioning import condition_with_report as condition_with_report
from optipromp.promp.demonstrations import Demonstration as Demonstration
from optipromp.promp.demonstrations import Demonstrations as Demonstrations
from optipromp.promp.demonstrations import load_demonstrations as load_demonstrations
from optipromp.promp.demonstrations import save_demonstrations as save_demonstrations
from optipromp.promp.em import fit_em as fit_em
from optipromp.promp.learning import fit as fit
from optipromp.promp.learning import held_out_residuals as held_out_residuals
from optipromp.promp.learning import residuals as residuals
from optipromp.promp.model import ProMP as ProMP
from optipromp.promp.points import JointPoint as JointPoint
from optipromp.promp.points import TaskPoint as TaskPoint
from optipromp.promp.tasks import TaskMap as TaskMap
