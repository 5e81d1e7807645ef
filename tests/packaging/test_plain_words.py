"""Plain words: no pronouns for users, and no tales, in messages, names and docstrings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "pytest_dura"
WORDS = re.compile(r"\b(nobody|somebody|whoever|told|said)\b", re.IGNORECASE)
ALLOWED = {
    # Part of the prompt of the judge, whose recorded answers it names.
    "llm/judge.py": 1,
    # Names in the files of traces, and classes of the page's style.
    "evidence/mcap.py": 5,
    "reports/episode_view.py": 3,
    "llm/panel/thoughts.py": 2,
    # The finding `cannot be told`, which records and the page have.
    "evidence/conclusions/effectiveness.py": 5,
    "evidence/verdict_model.py": 2,
    "reports/story.py": 1,
}
"""Uses that stay, by file."""


def used() -> dict[str, int]:
    counts = {
        file.relative_to(PACKAGE).as_posix(): len(WORDS.findall(file.read_text("utf-8")))
        for file in sorted(PACKAGE.rglob("*.py"))
    }
    return {file: number for file, number in counts.items() if number}


def test_the_package_speaks_of_workers_sessions_users_and_tests():
    assert used() == ALLOWED


@pytest.mark.parametrize("text", ["Nobody is left", "it was told", "whoever asks"])
def test_such_words_are_found(text):
    assert WORDS.search(text)
