"""What the package is made of: modules, lines, circles of imports, and empty identifiers.

Run: python benchmarks/structure.py [TREE ...]

Each TREE is a checkout, and a column of the table; without any it is this one. Lines are those of
Python files as they stand. Circles are groups of modules that reach each other by imports, those
inside functions and those for type checkers included. The modules that one case executes are those
in ``sys.modules`` after a session of one run of one built-in case. Identifiers are counted as names
and arguments, in the syntax tree.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median

from machine import table

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pytest_dura"
SMALL = 60
IDENTIFIERS = ("one", "found", "told", "said", "word")
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
ONE_CASE = """
import sys, pytest
code = pytest.main(["-q", "-p", "no:cacheprovider", "--dura-scenarios", "--dura-runs=1",
                    "--dura-select=intersection/nominal"])
print("modules", sum(name.split(".")[0] == "pytest_dura" for name in sys.modules))
"""


def read(tree: Path) -> dict[str, str]:
    """Source of each module of a checkout's package, by dotted name."""
    sources = {}
    for path in sorted((tree / PACKAGE).rglob("*.py")):
        parts = path.relative_to(tree).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        sources[name] = path.read_text(encoding="utf-8")
    return sources


def imports(module: ast.Module, known: Mapping[str, object]) -> Iterator[str]:
    """Modules of the package that a module imports, wherever in its text."""
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                names = (f"{node.module}.{alias.name}", node.module)
                yield from [name for name in names if name in known][:1]
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


def circles(graph: Mapping[str, set[str]]) -> list[set[str]]:
    """Groups of modules that reach each other."""
    reached = {name: _reached(graph, name) for name in graph}
    groups: list[set[str]] = []
    for name in graph:
        group = {other for other in reached[name] if name in reached[other]}
        if len(group) > 1 and group not in groups:
            groups.append(group)
    return groups


def _reached(graph: Mapping[str, set[str]], start: str) -> set[str]:
    reached: set[str] = set()
    waiting = [start]
    while waiting:
        for name in graph[waiting.pop()]:
            if name not in reached:
                reached.add(name)
                waiting.append(name)
    return reached


def executed(tree: Path) -> int:
    """How many modules of the package a session of one run of one case executes."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(tree)}
        done = subprocess.run(
            [sys.executable, "-c", ONE_CASE],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
    return int(done.stdout.split()[-1])


def measure(tree: Path) -> dict[str, str]:
    """The rows of one checkout."""
    sources = read(tree)
    modules = {name: ast.parse(source) for name, source in sources.items()}
    lines = {name: source.count("\n") for name, source in sources.items()}
    graph = {name: set(imports(module, modules)) - {name} for name, module in modules.items()}
    names: Counter[str] = Counter()
    before = 0
    for name, module in modules.items():
        first = next((node for node in module.body if isinstance(node, DEFINITIONS)), None)
        before += lines[name] if first is None else first.lineno - 1
        for node in ast.walk(module):
            if isinstance(node, ast.Name):
                names[node.id] += 1
            elif isinstance(node, ast.arg):
                names[node.arg] += 1
    groups = circles(graph)
    return {
        "modules": f"{len(lines):,}",
        "lines": f"{sum(lines.values()):,}",
        "lines of a module, median": f"{median(lines.values()):g}",
        f"modules below {SMALL} lines": str(sum(count < SMALL for count in lines.values())),
        "lines before the first definition": f"{before:,}",
        "modules that one case executes": str(executed(tree)),
        "circles of imports": str(len(groups)),
        "modules in circles": str(sum(len(group) for group in groups)),
        **{f"identifier `{name}`": f"{names[name]:,}" for name in IDENTIFIERS},
    }


def main() -> None:
    """Print the table."""
    trees = [Path(given).resolve() for given in sys.argv[1:]] or [ROOT]
    columns = [measure(tree) for tree in trees]
    rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
    print(table(["measure", *(tree.name for tree in trees)], rows))


if __name__ == "__main__":
    main()
