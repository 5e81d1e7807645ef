"""The house knows no guest: lines of its folders do not speak of one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest_dura

HOUSE = Path(pytest_dura.__file__).parent
WORDS = re.compile(
    r"language.?model|(?<![a-z])llm|prompt|cassette|comfort|pedestrian|(?<![a-z])driving(?![a-z])"
    r"|dura-log|dura-qualify|seeded.defect|pytest_dura\.(?:logs|qualification)",
    re.IGNORECASE,
)
FOLDERS = (
    "core", "requirements", "library", "execution", "campaign", "search", "evidence", "reports",
    "plugin", "faults",
)  # fmt: skip


def lines_with_words(folder):
    for file in sorted((HOUSE / folder).rglob("*.py")):
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1):
            if WORDS.search(line):
                yield f"{file.relative_to(HOUSE).as_posix()}:{number}: {line.strip()}"


def test_no_folder_of_the_house_learns_a_word_of_a_guest():
    found = [line for folder in FOLDERS for line in lines_with_words(folder)]
    assert found == []
