"""Every published result: its command, whether it is stale, and the pages that show it.

    python scripts/publish.py                    what is stale, and how long it would take
    python scripts/publish.py --run [NAME ...]   run what is stale, the most important first
    python scripts/publish.py --keep NAME ...    result files anew, of runs that are done
    python scripts/publish.py --pages            write the results into README.md and docs
    python scripts/publish.py --check            exit 1, and the names, where not all is of here

``scripts/publish.toml`` has a row for each result. A run leaves ``build/publish/VERSION/NAME``, in
which it goes on after an interruption, and ends with ``docs/results/NAME.json``: version, commit,
date, machine, commands, seeds, figures. A result is stale where there is no such file, or where it
is of another version of the source; but not where ``same`` says that the plans of both versions
are the same, and what shows it. Pages show results between marks:

    <!-- result NAME:KEY -->        of a table that stands between them, or, in one line,
    <!-- end -->                    <!-- result NAME:KEY -->94 of 100<!-- end --> of words

What a result can show is its tables and words (``scripts/publish_tables.py``), what cells of them
come to (``Words`` there: a key like ``short/^panda/harmed/sum``), its ``version``, ``date``,
``seeds``, ``size`` and ``commands``; or a table that the rows of ``[tables.NAME]`` lay
out: ``{NAME:KEY}`` in a cell stands for words of a result.
In a command ``{out}`` is the folder of the run, ``{python}`` this Python, ``{entry}`` each entry.
"""

import argparse
import itertools
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(Path(__file__).resolve().parent), str(ROOT)]

import publish_tables as tables  # noqa: E402

from benchmarks.machine import describe  # noqa: E402
from benchmarks.run import SINGLE  # noqa: E402
from optipromp.core.files import json_text, write_atomically  # noqa: E402
from optipromp.laboratory.experiments.rows import source_version  # noqa: E402

MARK = re.compile(r"(<!-- result ([\w-]+)(?::([^\n>]+?))? -->)(\n?)(.*?)<!-- end -->", re.DOTALL)
PLACE = re.compile(r"\{([\w-]+):([^}]+)\}")
NUMBER = re.compile(r"(?<![\w`-])\d[\d.,]*")
SAID = re.compile(r"\d %|\d of (?:the |its )?\d")  # a share or a count in a sentence
HISTORY = "docs/decisions.md"  # what was measured at each decision, dated there
FIGURES = 0.25  # share of a table's cells that hold a number from which it holds figures: a choice
Book = Mapping[str, Any]


def book_of(root: Path) -> Book:
    """What is published: ``result`` (in order), ``tables``, ``unmarked``, ``prose``."""
    return tomllib.loads((root / "scripts/publish.toml").read_text("utf-8"))


def result_file(root: Path, name: str) -> Path:
    """Where a result is kept."""
    return root / "docs/results" / f"{name}.json"


def kept(root: Path, name: str) -> dict[str, Any]:
    """A result as it is kept; empty where there is none."""
    path = result_file(root, name)
    return dict(json.loads(path.read_text("utf-8"))) if path.exists() else {}


def why_stale(root: Path, book: Book, name: str, version: str) -> str:
    """Why a result is not of this version, nor of one that is the ``same``; empty where it is."""
    found = kept(root, name)
    if not found:
        return "no result"
    alike = {version, *book.get("same", {}).get(version, {})}
    return "" if found["version"] in alike else f"of {found['version']}"


def lacks(row: Book) -> list[str]:
    """Packages that the commands of a row need, and which are not installed."""
    held = {re.sub(r"[-_.]+", "-", each.name).lower() for each in distributions()}
    return [name for name in row.get("needs", ()) if name not in held]


def commands_of(row: Book) -> list[str]:
    """The commands of a row; one with ``{entry}`` stands for each of its ``entries``."""
    return [
        command.replace("{entry}", entry)
        for command in row["commands"]
        for entry in (row["entries"] if "{entry}" in command else [""])
    ]


# running


