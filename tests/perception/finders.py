"""A finder of one's own, by its name."""

from optipromp_eyes.detector import ByDetector


def own() -> ByDetector:
    return ByDetector(lambda rgb: [])
