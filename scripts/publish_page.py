"""The page of figures, its pictures, and the README's table, of ``docs/results/``."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from optipromp_bench.experiments.forest import Share, Shares, forest

Book = Mapping[str, Any]
Results = Mapping[str, Mapping[str, Any]]  # what is kept of each result, by name
ENDS = "(95 %)"  # how the head of a column of shares ends
HEAD = """<!-- Made by scripts/publish.py --page of docs/results/: change those. -->
# Figures

All that was measured, each result with its version and its commands, which run in its commit; in
simulations, nothing on a real plant. Intervals are Wilson's, 95 %: the line through a dot of a
picture.

- **Promised and picked**: the plan was a `success`, and its execution left the ripe fruit alone in
  the cup, with nothing harmed. **Broken promise**: a `success` whose execution did not.
- **Executed although refused**: how many runs go well if every plan is executed.
- **Clean**: the ripe fruit alone is in the cup, and nothing was harmed. Harm counts before success.
- **Alone**: so many scenes ended so for one of two and not for the other; p is McNemar's, exact.

Names like `cluster` are kinds of random scenes ([presets](glossary.md)). A *frozen* result has
answered its question, and stays of its version. `python scripts/publish.py` tells which others are
stale: what they depend on behaves otherwise since.
"""


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table of a page."""
    lines = ["|".join(["", *(f" {cell} " if cell != "" else " " for cell in cells), ""])
             for cells in (columns, *rows)]  # fmt: skip
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])


def anchor(row: Book) -> str:
    """Where the page's section of a result is."""
    return "figures.md#" + str(row["title"]).lower().replace(" ", "-")


def promised(book: Book, results: Results) -> str:
    """The README's table: of each of ``readme`` the rows with the largest and the least share."""
    rows = []
    for row in book["result"]:
        found = results[row["name"]]["tables"].values()
        for cell, what in row.get("readme", {}).items():
            lines = [
                line for each in found for line in shares_in(each, row["draw"]) if line[1] == cell
            ]
            lines.sort(key=lambda line: next(iter(line[2].values())).share)
            ends = [(f"`{label}`", *shares.values()) for label, _, shares in (lines[-1], lines[0])]
            told = [f"{label} {clean}" for label, clean, _ in ends]
            harmed = "; ".join(str(share) for *_, share in ends)
            rows.append([f"[{what}](docs/{anchor(row)})", *told, harmed])
    heads = [
        "what",
        "best kind of scene",
        "worst kind of scene",
        "harmed, or promises broken, in these",
    ]
    return table(heads, rows)


def page(book: Book, results: Results) -> str:
    """The page of figures."""
    shown: set[str] = set()
    return "\n".join([HEAD, *(section(row, results[row["name"]], shown) for row in book["result"])])


def section(row: Book, found: Mapping[str, Any], shown: set[str]) -> str:
    """Of one result; a picture stands in the section of the first that it shows."""
    told = "\n".join(found["commands"]).replace("{out}", row["name"]).replace("{entry}", "NAME")
    machine = found["machine"]
    versions = ", ".join(f"{name} {v}" for name, v in found.get("versions", {}).items() if v)
    frozen = f" **Frozen**: {row['frozen']}." if "frozen" in row else ""
    parts = [
        f"## {row['title']}",
        f"{row['about']}{frozen}",
        f"Version `{found['version']}`, {found['date'][:10]} (commit {found['commit']}); "
        f"{machine['cpu']}, {machine['cores']} cores. {found['scenes']}.",
        *([f"With {versions}."] if versions else []),
    ]
    picture = row.get("draw", {}).get("picture")
    if picture and picture not in shown:
        shown.add(picture)
        parts.append(f"![{row['title']}: shares with their intervals]({file_of(picture)})")
    for title, each in found["tables"].items():
        parts += [f"**{title}**", table(each["columns"], each["rows"])]
        parts += ["\n".join(f"- {note}" for note in each["notes"])] if each["notes"] else []
    return "\n\n".join([*parts, f"```\n{told}\n```", ""])


def file_of(picture: str) -> str:
    """Where a picture is, in docs."""
    return f"images/figures-{picture}.svg"


def pictures(book: Book, results: Results) -> dict[str, str]:
    """The pictures by their files; results that name the same picture stand in it together."""
    drawn: dict[str, Shares] = {}
    for row in book["result"]:
        for each in results[row["name"]]["tables"].values() if "draw" in row else ():
            shares = drawn.setdefault(row["draw"]["picture"], {})
            for label, series, found in shares_in(each, row["draw"]):
                for head, share in found.items():
                    of, _, panel = head.rpartition(": ")
                    lines = shares.setdefault(panel, {})
                    name = row["draw"].get("before", "") + label
                    lines.setdefault(name, {})[series or of] = share
    return {file_of(name): forest(shares) for name, shares in drawn.items()}


def shares_in(found: Mapping[str, Any], draw: Book) -> Iterator[tuple[str, str, dict[str, Share]]]:
    """Of each row of a table its label, its cell under ``by`` and its shares by their heads."""
    heads = found["columns"]
    for cells in found["rows"] if set(draw["label"]) <= set(heads) else ():
        line = dict(zip(heads, cells, strict=True))
        label = ", ".join(line[name].replace("`", "") for name in draw["label"] if line[name])
        numbers = {head: re.findall(r"[\d.]+", cell) for head, cell in line.items()}
        shares = {
            head.removesuffix(ENDS).rstrip(" %,"): Share(*map(float, numbers[head]))
            for head in heads if head.endswith(ENDS) and len(numbers[head]) == 3
        }  # fmt: skip
        if shares:
            yield label, line[draw["by"]] if "by" in draw else "", shares
