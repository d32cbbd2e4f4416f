"""How large and how tangled is the source, by ring? A gate against growth.

Run from the repository: ``python scripts/end_state.py``. The script prints the lines of each ring
beside ``scripts/rings.toml``, and the figures that tell how the source reads beside what is wanted.

It exits with 1 where a ring has more lines than its row in ``scripts/rings.toml`` allows, where the
core names a ring, where imports go in a circle (also those in functions and for types alone), where
a function that is no kernel has no types, and where ``docs/reading.md`` names a file that is not
there or says other than the contracts what a ring may import. A row rises only by what other rows
fall in the same commit: ``--history REPOSITORY COMMIT`` checks all commits since COMMIT.
"""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "optipromp"
TESTS = ROOT / "tests"
ROWS = ROOT / "scripts" / "rings.toml"
READING = ROOT / "docs" / "reading.md"
CORE = "core"
HEART = "judging", "optimization", "pushing", "planning"  # of the core
KERNELS = "kernel", "inner", "inlined", "compiler"  # decorators of optipromp.core.compiled
MANY = 8  # parameters of a function


def name_of(path: Path) -> str:
    """Dotted name of a module."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _is_kernel(node: ast.FunctionDef) -> bool:
    """Whether a function is compiled, or implements one for Numba."""
    marks = (ast.unparse(decorator).partition("(")[0] for decorator in node.decorator_list)
    return any(mark in KERNELS for mark in marks)


class File:
    """One file, parsed."""

    def __init__(self, path: Path) -> None:
        self.path, self.text = path, path.read_text(encoding="utf-8")
        self.lines, self.tree = self.text.count("\n"), ast.parse(self.text)
        parts = path.relative_to(SOURCE).parts
        self.ring = parts[0] if len(parts) > 1 else "top"
        self.heart = self.ring == CORE and parts[1] in HEART
        self.public = [
            node.name
            for node in self.tree.body
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name[0] != "_"
        ]

    def functions(self) -> Iterator[tuple[int, int, str, bool]]:
        """Of every function: its lines, its parameters, its name, and whether it is a kernel."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.FunctionDef):
                given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                parameters = sum(arg.arg not in ("self", "cls") for arg in given)
                lines = (node.end_lineno or 0) - node.lineno + 1
                yield lines, parameters, f"{name_of(self.path)}.{node.name}", _is_kernel(node)

    def untyped(self) -> list[str]:
        """Functions without annotations that are no kernels, which mypy does not see."""
        out = []
        for node in ast.walk(self.tree):
            if isinstance(node, ast.FunctionDef):
                given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                typed = all(arg.annotation or arg.arg in ("self", "cls") for arg in given)
                returns = node.returns or node.name == "__init__"
                if not (typed and returns) and not _is_kernel(node):
                    out.append(f"{name_of(self.path)}.{node.name} has no types, and is no kernel")
        return out

    def imports(self, modules: dict[str, "File"]) -> set[str]:
        """Modules of the library that this one imports: in functions and for types alone, too."""
        out = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    dotted = f"{node.module}.{alias.name}"
                    out.add(dotted if dotted in modules else node.module)
        return out & modules.keys()

    def calls(self, name: str) -> int:
        """How often a function is called by its bare name."""
        return sum(
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name
            for node in ast.walk(self.tree)
        )

    def named(self, rings: set[str]) -> list[str]:
        """The rings that a file names: in an import, in a string, or by a path."""
        names = "|".join(sorted(rings))
        pattern = re.compile(rf"optipromp[./](?:{names})\b|\b(?:{names})/\w+")
        return [f"{name_of(self.path)} names {m}" for m in pattern.findall(self.text)]


def lines_of(path: Path) -> int:
    """Lines of a file."""
    return path.read_bytes().count(b"\n")


def circles(graph: dict[str, set[str]]) -> list[str]:
    """Modules from which imports lead back to themselves."""

    def reach(begin: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[begin])
        while waiting:
            module = waiting.pop()
            if module not in seen:
                seen.add(module)
                waiting += graph.get(module, set())
        return seen

    return sorted(module for module in graph if module in reach(module))


def missing() -> list[str]:
    """Files that ``docs/reading.md`` names and that do not exist."""
    named = dict.fromkeys(re.findall(r"`(\w+/[\w/]+\.py)`", READING.read_text(encoding="utf-8")))
    gone = [file for file in named if not any((top / file).is_file() for top in (SOURCE, ROOT))]
    return [f"{READING.name} names {file}, which does not exist" for file in gone]


