"""The house knows no guest: lines of its folders that speak of one are counted."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest_dura

HOUSE = Path(pytest_dura.__file__).parent
WORDS = re.compile(
    r"language.?model|(?<![a-z])llm|prompt|cassette|comfort|pedestrian|(?<![a-z])driving(?![a-z])",
    re.IGNORECASE,
)
LEFT = {
    "core": 1,
    "requirements": 0,
    "library": 1,
    "execution": 0,
    "campaign": 0,
    "search": 0,
    "evidence": 0,
    "reports": 0,
    "plugin": 1,
}
"""Lines by folder. A number that is too large here is an error as well: it hides the next one."""
FOLDERS = (
    "core", "requirements", "library", "execution", "campaign", "search", "evidence", "reports",
    "plugin",
)  # fmt: skip


def lines_with_words(folder):
    for file in sorted((HOUSE / folder).rglob("*.py")):
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1):
            if WORDS.search(line):
                yield f"{file.relative_to(HOUSE).as_posix()}:{number}: {line.strip()}"


def test_no_folder_of_the_house_learns_a_word_of_a_guest():
    found = {folder: list(lines_with_words(folder)) for folder in FOLDERS}
    counts = Counter({folder: len(lines) for folder, lines in found.items()})
    shown = "\n".join(line for folder in FOLDERS for line in found[folder])
    assert {folder: counts[folder] for folder in FOLDERS} == LEFT, shown
