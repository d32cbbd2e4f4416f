"""Tables and 3-D views as HTML, for notebooks and reports."""

import webbrowser
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import mkdtemp

from optipromp.core.files import write_atomically

DPI = 100  # of pictures in notebooks and reports
HEIGHT = 540  # [pixel] of a 3-D view there


@dataclass(frozen=True, eq=False, repr=False)
class View3D:
    """A page to turn and play: its ``html`` needs no network."""

    html: str

    def _repr_html_(self) -> str:
        return frame(self.html, HEIGHT)

    def save(self, path: Path | str) -> None:
        """Write the HTML. Raises InvalidRequestError where it cannot be written."""
        write_atomically(Path(path), self.html.encode("utf-8"))

    def open(self) -> None:
        """Open it in the browser, from a file in a temporary folder."""
        path = Path(mkdtemp(prefix="optipromp-")) / "view.html"
        self.save(path)
        webbrowser.open(path.as_uri())


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """An HTML table of texts; the first of each row is its name."""
    out = ["<table>"]
    if head:
        cells = "".join(f"<th>{escape(text)}</th>" for text in head)
        out.append(f'<tr class="head">{cells}</tr>')
    for name, *values in rows:
        cells = "".join(f"<td>{escape(value)}</td>" for value in values)
        out.append(f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>')
    return "".join([*out, "</table>"])


def frame(html: str, height: int) -> str:
    """An HTML page inside another, of which it sees nothing: its scripts are of no origin."""
    return (
        f'<iframe sandbox="allow-scripts" srcdoc="{escape(html)}" title="3-D view" '
        f'style="width:100%;height:{height}px;border:1px solid #d5d9dd"></iframe>'
    )
