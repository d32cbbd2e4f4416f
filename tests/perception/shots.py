"""The photograph of a cluster, taken once."""

from functools import cache

from optipromp.laboratory.generate import generate
from optipromp.laboratory.simulation.photograph import Photograph, photograph

SEED = 60011


@cache
def shot_of(seed: int = SEED) -> Photograph:
    return photograph(generate("cluster", seed), seed=seed)
