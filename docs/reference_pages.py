"""Reference pages that the code declares; ``python docs/reference_pages.py`` writes them.

Fixtures and markers as pytest shows them, built-in roles by their docstrings, the keys of files by
the models that read them, and the names of the Python API, which mkdocstrings fills in when the
site is built.
"""  # noqa: INP001 - a script, no package

from __future__ import annotations

import ast
import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "reference"


def reference_pages() -> Mapping[str, str]:
    """Return the pages by their names in the folder ``reference``."""
    return {
        "api.md": api_page(),
        "fixtures.md": fixtures_page(),
        "files.md": files_page(),
        "roles.md": roles_page(),
    }


GROUPS = {
    "The component and its roles": ("core.roles", "core.role_spec", "core.conformance"),
    "What roles see and say": ("core.percepts", "core.state"),
    "Simulators": ("core.simulator", "core.simulator_conformance", "adapters.black_box"),
    "Domains": ("domains", "core.measures"),
    "Faults": ("core.fault", "faults"),
    "Running episodes": (
        "runner", "core.orchestrator", "core.seeding", "library", "execution",
    ),
    "Episodes": ("core.episode", "core.metrics", "logs", "reports.episode_view"),
    "Campaigns, pairs, searches": ("campaign", "search"),
    "Requirements and verdicts": ("requirements",),
    "Evidence": ("evidence",),
    "Errors": ("core.errors",),
    "Trust": ("core.trust",),
}  # fmt: skip
"""Sections of the API, and the modules whose public names stand in each."""


def public_names() -> dict[str, str]:
    """Return each public name and the module that has it."""
    stub = ast.parse((ROOT / "pytest_dura" / "__init__.pyi").read_text("utf-8"))
    return {
        alias.name: node.module
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }


def api_page() -> str:
    """Return the page of the public names, which mkdocstrings fills from their docstrings.

    Raises:
        ValueError: If a name is of a module that no section names.
    """
    left = public_names()
    lines = [
        "# Python API",
        "",
        "<!-- Written by `python docs/reference_pages.py`; do not edit. -->",
        "",
        "Everything that `from pytest_dura import ...` gives. Names of other modules may change",
        "without notice. [Strategies](../strategies.md) of Hypothesis stand in",
        "`pytest_dura.strategies`, FMUs in [`pytest_dura.adapters.fmi`](../black-boxes.md#fmus).",
        "Where a line begins with `:::`, the site (`mkdocs build`) has signature and description.",
    ]
    for title, modules in GROUPS.items():
        own = [
            name
            for name, home in left.items()
            if any(home == module or home.startswith(f"{module}.") for module in modules)
        ]
        lines += ["", f"## {title}"]
        for name in sorted(own):
            lines += ["", f"::: pytest_dura.{left.pop(name)}.{name}"]
    if left:
        raise ValueError(f"no section of the API has {', '.join(left)}")
    return "\n".join([*lines, ""])


def fixtures_page() -> str:
    """Return the page of fixtures and markers, as pytest shows them."""
    from pytest_dura.plugin.waiting import MARKERS

    lines = [
        "# Fixtures and markers",
        "",
        "<!-- Written by `python docs/reference_pages.py`; do not edit. -->",
        "",
        "## Markers",
        "",
        "`pytest --markers` shows them, too. A marker that names what is not there is an error.",
        "",
    ]
    for marker in MARKERS:
        usage, _, meaning = marker.partition(": ")
        lines += [f"### {usage.partition('(')[0]}", "", "```python", f"pytest.mark.{usage}", "```"]
        lines += ["", f"{meaning[0].upper()}{meaning[1:]}.", ""]
    lines += [
        "## Fixtures",
        "",
        "Override one that is named after a role in a `conftest.py` to swap that role. What",
        "`episode` and `campaign` give stands in the [Python API](api.md#episodes). Each has a",
        "long and a short name; [a setting](../guest.md#names-of-fixtures) leaves short ones out.",
        "",
        "| fixture | scope | what it is |",
        "|---|---|---|",
    ]
    for name, scope, text in session_fixtures():
        lines.append(f"| `{name}` | {scope} | {text.replace('``', '`')} |")
    return "\n".join([*lines, ""])


ARGUMENT = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)


def roles_page() -> str:
    """Return the page of the registered roles, as their docstrings describe them."""
    from pytest_dura.domains import ROLES

    lines = [
        "# Built-in roles",
        "",
        "<!-- Written by `python docs/reference_pages.py`; do not edit. -->",
        "",
        "Scenarios name a role as `roles: {generator: tactical}`, with parameters as",
        "`roles: {generator: {path: tactical, params: {period: 0.5}}}`; `--dura-generator` takes",
        "the name of a Generator. Other packages [register](../extending.md) roles of their own.",
    ]
    title = ""
    for name in sorted(ROLES, key=lambda name: name.split(".")[-2:]):
        role, short = name.split(".")[-2:]
        described, text = ROLES[name], inspect.getdoc(ROLES[name]) or ""
        if not described.__module__.startswith("pytest_dura."):
            continue
        if role != title:
            lines += ["", f"## {role}"]
            title = role
        lines += ["", f"### {role} {short}", "", plain(text.partition("\n\n")[0])]
        meanings = dict(ARGUMENT.findall(text.partition("Args:\n")[2].partition("\n\n")[0]))
        rows = [
            f"| `{key}` | {default_text(parameter)} | {plain(meanings.get(key, ''))} |"
            for key, parameter in inspect.signature(described).parameters.items()
            if parameter.kind is not parameter.VAR_KEYWORD
        ]
        if rows:
            lines += ["", "| parameter | default | meaning |", "|---|---|---|", *rows]
    return "\n".join([*lines, ""])


