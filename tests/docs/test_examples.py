"""Each example of each page is one: it is read, and what it names is there.

Tutorials and how-to pages run as printed as well (``test_pages.py``), and so do pages with a test
of their own. This is what holds for all.
"""

from __future__ import annotations

import ast
import configparser
import contextlib
import functools
import importlib.util
import io
import itertools
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from printed import Block, blocks_of

from pytest_dura.__main__ import main
from pytest_dura.library.documents import parse_yaml, validate
from pytest_dura.library.hazards import HazardFile
from pytest_dura.library.requirements import RequirementFile
from pytest_dura.library.scenario import Scenario
from pytest_dura.logs.mapping import LogMapping
from pytest_dura.plugin.options import option_rows

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).parents[2]
DOCS = REPOSITORY / "docs"
PAGES = sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
FLAGS = {row.flag for row in option_rows() if row.flag}
SETTINGS = {row.ini for row in option_rows() if row.ini}
OF_ONE_PAGE = {"--dura-evidence-reduced"}
"""What looks like an option, and is none."""
TEXTS = {"", "text"}
"""Languages of outputs, pictures and data, which only a page's own test can judge."""
QUOTES = "mobile-robot.md"
"""Its blocks are parts of the suite, with which its own test compares them."""
OTHER_YAML = {
    "jobs": "a workflow", "command": "a binding of a link", "G1": "an argument",
    "decision": "a review", "posts": "a world",
}  # fmt: skip
"""A key by which YAML is no file of ours, and what it is."""


def test_every_block_is_of_a_language_that_is_checked():
    languages = {block.language for name in PAGES for block in blocks_of(DOCS / name)}
    assert languages <= TEXTS | {"python", "sh", "yaml", "toml", "ini"}
    assert languages >= {"python", "sh", "yaml"}


def check_names(text):
    named = set(re.findall(r"(?<![\w-])--dura-[a-z-]*[a-z]", text))
    assert named <= FLAGS | OF_ONE_PAGE
    settings = set(re.findall(r"(?:^|`)(dura_[a-z_]+) = ", text, re.MULTILINE))
    settings |= set(re.findall(r"setting `(dura_[a-z_]+)`", text))
    assert settings <= SETTINGS


def check_python(block):
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pytest_dura"):
            module = importlib.import_module(node.module)
            for name in (alias.name for alias in node.names):
                assert hasattr(module, name) or importlib.util.find_spec(f"{node.module}.{name}")


def check_yaml(block):
    """It is a file of ours, or a part of one."""
    data = yaml.safe_load(block.text)
    if isinstance(data, list):  # steps of a workflow, or campaigns and faults
        assert all(isinstance(each, (dict, str)) for each in data)
        return
    if set(data) & set(OTHER_YAML):
        return
    if "signals" in data:
        validate(LogMapping, parse_yaml(block.text, "page.yaml"))
        return
    model = RequirementFile if _defines(data) else HazardFile if "hazards" in data else Scenario
    if model is Scenario and not {"name", "simulator"} <= set(data):
        assert set(data) <= set(Scenario.model_fields)
        return
    validate(model, parse_yaml(block.text, "page.yaml"))


def _defines(data) -> bool:
    return any(isinstance(each, dict) for each in data.get("requirements", ()))


def check_toml(block):
    assert tomllib.loads(block.text)


def check_settings(block):
    text = block.text if block.text.startswith("[") else f"[pytest]\n{block.text}"
    parser = configparser.ConfigParser()
    parser.read_string(text)
    ours = {key for key in parser["pytest"] if key.startswith("dura_")}
    assert ours
    assert ours <= SETTINGS


def commands(block: Block) -> Iterator[list[str]]:
    """Yield the commands of a block, split; of an output only what was typed."""
    typed = re.sub(r"\\\n\s*", " ", block.text)
    for line in typed.splitlines():
        if block.language != "sh" and not line.startswith("$ "):
            continue
        words = shlex.split(line.removeprefix("$ "), comments=True)
        parts, at = [], 0
        for end, word in enumerate([*words, "&&"]):
            if word in ("&&", "|", ";"):
                parts.append(words[at:end])
                at = end + 1
        for part in parts:
            assigned = itertools.takewhile(lambda word: re.match(r"[A-Z_]+=", word), part)
            if command := part[len(list(assigned)) :]:
                yield command


@functools.cache
def options_of(command: str) -> set[str]:
    """Options of a command of ``python -m pytest_dura``, as its help shows them."""
    told = io.StringIO()
    with contextlib.redirect_stdout(told), pytest.raises(SystemExit):
        main([command, "--help"])
    return set(re.findall(r"--[a-z][a-z-]*", told.getvalue()))


def check_commands(block):
    """They are there, with the options that they are given."""
    for words in commands(block):
        if words[:2] == ["python", "-m"] and words[2] == "pytest_dura":
            given = {word.partition("=")[0] for word in words[4:] if word.startswith("--")}
            assert given <= options_of(words[3])
        elif words[:2] == ["python", "-m"]:
            assert words[2] in ("pytest", "venv", "pip") or importlib.util.find_spec(words[2])
        elif words[:1] == ["python"]:
            assert (REPOSITORY / words[1]).is_file()
        elif words[:1] == ["pytest"]:
            given = {word.partition("=")[0] for word in words if word.startswith("--dura")}
            assert given <= FLAGS
        elif words[:1] == ["cp"] and "$" not in words[-2]:
            assert (REPOSITORY / words[-2]).exists()


CHECKS = {
    "python": check_python, "yaml": check_yaml, "toml": check_toml, "ini": check_settings,
    "sh": check_commands, "": check_commands,
}  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
def test_what_a_page_names_is_there_and_each_example_is_one(name):
    check_names((DOCS / name).read_text("utf-8"))
    for block in blocks_of(DOCS / name):
        if block.language in CHECKS and (name, block.language) != (QUOTES, "python"):
            CHECKS[block.language](block)


def test_a_wrong_option_is_seen():
    block = Block("sh", "cd x && pytest --dura-scenrios  # no\npython -m pytest_dura verify d")
    assert list(commands(block)) == [
        ["cd", "x"], ["pytest", "--dura-scenrios"], ["python", "-m", "pytest_dura", "verify", "d"],
    ]  # fmt: skip
    assert "--dura-scenrios" not in FLAGS
