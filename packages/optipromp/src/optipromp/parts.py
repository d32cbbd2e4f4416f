"""What one package of the project gives to another that does not import it, by entry points."""

from contextlib import suppress
from importlib.metadata import entry_points
from typing import Any

from optipromp.core.errors import InvalidRequestError

GROUP = "optipromp.parts"
"""Group of entry points: an object for each name of :data:`GIVEN`."""

GIVEN = {
    "Paper": "paper", "PushCost": "paper", "beside_paper": "paper",
    "simulate": "sim", "mjcf": "sim",
    "study_report": "bench",
    "foreseen": "loop", "look_at_files": "eyes",
    "bag_pictures": "ros", "load_picks": "ros", "load_recording": "ros",
    "read_trajectory": "ros", "write_plan": "ros",
    "teaching_page": "page",
}  # fmt: skip
"""The package that gives each part."""

NEEDS = {
    "ros": "loop eyes", "sim": "loop eyes", "bench": "loop eyes sim paper", "page": "loop eyes sim",
}  # fmt: skip
"""Which further packages a package needs."""


def added(name: str) -> Any:
    """The part of a name; None where its package is not installed."""
    return next((entry.load() for entry in entry_points(group=GROUP, name=name)), None)


def part(name: str) -> Any:
    """The part of a name. Raises InvalidRequestError where its package is not installed."""
    with suppress(ModuleNotFoundError):  # of a package that this one needs
        if (found := added(name)) is not None:
            return found
    raise InvalidRequestError(f"{name} {lacking(GIVEN[name])}")


def lacking(package: str) -> str:
    """The words for what a package has that is not installed."""
    wanted = (*NEEDS.get(package, "").split(), package)
    words = " ".join(f"-e packages/optipromp-{each}" for each in wanted)
    return f"is of the package optipromp-{package}: pip install {words} in the clone of OptI-ProMP"
