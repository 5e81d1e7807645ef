"""What reports say of the coverage of the operating domain: pairs, and declared exposure."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence.case_model import (
    CombinationsEntry,
    ExposureEntry,
    PairEntry,
    WeighedViolations,
)
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


def exposure_text(entry: ExposureEntry) -> str:
    """Say which share of the declared exposure was exercised, and who declares none."""
    run = sum(scenario.runs > 0 for scenario in entry.scenarios)
    text = (
        f"{percent_text(entry.exercised)} % of the declared exposure was exercised: {run} of "
        f"{counted(len(entry.scenarios), 'scenario')} that declare any had a valid run"
    )
    if entry.undeclared:
        text += f"; {len(entry.undeclared)} without a declared exposure weigh nothing"
    return text + "."


def weighed_texts(entry: ExposureEntry) -> Iterator[str]:
    """Yield, for each kind of requirement, its violating runs, weighed by declared exposure."""
    yield from map(weighed_text, entry.violations)


def weighed_text(known: WeighedViolations) -> str:
    """Say how violating runs weigh, with their n."""
    weighed = (
        "nothing that occurs, as declared"
        if known.weighed is None
        else f"{percent_text(known.weighed)} % when weighed by declared exposure"
    )
    return (
        f"{known.kind}: {known.violating} of {counted(known.runs, 'valid run')} violate a "
        f"requirement, {weighed} ({counted(known.scenarios, 'scenario')}, "
        f"{percent_text(known.of_exposure)} % of what is declared)"
    )
