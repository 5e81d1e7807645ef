"""What reports say of the coverage of the operating domain: pairs of parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pytest_dura.evidence.case_model import CombinationsEntry, PairEntry
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.text import counted
from pytest_dura.reports.columns import Column, Shown, name_cell, share_text
from pytest_dura.reports.document import Level, Part, Table, Text
from pytest_dura.reports.failure_modes import percent_text

_MOST_NAMED = 5
_MOST_LISTED = 20


def combination_text(known: CombinationsEntry) -> str:
    """Say how many cells of pairs of parameters were drawn."""
    share = percent_text(known.met / known.cells)
    text = (
        f"{known.met} of {known.cells} cells ({share} %) of {counted(known.pairs, 'pair')} of "
        "varied parameters were drawn, in fifths of ranges and single choices"
    )
    if known.unpaired:
        text += (
            f"; {counted(known.unpaired, 'parameter')} with no single value, or too many choices, "
        )
        text += "in no pair"
    return text + "."


def _cells(pair: PairEntry) -> str:
    cells = sum(map(len, pair.counts))
    return f"{pair.met} of {cells} cells, by {counted(pair.drawn, 'draw')}"


PAIR_COLUMNS: Sequence[Column[PairEntry]] = (
    Column("scenario", lambda row: name_cell(row.scenario), kind=""),
    Column("parameter", lambda row: name_cell(row.first), kind=""),
    Column("with", lambda row: name_cell(row.second), kind=""),
    Column("share", lambda row: share_text(row.covered)),
    Column("cells", _cells, kind=""),
)


def pair_parts(head: RecordHead) -> Iterator[Part]:
    """Yield what was drawn of pairs of parameters, and those least covered by name."""
    known = head.coverage.combinations
    if known is None:
        return
    worst = [pair for pair in known.worst[:_MOST_LISTED] if pair.covered < 1]
    named = [
        f"{pair.first} with {pair.second} of {pair.scenario}: {_cells(pair)}"
        for pair in worst[:_MOST_NAMED]
    ]
    lines = (combination_text(known), *named)
    yield Text(lines, weight=Level.SUMMARY, shown=Shown.SUMMARY)
    caption = "Pairs of parameters with cells that were never drawn, the worst first"
    rows = [(pair.scenario, pair) for pair in worst]
    yield Table("scenario", PAIR_COLUMNS, rows, shown=Shown.PAGE, caption=caption, view="plots")
