"""What can a change reach? Prints which tests must run in full, which quickly, and which steps.

    python scripts/reach.py                 # beside the commit in .ci/landed
    python scripts/reach.py BASE            # beside another commit
    python scripts/reach.py --all           # everything
    python scripts/reach.py --files F ...   # as if these files had changed

Run it from the repository, or with ``--repository``. Each line of the answer has a word and a name:

    changed UNIT     a file of it changed
    reached UNIT     it imports, by way of others too, what changed
    full FOLDER      tests of what changed: all of them
    quick PLACE      tests of what is reached, and files that import that: ``-m quick``
    step NAME        a further step of .ci/run
    all WHY          everything is reached: every folder is full, and every step is there

Units are the packages of ``packages/``, which import what their source names, and need what their
``pyproject.toml`` says. A package that takes a part of a changed one (``optipromp.parts``) is
reached, but not what imports the taker. Tests at the top of ``tests`` are of the repository: they
run in full where something outside of the packages changed. A test file, and one of ``tests``,
scripts, benchmarks or examples, reaches in full the folders whose files import or name it.
"""

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
SHARED = r"constraints.*\.txt|pyproject\.toml|\.ci/(?!landed$).*|scripts/reach\.py"
SHARED += r"|conftest\.py|tests/(?!test_)\w+\.py"
"""Files outside of the units that reach everything."""
STEPS = {
    "real-ros": ("packages/optipromp-ros/",),
    "real-franka": ("packages/optipromp-loop/", "packages/optipromp/src/optipromp/core/execution/"),
    "real-lerobot": (
        "packages/optipromp-loop/", "packages/optipromp-bench/sockets/",
        "packages/optipromp-bench/tests/lerobot/",
        "packages/optipromp-bench/src/optipromp_bench/lerobot.py",
    ),
    "examples": ("packages/optipromp/src/", "examples/"),
}  # fmt: skip
"""Steps, and the places whose changes need them."""
FURTHER = *STEPS, "packages", "pythons", "extras"
HOME = "tests"  # whose own files are of the repository


class Units(NamedTuple):
    """The packages.

    ``imports``: of each unit, the units that it imports or needs. ``takes``: those of which it
    takes parts. ``tests``: all folders of tests. ``by_file``: the units that a test file imports.
    """

    imports: dict[str, set[str]]
    takes: dict[str, set[str]]
    tests: set[str]
    by_file: dict[str, set[str]]

    def of(self, file: str) -> str | None:
        """The unit of a file; None: of none."""
        folder, name, *_ = [*file.split("/"), ""]
        return name if folder == "packages" and name in self.imports else None

    def tests_of(self, units: set[str]) -> set[str]:
        """The test folders of some units."""
        return {folder for folder in self.tests if self.of(folder) in units}

    def dependents(self, changed: set[str]) -> set[str]:
        """The units that import these, by way of others too, and these."""
        out, more = set(changed), True
        while more:
            more = {unit for unit, names in self.imports.items() if names & out} - out
            out |= more
        return out


def modules_in(place: Path) -> set[str]:
    """All modules that a Python file imports, or those of a folder, in functions too."""
    out = set()
    for file in [place] if place.suffix else place.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                out |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
            elif isinstance(node, ast.Import):
                out |= {each.name for each in node.names}
    return out


def units_in(root: Path) -> Units:
    """The packages of ``packages/``."""
    folders = {path.parent.name: path.parent for path in root.glob("packages/*/pyproject.toml")}
    tops = {top.name: name for name, at in folders.items() for top in (at / "src").glob("*/")}

    def imported(place: Path) -> set[str]:
        return {tops[top] for top in {m.partition(".")[0] for m in modules_in(place)} & {*tops}}

    imports, givers, tests = {}, {}, {HOME}
    for name, folder in folders.items():
        project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["project"]
        needs = {re.split(r"[^\w-]", each)[0] for each in project.get("dependencies", ())}
        imports[name] = (needs & folders.keys() | imported(folder / "src")) - {name}
        givers |= dict.fromkeys(project.get("entry-points", {}).get("optipromp.parts", ()), name)
        tests |= {f"packages/{name}/tests"} if (folder / "tests").is_dir() else set()
    takes = {
        name: {givers[part] for part in taken(folder / "src") & givers.keys()}
        for name, folder in folders.items()
    }
    by_file = {
        file.relative_to(root).as_posix(): imported(file)
        for folder in tests - {HOME} for file in (root / folder).rglob("test_*.py")
    }  # fmt: skip
    return Units(imports, takes, tests, by_file)


