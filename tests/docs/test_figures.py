"""Marked figures: what a command prints takes their place, and every command is there."""

from __future__ import annotations

import runpy
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "figures.py"


def test_each_mark_has_an_end_and_a_script_that_exists():
    figures = runpy.run_path(str(SCRIPT))
    pages = list(figures["pages"]())
    assert pages
    for page in pages:
        text = page.read_text("utf-8")
        blocks = list(figures["BLOCK"].finditer(text))
        assert len(blocks) == text.count("<!-- figures:") == text.count("<!-- end of figures -->")
        for block in blocks:
            assert (ROOT / shlex.split(block["command"])[1]).is_file()


def test_what_a_command_prints_takes_the_place_of_its_figures_alone(tmp_path):
    (tmp_path / "docs").mkdir()
    script = tmp_path / "docs" / "figures.py"
    script.write_text(SCRIPT.read_text("utf-8"))
    (tmp_path / "measure.py").write_text("import sys\nprint('|', *sys.argv[1:], '|')\n")
    block = "<!-- figures: python measure.py {0} -->\n\nold {0}\n<!-- end of figures -->\n"
    page = tmp_path / "docs" / "page.md"
    page.write_text(f"before\n{block.format('a')}between\n{block.format('b')}after\n")
    subprocess.run([sys.executable, str(script), "measure.py a"], check=True, capture_output=True)
    text = page.read_text("utf-8")
    assert "| a |\n\nMeasured on 20" in text
    assert "old a" not in text
    assert "old b" in text
    assert [line for line in text.splitlines() if line in ("before", "between", "after")] == [
        "before", "between", "after",
    ]  # fmt: skip
