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
run in full where something outside of the units changed. A file of scripts, benchmarks or examples
reaches in full the folders whose tests name it.
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
    "real-ros": {"ros"}, "real-franka": {"optipromp", "loop"}, "real-lerobot": {"loop"},
}  # fmt: skip
"""Steps of real counterparts, and the last words of the units whose changes need them."""
FURTHER = *STEPS, "examples", "packages", "pythons", "extras"
HOME = "tests"  # whose own files are of the repository


class Units(NamedTuple):
    """The parts of a source.

    ``folders``: of each unit, where its files are. ``tests``: its test folders. ``imports``: the
    units that it imports. ``takes``: those of which it takes parts. ``all_tests``: all folders of
    tests. ``by_file``: the units that each test file imports.
    """

    folders: dict[str, list[str]]
    tests: dict[str, list[str]]
    imports: dict[str, set[str]]
    takes: dict[str, set[str]]
    all_tests: set[str]
    by_file: dict[str, set[str]]

    def of(self, file: str) -> str | None:
        """The unit of a file of its source; None: of none."""
        inside = [
            (len(folder), unit)
            for unit, folders in self.folders.items() for folder in folders
            if file.startswith(f"{folder}/") or file == folder
        ]  # fmt: skip
        return max(inside)[1] if inside else None

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


def taken(folder: Path) -> set[str]:
    """The names of the parts that the files of a folder take."""
    texts = (file.read_text(encoding="utf-8") for file in folder.rglob("*.py"))
    return {name for text in texts for name in re.findall(r'\b(?:part|added)\("(\w+)"', text)}


def of_packages(root: Path) -> Units:
    """The packages of ``packages/``."""
    folders, tests, imports, tops, givers = {}, {}, {}, {}, {}
    for folder in sorted(path.parent for path in root.glob("packages/*/pyproject.toml")):
        name = folder.name
        folders[name] = [f"packages/{name}"]
        tests[name] = [f"packages/{name}/tests"] if (folder / "tests").is_dir() else []
        tops |= {path.name: name for path in (folder / "src").glob("*/")}
    for name in folders:
        project = tomllib.loads((root / "packages" / name / "pyproject.toml").read_text("utf-8"))
        needs = project.get("project", {}).get("dependencies", [])
        parts = project.get("project", {}).get("entry-points", {}).get("optipromp.parts", {})
        givers |= dict.fromkeys(parts, name)
        known = {re.split(r"[^\w-]", each)[0] for each in needs} & folders.keys()
        modules = modules_in(root / "packages" / name / "src")
        named = {module.partition(".")[0] for module in modules}
        imports[name] = (known | {tops[top] for top in named & tops.keys()}) - {name}
    takes = {
        name: {givers[part] for part in taken(root / "packages" / name / "src") if part in givers}
        for name in folders
    }
    all_tests = {folder for its in tests.values() for folder in its}
    by_file = {
        file.relative_to(root).as_posix(): {
            tops[top] for module in modules_in(file) if (top := module.partition(".")[0]) in tops
        }
        for folder in all_tests for file in (root / folder).rglob("test_*.py")
    }  # fmt: skip
    return Units(folders, tests, imports, takes, all_tests | {HOME}, by_file)


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
    units = of_packages(root)
    shared = [file for file in files or () if re.fullmatch(SHARED, file)]
    if files is None or shared:
        tests = apart(root, {*units.all_tests})
        return Reach({*units.folders}, set(), tests, set(), {*FURTHER}, why or shared[0])
    changed, full, steps = set[str](), set[str](), set[str]()
    for file in {*files} - {".ci/landed"}:
        unit = units.of(file)
        folder = max((f for f in units.all_tests if file.startswith(f"{f}/")), key=len, default="")
        if folder:
            full |= {folder} | naming(root, Path(file).stem, units.all_tests)
        elif unit is not None:
            changed.add(unit)
        else:
            full.add(HOME)
            steps |= {"examples"} if file.startswith("examples/") else set()
            if file.startswith(("scripts/", "benchmarks/", "examples/", "tests/")):
                full |= naming(root, Path(file).stem, units.all_tests)
    full |= {folder for unit in changed for folder in units.tests.get(unit, ())}
    reached = units.dependents(changed)
    reached |= {unit for unit, names in units.takes.items() if names & changed}
    quick = {folder for unit in reached for folder in units.tests.get(unit, ())}
    quick |= {HOME} if changed else set()
    folders = tuple(f"{folder}/" for folder in full | quick)
    quick |= {
        file
        for file, names in units.by_file.items()
        if names & reached and not file.startswith(folders)
    }
    last = {unit.rpartition("-")[2] for unit in changed} | {Path(folder).name for folder in full}
    steps |= {name for name, needs in STEPS.items() if needs & last}
    steps |= {"examples"} if "optipromp" in changed else set()
    return Reach(changed, reached - changed, apart(root, full), apart(root, quick - full), steps)


def apart(root: Path, folders: set[str]) -> set[str]:
    """Folders, with the files of HOME in its place."""
    files = {path.relative_to(root).as_posix() for path in (root / HOME).glob("test_*.py")}
    return folders - {HOME} | (files if HOME in folders else set())


def naming(root: Path, stem: str, folders: Iterable[str]) -> set[str]:
    """The test folders whose files name a file."""
    word = re.compile(rf"\b{re.escape(stem)}\b")
    return {
        folder
        for folder in folders
        for file in (root / folder).glob("*.py" if folder == HOME else "**/*.py")
        if word.search(file.read_text(encoding="utf-8"))
    }  # fmt: skip


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
