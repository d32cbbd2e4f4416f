"""The licences of what our packages and their extras bring, written into docs/licences.md.

``licences.py [PAGE]``: pip (25 or newer, of the Python that runs this) resolves each with the
versions of constraints.txt and installs nothing. A licence that is neither free nor explained in
``EXPLAINED`` is an error, as tests/test_packaging.py says of the packages that are installed.
"""

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
MARK = "<!-- written by scripts/licences.py -->\n"
FREE = re.compile(
    r"\b(MIT|BSD|0BSD|Apache|ISC|MPL|Mozilla|PSF|Python Software|Zlib|HPND|CC0|Unlicense"
    r"|Public Domain|LGPL|Lesser General|BSL|Boost|EPL|Eclipse)",
    re.IGNORECASE,
)
BOUND = re.compile(r"(?<!L)GPL|(?<!Lesser )General Public|Proprietary", re.IGNORECASE)
CORE = "optipromp"
NAME = re.compile(r"[\w-]+")
EXPLAINED = {  # packages whose metadata do not tell a free licence or not all, and what holds
    "av": "(the wheel holds FFmpeg, LGPL, and libx264 and libx265, GPL: the encoders of films)",
    "apsw": "(any licence that the OSI approves)",
    "cmeel-qhull": "Qhull (free; its notice stays with it)",
    "docutils": "(the GPL is of one file for Emacs, which is not in the wheel)",
    "xacro": "(its licence file is BSD-3-Clause)",
}


def licence(metadata: Mapping[str, Any]) -> str:
    """What a package says of its licence, in the shape of ``importlib.metadata``'s ``json``."""
    if metadata.get("license_expression"):
        return str(metadata["license_expression"])
    said = [each.split(" :: ") for each in metadata.get("classifier", [])]
    named = [each[-1] for each in said if each[0] == "License" and each[-1] != "OSI Approved"]
    first = str(metadata.get("license", "")).strip().split("\n")[0]
    return ", ".join(named) or (first if len(first) < 60 else "")


def in_doubt(name: str, said: str) -> bool:
    """Whether a licence is unknown, not free or of the GPL's kind, and not explained here."""
    free = FREE.search(said) and not (BOUND.search(said) and " OR " not in said)
    return not free and name.lower() not in EXPLAINED


def projects() -> dict[str, dict[str, Any]]:
    """What the packages say of themselves, by name; the core first."""
    files = sorted(ROOT.glob("packages/*/pyproject.toml"))
    return {file.parent.name: tomllib.loads(file.read_text("utf-8"))["project"] for file in files}


def folders(name: str, extra: str = "") -> list[str]:
    """A package with an extra and those of ours that it needs, as pip takes them."""
    found, left = dict[str, None](), [name]
    while left:
        found[each := left.pop()] = None
        needs = (NAME.match(one) for one in projects()[each]["dependencies"])
        left += [one[0] for one in needs if one and one[0] in projects() and one[0] not in found]
    asked = {name: f"[{extra}]" if extra else ""}
    return [f"{ROOT / 'packages' / each}{asked.get(each, '')}" for each in found]


def resolved(label: str, wanted: Sequence[str]) -> dict[str, Mapping[str, Any]]:
    """The metadata of what is ``wanted`` brings, by name, less what is ours."""
    command = ["install", "-qq", "--dry-run", "--ignore-installed", "--report", "-"]
    pip = [sys.executable, "-m", "pip", *command, "-c", str(ROOT / "constraints.txt"), *wanted]
    said = subprocess.run(pip, capture_output=True, text=True)
    if said.returncode:
        print(f"{label}: {said.stderr.strip().splitlines()[-1]}", file=sys.stderr)
    found = [each["metadata"] for each in json.loads(said.stdout or '{"install": []}')["install"]]
    return {each["name"]: each for each in found if each["name"] not in projects()}


def main(page: str = str(ROOT / "docs/licences.md")) -> int:
    """Write the table; 1 where a licence is in doubt."""
    extras = [
        (name, extra)
        for name, project in projects().items()
        for extra in sorted({*project["optional-dependencies"]} - {"all"})
    ]
    asked = {name: folders(name) for name in projects()}
    asked |= {f"{name}[{extra}]": folders(name, extra) for name, extra in extras}
    tests = {f"{name}[test]": asked.pop(f"{name}[test]") for name in projects()}
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["dependency-groups"]
    brings: dict[str, list[str]] = {}
    metadata: dict[str, Mapping[str, Any]] = {}
    for label, wanted in {**asked, **tests, **groups}.items():
        print(label, flush=True)
        for name, each in resolved(label, wanted).items():
            metadata.setdefault(name, each)
            by = brings.setdefault(name, [])
            told = {CORE, label.partition("[")[0]} & {*by}
            if not told and (label in asked or not by):
                by.append(label)
    rows = ["| package | version | licence | comes with |", "|---|---|---|---|"]
    doubts = []
    for name in sorted(metadata, key=str.lower):
        said = licence(metadata[name])
        doubts += [f"{name}: {said or 'unknown'}"] if in_doubt(name, said) else []
        said += f" {EXPLAINED[name.lower()]}" if name.lower() in EXPLAINED else ""
        comes = ", ".join("always" if each == CORE else f"`{each}`" for each in brings[name])
        rows.append(f"| {name} | {metadata[name]['version']} | {said.strip()} | {comes} |")
    target = Path(page)
    head = target.read_text("utf-8").partition(MARK)[0]
    target.write_text("\n".join([head + MARK, *rows, ""]), "utf-8")
    print(*[f"{len(rows) - 2} packages", *(f"in doubt: {each}" for each in doubts)], sep="\n")
    return bool(doubts)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
