"""Execution of trajectories on an arm: the protocol, and checks before and during the motion.

>>> from optipromp import plan
>>> from optipromp.core.execution import PandaPy  # or Franky, or the simulation's SimulatedArm
>>> arm = PandaPy("robot.local")  # doctest: +SKIP
>>> made = plan("scenario-3", start_state=arm.state())  # doctest: +SKIP
>>> arm.execute(made.trajectory.slowed(5.0)).finished  # doctest: +SKIP
True
"""

from optipromp.core.execution.executor import Executed as Executed
from optipromp.core.execution.executor import Executor as Executor
from optipromp.core.execution.executor import Follower as Follower
from optipromp.core.execution.executor import Guard as Guard
from optipromp.core.execution.franka import Franky as Franky
from optipromp.core.execution.franka import PandaPy as PandaPy
