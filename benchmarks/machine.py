"""What the benchmarks say of the machine, and how they print tables."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version


def machine() -> str:
    """One line: interpreter, platform, cores, and the packages that matter."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "highway-env", "pytest"))
    python = f"{platform.python_implementation()} {platform.python_version()}"
    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return f"{python} on {system}; {packages}"


def table(headers: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [headers, ["---"] * len(headers), *rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in lines)
