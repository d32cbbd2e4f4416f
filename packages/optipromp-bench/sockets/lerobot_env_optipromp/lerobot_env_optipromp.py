"""The simulation of OptI-ProMP as an environment of LeRobot, found by its commands."""

import optipromp_bench.lerobot  # noqa: F401  (registers itself)
