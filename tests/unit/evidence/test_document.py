"""Documents: what a pen writes at which level of detail, each legend and each note once."""

from __future__ import annotations

from pytest_dura.reports.columns import Column, Shown
from pytest_dura.reports.document import Card, Document, Entry, Level, Section, Table, Text
from pytest_dura.reports.pens.markdown import MarkdownPen
from pytest_dura.reports.pens.terminal import TerminalPen

COLUMNS: list[Column[int]] = [
    Column("n", lambda row: row, meaning="number of runs"),
    Column("page", lambda row: row, meaning="not here", shown=Shown.PAGE),
    Column("double", lambda row: 2 * row, shown=Shown.ALL),
]
CARD = Card(
    "violated",
    "violated: safety on a/b (C)",
    "It ran into a_wall.",
    (
        Entry("SAF-1", "1 of 2 runs violates it.", code="always (gap > 0)"),
        Entry("rerun", "a/b::SAF-1", "rerun", weight=Level.SUMMARY),
        Entry("replay", "a/b#1", "replay"),
    ),
)
DOCUMENT = Document(
    "gate: failed",
    (
        Section("Causes", (CARD,)),
        Section("Details", (
            Text(("in short",), shown=Shown.TERMINAL),
            Table("first", COLUMNS, [("a", 1)], weight=Level.SUMMARY, notes=("a note",)),
            Table("second", COLUMNS, [("b", 2), ("a heading", None)], notes=("a note",)),
            Text(("for files",), shown=Shown.FILES),
        )),
        Section("Empty", (Table("none", COLUMNS, []),)),
        Section("Page", (Text(("for the page",), weight=Level.PAGE),)),
    ),
)  # fmt: skip


def command(entry: Entry) -> str:
    return f"pytest --{entry.kind}={entry.text}"


def lines(*, verbose: bool) -> list[str]:
    return [line.text for line in TerminalPen(DOCUMENT, command, verbose=verbose).lines()]


def test_the_terminal_stops_at_its_level_and_takes_commands_as_they_are() -> None:
    assert lines(verbose=False) == [
        "violated: safety on a/b (C) (1 of 1 cause)",
        "  It ran into a_wall.",
        "  SAF-1:    1 of 2 runs violates it. [always (gap > 0)]",
        "  replay:   pytest --replay=a/b#1",
        "",
        "in short",
    ]


def test_with_all_there_is_each_legend_and_note_stands_once() -> None:
    found = lines(verbose=True)
    assert "  rerun:    pytest --rerun=a/b::SAF-1" in found
    assert found[found.index("in short") :] == [
        "in short",
        "",
        "first  n  double",
        "a      1       2",
        "n: number of runs",
        "a note",
        "",
        "second     n  double",
        "b          2       4",
        "a heading",
    ]


def test_markdown_has_its_own_parts_and_escapes_what_users_wrote() -> None:
    pen = MarkdownPen(DOCUMENT, lambda entry: f"`{command(entry)}`")
    cards, sections = list(pen.cards()), list(pen.sections())
    assert "## Cause 1, violated: safety on a/b (C)" in cards
    assert "**It ran into a\\_wall.**" in cards
    assert "- SAF-1: 1 of 2 runs violates it. `always (gap > 0)`" in cards
    assert "- replay: `pytest --replay=a/b#1`" in cards
    assert not any("rerun" in line for line in cards)
    assert "| 1 | 2 |" in sections
    assert "- for files" in sections
    assert not any("in short" in line or "page" in line for line in sections)


def test_of_many_rows_the_worst_stay_and_sums_beside_them() -> None:
    rows = [(f"case {number}", number) for number in range(104)]
    ranks = [2] * 102 + [0, -1]
    table = Table("case", COLUMNS, rows, ranks=ranks, weight=Level.TERMINAL)
    pen = TerminalPen(Document("", (Section("", (table,)),)), str)
    found = [line.text for line in pen.lines()]
    assert [line[:8] for line in found if line.startswith("case 10")][1:] == [
        "case 102",
        "case 103",
    ]
    assert any(line.startswith("and 3 cases more: those with the worst verdicts") for line in found)
