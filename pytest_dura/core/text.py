"""Texts of users and components, made visible, bounded and harmless for every report.

A record may hold anything: control characters, lone surrogates, markup, a megabyte of prose. What
these functions return is printable, encodes as UTF-8, and has only characters that XML 1.0 allows.
For HTML, SVG and other XML they go through :func:`html`, or Jinja's own escaping, as well.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from html import escape
from itertools import accumulate

LIMIT = 2000
"""Default for the greatest number of characters of a text."""
LINE = 500
NAME = 120
LEAST_LIMIT = 64
"""Room for the note that a text was shortened."""

_DIGEST = 8
_SCANNED = 16  # times the limit: a megabyte of blanks costs no more than a page
_ESCAPES = {"\t": "\\t", "\n": "\\n", "\r": "\\r"}
# Printable for Python, yet drawn as nothing: fillers, joiners, and variation selectors but the two
# that choose between text and emoji.
_UNSEEN = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0\ufe00-\ufe0d\U000e0100-\U000e01ef]"
)
# Blanks and ends of lines as people type them: separators that are controls are none of them.
_BLANKS = re.compile(r"[^\S\x0b\x0c\x1c-\x1f\x85\u2028\u2029]+")
_BLANK = re.compile(r"[^\S\t\n\r\x0b\x0c\x1c-\x1f\x85\u2028\u2029]")


def visible(text: str, limit: int = LIMIT, *, hashed: bool = False) -> str:
    r"""Make each character of a text visible; ends of lines and tabs stay.

    What is not printable, or drawn as nothing, is written as Python would escape it:
    ``\x1b``, ``\u202e``, ``\udc80``. Blanks of any width become a space. A text that is shortened
    says so: ``begins like this... (1048576 characters)``. Applied twice, it changes nothing more.

    Args:
        text: Any string.
        limit: Greatest length of what is returned.
        hashed: Add a short hash of the text if it is shortened, so that two stay distinguishable.

    Raises:
        ValueError: If the limit is below ``LEAST_LIMIT``.
    """
    # An escape is never shorter than its character and CR LF becomes one, so what follows cannot
    # matter but for being there.
    head = text[: 2 * limit + 2].replace("\r\n", "\n")
    return _fitted(_pieces(head, unescaped="\n\t"), text, limit, hashed=hashed)


# GitHub acts on `::` at the beginning of a line, after blanks, Azure on `##vso[` anywhere in it,
# both on `##[`, and TeamCity on `##teamcity[`.
_COMMAND = re.compile(r"^([^\S\n]*):(?=:)|#(?=#\w*\[)", re.MULTILINE)


def without_commands(text: str) -> str:
    r"""Break what a CI would take for a command in its log: ``\:error::x``, ``\#[error]x``.

    For whole lines, as they are printed; lengths stay. Applied twice, it changes nothing more.

    Args:
        text: Printable, as :func:`visible` and :func:`one_line` return it.
    """
    return _COMMAND.sub(r"\g<1>\\", text)


def one_line(text: str, limit: int = LINE, *, hashed: bool = False) -> str:
    """Do the same as :func:`visible` on one line: runs of blanks and ends of lines become a space.

    Of a text that is far longer than the limit the end is not looked at: it counts as shortened,
    even if it is all blanks.
    """
    head = text[: _SCANNED * limit]
    joined = _BLANKS.sub(" ", head).strip(" ")[: limit + 1]
    return _fitted(_pieces(joined), text, limit, hashed=hashed, cut=len(head) < len(text))


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """Write ``1 run``, ``2 runs``."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def first_few(texts: Sequence[str], most: int = 8) -> str:
    """Join texts by commas; of many the first few, and how many more there are."""
    joined = ", ".join(texts[:most])
    return f"{joined} and {len(texts) - most} more" if len(texts) > most else joined


def name(text: str, limit: int = NAME) -> str:
    r"""Write an identifier on one line: two that differ stay different.

    Ends of lines and odd blanks are escaped too, and whatever was escaped or shortened
    bears a short hash: ``a\nb (#1f0c2e4d)``.
    """
    if len(text) <= limit and text.isprintable() and not _UNSEEN.search(text):
        return text
    return _fitted(_pieces(text[: limit + 1], blanks=False), text, limit, hashed=True, marked=True)


