"""docs/llm.md and the pages of docs/llm name everything that there is, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pytest_dura.driving import SIGNALS
from pytest_dura.driving.explanations import MEANINGS
from pytest_dura.llm import EVERYTHING, INTENTS, MANEUVERS
from pytest_dura.llm.answers import FAILURE_MEANINGS as CLASSES
from pytest_dura.llm.endpoint import KEY, MODEL, URL
from pytest_dura.llm.settings import Settings

DOCS = Path(__file__).parents[3] / "docs"
PAGE = "\n".join(
    page.read_text("utf-8") for page in [DOCS / "llm.md", *sorted((DOCS / "llm").glob("*.md"))]
)
FILLED_IN = {"server", "judge_server", "prompts"}


def rows(heading):
    """The first cells of the table under a heading, as the names in them."""
    section = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    cells = re.findall(r"^\| (`.*?) \|", section, flags=re.MULTILINE)
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def test_every_parameter_is_described():
    assert set(rows("Parameters")) == set(Settings.model_fields) - FILLED_IN
    for name in FILLED_IN:
        assert f"(`{name}`)" in PAGE


@pytest.mark.parametrize("name", ["decide_every", "samples", "beside_every", "history", "fallback"])
def test_the_defaults_are_told(name):
    default = Settings.model_fields[name].default
    assert re.search(rf"^\| `{name}` \| `?{default}`? \|", PAGE, flags=re.MULTILINE)


def test_every_failure_mode_is_described():
    told = rows("Failure modes")
    classes = set(CLASSES)
    assert set(told) - classes == set(MEANINGS) - classes
    assert {"unavailable", "unknown_action"} <= set(told)
    assert set(SIGNALS) - set(MEANINGS) == {"age"}
    assert "`proposal.age`" in PAGE


def test_every_class_of_failure_has_its_meaning():
    assert set(rows("A decision")) == {"answered", *CLASSES}
    for name, meaning in CLASSES.items():
        assert f"| `{name}` | {meaning}" in PAGE


def test_variables_variants_and_words_are_named():
    for name in (URL, MODEL, KEY, *EVERYTHING):
        assert f"`{name}`" in PAGE
    assert "|".join(INTENTS) in PAGE
    assert "|".join(MANEUVERS) in PAGE
