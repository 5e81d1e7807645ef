"""Tutorials and how-to pages run as printed."""

from __future__ import annotations

from pathlib import Path

import pytest
from printed import blocks_of, run_page, write_needed

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(
    str(page.relative_to(DOCS))
    for folder in ("tutorials", "how-to")
    for page in (DOCS / folder).glob("*.md")
    if any(block.command for block in blocks_of(page))
)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_does_what_it_shows(name, tmp_path, forked_workers):
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    write_needed(DOCS / name, tmp_path)
    ran = 0
    for _, problem in run_page(blocks_of(DOCS / name), tmp_path, forked_workers):
        assert not problem, problem
        ran += 1
    assert ran
