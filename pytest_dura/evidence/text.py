"""Texts made harmless for every report: those of :mod:`pytest_dura.core.text`."""

from __future__ import annotations

from pytest_dura.core.text import (
    LEAST_LIMIT,
    LIMIT,
    LINE,
    NAME,
    code,
    counted,
    first_few,
    html,
    indent_if_reserved,
    markdown,
    name,
    one_line,
    visible,
    without_commands,
)

__all__ = [
    "LEAST_LIMIT",
    "LIMIT",
    "LINE",
    "NAME",
    "code",
    "counted",
    "first_few",
    "html",
    "indent_if_reserved",
    "markdown",
    "name",
    "one_line",
    "visible",
    "without_commands",
]
