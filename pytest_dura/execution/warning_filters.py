"""Warning filters as plain data, so that a warning counts in another process as it does here."""

from __future__ import annotations

import importlib
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce
from typing import Any

_ABSENT = frozenset({"pytest", "_pytest"})
"""Packages whose warnings no process raises that runs no tests; their import takes long."""


def warning_filters() -> list[list[Any]]:
    """Describe the filters of this process as they are now, the first one to apply first.

    Returns:
        Of each, what :func:`warnings.filterwarnings` takes: action, pattern of the message, module
        and name of the category, pattern of the module, and line.
    """
    described: list[list[Any]] = []
    for action, message, category, module, line in warnings.filters:
        for each in category if isinstance(category, tuple) else (category,):
            if each.__module__.partition(".")[0] not in _ABSENT:
                place = [each.__module__, each.__qualname__]
                described.append([action, _pattern(message), *place, _pattern(module), line])
    return described


@contextmanager
def filtered(filters: Sequence[Sequence[Any]] | None) -> Iterator[None]:
    """Context in which these filters apply, and no others.

    Args:
        filters: See :func:`warning_filters`; ``None`` for those of this process.
    """
    if filters is None:
        yield
        return
    categories = [_category(module, name) for _, _, module, name, _, _ in filters]
    with warnings.catch_warnings():
        warnings.resetwarnings()
        for (action, text, _, _, module, line), category in zip(filters, categories, strict=True):
            if category is not None:
                warnings.filterwarnings(action, text, category, module, line, append=True)
        yield


def _category(module: str, name: str) -> type[Warning] | None:
    """Find a class of warnings; ``None`` where no code can raise it, since it is not there."""
    try:
        return reduce(getattr, name.split("."), importlib.import_module(module))  # type: ignore[return-value]
    except (ImportError, AttributeError):  # such as of a conftest.py
        return None


def _pattern(text: re.Pattern[str] | str | None) -> str:
    """Return the pattern of a filter; Python's own filters compare whole names."""
    if text is None:
        return ""
    return text.pattern if isinstance(text, re.Pattern) else rf"{re.escape(text)}\Z"
