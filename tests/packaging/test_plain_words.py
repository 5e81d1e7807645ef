"""Plain words: no pronouns for users, and no tales, in messages, names and docstrings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
READ = (
    *(f"pytest_dura/**/*.{kind}" for kind in ("py", "js", "css", "html")),
    "docs/**/*.md", "README.md", "CONTRIBUTING.md",
)  # fmt: skip
WORDS = re.compile(r"\b(nobody|somebody|whoever|told|said)\b", re.IGNORECASE)
ALLOWED = {
    # Part of the prompt of the judge, whose recorded answers it names.
    "pytest_dura/llm/judge.py": 1,
    # Names in the files of traces, and a class of the picture's style.
    "pytest_dura/evidence/mcap.py": 5,
    "pytest_dura/reports/episode_view.py": 3,
    # The finding `cannot be told`, which records and the page have.
    "pytest_dura/evidence/conclusions/effectiveness.py": 5,
    "pytest_dura/evidence/verdict_model.py": 2,
    "pytest_dura/reports/story.py": 1,
    "docs/record.md": 2,
    "docs/verdicts.md": 2,
    # What terminals of earlier versions showed.
    "docs/releases/terminal.md": 7,
}
"""Uses that stay, by file."""


def used() -> dict[str, int]:
    counts = {
        file.relative_to(ROOT).as_posix(): len(WORDS.findall(file.read_text("utf-8")))
        for pattern in READ
        for file in ROOT.glob(pattern)
    }
    return {file: number for file, number in counts.items() if number}


def test_package_and_docs_speak_of_workers_sessions_users_and_tests():
    assert used() == ALLOWED


@pytest.mark.parametrize("text", ["Nobody is left", "it was told", "whoever asks"])
def test_such_words_are_found(text):
    assert WORDS.search(text)
