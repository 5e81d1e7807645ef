"""Pens of items: a card as properties of a JUnit file, and as Allure's Markdown."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from pytest_dura.evidence.text import code, markdown
from pytest_dura.reports.document import Card, Entry

Command = Callable[[Entry], str]
"""Makes the command of an entry that is one."""


def card_properties(card: Card, command: Command) -> Iterator[tuple[str, str]]:
    """Write a card as properties: its title, what happened, and an entry each, by its label."""
    yield "card", card.title
    yield "card_headline", card.headline
    label, texts = "", list[str]()
    for entry in (*card.entries, Entry("end", "")):
        if entry.label and texts:
            yield f"card_{label}", "; ".join(texts)
            texts = []
        label = entry.label or label
        texts.append(_text(entry, command) + (f" [{entry.code}]" if entry.code else ""))


def card_markdown(card: Card, command: Command) -> Iterator[str]:
    """Write a card as paragraphs and a list in Markdown, a traceback as a block of code."""
    yield f"**{markdown(card.title, 400)}**"
    yield markdown(card.headline, 800)
    lines = []
    for entry in card.entries:
        text = _text(entry, command)
        if "\n" in text:
            fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=2))
            lines.append(f"- {markdown(entry.label, 200)}:\n\n{fence}\n{text}\n{fence}\n")
            continue
        shown = markdown(text, 800) if entry.kind == "text" else code(text, 800)
        check = f" {code(entry.code, 400)}" if entry.code else ""
        lines.append(f"- {markdown(entry.label, 200)}: {shown}{check}".replace("- : ", "- "))
    yield "\n".join(lines)


def _text(entry: Entry, command: Command) -> str:
    return command(entry) if entry.kind in ("replay", "rerun") else entry.text
