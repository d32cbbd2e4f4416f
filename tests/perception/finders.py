"""A finder of one's own, by its name."""

from optipromp.perception.detector import ByDetector


def own() -> ByDetector:
    return ByDetector(lambda rgb: [])
