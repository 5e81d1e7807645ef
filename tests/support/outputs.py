"""What a run of pytest within a test printed."""

from __future__ import annotations

import re

from _pytest.pytester import LineMatcher

HEAD = r"^_{2,} (?:ERROR at setup of )?([\w.]+)(?:\[.*\])? _{2,}$|^=+ .* =+$"


def output(result):
    """Both streams of it as one text."""
    return result.stdout.str() + result.stderr.str()


def shown_of(result):
    """The lines that pytest shows of each item that failed, by the name of its function."""
    parts = re.split(HEAD, result.stdout.str(), flags=re.MULTILINE)
    pairs = zip(parts[1::2], parts[2::2], strict=True)
    return {name: LineMatcher(text.splitlines()) for name, text in pairs if name}
