"""Names and words as they are shown, and what values show of themselves in notebooks."""

import html
from importlib.metadata import entry_points
from typing import Any

from optipromp.core.errors import InvalidRequestError

RENDERERS = "optipromp.renderers"
"""Group of entry points: each a module with ``rich``, ``plot`` and ``show`` of a value."""

LONGEST_NAME = 1000
"""Letters of a name, at most."""


def is_name(text: str) -> bool:
    """Whether ``text`` can name something: 1 to :data:`LONGEST_NAME` letters, all printable."""
    return 0 < len(text) <= LONGEST_NAME and printable(text) == text


def no_name(text: str) -> str:
    """What is wrong with a text that is no name, in words."""
    told = printable(text)[:60]
    return f"'{told}': must have 1 to {LONGEST_NAME} letters and no control characters"


def printable(text: str) -> str:
    """``text`` with what would steer a terminal, or turn the direction of writing, escaped."""
    if text.isprintable():
        return text
    joiners = "\u200c\u200d"  # which some scripts need
    return "".join(
        letter if letter.isprintable() or letter in joiners or letter == "\u00a0"
        else letter.encode("unicode_escape").decode()
        for letter in text
    )  # fmt: skip


class Shown:
    """A value with a line of words, rich text in notebooks, a picture and a 3-D view."""

    def _words(self) -> str:
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._words()}>"

    def _repr_html_(self) -> str:
        renderer = _renderer()
        return html.escape(repr(self)) if renderer is None else str(renderer.rich(self))

    def plot(self, *args: Any) -> Any:
        """A picture: shown by a notebook; ``figure`` is matplotlib's, ``save(path)`` a PNG file.

        A primitive's takes the demonstrations that it was learnt from, if there are any.

        Raises:
            InvalidRequestError: there is no picture of such a value.
        """
        return _needed().plot(self, *args)

    def show(self) -> Any:
        """A 3-D view to turn and play: shown by a notebook; ``open()`` opens a browser.

        ``save(path)`` writes it as one HTML file that needs no network.

        Raises:
            InvalidRequestError: viser is not installed, or there is no 3-D view of such a value.
        """
        return _needed().show(self)


def _renderer() -> Any:
    """The module that draws values: the first that has joined; None where none has."""
    return next((entry.load() for entry in entry_points(group=RENDERERS)), None)


def _needed() -> Any:
    renderer = _renderer()
    if renderer is None:
        raise InvalidRequestError(
            "nothing that draws is installed: install optipromp as a package (pip install), "
            "so that its parts are found"
        )
    return renderer
