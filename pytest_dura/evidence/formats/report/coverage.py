"""Section: what was tested and what was not, in requirements, scenarios, faults and ranges."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from pytest_dura.evidence.formats.report.anchors import requirement_anchor
from pytest_dura.evidence.formats.report.folding import Key
from pytest_dura.evidence.formats.report.gathering import Gathered
from pytest_dura.evidence.formats.report.links import Links
from pytest_dura.evidence.formats.report.matrix import heading, matrix
from pytest_dura.evidence.record.session_record import SessionRecord

Data = Mapping[str, Any]
BIN_WIDTH, BIN_HEIGHT = 12.0, 22.0
MAX_BARS = 20
"""A list of choices may be long."""


def section(record: SessionRecord, gathered: Gathered, _links: Links) -> Data:
    """The matrix of cells, and the bars of each varied parameter."""
    found = record["coverage"]
    requirements = [one["id"] for one in record["requirements"]]
    places: dict[tuple[str, str], dict[str, list[str | None]]] = {}
    shown, rest = _apart(found["cells"], gathered.folded)
    for cell in shown:
        row = places.setdefault((cell["scenario"], cell["faults"]), {})
        row.setdefault(cell["requirement"], []).append(cell["verdict"])
        if cell["requirement"] not in requirements:
            requirements.append(cell["requirement"])
    columns = sorted(places)
    words = Counter(one["verdict"] for one in found["cells"])
    judged = {_place(one) for one in record["verdicts"] if one["run"]}
    return {
        "matrix": matrix(
            [heading(name, anchor=requirement_anchor(name)) for name in requirements],
            [
                heading(scenario, f"+ {faults}" if faults else "no fault")
                for scenario, faults in columns
            ],
            # No cell at all: the requirement does not apply to the scenario.
            lambda i, j: places[columns[j]].get(requirements[i]),
            "Scenario and faults",
        ),
        "tested": sum(one["verdict"] is not None for one in found["cells"]),
        "words": {word: words[word] for word in ("supported", "violated", "undecided")},
        "not_run": sum(
            one["verdict"] is not None and _place(one) not in judged for one in found["cells"]
        ),
        "cells": len(found["cells"]) + found["left_out"],
        "left_out": found["left_out"],
        "folded": len(set(map(_scenario, rest))),
        "parameters": [_parameter(one) for one in found["parameters"]],
    }


def _apart(cells: list[Data], folded: frozenset[Key]) -> tuple[list[Data], list[Data]]:
    """The cells of places that are shown, and of those of which all cells are of folded cases."""
    untold = {_scenario(cell) for cell in cells if (cell["case"], cell["component"]) not in folded}
    shown = [cell for cell in cells if _scenario(cell) in untold]
    return shown, [cell for cell in cells if _scenario(cell) not in untold]


def _scenario(cell: Data) -> tuple[str, str]:
    return cell["scenario"], cell["faults"]


def _place(one: Data) -> tuple[str, str, str]:
    """What a cell and the verdicts on it have in common."""
    return one["requirement"], one["case"], one["component"]


def _parameter(one: Data) -> Data:
    choices = one["choices"]
    counts = one["bins"] if choices is None else [choice["count"] for choice in choices]
    highest = max([*counts, 1])
    bars = []
    for place, count in enumerate(counts[:MAX_BARS]):
        height = round(BIN_HEIGHT * count / highest, 1)
        bars.append({"x": place * BIN_WIDTH, "y": BIN_HEIGHT - height, "height": height})
    return {
        **one,
        "counts": counts,
        "bars": bars,
        "width": BIN_WIDTH * len(bars),
        "hit": sum(count > 0 for count in counts),
    }
