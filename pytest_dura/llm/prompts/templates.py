"""The templater: a prompt in words, by templates that users can replace."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.state import NOTHING
from pytest_dura.llm.port import Message
from pytest_dura.llm.prompts.few_shot import Example, read_examples
from pytest_dura.llm.prompts.prompt import Block, Prompt
from pytest_dura.llm.prompts.sandbox import Renderer
from pytest_dura.llm.prompts.sources import FEW_SHOT, SUFFIX, Sources

SYSTEM, USER = "system", "user"


class Templates:
    """All templates of a domain, compiled; see :meth:`load`."""

    def __init__(
        self, sources: Sources, vocabulary: Mapping[str, Any], schema: Mapping[str, Any]
    ) -> None:
        self._sources, self._vocabulary = sources, vocabulary
        texts = {name: text for name, text in sources.texts.items() if name.endswith(SUFFIX)}
        self._renderer = Renderer(texts, sources.files)
        self._names = frozenset(texts)
        self._examples = {
            wording: self._read(wording, schema) for wording in ("", *sources.wordings)
        }
        self._openings: dict[str, tuple[Message, ...]] = {}
        for wording in self._examples:
            self._opening(wording)

    @classmethod
    def load(
        cls,
        own: Path,
        directory: Path | None = None,
        *,
        vocabulary: Mapping[str, Any] = NOTHING,
        schema: Mapping[str, Any] = NOTHING,
        probes: Iterable[Prompt] = (),
    ) -> Templates:
        """The templates of a directory: ``system.j2``, ``user.j2``, one per block, examples.

        A folder in it is another wording; what it lacks is taken from the directory itself.

        Args:
            own: The domain's directory.
            directory: A user's; each file replaces the domain's of its name.
            vocabulary: What ``system.j2`` may use: the answer's words and what they mean.
            schema: JSON schema of an answer, for the examples.
            probes: Prompts that are rendered in every wording, so that errors show at once.

        Raises:
            ConfigurationError: For files that cannot be used, with file and line.
        """
        made = cls(Sources.read(own, directory), vocabulary, schema)
        for prompt in probes:
            for wording in made._examples:
                made._user(prompt.blocks, wording)
        return made

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the sources of all templates in use."""
        return self._sources.digest

    def messages(self, prompt: Prompt) -> tuple[Message, ...]:
        """The conversation: system, pairs of examples, and the user's message with its images.

        Raises:
            ConfigurationError: For a wording or a block without templates, or one that fails.
        """
        text = self._user(prompt.blocks, prompt.wording)
        return (*self._opening(prompt.wording), Message("user", text, prompt.images))

    def _opening(self, wording: str) -> tuple[Message, ...]:
        """All before the user's message; the same at every decision."""
        if wording not in self._examples:
            raise ConfigurationError(
                f"there is no wording {wording!r} of the prompt",
                found=wording,
                expected="one of " + ", ".join(map(repr, self._examples)),
                remedy="name a folder of the templates",
            )
        if wording not in self._openings:
            found = [Message("system", self._render(SYSTEM, wording, self._vocabulary))]
            for one in self._examples[wording]:
                found.append(Message("user", self._user(one.blocks, wording)))
                found.append(Message("assistant", one.answer))
            self._openings[wording] = tuple(found)
        return self._openings[wording]

    def _user(self, blocks: tuple[Block, ...], wording: str) -> str:
        self._check(blocks)
        shown = [
            {"name": block.name, "text": self._render(block.name.lower(), wording, block.facts)}
            for block in blocks
        ]
        return self._render(USER, wording, {"blocks": shown})

    def _check(self, blocks: tuple[Block, ...]) -> None:
        for block in blocks:
            if f"{block.name.lower()}{SUFFIX}" not in self._names:
                known = sorted(name for name in self._names if "/" not in name)
                raise ConfigurationError(
                    f"the block {block.name!r} has no template",
                    found=block.name,
                    expected="a block of " + ", ".join(known),
                    remedy="correct the block's name",
                )

    def _render(self, stem: str, wording: str, facts: Mapping[str, Any]) -> str:
        name = f"{wording}/{stem}{SUFFIX}" if wording else ""
        return self._renderer.render(name if name in self._names else stem + SUFFIX, facts)

    def _read(self, wording: str, schema: Mapping[str, Any]) -> tuple[Example, ...]:
        name = f"{wording}/{FEW_SHOT}" if wording else ""
        name = name if name in self._sources.texts else FEW_SHOT
        if name not in self._sources.texts:
            return ()
        return read_examples(self._sources.texts[name], self._sources.files[name], schema)
