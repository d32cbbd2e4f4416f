"""The parts of a report: sections, tables, pictures, films, and the page around them."""

import platform
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.metadata import PackageNotFoundError, version

from optipromp.looks.viewer import notebook

LARGEST_FILE = 5_000_000  # bytes of a report
PACKAGES = "optipromp", "numpy", "scipy", "numba", "mujoco", "viser"
STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  color: #20262c; background: #fff; margin: 0 auto; max-width: 1080px; padding: 0 20px 40px; }
h1 { font-size: 26px; margin: 28px 0 4px; } h2 { font-size: 18px; margin: 34px 0 8px;
  border-bottom: 1px solid #d9dde1; padding-bottom: 4px; }
p { max-width: 75ch; } .faint { color: #66707a; font-size: 13px; }
.good { color: #1c7a35; } .bad { color: #b3261e; } .status { font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 8px 0 14px; font-size: 14px; }
th, td { text-align: left; vertical-align: top; padding: 4px 14px 4px 0;
  border-bottom: 1px solid #eceff1; } th[scope=row] { font-weight: 500; color: #47515a; }
tr.head th { color: #66707a; font-weight: 600; font-size: 13px; }
td { font-variant-numeric: tabular-nums; }
img, video { max-width: 100%; height: auto; display: block; }
code { background: #f3f5f7; padding: 2px 6px; border-radius: 4px; overflow-wrap: anywhere; }
figure { margin: 10px 0 18px; break-inside: avoid; } figcaption { font-size: 13px; color: #47515a; }
.cases { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: 18px; }
@media (max-width: 600px) { iframe { height: 360px !important; } body { padding: 0 12px 24px; } }
@media print { body { max-width: none; font-size: 10.5pt; padding: 0; } .screen { display: none; }
  h2 { break-after: avoid; } table, tr { break-inside: avoid; } a { color: inherit; }
  .cases { grid-template-columns: 1fr 1fr; } @page { margin: 15mm; } }
"""


def page(title: str, sections: Iterable[str]) -> bytes:
    """The HTML file, which fetches nothing."""
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
    )
    return "".join([head, *sections, "</body></html>\n"]).encode("utf-8")


def section(title: str, *content: str, screen: bool = False) -> str:
    """A heading and its content; with ``screen``, left out on paper."""
    kind = ' class="screen"' if screen else ""
    return f"<section{kind}><h2>{escape(title)}</h2>{''.join(content)}</section>"


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of text."""
    return f'<p class="{kind}">{escape(text)}</p>'


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of texts, which scrolls on a narrow screen; the first of each row is its name."""
    return f'<div class="wide">{notebook.table(rows, head)}</div>'


def picture(content: bytes, caption: str) -> str:
    """A PNG, embedded in the file."""
    return (
        f'<figure><img alt="{escape(caption)}" src="{_data("image/png", content)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def film(content: bytes, kind: str, caption: str) -> str:
    """A film of a ``kind`` (webm, mp4), embedded in the file; left out on paper."""
    source = _data(f"video/{kind}", content)
    return (
        f'<figure class="screen"><video controls loop muted src="{source}">'
        f"</video><figcaption>{escape(caption)}</figcaption></figure>"
    )


def made_with(command: str, recorded: Mapping[str, str]) -> str:
    """The section of the command and of versions."""
    versions = [(name, _version(name)) for name in PACKAGES]
    rows = [*recorded.items(), *((name, found) for name, found in versions if found)]
    rows += [("Python", platform.python_version()), ("system", platform.platform(terse=True))]
    return section("Made with", f"<p><code>{escape(command)}</code></p>", table(rows))


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode('ascii')}"
