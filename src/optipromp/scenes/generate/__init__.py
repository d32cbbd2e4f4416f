"""Seeded clutter: random scenes that an arm could solve, and what a detector would see of them."""

from optipromp.scenes.generate.generator import (
    PRESETS,
    GenerationReport,
    Preset,
    generate,
    generate_with_report,
)
from optipromp.scenes.generate.noise import perceived

__all__ = [
    "PRESETS",
    "GenerationReport",
    "Preset",
    "generate",
    "generate_with_report",
    "perceived",
]
