"""Other prompts of the same content: metamorphic twins, whatever the domain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pytest_dura.llm.prompts.prompt import Block, Prompt

PARAPHRASED = "paraphrased"
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
    return replace(prompt, wording=PARAPHRASED)


def blind(prompt: Prompt) -> Prompt:
    """The same without pictures, which the text then tells as missing."""

    def without(block: Block) -> Block:
        pictures = block.facts.get(PICTURES, ())
        if not pictures:
            return block
        unseen = tuple({**one, "shown": 0} for one in pictures)
        return replace(block, facts={**block.facts, PICTURES: unseen})

    return replace(prompt, blocks=tuple(map(without, prompt.blocks)), images=())
