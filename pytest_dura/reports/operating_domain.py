"""What reports say of the coverage of the operating domain: pairs of parameters."""

from __future__ import annotations

from pytest_dura.evidence.case_model import CombinationsEntry, PairEntry
from pytest_dura.evidence.text import counted
from pytest_dura.reports.failure_modes import percent_text


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


def pair_text(pair: PairEntry) -> str:
    """Say how many cells of a pair were drawn."""
    cells = sum(map(len, pair.counts))
    return f"{pair.met} of {cells} cells, by {counted(pair.drawn, 'draw')}"
