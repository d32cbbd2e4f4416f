"""Curves on an arm: the protocol of an executor, what is checked before and while the arm moves.

>>> from optipromp import plan
>>> from optipromp.execution import PandaPy  # or Franky, or SimulatedArm of optipromp.simulation
>>> arm = PandaPy("robot.local")  # doctest: +SKIP
>>> made = plan("scenario-3", start_state=arm.state())  # doctest: +SKIP
>>> arm.execute(made.trajectory.slowed(5.0)).finished  # doctest: +SKIP
True
"""

from optipromp.execution.executor import Executed as Executed
from optipromp.execution.executor import Executor as Executor
from optipromp.execution.executor import Follower as Follower
from optipromp.execution.executor import Guard as Guard
from optipromp.execution.franka import Franky as Franky
from optipromp.execution.franka import PandaPy as PandaPy
