"""What reads the schema of the evidence does not load what it never asks."""

from __future__ import annotations

import subprocess
import sys

GRAMMARS = """
LOADED = True
def is_valid_syntax(rule, text):
    return (rule, text) == ("iri", "x:y")
"""
SCRIPT = """
import sys
from pytest_dura.evidence.schema import check_record
assert check_record({})
assert "rfc3987_syntax" not in sys.modules, "seconds, in which a grammar is read"
from jsonschema import FormatChecker
assert FormatChecker(["iri"]).conforms("x:y", "iri")
assert not FormatChecker(["iri"]).conforms("x y", "iri")
assert sys.modules["rfc3987_syntax"].LOADED
"""


def test_grammars_of_formats_are_loaded_when_somebody_asks_for_them(tmp_path):
    (tmp_path / "rfc3987_syntax.py").write_text(GRAMMARS)
    script = f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n{SCRIPT}"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert found.returncode == 0, found.stderr
