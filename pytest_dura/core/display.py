"""How objects show themselves: on one line in a console, as a table in a notebook."""

from __future__ import annotations

import dataclasses
import math
import reprlib
from collections.abc import Iterable
from typing import Any

from pytest_dura.core.text import html, one_line

LONGEST_REPR = 120
"""Characters of a ``repr``."""
_LONGEST_CELL = 400
"""Characters of a cell of a table."""


class _Short(reprlib.Repr):
    """``repr`` that looks at little of a large value."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother, self.maxlong = 2, 72, 72, 24

    def repr_ndarray(self, array: Any, _level: int) -> str:
        """Show the shape alone: numpy itself writes a thousand numbers."""
        return f"array{array.shape}"


_SHORT = _Short()


def short_repr(value: Any) -> str:
    """Describe a dataclass on one line: as many fields as fit, but for those with their default.

    It is meant to be a class's ``__repr__``. Fields that are left out are shown as ``...``.
    """
    head = f"{type(value).__name__}("
    parts: list[str] = []
    left = LONGEST_REPR - len(head) - len(", ...)")
    for field in dataclasses.fields(value):
        item = getattr(value, field.name, field.default)
        if not field.repr or _is_default(field, item):
            continue
        text = f"{field.name}={one_line(_SHORT.repr(item), LONGEST_REPR)}"
        if len(text) + 2 > left:
            parts.append("...")
            break
        left -= len(text) + 2
        parts.append(text)
    return f"{head}{', '.join(parts)})"


def _is_default(field: dataclasses.Field[Any], item: Any) -> bool:
    if field.default_factory is not dataclasses.MISSING:
        return isinstance(item, (dict, list, set, tuple)) and not item
    # Arrays and the like are not compared: what comes of it need be no truth value.
    plain = (str, int, float, bool, tuple, type(None))
    return (isinstance(item, plain) and item is field.default) or _equal(item, field.default)


def _equal(item: Any, default: Any) -> bool:
    return isinstance(item, (str, int, float)) and type(item) is type(default) and item == default


class Shown:
    """Base of what a notebook shows as a table; no notebook needs to be there for it."""

    __slots__ = ()

    def _figures(self) -> Iterable[tuple[str, object]]:
        """Yield the rows of the table; ``None`` and empty texts are left out."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """Return the table as HTML, in which all texts are escaped."""
        return table_html(type(self).__name__, self._figures())


def table_html(caption: str, rows: Iterable[tuple[str, object]]) -> str:
    """Make a table of labels and values.

    Args:
        caption: What is shown.
        rows: Label and value. A list becomes a line each.
    """
    lines = [f"<tr><th>{_escaped(label)}</th><td>{_cell(item)}</td></tr>" for label, item in rows
             if item is not None and item not in ("", ())]  # fmt: skip
    return f"<table><caption>{_escaped(caption)}</caption>{''.join(lines)}</table>"


_MOST_LINES = 10


def _cell(item: object) -> str:
    if isinstance(item, (list, tuple)):
        lines = [_cell(part) for part in item[:_MOST_LINES]]
        if len(item) > _MOST_LINES:
            lines.append(f"and {len(item) - _MOST_LINES} more")
        return "<br>".join(lines)
    if isinstance(item, float):
        return f"{item:.4g}" if math.isfinite(item) else str(item)
    return _escaped(str(item))


def _escaped(text: str) -> str:
    return html(one_line(text, _LONGEST_CELL))
