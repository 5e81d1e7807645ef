"""Texts from the world: shown to a model as data, and never as anything else."""

from __future__ import annotations

import html
import re
import unicodedata
from dataclasses import dataclass

TAG = "perceived_text"
LONGEST = 300
"""Characters of one text that are shown."""

_ROUNDS = 3
_LEFT, _RIGHT = (
    {ord("<"), 0x2039, 0x00AB, 0x02C2, 0x1438, 0x276E, 0x27E8, 0x27EA, 0x3008, 0x300A, 0x227A},
    {ord(">"), 0x203A, 0x00BB, 0x02C3, 0x1433, 0x276F, 0x27E9, 0x27EB, 0x3009, 0x300B, 0x227B},
)
"""Code points of what looks like a tag's brackets: quotation marks, arrow heads, ornaments."""
_BRACKETS = {**dict.fromkeys(_LEFT, "("), **dict.fromkeys(_RIGHT, ")"), ord("&"): "+"}
_TAG_NAME = re.compile(r"perceived[\W_]*text", re.IGNORECASE)
_KEPT = frozenset(map(chr, (0x2013, 0x2014, 0x2018, 0x2019, 0x201C, 0x201D, 0x2026, 0xB0, 0x20AC)))
"""Dashes, quotation marks, the ellipsis, degrees, euros."""


@dataclass(frozen=True)
class PerceivedText:
    """A text that somebody else wrote: on a sign, as an object's name, in an answer of the model.

    As a text it is always enclosed in ``<perceived_text>`` and bounded, whoever puts it into
    words; templates cannot reach what it was before.

    Args:
        _text: As it was perceived. What is no text is told as unreadable.
        longest: Characters that are shown of it.
    """

    _text: object
    longest: int = LONGEST

    def __str__(self) -> str:
        return f"<{TAG}>{harmless(self._text, self.longest)}</{TAG}>"


def harmless(text: object, longest: int = LONGEST) -> str:
    """A text on one line that holds no tag, nor anything that is easily taken for one.

    Compatibility forms and entities are resolved; brackets that look like those of a tag become
    round ones, the tag's name goes, and of other scripts letters and digits stay.
    """
    if not isinstance(text, str):
        return "(unreadable)"
    text = text[: 4 * longest]  # bounds the work; what is invisible may take most of it
    for _ in range(_ROUNDS):
        text = html.unescape(unicodedata.normalize("NFKC", text))
    text = text.translate(_BRACKETS)
    text = " ".join("".join(map(_visible, text)).split())
    text = _TAG_NAME.sub("(tag)", text)
    return text if len(text) <= longest else text[: longest - 1] + "…"


def _visible(character: str) -> str:
    if character.isascii():
        return character if character.isprintable() else " "
    category = unicodedata.category(character)
    if category in ("Cf", "Mn", "Me"):  # invisible, or stacked upon others
        return ""
    if category[0] in "CZ":
        return " "
    return character if category[0] in "LMN" or character in _KEPT else "?"
