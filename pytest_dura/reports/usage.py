"""Tokens of language models: figures and columns that reports and terminal share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pytest_dura.core.metrics import Usage
from pytest_dura.evidence.case_model import CaseEntry, CaseUsage
from pytest_dura.evidence.session_model import LanguageModelEntry, TokensEntry
from pytest_dura.evidence.text import counted
from pytest_dura.reports.columns import Cell, Column, Shown, name_cell

Tokens = TokensEntry | CaseUsage | Usage
"""Counts of tokens, ``prompt``, ``completion`` and ``uncounted``."""


def tokens_text(tokens: Tokens) -> str:
    """Tokens in words; empty where there is nothing to say."""
    if not (tokens.prompt or tokens.completion or tokens.uncounted):
        return ""
    text = f"{tokens.prompt} + {tokens.completion} tokens (prompts + answers)"
    if tokens.uncounted:
        text += f"; the server counted none for {counted(tokens.uncounted, 'answer')}"
    return text


def usage_text(model: LanguageModelEntry) -> str:
    """What a session asked of a model and took from the cassette, in words; empty for nothing."""
    calls = model.asked + model.repeated
    texts = (
        (f"{counted(calls, 'request')} to the server", tokens_text(model.asked_tokens)),
        (f"{counted(model.reused, 'answer')} from the cassette", tokens_text(model.reused_tokens)),
    )
    return "; ".join(f"{what}: {text}" for what, text in texts if text)


@dataclass(frozen=True)
class UsageRow:
    """What the decisions of a case used.

    Args:
        case: The case.
        usage: Its figures.
    """

    case: CaseEntry
    usage: CaseUsage


def usage_rows(cases: Sequence[CaseEntry]) -> list[UsageRow]:
    """Rows of the cases whose episodes tell what they used."""
    return [UsageRow(case, usage) for case in cases if (usage := case.metrics.usage) is not None]


def usage_columns() -> list[Column[UsageRow]]:
    """The columns of the table."""
    return [
        Column("case", lambda row: name_cell(row.case.id), shown=Shown.FILES, kind=""),
        Column("component", lambda row: name_cell(row.case.component), shown=Shown.FILES, kind=""),
        Column("episodes", lambda row: row.usage.episodes, short="n", meaning="episodes that tell"),
        Column("decisions", lambda row: row.usage.decisions),
        Column(
            "requests", lambda row: row.usage.requests,
            meaning="to the model, those beside the decisions included",
        ),
        Column("prompt tokens", lambda row: row.usage.prompt, short="prompt",
               meaning="tokens of the requests, as the server counted them"),
        Column("answer tokens", lambda row: row.usage.completion, short="answer",
               meaning="tokens of the answers"),
        Column("per decision", _per_decision, short="per dec",
               meaning="tokens of both for a decision and what is asked beside it"),
        Column("uncounted", lambda row: row.usage.uncounted, short="uncnt",
               meaning="answers for which the server counted no tokens"),
    ]  # fmt: skip


def _per_decision(row: UsageRow) -> Cell | None:
    usage = row.usage
    if not usage.decisions:
        return None
    return _plain(f"{(usage.prompt + usage.completion) / usage.decisions:.0f}")


def _plain(text: str) -> Cell:
    return Cell(text, text, text)
