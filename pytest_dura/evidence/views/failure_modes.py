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
TIMEOUT = "timeout"
"""Name of the failure mode of a decision that was not there in time."""
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
    """Those that could show, failures first, then the controls that they are to be read with.

    Also those that could only have shown of the null component: that a component gave nothing to
    measure, as where it failed on each variant of its prompt, is not to be overlooked.
    """
    could = [one for one in modes if one["of"] or one["null_of"]]
    return [one for kind in HEADINGS for one in could if one["kind"] == kind]


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
    """Each component whose decisions took time, how much, and how many took too much, in words."""
    late = _timeouts(cases)
    for component, spreads in _spreads(cases, "answer_times").items():
        decisions = sum(one["decisions"] for one in spreads)
        text = f"{decisions} decisions, {_percentiles(spreads, 'longest', '.2f')}"
        hits, of = late.get(component, (0, 0))
        if of:
            text += f"; {hits} of {of} ({percent(hits / of)} %) past the time budget"
        yield component, text


def ages(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions came into force late, and how old they were, in words.

    Where the simulation waits for each decision, none is older than its percept, and nothing is
    told.
    """
    for component, spreads in _spreads(cases, "answer_ages").items():
        if any(one["max"] > 0.0 for one in spreads):
            yield component, _percentiles(spreads, "oldest", ".4g")


def _timeouts(cases: Sequence[Data]) -> dict[str, tuple[int, int]]:
    """By component: decisions to which no answer came in time, of all whose outcome is told."""
    found: dict[str, tuple[int, int]] = {}
    for case in told(cases):
        for one in case["metrics"]["failure_modes"]:
            if one["name"] == TIMEOUT:
                hits, of = found.get(case["component"], (0, 0))
                found[case["component"]] = hits + one["hits"], of + one["of"]
    return found


def _spreads(cases: Sequence[Data], key: str) -> dict[str, list[Data]]:
    """By component, what this key of the metrics says, one for each case that has it."""
    found: dict[str, list[Data]] = {}
    for case in told(cases):
        if case["metrics"][key] is not None:
            found.setdefault(case["component"], []).append(case["metrics"][key])
    return found


def _percentiles(spreads: Sequence[Data], last: str, shown: str) -> str:
    """Median, 95th percentile and greatest, in s."""
    median, high = (
        _range(word, key, spreads, shown)
        for word, key in (("median", "p50"), ("95th percentile", "p95"))
    )
    return f"{median}, {high}, {last} {max(one['max'] for one in spreads):{shown}} s"


def _range(word: str, key: str, spreads: Sequence[Data], shown: str) -> str:
    """Percentiles of several cases do not add up: the least and the greatest are told."""
    least, greatest = (f"{limit(one[key] for one in spreads):{shown}}" for limit in (min, max))
    if least == greatest:
        return f"{word} {least} s"
    return f"{word} {least} to {greatest} s by case"
