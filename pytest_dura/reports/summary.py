"""``summary.md``: the session on a page of GitHub-flavoured Markdown, for the page of a CI job."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import code, markdown, name
from pytest_dura.reports.document import Entry, Level
from pytest_dura.reports.pens.markdown import MAX_BYTES, MarkdownPen
from pytest_dura.reports.story import document_of
from pytest_dura.reports.wording import entry_command, gate_title

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
    """The command of an entry, where it can be shown as it has to be typed."""
    command = entry_command(record, entry.kind, entry.text)
    unchanged = name(command, 400) == command and "\\|" not in command and "  " not in command
    return code(command) if unchanged else ""


def _count_lines(record: SessionRecord) -> Iterator[str]:
    counts, gate = record.head.totals.to_json(), record.head.gate
    yield from ["", f"| {' | '.join(counts)} |", f"|{' --- |' * len(counts)}"]
    yield f"| {' | '.join(map(str, counts.values()))} |"
    yield ""
    yield from (f"- {markdown(reason, 300) or 'no reason'}" for reason in gate.reasons[:_REASONS])
    if len(gate.reasons) > _REASONS:
        yield f"- and {len(gate.reasons) - _REASONS} more reasons"
