"""Failure modes of components as tables show them: summed over cases, and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.record.failure_modes import share

Data = Mapping[str, Any]

SUMMED = ("hits", "of", "null_hits", "null_of", "episodes", "of_episodes")
HEADINGS = {
    "failure": "failure modes",
    "control": "negative control",
    "comparison": "no failure by itself",
}
"""What tables write above the measures of a kind."""
NULL = (
    "null: a component that ignores its input, on the same decisions: what it also reaches says "
    "nothing about the model"
)


def told(cases: Sequence[Data]) -> list[Data]:
    """The cases whose component gave accounts; those without a role repeat others' decisions."""
    return [one for one in cases if one["metrics"]["failure_modes"] and not one["without"]]


def summed(cases: Sequence[Data]) -> dict[str, list[dict[str, Any]]]:
    """By component, its failure modes over all cases, those that could show, by kind.

    Without a bound: cases are no sample of one kind of episode.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for case in told(cases):
        modes = found.setdefault(case["component"], {})
        for one in case["metrics"]["failure_modes"]:
            empty = {"name": one["name"], "kind": one["kind"], **dict.fromkeys(SUMMED, 0)}
            mode = modes.setdefault(one["name"], empty)
            for key in SUMMED:
                mode[key] += one[key]
    return {
        component: [
            {
                **one,
                "share": share(one["hits"], one["of"]),
                "null_share": share(one["null_hits"], one["null_of"]),
            }
            for one in by_kind(list(modes.values()))
        ]
        for component, modes in found.items()
    }


def by_kind(modes: Sequence[Data]) -> list[Data]:
    """Those that could show, failures first, then the controls that they are to be read with."""
    return [one for kind in HEADINGS for one in modes if one["kind"] == kind and one["of"]]


def in_words(name: str) -> str:
    """``misses threat``."""
    return name.replace("_", " ")


def percent(part: float | None) -> str:
    """A share in per cent, ``-`` of nothing; what is neither never nor always does not read so."""
    if part is None:
        return "-"
    text = f"{100 * part:.1f}"
    if part > 0.0 and text == "0.0":
        return "<0.1"
    return ">99.9" if part < 1.0 and text == "100.0" else text


def answers(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions took time, and how much, in words."""
    times: dict[str, list[Data]] = {}
    for case in told(cases):
        if case["metrics"]["answer_times"] is not None:
            times.setdefault(case["component"], []).append(case["metrics"]["answer_times"])
    for component, spreads in times.items():
        decisions = sum(one["decisions"] for one in spreads)
        longest = max(one["max"] for one in spreads)
        text = f"{decisions} decisions, {_range('median', 'p50', spreads)}, "
        text += f"{_range('95th percentile', 'p95', spreads)}, longest {longest:.2f} s"
        yield component, text


def _range(word: str, key: str, spreads: Sequence[Data]) -> str:
    """Percentiles of several cases do not add up: the least and the greatest are told."""
    least, greatest = (f"{limit(one[key] for one in spreads):.2f}" for limit in (min, max))
    if least == greatest:
        return f"{word} {least} s"
    return f"{word} {least} to {greatest} s by case"
