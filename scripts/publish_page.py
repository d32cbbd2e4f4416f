"""The page of figures, its pictures, and the README's table, of ``docs/results/``."""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from optipromp_bench.experiments.forest import Panels, Share, forest

Book = Mapping[str, Any]
Results = Mapping[str, Mapping[str, Any]]  # what is kept of each result, by name
ENDS = "(95 %)"  # how the head of a column of shares ends
BESIDE = "images/figures-before.svg"
OTHER = f"""## Beside the version before

What is other than in the version before: neither share is within the other's interval. Its results
stand in `docs/results/before`. The scenes are others, of the same kinds.

![The figures of the table, drawn]({BESIDE})"""
HEAD = """<!-- Made by scripts/publish.py --page of docs/results/: change those. -->
# Figures

All that was measured, each result with its version and its commands, which run in its commit; in
simulations, nothing on a real plant. Intervals are Wilson's, 95 %: the line through a dot of a
picture. A bar of a picture is a time over another's: to the left of 1 ours is shorter.

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
    drawn = pictures(book, results)
    parts = [section(row, results[row["name"]], drawn) for row in book["result"]]
    if BESIDE in drawn:
        rows = [[f"{panel}, %", label, *each.values()]
                for panel, lines in others(book, results).items()
                for label, each in lines.items()]  # fmt: skip
        parts.insert(0, f"{OTHER}\n\n{table(['what', 'of', 'then', 'now'], rows)}\n\n")
    return "\n".join([HEAD, *parts])


def section(row: Book, found: Mapping[str, Any], drawn: Mapping[str, str]) -> str:
    """Of one result."""
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
    if (picture := file_of(row)) in drawn:
        parts.append(f"![{row['title']}: the figures of the tables, drawn]({picture})")
    for title, each in found["tables"].items():
        parts += [f"**{title}**", table(each["columns"], each["rows"])]
        parts += ["\n".join(f"- {note}" for note in each["notes"])] if each["notes"] else []
    return "\n\n".join([*parts, f"```\n{told}\n```", ""])


def file_of(row: Book) -> str:
    """Where the picture of a result is, in docs."""
    return f"images/figures-{row['name']}.svg"


def pictures(book: Book, results: Results) -> dict[str, str]:
    """The pictures by their files: of shares, and of times over others' in a panel a table."""
    out = {}
    for row in (row for row in book["result"] if "draw" in row):
        panels: Panels = {}
        for title, each in results[row["name"]]["tables"].items():
            for label, series, shares in shares_in(each, row["draw"]):
                for head, share in shares.items():
                    of, _, panel = head.rpartition(": ")
                    panels.setdefault(panel, {}).setdefault(label, {})[series or of] = share
            for label, line in labelled(each, row["draw"]):
                for head, name in row["draw"].get("ratios", {}).items():
                    if ratio := re.fullmatch(r"(\d+(?:\.\d+)?)(?: ×.*)?", line.get(head, "")):
                        lines = panels.setdefault(f"{title}: times", {}).setdefault(label, {})
                        lines[name] = float(ratio[1])
        if panels:
            out[file_of(row)] = forest(panels)
    if panels := others(book, results):
        out[BESIDE] = forest(panels)
    return out


def others(book: Book, results: Results) -> Panels:
    """The shares of which neither is within the other's interval, here and in ``before``."""
    out: Panels = {}
    for row in (row for row in book["result"] if results.get(f"before/{row['name']}")):
        then, now = (
            {(head, label, by): share for each in found["tables"].values()
             for label, by, shares in shares_in(each, row["draw"])
             for head, share in shares.items()}
            for found in (results[f"before/{row['name']}"], results[row["name"]])
        )  # fmt: skip
        for (head, label, by), share in now.items():
            was = then.get((head, label, by), share)
            if not (was.low <= share.share <= was.high or share.low <= was.share <= share.high):
                lines = out.setdefault(f"{row['title']}: {head}", {})
                lines[", ".join(filter(None, (label, by)))] = {"then": was, "now": share}
    return out


def labelled(found: Mapping[str, Any], draw: Book) -> Iterator[tuple[str, dict[str, str]]]:
    """The rows of a table by their labels; none where it lacks a column of these."""
    heads = found["columns"]
    for cells in found["rows"] if set(draw["label"]) <= set(heads) else ():
        line = dict(zip(heads, cells, strict=True))
        yield ", ".join(line[name].replace("`", "") for name in draw["label"] if line[name]), line


def shares_in(found: Mapping[str, Any], draw: Book) -> Iterator[tuple[str, str, dict[str, Share]]]:
    """Of each row of a table its label, its cell under ``by`` and its shares by their heads."""
    for label, line in labelled(found, draw):
        numbers = {head: re.findall(r"[\d.]+", cell) for head, cell in line.items()}
        shares = {
            head.removesuffix(ENDS).rstrip(" %,"): Share(*map(float, numbers[head]))
            for head in line if head.endswith(ENDS) and len(numbers[head]) == 3
        }  # fmt: skip
        if shares:
            yield label, line[draw["by"]] if "by" in draw else "", shares