class Runner:
    """Runs commands; ends those that run where it is interrupted."""

    def __init__(self, root: Path, version: str, until: float) -> None:
        self.root, self.version, self.until = root, version, until
        self.running: set[subprocess.Popen[bytes]] = set()
        self.ended = False

    def folder(self, name: str) -> Path:
        """Of the commands of a result."""
        return self.root / "build/publish" / self.version / name

    def __call__(self, row: Book) -> str:
        """Run what a row lacks, and keep its result. Returns: why it is not done; empty: it is."""
        folder = self.folder(row["name"])
        folder.mkdir(parents=True, exist_ok=True)
        for k, command in enumerate(commands_of(row), 1):
            if (folder / f"{k}.out").exists():
                continue
            if self.ended or time.monotonic() > self.until:
                return f"command {k} of {len(commands_of(row))} was not begun"
            print(f"{row['name']}: {command}", flush=True)
            code = self.run(command, folder, k)
            if self.ended:
                return f"command {k} was interrupted"
            if code:
                told = (folder / f"{k}.err").read_text("utf-8").strip().splitlines() or ["no words"]
                return f"command {k} ended with {code}: {told[-1][:300]}"
        keep(self.root, row, folder, self.version)
        return ""

    def run(self, command: str, folder: Path, k: int) -> int:
        """Run one command; what it prints is ``K.out`` once it ended well."""
        for place, here in (("{out}", str(folder)), ("{python}", sys.executable)):
            command = command.replace(place, here)
        words = shlex.split(command)
        known = itertools.takewhile(lambda word: re.match(r"[A-Z_]+=", word), words)
        settings = dict(word.split("=", 1) for word in known)
        first, *words = words[len(settings) :]
        program = {"python": [sys.executable], "optipromp": [sys.executable, "-m", "optipromp"]}
        part = folder / f"{k}.part"
        with part.open("wb") as out, (folder / f"{k}.err").open("wb") as err:
            process = subprocess.Popen(
                [*program.get(first, [first]), *words], cwd=self.root, stdout=out, stderr=err,
                env={**os.environ, **SINGLE, **settings}, start_new_session=True,
            )  # fmt: skip
            self.running.add(process)
            code = process.wait()
            self.running.discard(process)
        if not code and not self.ended:
            part.replace(folder / f"{k}.out")
        return code

    def end(self) -> None:
        """Begin nothing more, and interrupt what runs: studies keep their rows."""
        self.ended = True
        for process in list(self.running):
            process.send_signal(signal.SIGINT)


def keep(root: Path, row: Book, folder: Path, version: str) -> None:
    """Write the result file of what a row's commands left in a folder."""
    here = describe()
    found = {
        "version": version,
        **{name: here[name] for name in ("commit", "date", "machine")},
        **{name: row[name] for name in ("commands", "seeds", "size")},
        "figures": tables.KINDS[row["kind"]][0](folder, row),
    }
    result_file(root, row["name"]).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(result_file(root, row["name"]), json_text(found).encode())


def run(runner: Runner, rows: Sequence[Book], workers: int) -> int:
    """Run rows in their order, as many at once as there are workers; the number not done.

    A row that measures time runs ``alone``: after those before it, and before those behind it.
    """
    failed = 0

    def one(row: Book) -> bool:
        try:
            why = runner(row)
        except (ValueError, OSError, KeyError) as error:
            why = f"its figures cannot be kept: {error!r}"
        print(f"{row['name']}: {why or 'done'}", flush=True)
        return bool(why)

    for alone, group in itertools.groupby(rows, key=lambda row: row.get("alone", False)):
        with ThreadPoolExecutor(1 if alone else workers) as pool:
            futures = [pool.submit(one, row) for row in group]
            try:
                failed += sum(future.result() for future in futures)
            except KeyboardInterrupt:
                runner.end()
                raise
    return failed


# pages


def pages_of(root: Path) -> list[Path]:
    """The pages that may show results."""
    return [root / "README.md", *sorted((root / "docs").glob("*.md"))]


def words_of(root: Path, book: Book) -> dict[str, dict[str, str]]:
    """What each result can show, by key; a table that the book lays out has the key ``""``."""
    words: dict[str, dict[str, str]] = {}
    for row in book["result"]:
        found = kept(root, row["name"])
        if found:
            told = "\n".join(found["commands"]).replace("{out}", row["name"])
            told = told.replace("{entry}", "NAME").replace("{python}", "python")
            about = {
                "version": found["version"], "date": found["date"][:10],
                "seeds": found["seeds"], "size": found["size"], "commands": f"```\n{told}\n```",
            }  # fmt: skip
            words[row["name"]] = tables.shown(row["kind"], found["figures"], about)
    known, laid_out = {row["name"] for row in book["result"]}, {}

    def filled(cell: str) -> str:
        return PLACE.sub(lambda place: words[place[1]][place[2]], cell)

    for name, laid in book.get("tables", {}).items():
        rows = [
            [filled(cell) for cell in row]
            for row in laid["rows"]
            if known & {place[1] for cell in row for place in PLACE.finditer(cell)} <= words.keys()
        ]
        laid_out[name] = {"": tables.table(laid["columns"], rows)}
    return words | laid_out