def default_text(parameter: inspect.Parameter) -> str:
    """Return the default of a parameter as a cell of a table."""
    return "required" if parameter.default is parameter.empty else f"`{parameter.default!r}`"


FIXTURE = re.compile(r"^(\w+)(?: \[(\w+) scope\])? -- .*\n((?: {4}.*\n)+)", re.MULTILINE)


def session_fixtures() -> list[tuple[str, str, str]]:
    """Return name, scope and meaning of each fixture of the plugin, as `pytest --fixtures` does."""
    pytest_command = [sys.executable, "-m", "pytest", "--fixtures", "-p", "no:cacheprovider"]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [*pytest_command, f"--rootdir={folder}", folder],
            cwd=folder, capture_output=True, text=True, check=False,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
    sections = re.split(r"^-+ (.*) -+$", done.stdout, flags=re.MULTILINE)
    own = [
        text
        for title, text in zip(sections[1::2], sections[2::2], strict=True)
        if "from pytest_dura." in title
    ]
    found = [
        (name, scope or "function", " ".join(text.split()))
        for section in own
        for name, scope, text in FIXTURE.findall(section)
    ]
    if not found:
        raise ValueError(f"pytest --fixtures shows none of the plugin's: {done.stdout[-500:]}")
    return found


def files_page() -> str:
    """Return the page of the keys of YAML files, from the models that read them."""
    from pytest_dura.library.hazards import HazardFile
    from pytest_dura.library.requirements import RequirementFile
    from pytest_dura.library.scenario import Scenario

    files = {
        "Scenario files": (Scenario, SCENARIO_FILES),
        "Requirement files": (RequirementFile, REQUIREMENT_FILES),
        "Hazard files": (HazardFile, HAZARD_FILES),
    }
    lines = [
        "# Keys of YAML files",
        "",
        "<!-- Written by `python docs/reference_pages.py`; do not edit. -->",
        "",
        "An unknown key, a missing one, and a value of another type are errors at collection, with",
        "file, line, what was found and what was expected. `python -m pytest_dura.library.scenario",
        "FILE` writes the JSON Schema for editors, with the worlds of all installed domains.",
    ]
    for title, (model, introduction) in files.items():
        schema = model.model_json_schema(ref_template="{model}")
        lines += ["", f"## {title}", "", introduction, "", *key_table(schema)]
        for name, part in schema.get("$defs", {}).items():
            if "properties" in part:
                lines += ["", f"### {name}", "", plain(part.get("description", "")), ""]
                lines += key_table(part)
    return "\n".join([*lines, ""])


SCENARIO_FILES = """One scenario a file, below `scenarios/` or the ini setting
`dura_scenario_paths`. What `world` holds is the domain's: [driving](../driving.md),
[roads](../roads.md). What faults and their activations hold stands under [faults](../faults.md),
what `campaigns` takes under [fault campaigns](../fault-campaigns.md)."""
REQUIREMENT_FILES = """Named `requirements*.yaml`, beside scenarios.
[Requirements](../requirements.md) has an example, [formulas](../formulas.md) what `check` takes."""
HAZARD_FILES = """Named `hazards*.yaml`, beside requirements.
[Hazards](../standards.md#hazards) says what they are for."""


def key_table(schema: Mapping[str, Any]) -> Iterator[str]:
    """Yield a table of the keys of a mapping."""
    yield "| key | value | default | meaning |"
    yield "|---|---|---|---|"
    required = schema.get("required", ())
    for key, part in schema["properties"].items():
        default = "required" if key in required else json.dumps(part.get("default"))
        default = "" if default in ("null", '""', "[]", "{}") else default
        cell = f"`{default}`" if default not in ("", "required") else default
        yield f"| `{key}` | {value_text(part)} | {cell} | {plain(part.get('description', ''))} |"


def plain(text: str) -> str:
    """Return text of a docstring as a cell of a table."""
    return " ".join(text.replace("``", "`").split()).replace("|", "\\|")


TYPES = {
    "string": "text", "integer": "whole number", "number": "number", "boolean": "true or false",
    "array": "list", "object": "mapping", "null": "null",
}  # fmt: skip


def value_text(part: Mapping[str, Any]) -> str:
    """Say what a key may hold."""
    if "$ref" in part:
        name = part["$ref"]
        return "anything" if name == "JsonValue" else f"[{name}](#{name.lower()})"
    for several in ("anyOf", "oneOf"):
        if several in part:
            return " or ".join(dict.fromkeys(map(value_text, part[several])))
    if "enum" in part or "const" in part:
        return ", ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    text = TYPES.get(part.get("type", ""), "anything")
    inner = part.get("items") or part.get("additionalProperties")
    if isinstance(inner, dict) and inner:
        return f"{text} of {value_text(inner)}"
    return text + limits_text(part)


LIMITS = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "below",
          "maximum": "to"}  # fmt: skip


def limits_text(part: Mapping[str, Any]) -> str:
    """Say between which limits a number is."""
    limits = [f"{word} {part[key]:g}" for key, word in LIMITS.items() if key in part]
    return f", {' '.join(limits)}" if limits else ""


if __name__ == "__main__":
    for _name, _text in reference_pages().items():
        (FOLDER / _name).write_text(_text, "utf-8")
