"""The display of values in notebooks."""

import html
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any

from optipromp.core.errors import InvalidRequestError

RENDERERS = "optipromp.renderers"
"""Group of entry points: modules with functions ``rich``, ``plot`` and ``show`` of a value."""


class Shown:
    """A value with a line of words, rich text in notebooks, a picture and a 3-D view."""

    def _words(self) -> str:
        raise NotImplementedError

    def _table(self) -> Sequence[tuple[str, str]]:
        """Names and values of the table in notebooks, of a type that no renderer knows."""
        return ()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._words()}>"

    def _repr_html_(self) -> str:
        renderer = _renderer()
        return html.escape(repr(self)) if renderer is None else str(renderer.rich(self))

    def plot(self, *args: Any) -> Any:
        """A picture for notebooks, with matplotlib's ``figure`` and ``save(path)`` of a PNG file.

        The picture of a primitive takes the demonstrations that it was learnt from, if any.
        """
        return _needed().plot(self, *args)

    def show(self) -> Any:
        """A 3-D view for notebooks; ``open()`` opens it in a browser.

        ``save(path)`` writes one HTML file that needs no network.
        """
        return _needed().show(self)


def _renderer() -> Any:
    """The first module of the entry points that draws values; None without one."""
    return next((entry.load() for entry in entry_points(group=RENDERERS)), None)


def _needed() -> Any:
    renderer = _renderer()
    if renderer is None:
        raise InvalidRequestError(
            "nothing that draws is installed: pip install -e packages/optipromp-page in the clone"
        )
    return renderer
