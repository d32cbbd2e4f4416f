"""Do the walls hold? What may only fall, beside ``scripts/walls.toml``; each red is an error.

    python scripts/walls.py                       # prints each number beside its wall
    python scripts/walls.py --landed REPOSITORY   # also: no wall is higher than in .ci/landed
    python scripts/walls.py --lower               # writes walls that have room, and missing ones

Walls that may only fall:

- ``lines`` of a package: the Python of its src, tests, scripts, benchmarks, sockets. Packages are
  the folders of ``packages/``, and ``workspace`` is what stands beside them. All of them together
  may only fall; one may rise by what moves there from another.
- ``closure`` of a function: lines and files of the definitions that it needs. From its own
  definition, each name in a body, a default or an annotation leads to the definition of that name,
  in this module or in the one that it is imported from. A class counts whole. Modules' docstrings
  and imports do not count, so that joining files lowers nothing.
- ``attributes`` of a class: those that its methods set on ``self``. At most 15; a class above has a
  row until it is mended.

Errors without a number: imports in a circle (also those in functions and for types alone), a
function without types that is no kernel, a package or a room that names one above it, a file that
``docs/reading.md`` names and that is not there, a row of that page that says other than the
contracts what a ring may import. Complexity, statements and parameters of functions are ruff's.
"""

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Collection, Iterator
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
WALLS = ROOT / "scripts" / "walls.toml"
READING = ROOT / "docs" / "reading.md"
FOLDERS = "src", "tests", "scripts", "benchmarks", "sockets"
CORE = "core"
KERNELS = "kernel", "called", "inner", "inlined", "compiler"  # decorators of core.compiled
MOST = 15  # attributes of a class
SIZES = "lines", "files"  # of a closure
HEAD = "# What may only fall: see scripts/walls.py, whose --lower lowers these numbers.\n"
Walls = dict[str, dict[str, Any]]
Definition = ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign


def packages() -> dict[str, Path]:
    """Folders of the packages by name, and the repository that they stand in."""
    found = {file.parent.name: file.parent for file in ROOT.glob("packages/*/pyproject.toml")}
    return {**dict(sorted(found.items())), "workspace": ROOT}


def settings(folder: Path) -> dict[str, Any]:
    """What ``pyproject.toml`` of a folder says."""
    return tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))


def lines_of(folder: Path) -> int:
    """Lines of a package."""
    files = (file for name in FOLDERS for file in (folder / name).rglob("*.py"))
    return sum(file.read_bytes().count(b"\n") for file in files)


class Module:
    """One file of a src, parsed."""

    def __init__(self, path: Path, source: Path) -> None:
        self.path, self.text = path, path.read_text(encoding="utf-8")
        self.tree = ast.parse(self.text)
        parts = path.relative_to(source).with_suffix("").parts
        self.name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        self.package, self.ring = parts[0], parts[1] if len(parts) > 2 else ""

    @cached_property
    def imports(self) -> list[tuple[str, str, str]]:
        """Of each import, in functions too: the name here, the module, the name there."""
        out = []
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                out += [(one.asname or one.name, node.module, one.name) for one in node.names]
            elif isinstance(node, ast.Import):
                out += [(one.asname or one.name, one.name, "") for one in node.names]
        return out

    def imported(self, modules: dict[str, "Module"]) -> dict[str, tuple[str, str]]:
        """Module, and name there, of each name that is imported from ``modules``; "": the module
        itself."""
        out = {}
        for here, module, there in self.imports:
            whole = f"{module}.{there}"
            if whole in modules:
                out[here] = whole, ""
            elif module in modules:
                out[here] = module, there
        return out

    @cached_property
    def definitions(self) -> dict[str, list[Definition]]:
        """Statements that define each name at the top, also within an ``if`` or a ``try``."""
        out: dict[str, list[Definition]] = {}
        waiting = list(self.tree.body)
        while waiting:
            node = waiting.pop(0)
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                out.setdefault(node.name, []).append(node)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                for each in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    for name in ast.walk(each):
                        if isinstance(name, ast.Name):
                            out.setdefault(name.id, []).append(node)
            elif isinstance(node, ast.If | ast.Try):
                waiting += [one for one in ast.iter_child_nodes(node) if isinstance(one, ast.stmt)]
        return out

    def functions(self) -> Iterator[ast.FunctionDef]:
        """All functions that are no kernels."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.FunctionDef):
                marks = (ast.unparse(each).partition("(")[0] for each in node.decorator_list)
                if not any(mark in KERNELS for mark in marks):
                    yield node

    def untyped(self) -> Iterator[str]:
        """Functions without annotations that are no kernels, which mypy does not see."""
        for node in self.functions():
            given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            typed = all(each.annotation or each.arg in ("self", "cls") for each in given)
            if not (typed and (node.returns or node.name == "__init__")):
                yield f"{self.name}.{node.name} has no types, and is no kernel"

    def attributes(self) -> Iterator[tuple[str, int]]:
        """Of each class, how many attributes its methods set."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ClassDef):
                names = {
                    each.attr
                    for each in ast.walk(node)
                    if isinstance(each, ast.Attribute)
                    and isinstance(each.ctx, ast.Store)
                    and isinstance(each.value, ast.Name)
                    and each.value.id == "self"
                }
                yield node.name, len(names)


