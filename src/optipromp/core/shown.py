"""Names and texts as they are shown, and the display of values in notebooks."""

import difflib
import html
import reprlib
from collections.abc import Collection, Iterable, Sequence
from importlib.metadata import entry_points
from typing import Any

from optipromp.core.errors import InvalidRequestError

RENDERERS = "optipromp.renderers"
"""Group of entry points: modules with functions ``rich``, ``plot`` and ``show`` of a value."""

LONGEST_NAME = 1000  # most letters of a name

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60


def is_name(text: str) -> bool:
    """Whether ``text`` can name something: 1 to :data:`LONGEST_NAME` letters, all printable."""
    return 0 < len(text) <= LONGEST_NAME and printable(text) == text


def no_name(text: str) -> str:
    """The words of a refusal of ``text``, which is no name."""
    return (
        f"'{printable(text)[:60]}': must have 1 to {LONGEST_NAME} letters and no control characters"
    )


def short(value: object) -> str:
    """A value in at most some 60 letters."""
    return _SHORT.repr(value)


def suggest(name: object, valid: Iterable[str]) -> str:
    """``valid are ...``, and ``did you mean ...?`` if a valid name is close to ``name``."""
    names = list(valid)
    near = difflib.get_close_matches(str(name), names, n=1)
    question = f"; did you mean {near[0]!r}?" if near else ""
    return f"valid are {', '.join(names)}{question}"


def check_one_of(what: str, value: object, valid: Collection[str]) -> None:
    """Refuse a value that is none of the valid names."""
    if not (isinstance(value, str) and value in valid):
        raise InvalidRequestError(f"{what} is {value!r}: {suggest(value, valid)}")


def printable(text: str) -> str:
    """``text`` with characters escaped that control a terminal or the direction of writing."""
    if text.isprintable():
        return text
    joiners = "\u200c\u200d"  # which some scripts need
    return "".join(
        letter
        if letter.isprintable() or letter in joiners or letter == "\u00a0"
        else letter.encode("unicode_escape").decode()
        for letter in text
    )


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
            "nothing that draws is installed: install optipromp as a package, by "
            "pip install -e . in the clone of OptI-ProMP, so that its parts are found"
        )
    return renderer