def allowed_imports() -> dict[str, str]:
    """What each ring may import, in words, lowest ring first: by the layers of pyproject.toml."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        layers = tomllib.load(file)["tool"]["importlinter"]["contracts"][0]["layers"]
    above: list[str] = []
    out = {}
    for layer in reversed(layers):
        names = re.findall(r"optipromp\.([\w.]+)", layer)
        for k, name in enumerate(names):
            but = " but " + ", ".join(f"`{each}`" for each in names[:k]) if k else ""
            out[name.replace(".", "/")] = f"all rings above{but}" if above else "no other ring"
        above += names
    return out


def untrue() -> list[str]:
    """Rings whose row in ``docs/reading.md`` says other than the contracts what they may import."""
    rows = re.findall(r"^\| `([\w/]+)` \|.*\| (.*) \|$", READING.read_text(encoding="utf-8"), re.M)
    said, wanted = dict(rows), allowed_imports()
    if list(said) != list(wanted):
        return [f"{READING.name}: the rows of rings must be, in this order: {', '.join(wanted)}"]
    return [
        f"{READING.name}: the row of `{ring}` must say that it may import: {words}"
        for ring, words in wanted.items()
        if said.get(ring) != words
    ]


def raised(repository: str, landed: str) -> list[str]:
    """Commits since ``landed`` in which rows of ``rings.toml`` rose by more than others fell."""

    def git(*words: str) -> str:
        return subprocess.run(
            ("git", "-C", repository, *words), check=True, capture_output=True, text=True
        ).stdout

    if git("rev-parse", "--is-shallow-repository").strip() == "true":
        print("a shallow clone has no history of rows: NOT COMPARED\n")
        return []

    def total(commit: str) -> int:
        rows = tomllib.loads(git("show", f"{commit}:scripts/{ROWS.name}"))
        return sum(row["lines"] - row.get("unpaid", 0) for row in rows.values())

    since = ("--first-parent", "--format=%h %s", f"{landed}..HEAD", "--", f"scripts/{ROWS.name}")
    out = []
    for line in git("log", *since).splitlines():
        commit = line.split()[0]
        more = total(commit) - total(f"{commit}^")
        if more > 0:
            out.append(f"{line}: rows of {ROWS.name} rose by {more} lines more than others fell")
    return out


def grown(files: list[File]) -> list[str]:
    """Print the lines of each ring, and return those that have more than their row allows."""
    allowed = tomllib.loads(ROWS.read_text(encoding="utf-8"))
    now, count = Counter[str](), Counter(f.ring for f in files)
    for f in files:
        now[f.ring] += f.lines
    print(f"{'ring':<14} {'files':>6} {'lines':>7} {'allowed':>8}")
    wrong = [f"{ring}: no such ring, but a row in {ROWS.name}" for ring in allowed.keys() - now]
    unpaid = {ring: row["unpaid"] for ring, row in allowed.items() if "unpaid" in row}
    print(f"UNPAID, a shortfall that merges are to pay: {unpaid}\n")
    for ring in sorted(now, key=lambda name: -now[name]):
        most = allowed.get(ring, {}).get("lines", 0)
        print(f"{ring:<14} {count[ring]:>6} {now[ring]:>7} {most:>8}")
        if now[ring] > most:
            wrong.append(
                f"{ring} has {now[ring]} lines, {now[ring] - most} more than {ROWS.name} allows: "
                "take lines away, or raise its row and say why there"
            )
    print(f"{'all':<14} {len(files):>6} {sum(now.values()):>7}\n")
    return wrong


def main() -> int:
    """Print both tables; 0 where no ring has grown and the rules hold."""
    files = [File(path) for path in sorted(SOURCE.rglob("*.py"))]
    wrong = grown(files)
    if sys.argv[1:2] == ["--history"]:
        wrong += raised(*sys.argv[2:4])
    modules = {name_of(f.path): f for f in files}
    graph = {name: f.imports(modules) for name, f in modules.items()}
    rings = {f.ring for f in files} - {CORE, "top"}
    core = [f for f in files if f.ring == CORE]
    wrong += [words for f in core for words in f.named(rings)]
    wrong += [words for f in files for words in f.untyped()]
    around = circles(graph)
    wrong += [f"imports lead back to {module}" for module in around] + missing() + untrue()
    functions = [item for f in files for item in f.functions()]
    plain = max(item for item in functions if not item[3])
    kernel = max(item for item in functions if item[3])
    many = [item for item in functions if item[1] >= MANY]
    owners = Counter(name for f in files for name in f.public)
    twice = [name for name, count in owners.most_common() if count > 1]
    importers = Counter(module for names in graph.values() for module in names)
    alone = [name for name in modules if importers[name] == 1 and modules[name].path.name[0] != "_"]
    text = "\n".join(f.text for f in files)
    longest = max(files, key=lambda f: f.lines)
    rows = [
        ("lines of src", sum(f.lines for f in files), 60_000, ""),
        ("files of src", len(files), 340, ""),
        ("lines of the core", sum(f.lines for f in core), 26_500, ""),
        ("lines of " + " + ".join(HEART), sum(f.lines for f in files if f.heart), 13_500, ""),
        ("lines of tests", sum(map(lines_of, TESTS.rglob("*.py"))), 37_000, ""),
        ("modules with exactly one importer", len(alone), 50, ""),
        ("public names that two files define", len(twice), 40, " ".join(twice[:6])),
        ("calls of resolve", sum(f.calls("resolve") for f in files), 5, ""),
        (f"functions of >= {MANY} parameters", len(many), 40,
         f"{sum(item[3] for item in many)} are kernels"),
        ("type: ignore", text.count("# type: ignore"), 30, ""),
        ("fmt: skip", text.count("# fmt: skip"), 150, ""),
        ("longest file", longest.lines, 600, name_of(longest.path)),
        ("longest function", plain[0], 80, plain[2]),
        ("longest kernel", kernel[0], 130, kernel[2]),
    ]  # fmt: skip
    print(f"{'':<52} {'now':>7} {'wanted':>7}")
    for label, now, wanted, remark in rows:
        print(f"{label:<52} {now:>7} {wanted:>7} {' *'[now > wanted]} {remark}".rstrip())
    print("".join(f"\nWRONG: {words}" for words in wrong), file=sys.stderr)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
