"""Random scenes by seed that an arm could solve, and the errors of a detector."""

from optipromp.scenes.generate.furniture import FURNITURE, Furniture
from optipromp.scenes.generate.generator import (
    PANDA,
    PRESETS,
    GenerationReport,
    Preset,
    generate,
    generate_with_report,
)
from optipromp.scenes.generate.noise import NOISES, Noise, noisy, perceived

__all__ = [
    "FURNITURE",
    "NOISES",
    "PANDA",
    "PRESETS",
    "Furniture",
    "GenerationReport",
    "Noise",
    "Preset",
    "generate",
    "generate_with_report",
    "noisy",
    "perceived",
]
