"""Prompt: what is put before the model, before it is put into words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_dura.llm.port import Image


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
        objects = (one for block in self.blocks for one in block.facts.get("objects", ()))
        return tuple(dict.fromkeys(str(one["id"]) for one in objects))
