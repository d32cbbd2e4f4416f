"""Notebooks and pages of the scripts in examples/notebooks.

    python scripts/notebooks.py [NAME ...]

Each script is cut at its ``# %%`` lines, its cells are run in one namespace, and what they print or
show is kept. Left are ``examples/notebooks/NAME.ipynb`` and ``docs/notebooks/NAME.md`` with its
pictures. Cells of nothing but ``assert`` are for those who run the script, and are left out.
"""

import argparse
import ast
import base64
import contextlib
import io
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "examples" / "notebooks"
PAGES = ROOT / "docs" / "notebooks"
MARK = re.compile(r"^# %%( \[markdown\])?\n", re.MULTILINE)
DPI = 60  # of pictures: some 50 kB each


@dataclass(frozen=True)
class NotebookCell:
    """A cell of a script: text, or code with what it said and its picture (PNG)."""

    text: str
    code: bool
    said: str = ""
    picture: bytes = b""


def cells(script: str) -> list[NotebookCell]:
    """The cells of a script in the percent format, not yet run."""
    _, *parts = MARK.split(script)
    out = []
    for kind, text in zip(parts[::2], parts[1::2], strict=True):
        if kind:
            lines = (line.removeprefix("#").removeprefix(" ") for line in text.strip().split("\n"))
            out.append(NotebookCell("\n".join(lines), code=False))
        elif not all(isinstance(item, ast.Assert) for item in ast.parse(text).body):
            out.append(NotebookCell(text.strip(), code=True))
    return out


def run(cell: NotebookCell, names: dict[str, Any]) -> NotebookCell:
    """The cell with its output; a last expression is shown, as in a notebook."""
    tree = ast.parse(cell.text)
    last = tree.body[-1]
    shown: Any = None
    with contextlib.redirect_stdout(io.StringIO()) as said:
        if isinstance(last, ast.Expr):
            tree.body.pop()
            exec(compile(tree, "cell", "exec"), names)
            shown = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        else:
            exec(compile(tree, "cell", "exec"), names)
    figure = getattr(shown, "figure", None)
    if figure is None:
        text = said.getvalue() + ("" if shown is None else f"{shown!r}\n")
        return NotebookCell(cell.text, True, text)
    file = io.BytesIO()
    figure.savefig(file, dpi=DPI, metadata={"Software": None})
    return NotebookCell(cell.text, True, said.getvalue(), file.getvalue())


def notebook(found: Sequence[NotebookCell]) -> str:
    """The notebook (format 4.5) of cells."""
    out: list[Mapping[str, Any]] = []
    for k, cell in enumerate(found):
        kept: dict[str, Any] = {"id": f"cell-{k}", "metadata": {}, "source": cell.text}
        if cell.code:
            outputs: list[Mapping[str, Any]] = []
            if cell.said:
                outputs.append({"output_type": "stream", "name": "stdout", "text": cell.said})
            if cell.picture:
                data = {"image/png": base64.b64encode(cell.picture).decode()}
                outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
            kept |= {"cell_type": "code", "execution_count": None, "outputs": outputs}
        else:
            kept["cell_type"] = "markdown"
        out.append(kept)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": out, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def page(found: Sequence[NotebookCell], name: str) -> tuple[str, dict[str, bytes]]:
    """The page of cells, and its pictures by their file names."""
    out, pictures = [], dict[str, bytes]()
    for cell in found:
        if not cell.code:
            out.append(cell.text)
            continue
        out.append(f"```python\n{cell.text}\n```")
        if cell.said:
            out.append(f"```text\n{cell.said.rstrip()}\n```")
        if cell.picture:
            file = f"{name}_{len(pictures) + 1}.png"
            pictures[file] = cell.picture
            out.append(f"![What the cell shows]({file})")
    head, *rest = out
    made = (
        f"*Made by* `python scripts/notebooks.py {name}`. *The notebook is* "
        f"`examples/notebooks/{name}.ipynb`."
    )
    return "\n\n".join([head, made, *rest]) + "\n", pictures


def main(names: Sequence[str]) -> None:
    """Run the scripts and write their notebooks and pages."""
    known = sorted(path.stem for path in SOURCES.glob("*.py"))
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"{', '.join(known)}; else all")
    names = parser.parse_args(names).names
    if unknown := sorted({*names} - {*known}):
        parser.error(f"no script {', '.join(unknown)}; there are {', '.join(known)}")
    PAGES.mkdir(exist_ok=True)
    for name in names or known:
        space: dict[str, Any] = {"__name__": "__main__"}
        script = (SOURCES / f"{name}.py").read_text(encoding="utf-8")
        found = [run(cell, space) if cell.code else cell for cell in cells(script)]
        (SOURCES / f"{name}.ipynb").write_text(notebook(found), encoding="utf-8")
        text, pictures = page(found, name)
        (PAGES / f"{name}.md").write_text(text, encoding="utf-8")
        for file, content in pictures.items():
            (PAGES / file).write_bytes(content)


if __name__ == "__main__":
    main(sys.argv[1:])
