"""Execution of trajectories on an arm: the protocol, and checks before and during the motion."""

from optipromp.core.execution.executor import Executed as Executed
from optipromp.core.execution.executor import Executor as Executor
from optipromp.core.execution.executor import Follower as Follower
from optipromp.core.execution.executor import Guard as Guard
