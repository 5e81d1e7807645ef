"""Messages of failed tests that quote components, in which there may be anything."""

from __future__ import annotations

import pytest

LIMIT = 20_000
"""Characters of a message of our own."""


def make_visible(error: BaseException) -> None:
    """Change an error's texts where they cannot be passed on, or are endless.

    A lone surrogate in the message of a single test ends a session under xdist, and one that
    writes an Allure report.
    """
    from pytest_dura.evidence.text import visible

    if isinstance(error, (pytest.fail.Exception, pytest.skip.Exception)):
        error.msg = visible(str(error.msg), LIMIT)
        error.args = (error.msg,)
    elif any(isinstance(one, str) and not _encodes(one) for one in error.args):
        error.args = tuple(
            one.encode("utf-8", "backslashreplace").decode() if isinstance(one, str) else one
            for one in error.args
        )


def _encodes(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True
