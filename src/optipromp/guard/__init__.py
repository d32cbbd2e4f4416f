"""The guard: whatever a policy wants, the arm does the nearest thing that harms nothing."""

from optipromp.guard.guard import Guard as Guard
from optipromp.guard.guard import GuardParameters as GuardParameters
from optipromp.guard.guard import Safe as Safe
from optipromp.guard.motion import joints_for as joints_for