def taken(folder: Path) -> set[str]:
    """The names of the parts that the files of a folder take."""
    texts = (file.read_text(encoding="utf-8") for file in folder.rglob("*.py"))
    return {name for text in texts for name in re.findall(r'\b(?:part|added)\("(\w+)"', text)}


class Reach(NamedTuple):
    """What a change reaches: units, folders of tests, steps; ``why`` everything."""

    changed: set[str]
    reached: set[str]
    full: set[str]
    quick: set[str]
    steps: set[str]
    why: str = ""

    def __str__(self) -> str:
        rows = [f"all {self.why}"] if self.why else []
        for word in ("changed", "reached", "full", "quick", "step"):
            names = getattr(self, "steps" if word == "step" else word)
            rows += [f"{word} {name}" for name in sorted(names)]
        return "\n".join(rows)


def reach(root: Path, files: Iterable[str] | None, why: str = "") -> Reach:
    """What changed files reach; None: everything, for the reason ``why``."""
    units = units_in(root)
    shared = [file for file in files or () if re.fullmatch(SHARED, file)]
    if files is None or shared:
        tests = apart(root, units.tests)
        return Reach({*units.imports}, set(), tests, set(), {*FURTHER}, why or shared[0])
    changed, full = set[str](), set[str]()
    steps = {k for k, places in STEPS.items() for file in files if file.startswith(places)}
    for file in {*files} - {".ci/landed"}:
        folder = max((f for f in units.tests if file.startswith(f"{f}/")), key=len, default="")
        unit = units.of(file)
        if unit is not None and not folder:
            changed.add(unit)
        else:
            full.add(folder or HOME)
        if folder or file.startswith(("scripts/", "benchmarks/", "examples/")):
            full |= naming(root, Path(file), units.tests)
    full |= units.tests_of(changed)
    reached = units.dependents(changed)
    takers = {unit for unit, names in units.takes.items() if names & changed} - reached
    quick = units.tests_of(reached | takers) | ({HOME} if changed else set())
    folders = tuple(f"{folder}/" for folder in full | quick)
    quick |= {
        file
        for file, names in units.by_file.items()
        if names & reached and not file.startswith(folders)
    }
    quick = apart(root, quick - full)
    return Reach(changed, (reached | takers) - changed, apart(root, full), quick, steps)


def apart(root: Path, folders: set[str]) -> set[str]:
    """Folders, with the files of HOME in its place."""
    files = {path.relative_to(root).as_posix() for path in (root / HOME).glob("test_*.py")}
    return folders - {HOME} | (files if HOME in folders else set())


def naming(root: Path, file: Path, folders: Iterable[str]) -> set[str]:
    """The test folders whose files import a file, or name it with its folder."""
    word = re.compile(rf"\b{file.parent.name}\W+(import [\w, ]*)?\b{re.escape(file.stem)}\b")
    return {
        folder
        for folder in folders
        for each in (root / folder).glob("*.py" if folder == HOME else "**/*.py")
        if word.search(each.read_text(encoding="utf-8"))
    }


def changes(repository: Path, base: str) -> list[str] | None:
    """Files that differ from a commit, new ones too; None where it is not in the history."""

    def git(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ("git", "-C", str(repository), *words), capture_output=True, text=True, check=False
        )

    if git("merge-base", "--is-ancestor", base, "HEAD").returncode:
        return None
    names = git("diff", "--name-only", "--no-renames", base).stdout
    return (names + git("ls-files", "--others", "--exclude-standard").stdout).splitlines()


def main() -> int:
    """Print what a change reaches."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("base", nargs="?", help="commit; by default that of .ci/landed")
    parser.add_argument("--repository", type=Path, default=ROOT, help="with the history")
    parser.add_argument("--files", nargs="*", help="in place of those that differ")
    parser.add_argument("--all", action="store_true")
    given = parser.parse_args()
    landed = re.findall(r"^\w+", (ROOT / ".ci" / "landed").read_text("utf-8"), re.M)[0]
    files, why = given.files, f"{given.base or landed} is not in the history"
    if given.all:
        files, why = None, "as asked"
    elif files is None:
        files = changes(given.repository, given.base or landed)
    print(reach(ROOT, files, why if files is None else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main())
