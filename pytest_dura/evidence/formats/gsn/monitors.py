"""Tool confidence: how far the quality of the runtime monitors is known from seeded violations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.formats.gsn.element import Element, derived_id
from pytest_dura.evidence.formats.gsn.wording import monitor_text
from pytest_dura.evidence.text import name

Data = Mapping[str, Any]

MONITORS = "GMonitors"


def monitor_elements(rows: Sequence[Data]) -> Iterator[Element]:
    """A goal that the quality is known, and for each monitor and target what was measured.

    The goal is on what is known and not on how good it is: low figures are evidence as well.
    """
    if not rows:
        return
    found: dict[tuple[str, str, str], list[Data]] = {}
    for row in rows:
        found.setdefault((row["component"], row["monitor"], row["target"]), []).append(row)
    told = [_quality(key, own) for key, own in found.items()]
    yield Element(
        MONITORS,
        "The quality of the runtime monitors is known from violations that they could have "
        "missed, where recovery did not act. The verdicts do not rest on the monitors.",
        supported_by=tuple(one.id for one in told),
        url="evidence.json#/monitors",
        alias="monitors",
    )
    yield from told


def _quality(key: tuple[str, str, str], rows: list[Data]) -> Element:
    _, monitor, target = key
    known = any(row["true_positives"] or row["false_negatives"] for row in rows)
    text = monitor_text(monitor, target, rows)
    return Element(
        derived_id("Sn" if known else "G", "monitor", monitor, target, apart=key[:1]),
        text if known else f"The quality of {text}",
        undeveloped=not known,
        url="evidence.json#/monitors",
        alias=f"monitor:{name(monitor)}:{name(target)}",
        brief=(name(monitor), name(target)),
    )
