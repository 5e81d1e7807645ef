"""Prompts before they are put into words: blocks of facts, texts from the world, variants.

Texts from the world are shown to a model as data, and never as anything else. Variants are
prompts of the same content, whatever the domain.
"""

from __future__ import annotations

import html
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pytest_dura.llm.port import Image

TAG = "perceived_text"
LONGEST_PERCEIVED = 300
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
    longest: int = LONGEST_PERCEIVED

    def __str__(self) -> str:
        return f"<{TAG}>{harmless(self._text, self.longest)}</{TAG}>"


def harmless(text: object, longest: int = LONGEST_PERCEIVED) -> str:
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


@dataclass(frozen=True)
class Block:
    """One block of the prompt, such as ``LIDAR``.

    Args:
        name: In capitals, as it stands in the prompt.
        facts: What the block's template puts into words: rounded numbers, texts, and under
            ``objects`` one mapping per object, each with its ``id``.
    """

    name: str
    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Prompt:
    """The message on the channel ``prompt``, which faults may change.

    Args:
        blocks: In the order in which they are shown.
        images: In the order in which they are shown.
        wording: Name of another wording of the same content; empty for the templates' own.
    """

    blocks: tuple[Block, ...]
    images: tuple[Image, ...] = ()
    wording: str = ""

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of all objects in it, each once, in the order in which they are shown."""
        objects = (item for block in self.blocks for item in block.facts.get("objects", ()))
        return tuple(dict.fromkeys(str(item["id"]) for item in objects))


_PARAPHRASED = "paraphrased"
OBJECTS, PICTURES = "objects", "pictures"
"""Keys of a block's facts: what it lists, and what it says of the pictures."""


def shuffled(items: Sequence[Any], rng: np.random.Generator) -> tuple[Any, ...]:
    """The same things in another order; in the same only if there are fewer than two."""
    order = rng.permutation(len(items)).tolist()
    if order == sorted(order):
        order = order[1:] + order[:1]
    return tuple(items[place] for place in order)


def reordered(prompt: Prompt, rng: np.random.Generator) -> Prompt:
    """The objects within each block in another order; the blocks stay where they are."""

    def turned(block: Block) -> Block:
        listed = block.facts.get(OBJECTS, ())
        if len(listed) < 2:
            return block
        return replace(block, facts={**block.facts, OBJECTS: shuffled(listed, rng)})

    return replace(prompt, blocks=tuple(map(turned, prompt.blocks)))


def paraphrased(prompt: Prompt) -> Prompt:
    """The same facts in other words."""
    return replace(prompt, wording=_PARAPHRASED)


def blind(prompt: Prompt) -> Prompt:
    """The same without pictures, which the text then tells as missing."""

    def without(block: Block) -> Block:
        pictures = block.facts.get(PICTURES, ())
        if not pictures:
            return block
        unseen = tuple({**picture, "shown": 0} for picture in pictures)
        return replace(block, facts={**block.facts, PICTURES: unseen})

    return replace(prompt, blocks=tuple(map(without, prompt.blocks)), images=())
