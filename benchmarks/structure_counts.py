"""What a feature costs in lines: lines of code by folder, classes with a twin, conversions.

Run: python benchmarks/structure_counts.py [TREE ...]

Each TREE is a checkout, and a column of the table; without any it is this one. Lines are logical
ones of every Python file outside ``tests/``: lines of code, without those that hold nothing but
white space, comments or docstrings, below fields too. Twins are classes of the package that share
by name at least half of their annotated fields, and at least three, with another class; a class and
those that it inherits from are no twins. Conversions are functions ``to_json``, ``from_json``,
``plain_data``, and class methods ``of``; for ``plain_data`` its calls are counted, too.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

from machine import table

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "pytest_dura"
LEAST_SHARED = 3
NO_CODE = (
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT,
    tokenize.ENDMARKER,
)  # fmt: skip


def python_files(tree: Path) -> list[Path]:
    """Python files that the repository has, relative to the tree, without those of tests."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"],
        cwd=tree,
        capture_output=True,
        text=True,
        check=True,
    )
    paths = map(Path, listed.stdout.splitlines())
    return [path for path in paths if path.parts[0] != "tests" and (tree / path).is_file()]


def logical_lines(source: str) -> int:
    """Lines that hold code; a text that stands alone, as a docstring does, is none."""
    texts: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        alone = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if alone and isinstance(node.value.value, str):
            texts.update(range(node.lineno, node.end_lineno + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(StringIO(source).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - texts)


def folder_of(path: Path) -> str:
    """First folder of a file; below the package, the first one there."""
    parts = path.parts[:-1]
    return "/".join(parts[: 2 if parts[:1] == (PACKAGE,) else 1]) or "."


def class_fields(modules: dict[Path, ast.Module]) -> Iterator[tuple[str, set[str], set[str]]]:
    """Yield name, own annotated fields and names of bases of each class of the package."""
    for path, module in modules.items():
        for node in ast.walk(module):
            if path.parts[0] == PACKAGE and isinstance(node, ast.ClassDef):
                fields = {
                    part.target.id
                    for part in node.body
                    if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
                }
                bases = {base.id for base in node.bases if isinstance(base, ast.Name)}
                yield f"{'.'.join(path.with_suffix('').parts[1:])}.{node.name}", fields, bases


def twins(modules: dict[Path, ast.Module]) -> list[tuple[str, str]]:
    """List the classes that share half of their fields with another one, and which that is."""
    classes = list(class_fields(modules))
    found = []
    for name, fields, bases in classes:
        shared = [
            (len(fields & others), other)
            for other, others, other_bases in classes
            if other != name
            and other.rpartition(".")[2] not in bases
            and name.rpartition(".")[2] not in other_bases
        ]
        most, other = max(shared, default=(0, ""))
        if most >= max(LEAST_SHARED, len(fields) / 2):
            found.append((name, other))
    return found


def conversions(modules: dict[Path, ast.Module]) -> Counter[str]:
    """Count the functions of the package that turn one form of a fact into another."""
    counts: Counter[str] = Counter()
    for path, module in modules.items():
        if path.parts[0] != PACKAGE:
            continue
        for node in ast.walk(module):
            if isinstance(node, ast.FunctionDef):
                of = any(ast.unparse(mark) == "classmethod" for mark in node.decorator_list)
                if node.name in ("to_json", "from_json", "plain_data") or (
                    node.name == "of" and of
                ):
                    counts[node.name] += 1
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == "plain_data":
                counts["calls of plain_data"] += 1
    return counts


def measure(tree: Path) -> tuple[dict[str, str], list[tuple[str, str]]]:
    """The rows of one checkout, and its twins."""
    sources = {path: (tree / path).read_text(encoding="utf-8") for path in python_files(tree)}
    modules = {path: ast.parse(source) for path, source in sources.items()}
    lines: Counter[str] = Counter()
    standing: Counter[str] = Counter()
    files: Counter[str] = Counter()
    for path, source in sources.items():
        counted = logical_lines(source)
        for folder in {folder_of(path), PACKAGE if path.parts[0] == PACKAGE else "", "all"} - {""}:
            lines[folder] += counted
            standing[folder] += source.count("\n")
            files[folder] += 1
    pairs, converted = twins(modules), conversions(modules)
    entries = [name for name, _ in pairs if name.startswith("evidence.") and "_model." in name]
    rows = {
        f"`{name}`: modules, lines, logical lines": f"{files[name]}, {standing[name]:,}, {count:,}"
        for name, count in sorted(lines.items())
    }
    rows["classes with a twin"] = str(len(pairs))
    rows["of them models of the record"] = str(len(entries))
    names = ("to_json", "from_json", "of", "plain_data")
    rows["conversion functions"] = str(sum(converted[name] for name in names))
    rows |= {f"`{name}`": str(converted[name]) for name in names}
    rows["calls of `plain_data`"] = str(converted["calls of plain_data"])
    return rows, pairs


def main() -> None:
    """Print the table, and the twins of the last tree."""
    trees = [Path(given).resolve() for given in sys.argv[1:]] or [ROOT]
    columns = [measure(tree) for tree in trees]
    names = dict.fromkeys(name for rows, _ in columns for name in rows)
    rows = [[name, *(column.get(name, "-") for column, _ in columns)] for name in names]
    print(table(["measure", *(tree.name for tree in trees)], rows))
    print()
    print(
        table([f"class of {trees[-1].name}", "its twin"], [list(pair) for pair in columns[-1][1]])
    )


if __name__ == "__main__":
    main()
