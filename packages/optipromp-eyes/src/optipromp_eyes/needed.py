"""Modules that a package of ours or its extra brings."""

from importlib import import_module
from typing import Any

from optipromp.core.errors import InvalidRequestError, installed_by


def needed(module: str, words: str, what: str) -> Any:
    """A module that a package of ours or its extra brings; or else a refusal of these words."""
    try:
        return import_module(module)
    except ImportError:
        raise InvalidRequestError(f"{words} {installed_by(what)}") from None


def opencv() -> Any:
    """OpenCV's module."""
    return needed("cv2", "the eyes need OpenCV:", "optipromp-eyes")
