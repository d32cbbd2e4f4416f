"""Curves on an arm: the protocol of an executor, what is checked before and while the arm moves.

>>> from optipromp import plan
>>> from optipromp.execution import PandaPy  # or Franky, or SimulatedArm of optipromp.simulation
>>> arm = PandaPy("robot.local")  # doctest: +SKIP
>>> made = plan("scenario-3", start_state=arm.state())  # doctest: +SKIP
>>> arm.execute(made.trajectory.slowed(5.0)).finished  # doctest: +SKIP
True
"""

from optipromp.execution.executor import Executed, Executor, Follower, Guard
from optipromp.execution.franka import Franky, PandaPy

__all__ = ["Executed", "Executor", "Follower", "Franky", "Guard", "PandaPy"]
