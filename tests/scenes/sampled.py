"""Random scenes, made once."""

import functools

from optipromp_sim.generate import generate_with_report

made = functools.cache(generate_with_report)