def code(text: str, limit: int = LINE) -> str:
    """Write a Markdown code span of one line, also for a cell of a table; no text gives none.

    Nothing in it is a link, a mention, a reference, a formula or HTML, in any dialect.
    """
    shown = one_line(text, limit)
    if not shown:
        return ""
    # Dialects disagree on whether the first backslash of two escapes the second or the bar.
    shown = shown.replace("\\|", "\\\\x7c").replace("|", "\\|")
    longest = max((len(run) for run in re.findall("`+", shown)), default=0)
    # GitHub takes a dollar beside a backtick for a formula.
    pad = " " if shown[0] in "`$" or shown[-1] in "`$" else ""
    fence = "`" * (longest + 1)
    return f"{fence}{pad}{shown}{pad}{fence}"


def html(text: str, *, quote: bool = True) -> str:
    """Escape a text for HTML, SVG and other XML.

    Args:
        text: Printable, as the other functions return it.
        quote: Whether it becomes an attribute, and no content.
    """
    return escape(text, quote=quote)


# What GitHub makes a link, a mention, a reference or a formula of after Markdown has been read, so
# that a backslash does not help.
_AUTOMATIC = re.compile(
    r"@|\$|#\d|\bGH-\d|://|www\.|mailto:|xmpp:|\b[0-9a-f]{7,40}\b", re.IGNORECASE
)
_MARKS = re.compile(r"[\\`*_\[\]<>&|~!]")
_BEGINS_BLOCK = re.compile(r"^(?:([#+=:-])|(\d{1,9})([.)]))")


def markdown(text: str, limit: int = LINE) -> str:
    """Escape prose for one line of Markdown or a cell of a table, so that it reads as written.

    Text which a renderer may take for a link, a mention, a reference or a formula is set as code.
    """
    shown = one_line(text, limit)
    if _AUTOMATIC.search(shown):
        return code(shown, limit)
    escaped = _MARKS.sub(r"\\\g<0>", shown)
    return _BEGINS_BLOCK.sub(_unblocked, escaped)


def _unblocked(match: re.Match[str]) -> str:
    mark, number, point = match.groups()
    return f"\\{mark}" if mark else f"{number}\\{point}"


def _pieces(text: str, *, unescaped: str = "", blanks: bool = True) -> list[str]:
    """Split a text into its characters, each escaped if need be."""
    if text.isprintable() and not _UNSEEN.search(text):
        return list(text)
    return [_shown(char, unescaped, blanks=blanks) for char in text]


def _shown(char: str, unescaped: str, *, blanks: bool) -> str:
    if char in unescaped or (char.isprintable() and not _UNSEEN.match(char)):
        return char
    if blanks and _BLANK.match(char):
        return " "
    return _ESCAPES.get(char) or _escape(ord(char))


def _escape(point: int) -> str:
    if point <= 0xFF:
        return f"\\x{point:02x}"
    return f"\\u{point:04x}" if point <= 0xFFFF else f"\\U{point:08x}"


def indent_if_reserved(text: str) -> str:
    """Indent a text that begins with a user's name and would read as a line of ours."""
    return f" {text}" if text.startswith(("|", "#", "gate:")) else text


def _fitted(
    pieces: list[str],
    text: str,
    limit: int,
    *,
    hashed: bool,
    marked: bool = False,
    cut: bool = False,
) -> str:
    """Join as many pieces as fit.

    ``marked`` adds the hash also to what was not shortened; ``cut`` says that there was more.
    """
    if limit < LEAST_LIMIT:
        raise ValueError(f"a limit of {limit} characters is below {LEAST_LIMIT}")
    digest = f"#{_digest(text)}" if hashed else ""
    note = f" ({digest})" if marked else ""
    if not cut and sum(map(len, pieces)) <= limit - len(note):
        return "".join(pieces) + note
    note = f"... ({len(text)} characters{', ' + digest if digest else ''})"
    room = limit - len(note)
    ends = accumulate(map(len, pieces))
    # Never a part of an escape, which would read as another.
    return "".join(piece for piece, end in zip(pieces, ends, strict=True) if end <= room) + note


def _digest(text: str) -> str:
    """A short hash; of lone surrogates as well, which UTF-8 proper cannot encode."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_DIGEST]