def written(text: str, words: Mapping[str, Mapping[str, str]], home: bool) -> str:
    """A page with the results between its marks; links of one in docs (not ``home``) lead there."""

    def fill(match: re.Match[str]) -> str:
        mark, name, key, line, _ = match.groups()
        if name not in words:  # not run yet
            return match[0]
        said = words[name][key or ""]
        said = said if home else said.replace("](docs/", "](")
        return f"{mark}\n\n{said}\n\n<!-- end -->" if line else f"{mark}{said}<!-- end -->"

    return MARK.sub(fill, text)


def differences(root: Path, book: Book, texts: Mapping[str, str] | None = None) -> list[str]:
    """What stands between marks and is not what the results give: page, mark.

    ``texts`` of pages, by path from the root; None: as they are.
    """
    words, out = words_of(root, book), []
    known = {row["name"] for row in book["result"]}
    for page, text in (texts or texts_of(root)).items():
        for match in MARK.finditer(text):
            shown = f"{page}: {match[1]}"
            if match[2] in known - words.keys():
                continue  # nothing is shown before it is run; the result counts as stale
            try:
                words[match[2]][match[3] or ""]
                same = written(match[0], words, page == "README.md") == match[0]
            except KeyError as error:
                out.append(f"{shown} names no result: {error}")
            else:
                out += [] if same else [f"{shown} has other figures than the result"]
    return out


def texts_of(root: Path) -> dict[str, str]:
    """Pages by their path from the root."""
    return {str(page.relative_to(root)): page.read_text("utf-8") for page in pages_of(root)}


def shown_in(root: Path, book: Book) -> dict[str, list[str]]:
    """The pages that show each result, by itself or in a table that the book lays out."""
    out: dict[str, list[str]] = {row["name"]: [] for row in book["result"]}
    for page, text in texts_of(root).items():
        names = {match[2] for match in MARK.finditer(text)}
        laid = [book["tables"][name]["rows"] for name in names & book.get("tables", {}).keys()]
        names |= {place[1] for rows in laid for row in rows for place in PLACE.finditer(str(row))}
        for name in out.keys() & names:
            out[name].append(Path(page).stem)
    return out


def figured(text: str) -> Iterator[str]:
    """The header lines of tables that hold figures and stand between no marks."""
    for found in re.findall(r"(?:^\|.*\|\n)+", MARK.sub("", text), re.MULTILINE):
        head, _, *body = found.splitlines()
        cells = [cell for line in body for cell in line.strip("|").split("|")]
        if sum(bool(NUMBER.search(cell)) for cell in cells) >= FIGURES * len(cells):
            yield head


def unlisted(root: Path, book: Book) -> list[str]:
    """Tables with figures that no marks hold, and that ``unmarked`` does not name either."""
    known = book.get("unmarked", {})
    return [
        f"{page}: {head}"
        for page, text in texts_of(root).items()
        for head in figured(text)
        if not any(head.startswith(f"| {begin}") for begin in known.get(page, {}))
    ]


def sentences(text: str) -> str:
    """The words of a page that stand between no marks, in no table and in no example."""
    text = re.sub(r"```.*?```", "", MARK.sub("_", text), flags=re.DOTALL)
    return " ".join(re.sub(r"^\|.*$", "", text, flags=re.MULTILINE).split())


def unsaid(root: Path, book: Book, texts: Mapping[str, str] | None = None) -> list[str]:
    """Shares and counts in sentences that are of no result, and that ``prose`` does not name."""
    out = []
    for page, text in (texts or texts_of(root)).items():
        words = "" if page == HISTORY else sentences(text)
        for known in book.get("prose", {}).get(page, {}):
            words = words.replace(known, "")
        for found in SAID.finditer(words):
            out.append(f"{page}: {words[max(0, found.start() - 40) : found.end() + 20]}")
    return out


