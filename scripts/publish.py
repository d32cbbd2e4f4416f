"""Every published result: its commands, whether it is stale, and the page that shows it.

    python scripts/publish.py                    what is stale, and how long it would take
    python scripts/publish.py --run [NAME ...]   run what is stale, the most important first
    python scripts/publish.py --page             write docs/figures.md, its pictures, README's table
    python scripts/publish.py --check            exit 1, and the names, where not all is of here

``scripts/publish.toml`` has a row for each result. A run leaves ``build/publish/VERSION/NAME``, in
which it goes on after an interruption, and ends with ``docs/results/NAME.json``: version, digest,
commit, date, machine, versions, commands, scenes, tables: those that the commands print or write
as Markdown, under headings. The digest has a hash of each kind of behaviour that the result depends
on (``scripts/plan_hashes.py --digest``). A result is stale where there is no file, where its
commands or scenes are others than the row's, and where it is of another version of the source and
one of its kinds behaves otherwise now; it is never stale where its row says that it is ``frozen``:
its question is answered. Two processes of ``--run`` share the list, and use two cores.

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
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(Path(__file__).resolve().parent), str(ROOT)]

import publish_page as pages  # noqa: E402

from benchmarks.machine import describe  # noqa: E402
from benchmarks.run import SINGLE  # noqa: E402
from optipromp.core.errors import InvalidRequestError  # noqa: E402
from optipromp.core.files import json_text, write_atomically  # noqa: E402
from optipromp_bench.experiments.rows import locked, source_version  # noqa: E402

MARKED = re.compile(r"(?<=<!-- promised -->\n)(.*?)(?=<!-- end -->)", re.DOTALL)
LATE = "was not begun"  # as the minutes were over, or as another process runs it
Book = Mapping[str, Any]
Digest = Callable[[], Mapping[str, str]]  # a hash of each kind of behaviour


def book_of(root: Path) -> Book:
    """What is published: ``result``, in order."""
    return tomllib.loads((root / "scripts/publish.toml").read_text("utf-8"))


def kept(root: Path, name: str) -> dict[str, Any]:
    """A result as it is kept; empty where there is none."""
    path = root / "docs/results" / f"{name}.json"
    return dict(json.loads(path.read_text("utf-8"))) if path.exists() else {}


@cache
def digest_of(root: Path, version: str) -> Mapping[str, str]:
    """How the source behaves: a hash of each kind. Takes minutes, once a version."""
    file = root / "build/publish" / version / "digest.json"
    if not file.exists():
        print("how the source behaves is worked out: some minutes", file=sys.stderr, flush=True)
        words = [sys.executable, "scripts/plan_hashes.py", "--digest"]
        told = subprocess.run(words, cwd=root, stdout=subprocess.PIPE, text=True, check=True).stdout
        file.parent.mkdir(parents=True, exist_ok=True)
        found = dict(re.findall(r"^(\w+): .* ([0-9a-f]{16})$", told, re.MULTILINE))
        write_atomically(file, json_text(found).encode())
    return dict(json.loads(file.read_text("utf-8")))


def why_stale(row: Book, found: Mapping[str, Any], version: str, digest: Digest) -> str:
    """Why a result is not of here; empty where it is, or where it is frozen."""
    if "frozen" in row:
        return ""
    if not found:
        return "no result"
    if other := [name for name in ("commands", "scenes") if found[name] != row[name]]:
        return f"of {found['version']}, with other {other[0]}"
    if found["version"] == version:
        return ""
    if not set(row["kinds"]) <= found.get("digest", {}).keys():
        return f"of {found['version']}, without a digest"
    other = [kind for kind in row["kinds"] if found["digest"][kind] != digest()[kind]]
    return f"of {found['version']}, other {', '.join(other)}" if other else ""


def commands_of(row: Book) -> list[str]:
    """The commands of a row; one with ``{entry}`` stands for each of its ``entries``."""
    return [
        command.replace("{entry}", entry)
        for command in row["commands"]
        for entry in (row["entries"] if "{entry}" in command else [""])
    ]


# running


def folder_of(root: Path, version: str, name: str) -> Path:
    """Of what the commands of a result leave."""
    return root / "build/publish" / version / name


def run(root: Path, row: Book, version: str, until: float) -> str:
    """Run what a row lacks, and keep its result. Returns: why it is not done; empty: it is."""
    folder, commands = folder_of(root, version, row["name"]), commands_of(row)
    folder.mkdir(parents=True, exist_ok=True)
    for k, command in enumerate(commands, 1):
        if (folder / f"{k}.out").exists():
            continue
        if time.monotonic() > until:
            return f"command {k} of {len(commands)} {LATE}"
        print(f"{row['name']}: {command}", flush=True)
        if code := call(root, command, folder, k):
            told = (folder / f"{k}.err").read_text("utf-8").strip().splitlines() or ["no words"]
            return f"command {k} ended with {code}: {told[-1][:300]}"
    try:
        keep(root, row, version)
    except (ValueError, OSError, KeyError) as error:
        return f"its figures cannot be kept: {error!r}"
    return ""


def call(root: Path, command: str, folder: Path, k: int) -> int:
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
            [*program.get(first, [first]), *words], cwd=root, stdout=out, stderr=err,
            env={**os.environ, **SINGLE, **settings}, start_new_session=True,
        )  # fmt: skip
        try:
            code = process.wait()
        except KeyboardInterrupt:  # studies keep their rows
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
    if not code:
        part.replace(folder / f"{k}.out")
    return code


def tables_in(folder: Path) -> dict[str, Any]:
    """The tables under headings (``### ``), with the list below them, in the commands' order."""
    found = {}
    printed = sorted(folder.glob("*.out"), key=lambda path: int(path.stem))
    for path in (*printed, *sorted(folder.glob("*.md"), key=os.path.getmtime)):
        _, *parts = re.split(r"^### (.+)\n", path.read_text("utf-8"), flags=re.MULTILINE)
        for title, part in zip(parts[::2], parts[1::2], strict=True):
            lines = re.findall(r"^\|(.*)\|$", part, re.MULTILINE)
            columns, _, *rows = [[cell.strip() for cell in line.split("|")] for line in lines]
            notes = list(dict.fromkeys(re.findall(r"^- (.+)$", part, re.MULTILINE)))
            found[title] = {"columns": columns, "rows": rows, "notes": notes}
    if not found:
        raise ValueError(f"{folder} holds no table under a heading")
    return found


def keep(root: Path, row: Book, version: str) -> None:
    """Write the result file of what a row's commands left."""
    here = describe()
    found = {
        "version": version,
        "digest": {kind: digest_of(root, version)[kind] for kind in row["kinds"]},
        **{name: here[name] for name in ("commit", "date", "machine")},
        **{name: row[name] for name in ("commands", "scenes")},
        "versions": {**here["versions"], "compiler": here["compiler"]},
        "tables": tables_in(folder_of(root, version, row["name"])),
    }
    file = root / "docs/results" / f"{row['name']}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, json_text(found).encode())


# the page


def made(root: Path, book: Book) -> dict[str, str]:
    """All that is made of the results, by path from the root."""
    names = [row["name"] for row in book["result"]]
    results = {name: kept(root, name) for each in names for name in (each, f"before/{each}")}
    shown = {"result": [row for row in book["result"] if results[row["name"]]]}
    readme = (root / "README.md").read_text("utf-8")
    promised = f"\n{pages.promised(shown, results)}\n\n"
    return {
        "docs/figures.md": pages.page(shown, results),
        "README.md": MARKED.sub(lambda _: promised, readme),
        **{f"docs/{file}": drawn for file, drawn in pages.pictures(shown, results).items()},
    }


def differences(root: Path, book: Book) -> list[str]:
    """The files that are not what the results give."""
    return [
        f"{path} has other figures than the results: run scripts/publish.py --page"
        for path, text in made(root, book).items()
        if not (root / path).exists() or (root / path).read_text("utf-8") != text
    ]


# the commands


def status(book: Book, stale: Mapping[str, str]) -> str:
    """What is published, what of it is stale, and how long that takes."""
    lines, minutes = [], 0.0
    for row in book["result"]:
        why = stale[row["name"]]
        minutes += row["minutes"] if why else 0.0
        lines.append(f"{row['name']:<12}{'frozen' if 'frozen' in row else why or 'of here'}")
    return "\n".join([*lines, f"stale: {minutes / 60:.1f} hours of one core"])


def chosen(book: Book, names: Sequence[str]) -> list[Book]:
    """The rows that are named, in their order; all where none is."""
    known = [row["name"] for row in book["result"]]
    for name in names:
        if name not in known:
            raise SystemExit(f"{name} is no result: choose from {', '.join(known)}")
        if "frozen" in book["result"][known.index(name)]:
            raise SystemExit(f"{name} is frozen: it stays of its version")
    return [row for row in book["result"] if not names or row["name"] in names]


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """See the module."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--run", nargs="*", metavar="NAME", help="run these, or all that is stale")
    add("--minutes", type=float, default=float("inf"), help="of --run: begin nothing after these")
    add("--page", action="store_true", help="write what shows the results")
    add("--check", action="store_true", help="exit 1 where the page or a result is not of here")
    asked = parser.parse_args(arguments)
    book, version = book_of(root), source_version()
    code, until = 0, time.monotonic() + 60.0 * asked.minutes

    def stale(row: Book) -> str:  # takes minutes where a digest is to be worked out
        return why_stale(row, kept(root, row["name"]), version, partial(digest_of, root, version))

    if asked.run is not None:
        for end in (signal.SIGTERM, signal.SIGINT):  # of a job in the background, too
            signal.signal(end, signal.default_int_handler)
        try:
            for row in chosen(book, asked.run):
                if not asked.run and not stale(row):
                    continue
                try:
                    with locked(folder_of(root, version, f"running/{row['name']}")):
                        why = run(root, row, version, until)
                except InvalidRequestError:
                    why = f"another process runs it, so it {LATE}"
                print(f"{row['name']}: {why or 'done'}", flush=True)
                code |= bool(why) and not why.endswith(LATE)
        except KeyboardInterrupt:
            print("interrupted: the same command goes on", flush=True)
            return 130
    if asked.page:
        for path, text in made(root, book).items():
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text, encoding="utf-8")
    if asked.check:
        found = differences(root, book)
        found += [f"{row['name']}: {why}" for row in book["result"] if (why := stale(row))]
        print("\n".join(found) or "the page and all results are of this version")
        code = int(bool(found))
    if asked.run is None and not (asked.page or asked.check):
        print(status(book, {row["name"]: stale(row) for row in book["result"]}))
    return code


if __name__ == "__main__":
    sys.exit(main())
