"""Probabilistic movement primitives: learn and condition.

>>> import numpy as np
>>> from optipromp.core.promp import Basis, JointPoint, condition, fit
>>> rng = np.random.default_rng(0)
>>> phase = np.linspace(0, 1, 100)[:, None]
>>> promp = fit([phase * goal for goal in rng.normal(1.0, 0.2, (20, 1, 3))], Basis(count=8))
>>> reached = condition(promp, [JointPoint(1.0, [1.1, 0.9, 1.0])])
>>> reached.mean_trajectory(100)[-1].round(6).tolist()
[1.1, 0.9, 1.0]
"""

from optipromp.core.promp.basis import Basis as Basis
from optipromp.core.promp.checks import ConditioningWarning as ConditioningWarning
from optipromp.core.promp.checks import ConvergenceWarning as ConvergenceWarning
from optipromp.core.promp.checks import RegularisedWarning as RegularisedWarning
from optipromp.core.promp.checks import UnitsWarning as UnitsWarning
from optipromp.core.promp.conditioning import ConditioningReport as ConditioningReport
from optipromp.core.promp.conditioning import condition as condition
from optipromp.core.promp.conditioning import condition_with_report as condition_with_report
from optipromp.core.promp.demonstrations import Demonstration as Demonstration
from optipromp.core.promp.demonstrations import Demonstrations as Demonstrations
from optipromp.core.promp.demonstrations import load_demonstrations as load_demonstrations
from optipromp.core.promp.demonstrations import save_demonstrations as save_demonstrations
from optipromp.core.promp.learning import fit as fit
from optipromp.core.promp.learning import fit_em as fit_em
from optipromp.core.promp.learning import held_out_residuals as held_out_residuals
from optipromp.core.promp.learning import residuals as residuals
from optipromp.core.promp.model import ProMP as ProMP
from optipromp.core.promp.tasks import JointPoint as JointPoint
from optipromp.core.promp.tasks import TaskMap as TaskMap
from optipromp.core.promp.tasks import TaskPoint as TaskPoint