def dead(root: Path, book: Book) -> list[str]:
    """What ``unmarked`` and ``prose`` name and no page has."""
    out, texts = [], texts_of(root)
    for page, phrases in book.get("prose", {}).items():
        words = sentences(texts.get(page, ""))
        lost = [each for each in phrases if each not in words]
        out += [f"scripts/publish.toml: {page} does not say {each!r}" for each in lost]
    for page, begins in book.get("unmarked", {}).items():
        path = root / page
        heads = list(figured(path.read_text("utf-8"))) if path.exists() else []
        lost = [each for each in begins if not any(h.startswith(f"| {each}") for h in heads)]
        out += [f"scripts/publish.toml: {page} has no unmarked table {each!r}" for each in lost]
    return out


# the commands


def status(root: Path, book: Book, version: str, workers: int) -> str:
    """What is published, what of it is stale, and how long that takes."""
    heads = f"{'result':<12}{'min':>6}  {'seeds':<26}{'size':<42}{'stale':<24}shown in"
    lines, minutes, places = [heads], 0.0, shown_in(root, book)
    for row in book["result"]:
        why = why_stale(root, book, row["name"], version)
        minutes += row["minutes"] if why else 0.0
        begun = (root / "build/publish" / version / row["name"]).exists()
        why += ", begun" if why and begun else ""
        lacking = f"; lacks {', '.join(lacks(row))}" if why and lacks(row) else ""
        lines.append(
            f"{row['name']:<12}{row['minutes']:>6g}  {row['seeds']:<26}{row['size']:<42}"
            f"{why:<24}{', '.join(places[row['name']])}{lacking}".rstrip()
        )
    lines.append(
        f"stale: {minutes / 60:.1f} hours of one core, about {minutes / 60 / workers:.1f} hours "
        f"of {workers}; version {version}"
    )
    return "\n".join(lines)


def chosen(book: Book, names: Sequence[str]) -> list[Book]:
    """The rows that are named, in their order; all where none is."""
    known = [row["name"] for row in book["result"]]
    for name in names:
        if name not in known:
            raise SystemExit(f"{name} is no result: choose from {', '.join(known)}")
    return [row for row in book["result"] if not names or row["name"] in names]


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """See the module."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--run", nargs="*", metavar="NAME", help="run these, or all that is stale")
    add("--minutes", type=float, default=float("inf"), help="of --run: begin nothing after these")
    add("--workers", type=int, default=2, help="of --run: results at a time, a core each")
    add("--keep", nargs="+", metavar="NAME", help="make result files anew, of runs that are done")
    add("--pages", action="store_true", help="write the results into the pages")
    add("--check", action="store_true", help="exit 1 where a page or a result is not of here")
    asked = parser.parse_args(arguments)
    book, version = book_of(root), source_version()
    runner = Runner(root, version, time.monotonic() + 60.0 * asked.minutes)
    code = 0
    if asked.run is not None:
        for end in (signal.SIGTERM, signal.SIGINT):  # of a job in the background, too
            signal.signal(end, signal.default_int_handler)
        wanted = [
            row for row in chosen(book, asked.run)
            if asked.run or why_stale(root, book, row["name"], version)
        ]  # fmt: skip
        print(status(root, book, version, asked.workers), flush=True)
        able = [row for row in wanted if not lacks(row)]
        for row in wanted:
            if row not in able:
                print(f"{row['name']}: not run, lacks {', '.join(lacks(row))}", flush=True)
        try:
            code = int(run(runner, able, asked.workers) + len(wanted) - len(able) > 0)
        except KeyboardInterrupt:
            print("interrupted: the same command goes on", flush=True)
            return 130
    for row in chosen(book, asked.keep) if asked.keep else ():
        keep(root, row, runner.folder(row["name"]), version)
    if asked.pages:
        words = words_of(root, book)
        for page, text in texts_of(root).items():
            new = written(text, words, page == "README.md")
            if new != text:
                (root / page).write_text(new, encoding="utf-8")
    if asked.check:
        found = differences(root, book) + unlisted(root, book) + unsaid(root, book)
        found += dead(root, book)
        for name, pages in shown_in(root, book).items():
            if why := why_stale(root, book, name, version):
                found.append(f"{name}: {why}; shown in {', '.join(pages) or 'no page'}")
        print("\n".join(found) or "all pages and results are of this version")
        code = int(bool(found))
    if asked.run is None and not (asked.keep or asked.pages or asked.check):
        print(status(root, book, version, asked.workers))
    return code


if __name__ == "__main__":
    sys.exit(main())
