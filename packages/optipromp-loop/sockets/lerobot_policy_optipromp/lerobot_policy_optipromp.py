"""The closed loop of OptI-ProMP as a policy of LeRobot, found by its commands."""

import optipromp_loop.lerobot  # noqa: F401  (registers itself)
