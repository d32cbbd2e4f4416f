"""Print how large and how tangled the source is, beside what issue 11 asks for.

Run from the repository: ``python scripts/end_state.py``. Exits with 1 where a line is not met.
"""

import ast
import re
import sys
from collections import defaultdict
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src" / "optipromp"
CORE = ("judging", "optimization", "pushing", "planning")
KERNELS = ("kernel", "inner", "inlined")  # decorators of optipromp.core.compiled
ENTRY, BOX = "planning/plan.py", "geometry/distances.py"  # from ``plan`` to the distance of a box


def name_of(path: Path) -> str:
    """Dotted name of a module."""
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


class File:
    """One file, parsed."""

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8")
        self.path, self.lines, self.tree = path, text.count("\n"), ast.parse(text)
        self.core = path.relative_to(SOURCE).parts[0] in CORE
        self.classes = [n.name for n in ast.walk(self.tree) if isinstance(n, ast.ClassDef)]
        self.constants = dict(self._constants())

    def _constants(self) -> list[tuple[str, str]]:
        """Numeric constants of the module: name and value as text."""
        found = []
        for node in self.tree.body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                names = target.elts if isinstance(target, ast.Tuple) else [target]
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                if len(names) != len(values):
                    values = [node.value] * len(names)
                for name, value in zip(names, values, strict=True):
                    if (
                        isinstance(name, ast.Name)
                        and re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name.id)
                        and any(
                            isinstance(n, ast.Constant) and type(n.value) in (int, float)
                            for n in ast.walk(value)
                        )
                    ):
                        found.append((name.id, ast.unparse(value)))
        return found

    def functions(self) -> list[tuple[int, str, bool]]:
        """Length, name and whether it is a compiled kernel, of every function."""
        return [
            (
                (node.end_lineno or 0) - node.lineno + 1, f"{name_of(self.path)}.{node.name}",
                any(d in KERNELS or "jit" in d for d in map(ast.unparse, node.decorator_list)),
            )
            for node in ast.walk(self.tree)
            if isinstance(node, ast.FunctionDef)
        ]  # fmt: skip

    def imports(self, modules: dict[str, "File"]) -> set[str]:
        """Modules of the library that this one imports when it is imported."""
        out = set()
        for node in self.tree.body:
            if isinstance(node, ast.ImportFrom) and node.module in modules:
                for alias in node.names:
                    dotted = f"{node.module}.{alias.name}"
                    out.add(dotted if dotted in modules else node.module)
            elif isinstance(node, ast.ImportFrom) and node.module:
                out |= {
                    f"{node.module}.{alias.name}"
                    for alias in node.names
                    if f"{node.module}.{alias.name}" in modules
                }
        return out


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


def hops(graph: dict[str, set[str]], begin: str, end: str) -> int:
    """Files on the shortest path of imports from one module to another, both included."""
    level, count, seen = {begin}, 1, {begin}
    while level and end not in level:
        level = set().union(*(graph.get(m, set()) for m in level)) - seen
        seen |= level
        count += 1
    return count


def main() -> int:
    """Print the table; 0 where every line is met."""
    files = [File(path) for path in sorted(SOURCE.rglob("*.py"))]
    modules = {name_of(f.path): f for f in files}
    graph = {name: f.imports(modules) for name, f in modules.items()}
    core = [f for f in files if f.core]
    functions = [item for f in files for item in f.functions()]
    plain = max(item for item in functions if not item[2])
    kernel = max(item for item in functions if item[2])
    owners: dict[str, set[str]] = defaultdict(set)
    values: dict[str, set[str]] = defaultdict(set)
    for f in files:
        for name in f.classes:
            owners[name].add(name_of(f.path))
        for name, value in f.constants.items():
            values[name].add(value)
    twice = sorted(name for name, where in owners.items() if len(where) > 1 and name[0] != "_")
    torn = sorted(name for name, many in values.items() if len(many) > 1)
    path = hops(graph, name_of(SOURCE / ENTRY), name_of(SOURCE / BOX))
    rows = [
        ("lines of src", sum(f.lines for f in files), 19_000, ""),
        ("lines of the core", sum(f.lines for f in core), 5_350, ", ".join(CORE)),
        ("files of the core", len(core), 34, ""),
        ("numeric constants of the core", sum(len(f.constants) for f in core), 40, ""),
        ("longest function", plain[0], 80, plain[1]),
        ("longest kernel", kernel[0], 130, kernel[1]),
        ("files from plan to the distance of a box", path, 8, ""),
        ("files in circles of imports", len(circles(graph)), 0, " ".join(circles(graph))),
        ("class names of two files", len(twice), 0, " ".join(twice)),
        ("constant names of two values", len(torn), 0, " ".join(torn)),
    ]
    print(f"{'':<42} {'now':>7} {'wanted':>7}")
    for label, now, wanted, remark in rows:
        mark = " " if now <= wanted else "*"
        print(f"{label:<42} {now:>7} {wanted:>7} {mark} {remark}".rstrip())
    return int(any(now > wanted for _, now, wanted, _ in rows))


if __name__ == "__main__":
    sys.exit(main())