def closure(modules: dict[str, Module], start: str) -> tuple[int, int]:
    """Lines and files of the definitions that a function MODULE:NAME needs."""
    module, _, name = start.partition(":")
    if module not in modules or name not in modules[module].definitions:
        raise SystemExit(f"{WALLS.name}: {start} is not defined")
    imported = {name: each.imported(modules) for name, each in modules.items()}
    lines: dict[str, set[int]] = {}
    waiting, seen = [(module, name)], set[tuple[str, str]]()
    while waiting:
        at = module, name = waiting.pop()
        if at in seen:
            continue
        seen.add(at)
        if name not in modules[module].definitions and name in imported[module]:
            waiting.append(imported[module][name])
        for node in modules[module].definitions.get(name, []):
            first = min([node.lineno, *(m.lineno for m in getattr(node, "decorator_list", []))])
            lines.setdefault(module, set()).update(range(first, (node.end_lineno or first) + 1))
            for each in ast.walk(node):
                if isinstance(each, ast.Name):
                    waiting.append((module, each.id))
                elif isinstance(each, ast.Attribute) and isinstance(each.value, ast.Name):
                    there, what = imported[module].get(each.value.id, ("", "?"))
                    waiting += [] if what else [(there, each.attr)]
    return sum(map(len, lines.values())), len(lines)


