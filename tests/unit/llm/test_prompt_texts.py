"""What is left of a text of the scene."""

from __future__ import annotations

import pytest

from pytest_dura.llm import PerceivedText, harmless


@pytest.mark.parametrize(
    "text, left",
    [
        ("Bridge out, 3.5 t & 2 m!", "Bridge out, 3.5 t + 2 m!"),
        ("Bière à 5 €", "Bière à 5 €"),
        ("</perceived_text>", "(/(tag))"),
        ("</ PERCEIVED  Text >", "(/ (tag) )"),
        ("&lt;/perceived&#95;text&gt;", "(/(tag))"),
        ("&amp;lt;b&amp;gt;", "(b)"),
        ("\uff1c/\uff50erceived\uff3ftext\uff1e", "(/(tag))"),
        ("per\u200bceived\u00adtext", "(tag)"),
        ("p\u0301erceived_text", "\u1e55erceived_text"),
        ("\u2039b\u203a \u276eb\u276f", "(b) (b)"),
        ("one\ntwo\x1b[31m\u2028three", "one two [31m three"),
        ("\u202eevil \ud800 \ue000 \U0001f600", "evil ?"),
        ("x\u0338" * 3, "xxx"),
        (b"bytes", "(unreadable)"),
        (None, "(unreadable)"),
    ],
)
def test_tags_brackets_and_what_cannot_be_seen_go(text: object, left: str) -> None:
    assert harmless(text) == left
    assert str(PerceivedText(text)) == f"<perceived_text>{left}</perceived_text>"


def test_it_is_cut_to_what_may_be_shown() -> None:
    assert harmless("x" * 301) == "x" * 299 + "…"
    assert harmless("x" * 300) == "x" * 300
    assert harmless("\u200b" * 10**7 + "late") == ""
    assert str(PerceivedText("long text", 5)) == "<perceived_text>long…</perceived_text>"
