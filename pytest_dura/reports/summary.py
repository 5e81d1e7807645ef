"""``summary.md``: the session on a page of GitHub-flavoured Markdown, for the page of a CI job."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.reports.document import Entry, Level
from pytest_dura.reports.pens.markdown import MAX_BYTES, MarkdownPen
from pytest_dura.reports.story import document_of
from pytest_dura.reports.wording import (
    evidence_option,
    gate_title,
    replay_command,
    replay_options,
)

__all__ = ["FILE", "MAX_BYTES", "render"]


FILE = "summary.md"
_REASONS = 20


def render(record: SessionRecord) -> str:
    """The page as text, of at most :data:`MAX_BYTES` bytes in UTF-8."""
    document = document_of(record, Level.SUMMARY)
    pen = MarkdownPen(document, lambda entry: _command(record, entry))
    lines = [
        f"# {gate_title(record)}",
        *pen.cards(),
        *_count_lines(record),
        *pen.sections(),
    ]
    return "\n".join(lines) + "\n"


def _command(record: SessionRecord, entry: Entry) -> str:
    """The command of an entry; one that runs an item again depends on options of the session."""
    if entry.kind == "replay":
        return _replay(record.head.command, entry.text)
    command = f"pytest {shlex.quote(entry.text)}"
    return code(command) if name(command, 400) == command and "  " not in command else ""


def _count_lines(record: SessionRecord) -> Iterator[str]:
    counts, gate = record.head.totals.to_json(), record.head.gate
    yield from ["", f"| {' | '.join(counts)} |", f"|{' --- |' * len(counts)}"]
    yield f"| {' | '.join(map(str, counts.values()))} |"
    yield ""
    yield from (f"- {markdown(reason, 300) or 'no reason'}" for reason in gate.reasons[:_REASONS])
    if len(gate.reasons) > _REASONS:
        yield f"- and {len(gate.reasons) - _REASONS} more reasons"


def _replay(session: str, episode: str) -> str:
    """The command, where it can be shown as it has to be typed."""
    command = replay_command(episode, evidence_option(session), replay_options(session))
    unchanged = name(command, 400) == command and "\\|" not in command and "  " not in command
    return code(command) if unchanged else ""