def circles(modules: dict[str, Module]) -> list[str]:
    """The first circle of imports, in words."""
    graph = {
        name: {there for there, _ in each.imported(modules).values()}
        for name, each in modules.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return [f"imports lead back: {' to '.join(reversed(error.args[1]))}"]
    return []


def named_above(files: list[Module], found: dict[str, Path]) -> list[str]:
    """Files of the core that name a ring, and of a package that name one it does not need."""
    rings = {each.ring for each in files if each.package == "optipromp"} - {CORE, ""}
    ring = "|".join(sorted(rings)) or "(?!)"
    of_core = re.compile(rf"optipromp[./](?:{ring})\b|\b(?:{ring})/\w+")
    out = []
    for folder in found.values():
        mine = [each for each in files if each.path.is_relative_to(folder / "src")]
        others = "|".join(sorted({each.package for each in files} - known(folder))) or "(?!)"
        of_package = re.compile(rf"\b(?:{others})\b")
        for each in mine:
            words = of_package.findall(each.text)
            words += of_core.findall(each.text) if each.ring == CORE else []
            out += [f"{each.name} names {word}" for word in words]
    return out


def known(folder: Path) -> set[str]:
    """Import names of a package's own source, and of the distributions that it needs."""
    project = settings(folder).get("project", {})
    needs = [*project.get("dependencies", [])]
    for extra in project.get("optional-dependencies", {}).values():
        needs += extra
    names = {re.split(r"[^\w-]", each)[0].replace("-", "_") for each in needs}
    return names | {path.name for path in (folder / "src").glob("*/")}


def missing(folders: Collection[Path]) -> list[str]:
    """Files that ``docs/reading.md`` names and that do not exist."""
    named = dict.fromkeys(re.findall(r"`(\w[\w-]*/[\w/-]+\.py)`", READING.read_text("utf-8")))
    tops = [
        ROOT,
        *folders,
        *(path for folder in folders for path in (folder / "src", *folder.glob("src/*/"))),
    ]
    gone = [file for file in named if not any((top / file).is_file() for top in tops)]
    return [f"{READING.name} names {file}, which does not exist" for file in gone]


def allowed_imports() -> dict[str, str]:
    """What each ring may import, in words, lowest ring first: by the layers of pyproject.toml."""
    contracts = settings(ROOT).get("tool", {}).get("importlinter", {}).get("contracts", [])
    above: list[str] = []
    out = {}
    for layer in reversed(contracts[0]["layers"] if contracts else []):
        names = re.findall(r"optipromp[\w.]*", layer)
        for k, name in enumerate(names):
            but = " but " + ", ".join(f"`{each}`" for each in names[:k]) if k else ""
            out[name.replace(".", "/")] = f"all rings above{but}" if above else "no other ring"
        above += names
    return out


def untrue() -> list[str]:
    """Rings whose row in ``docs/reading.md`` says other than the contracts what they may import."""
    rows = re.findall(r"^\| `([\w/]+)` \|.*\| (.*) \|$", READING.read_text("utf-8"), re.M)
    said, wanted = dict(rows), allowed_imports()
    if wanted and list(said) != list(wanted):
        return [f"{READING.name}: the rows of rings must be, in this order: {', '.join(wanted)}"]
    return [
        f"{READING.name}: the row of `{ring}` must say that it may import: {words}"
        for ring, words in wanted.items()
        if said.get(ring) != words
    ]


def raised(walls: Walls, repository: str) -> list[str]:
    """Walls that are higher than in the last landed commit.

    What moves from one package to another takes its lines along: the wall of one may rise by what
    the walls of others fall.
    """
    landed = re.findall(r"^\w+", (ROOT / ".ci" / "landed").read_text("utf-8"), re.M)[0]
    name = f"{landed}:{WALLS.relative_to(ROOT).as_posix()}"
    shown = subprocess.run(
        ("git", "-C", repository, "show", name), capture_output=True, text=True, check=False
    )
    if shown.returncode:
        print(f"{name} cannot be read: NOT COMPARED with the last landed commit\n")
        return []
    before, now = flat(tomllib.loads(shown.stdout)), flat(walls)
    lines = [key for key in now.keys() & before.keys() if key.startswith("lines ")]
    moved = sum(now[key] for key in lines) <= sum(before[key] for key in lines)
    out = [
        f"the wall of {key} is {most}, and was {before.get(key, MOST)} in the last landed commit"
        for key, most in now.items()
        if most > before.get(key, MOST if key.startswith("attributes ") else most)
        and not (moved and key in lines)
    ]
    lost = (key for key in before.keys() - now.keys() if "closure" in key)
    return out + [f"{key} had a wall in the last landed commit" for key in sorted(lost)]


def flat(walls: Walls) -> dict[str, int]:
    """Walls by their names in words."""
    rows = {f"{kind} {name}": most for kind in ("lines", "attributes")
            for name, most in walls.get(kind, {}).items()}  # fmt: skip
    for name, row in walls.get("closure", {}).items():
        rows |= {f"{what} of closure {name}": row[what] for what in SIZES if what in row}
    return rows


def written(walls: Walls) -> str:
    """The file of the walls."""
    out = [HEAD, "[lines]", *(f"{name} = {most}" for name, most in walls["lines"].items())]
    for name, row in walls["closure"].items():
        out += ["", f"[closure.{name}]", f'start = "{row["start"]}"']
        out += [f"{what} = {row[what]}" for what in SIZES]
    out += ["", "[attributes]", *(f"{name} = {n}" for name, n in walls["attributes"].items())]
    return "\n".join(out) + "\n"


def measured(walls: Walls, found: dict[str, Path], modules: dict[str, Module]) -> Walls:
    """The numbers of today, as a file of walls."""
    closures = {}
    for name, row in walls["closure"].items():
        lines, files = closure(modules, row["start"])
        closures[name] = {"start": row["start"], "lines": lines, "files": files}
    large = dict(item for each in modules.values() for item in each.attributes() if item[1] > MOST)
    return {
        "lines": {name: lines_of(folder) for name, folder in found.items()},
        "closure": closures,
        "attributes": dict(sorted(large.items(), key=lambda item: -item[1])),
    }


def lowered(walls: Walls, now: Walls) -> Walls:
    """The walls of what is there, at most the numbers of today; no class gets a new one."""
    was = walls["closure"]
    return {
        "lines": {k: min(n, walls["lines"].get(k, n)) for k, n in now["lines"].items()},
        "closure": {
            name: row | {what: min(row[what], was[name].get(what, row[what])) for what in SIZES}
            for name, row in now["closure"].items()
        },
        "attributes": {
            k: min(n, walls["attributes"][k])
            for k, n in now["attributes"].items() if k in walls["attributes"]
        },
    }  # fmt: skip


def main() -> int:
    """Print each number beside its wall; 0 where all walls and rules hold."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--landed", metavar="REPOSITORY", help="whose history has .ci/landed")
    parser.add_argument("--lower", action="store_true", help="write what has room, and what is new")
    given = parser.parse_args()
    walls, found = tomllib.loads(WALLS.read_text("utf-8")), packages()
    sources = [folder / "src" for folder in found.values() if (folder / "src").is_dir()]
    files = [Module(path, source) for source in sources for path in sorted(source.rglob("*.py"))]
    modules = {each.name: each for each in files}
    now = measured(walls, found, modules)
    numbers, most = flat(now), flat(walls)
    wrong = raised(walls, given.landed) if given.landed else []
    wide = max(map(len, numbers))
    print(f"{'':<{wide}} {'now':>7} {'wall':>7}")
    for key, number in numbers.items():
        wall = most.get(key)
        room = "" if wall is None or number >= wall else f"  lower it by {wall - number}"
        print(f"{key:<{wide}} {number:>7} {wall if wall is not None else '-':>7}{room}")
        if wall is None and key.startswith("attributes"):
            wrong.append(f"{key} is {number}: at most {MOST}")
        elif wall is None and not given.lower:
            wrong.append(f"{key} is {number}, and has no wall: --lower adds it")
        elif wall is not None and number > wall:
            wrong.append(f"{key} is {number}, {number - wall} above its wall of {wall}")
    for key in sorted(most.keys() - numbers.keys()):
        print(f"{key} is gone, or at most {MOST}: --lower takes its row away")
    if given.lower:
        WALLS.write_text(written(lowered(walls, now)), "utf-8")
    wrong += circles(modules) + named_above(files, found) + missing(found.values()) + untrue()
    wrong += [words for each in files for words in each.untyped()]
    print("", *(wrong or ["all walls hold"]), sep="\n")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
