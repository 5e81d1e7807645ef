"""Text in lines of a width, without a font at hand: widths are estimated on the large side."""

from __future__ import annotations

import unicodedata

SIZE = 12.0
"""Height of the letters in units of the picture."""
LINE = 15.0
BOLD = 1.12 * SIZE
"""Bold letters take as much room as larger ones."""

_NARROW, _USUAL, _BROAD, _FULL = 0.38, 0.62, 0.9, 1.1
"""Widths of letters in units of their height; those of DejaVu Sans, which is a wide face."""


def text_width(text: str, size: float = SIZE) -> float:
    """The estimated width of a line."""
    return size * sum(map(_letter, text))


def wrapped(text: str, width: float, most: int, size: float = SIZE) -> list[str]:
    """The text in lines of at most this width; what does not fit into ``most`` lines ends in …."""
    lines: list[str] = []
    line = ""
    for word in _words(text, width, size):
        joined = f"{line} {word}" if line else word
        if line and text_width(joined, size) > width:
            lines.append(line)
            line = word
        else:
            line = joined
    lines += [line] if line else []
    if len(lines) <= most:
        return lines
    last = lines[most - 1]
    while last and text_width(last + " …", size) > width:
        last = last[:-1]
    return [*lines[: most - 1], f"{last} …"]


def _words(text: str, width: float, size: float) -> list[str]:
    """The words, those that are wider than a line broken, after a separator if there is one."""
    found: list[str] = []
    for word in text.split():
        rest = word
        while text_width(rest, size) > width:
            fits = 1
            while text_width(rest[: fits + 1], size) <= width:
                fits += 1
            cut = max((rest.rfind(mark, 1, fits) + 1 for mark in "/+~-_.;,@#"), default=0)
            cut = cut if cut > fits // 2 else fits
            found.append(rest[:cut])
            rest = rest[cut:]
        found.append(rest)
    return found


def _letter(char: str) -> float:
    if char in "iljtfrI.,:;'|!()[] /-":
        return _NARROW
    if unicodedata.east_asian_width(char) in "WF":
        return _FULL
    return _BROAD if char in "mwMW@%+~=<>—…≤" or not char.isascii() else _USUAL
