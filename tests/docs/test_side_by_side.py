"""Two outputs in the terminal beside each other, and what went from the first to the second."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
BEFORE = [
    "violated: safety on a (B) (1 of 1 cause)",
    "  At t = 4.40 s the ego was hit by V3, and",
    "  it stood still.",
    "  replay:   pytest --dura-replay=a#1",
    "  replay:   pytest --dura-replay=a#1",
    "Nothing was there to prevent in any run. The rest is as before in 15 runs.",
]
AFTER = [
    "violated: safety on a (B) (1 of 1 cause)",
    "  replay:   pytest --dura-replay=a#1",
    "The rest is as before in 3 runs.",
]


@pytest.fixture
def pages(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    return importlib.import_module("side_by_side")


def test_what_went_is_named_once_whatever_its_figures(pages):
    assert pages.gone(BEFORE, AFTER) == [
        "`replay:` 2 -> 1",
        "`At t = 4.40 s the ego was hit by V3, and it stood still.`",
        "`Nothing was there to prevent in any run`",
    ]
    assert pages.gone(AFTER, AFTER) == []


def test_equal_lines_stand_beside_each_other_and_long_ones_are_wrapped(pages):
    rows = pages.side_by_side([*BEFORE, "x" * (pages.WIDTH + 1)], AFTER)
    assert all(len(row) <= 2 * pages.WIDTH + 3 for row in rows)
    assert all(row[pages.WIDTH : pages.WIDTH + 2] == " |" for row in rows)
    assert sum(row[: pages.WIDTH].rstrip() == row[pages.WIDTH + 3 :] for row in rows) == 2
