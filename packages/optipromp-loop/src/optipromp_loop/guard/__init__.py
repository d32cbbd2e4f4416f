"""The guard: whatever a policy wants, the arm does the nearest thing that harms nothing."""

from optipromp_loop.guard.guard import Guard as Guard
from optipromp_loop.guard.guard import GuardParameters as GuardParameters
from optipromp_loop.guard.guard import Safe as Safe
from optipromp_loop.guard.motion import joints_for as joints_for
