"""Failure modes and decision times: figures and cells of tables that reports and terminal share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.evidence.metrics import share

Data = Mapping[str, Any]

_SUMMED_COUNTS = ("hits", "of", "null_hits", "null_of", "episodes", "of_episodes")
FAILURE_MODE_HEADINGS = {
    "failure": "failure modes",
    "control": "negative control",
    "comparison": "no failure by itself",
}
"""Headings of tables above the measures of a kind."""
_TIMEOUT = "timeout"
"""Name of the failure mode of a decision that was not there in time."""
NULL_NOTE = (
    "null: a component that ignores its input, on the same decisions: what it also reaches says "
    "nothing about the model"
)


def cases_with_accounts(cases: Sequence[Data]) -> list[Data]:
    """The cases whose component gave accounts; those without a role repeat others' decisions."""
    return [case for case in cases if case["metrics"]["failure_modes"] and not case["without"]]


def failure_modes_by_component(cases: Sequence[Data]) -> dict[str, list[dict[str, Any]]]:
    """Failure modes of each component over all cases, those that could show, by kind.

    Without a bound: cases are no sample of one kind of episode.
    """
    components: dict[str, dict[str, dict[str, Any]]] = {}
    for case in cases_with_accounts(cases):
        modes = components.setdefault(case["component"], {})
        for failure_mode in case["metrics"]["failure_modes"]:
            empty = {
                "name": failure_mode["name"],
                "kind": failure_mode["kind"],
                **dict.fromkeys(_SUMMED_COUNTS, 0),
            }
            mode = modes.setdefault(failure_mode["name"], empty)
            for key in _SUMMED_COUNTS:
                mode[key] += failure_mode[key]
    return {
        component: [
            {
                **failure_mode,
                "share": share(failure_mode["hits"], failure_mode["of"]),
                "null_share": share(failure_mode["null_hits"], failure_mode["null_of"]),
            }
            for failure_mode in measured_failure_modes(list(modes.values()))
        ]
        for component, modes in components.items()
    }


def measured_failure_modes(modes: Sequence[Data]) -> list[Data]:
    """Failure modes that could show, failures first, then the controls to be read with them.

    Those that could have shown of the null component alone are included: a reader is to see that a
    component gave nothing to measure, as where it failed on each variant of its prompt.
    """
    measured = [mode for mode in modes if mode["of"] or mode["null_of"]]
    return [mode for kind in FAILURE_MODE_HEADINGS for mode in measured if mode["kind"] == kind]


def failure_mode_text(name: str) -> str:
    """A failure mode's name with spaces: ``misses threat``."""
    return name.replace("_", " ")


def percent_text(part: float | None) -> str:
    """A share in per cent, ``-`` of nothing; what is neither never nor always does not read so."""
    if part is None:
        return "-"
    text = f"{100 * part:.1f}"
    if part > 0.0 and text == "0.0":
        return "<0.1"
    return ">99.9" if part < 1.0 and text == "100.0" else text


def decision_time_lines(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions took time, and a text on how much and how often too much."""
    late = _timeouts(cases)
    for component, spreads in _metric_spreads(cases, "answer_times").items():
        decisions = sum(spread["decisions"] for spread in spreads)
        text = f"{decisions} decisions, {_percentiles(spreads, 'longest', '.2f')}"
        hits, of = late.get(component, (0, 0))
        if of:
            text += f"; {hits} of {of} ({percent_text(hits / of)} %) past the time budget"
        yield component, text


def decision_age_lines(cases: Sequence[Data]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions came into force late, and a text on how old they were.

    Where the simulation waits for each decision, none is older than its percept: no line.
    """
    for component, spreads in _metric_spreads(cases, "answer_ages").items():
        if any(spread["max"] > 0.0 for spread in spreads):
            yield component, _percentiles(spreads, "oldest", ".4g")


def _timeouts(cases: Sequence[Data]) -> dict[str, tuple[int, int]]:
    """Decisions of each component without an answer in time, and all whose outcome is known."""
    timeouts: dict[str, tuple[int, int]] = {}
    for case in cases_with_accounts(cases):
        for failure_mode in case["metrics"]["failure_modes"]:
            if failure_mode["name"] == _TIMEOUT:
                hits, of = timeouts.get(case["component"], (0, 0))
                timeouts[case["component"]] = hits + failure_mode["hits"], of + failure_mode["of"]
    return timeouts


def _metric_spreads(cases: Sequence[Data], key: str) -> dict[str, list[Data]]:
    """Values of this key of the metrics for each component, of each case that has it."""
    spreads: dict[str, list[Data]] = {}
    for case in cases_with_accounts(cases):
        if case["metrics"][key] is not None:
            spreads.setdefault(case["component"], []).append(case["metrics"][key])
    return spreads


def _percentiles(spreads: Sequence[Data], greatest: str, format_spec: str) -> str:
    """Median, 95th percentile and greatest, in s."""
    median, high = (
        _percentile_range(label, key, spreads, format_spec)
        for label, key in (("median", "p50"), ("95th percentile", "p95"))
    )
    return (
        f"{median}, {high}, {greatest} {max(spread['max'] for spread in spreads):{format_spec}} s"
    )


def _percentile_range(label: str, key: str, spreads: Sequence[Data], format_spec: str) -> str:
    """Percentiles of several cases do not add up: the text has the least and the greatest."""
    least, greatest = (
        f"{limit(spread[key] for spread in spreads):{format_spec}}" for limit in (min, max)
    )
    if least == greatest:
        return f"{label} {least} s"
    return f"{label} {least} to {greatest} s by case"
