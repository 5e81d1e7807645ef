"""Failure modes and decision times: figures and cells of tables that reports and terminal share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter

from pytest_dura.evidence.case_model import (
    CaseEntry,
    CaseMetricsEntry,
    FailureModeEntry,
    Percentiles,
)
from pytest_dura.evidence.conclusions.failure_modes import share
from pytest_dura.evidence.model import RecordHead
from pytest_dura.evidence.text import name

_COUNTS = attrgetter("hits", "of", "null_hits", "null_of", "episodes", "of_episodes")
FAILURE_MODE_HEADINGS = {
    "failure": "failure modes",
    "infrastructure": "of the server or the way there",
    "control": "negative control",
    "comparison": "no failure by itself",
}
"""Headings of tables above the measures of a kind."""
_JUDGED_KINDS = ("failure", "control")
"""Kinds of measures that a requirement may be asked for."""
_OF_PROPOSAL = re.compile(r"\bproposal\.(\w+)")
_TIMEOUT = "timeout"
"""Name of the failure mode of a decision that was not there in time."""
NULL_NOTE = (
    "null: a component that ignores its input, on the same decisions: what it also reaches says "
    "nothing about the model"
)


def cases_with_accounts(cases: Sequence[CaseEntry]) -> list[CaseEntry]:
    """The cases whose component gave accounts; those without a role repeat others' decisions."""
    return [case for case in cases if case.metrics.failure_modes and not case.without]


def failure_modes_by_component(cases: Sequence[CaseEntry]) -> dict[str, list[FailureModeEntry]]:
    """Failure modes of each component over all cases, those that could show, by kind.

    Without a bound: cases are no sample of one kind of episode.
    """
    components: dict[str, dict[str, list[FailureModeEntry]]] = {}
    for case in cases_with_accounts(cases):
        modes = components.setdefault(case.component, {})
        for mode in case.metrics.failure_modes:
            modes.setdefault(mode.name, []).append(mode)
    return {
        component: measured_failure_modes([_pooled_mode(same) for same in modes.values()])
        for component, modes in components.items()
    }


def _pooled_mode(modes: Sequence[FailureModeEntry]) -> FailureModeEntry:
    """A failure mode over several cases."""
    sums = (sum(counts) for counts in zip(*map(_COUNTS, modes), strict=True))
    hits, of, null_hits, null_of, episodes, of_episodes = sums
    return FailureModeEntry(
        name=modes[0].name,
        kind=modes[0].kind,
        hits=hits,
        of=of,
        share=share(hits, of),
        null_hits=null_hits,
        null_of=null_of,
        null_share=share(null_hits, null_of),
        episodes=episodes,
        of_episodes=of_episodes,
        upper=None,
    )


def measured_failure_modes(modes: Sequence[FailureModeEntry]) -> list[FailureModeEntry]:
    """Failure modes that could show, failures first, then the controls to be read with them.

    Those that could have shown of the null component alone are included: a reader is to see that a
    component gave nothing to measure, as where it failed on each variant of a request.
    """
    measured = [mode for mode in modes if mode.of or mode.null_of]
    return [mode for kind in FAILURE_MODE_HEADINGS for mode in measured if mode.kind == kind]


def failure_mode_text(name: str) -> str:
    """A failure mode's name with spaces: ``threat ids miss nearest``."""
    return name.replace("_", " ")


def percent_text(part: float | None) -> str:
    """A share in per cent, ``-`` of nothing; what is neither never nor always does not read so."""
    if part is None:
        return "-"
    text = f"{100 * part:.1f}"
    if part > 0.0 and text == "0.0":
        return "<0.1"
    return ">99.9" if part < 1.0 and text == "100.0" else text


def decision_time_lines(cases: Sequence[CaseEntry]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions took time, and a text on how much and how often too much."""
    late = _timeouts(cases)
    for component, spreads in _spreads(cases, attrgetter("answer_times")).items():
        decisions = sum(spread.decisions for spread in spreads)
        text = f"{decisions} decisions, {_percentiles(spreads, 'longest', '.2f')}"
        hits, of = late.get(component, (0, 0))
        if of:
            text += f"; {hits} of {of} ({percent_text(hits / of)} %) past the time budget"
        yield component, text


def decision_age_lines(cases: Sequence[CaseEntry]) -> Iterator[tuple[str, str]]:
    """Each component whose decisions came into force late, and a text on how old they were.

    Where the simulation waits for each decision, none is older than its percept: no line.
    """
    for component, spreads in _spreads(cases, attrgetter("answer_ages")).items():
        if any(spread.max > 0.0 for spread in spreads):
            yield component, _percentiles(spreads, "oldest", ".4g")


def uncovered_lines(head: RecordHead) -> Iterator[str]:
    """Say of each component which failures showed that no formula it was judged by reads."""
    several = len(failure_modes_by_component(head.cases)) > 1
    checks = {requirement.id: requirement.check for requirement in head.requirements}
    for component, modes in failure_modes_by_component(head.cases).items():
        read = {
            signal
            for verdict in head.verdicts
            if verdict.component == component
            for signal in _OF_PROPOSAL.findall(checks.get(verdict.requirement, ""))
        }
        shown = [
            f"{name(failure_mode_text(mode.name))} ({mode.hits} of {mode.of})"
            for mode in modes
            if mode.kind in _JUDGED_KINDS and mode.hits and mode.name not in read
        ]
        if shown:
            whose = f", of {component}" if several else ""
            yield f"no requirement covers {', '.join(shown)}{whose}"


def _timeouts(cases: Sequence[CaseEntry]) -> dict[str, tuple[int, int]]:
    """Decisions of each component without an answer in time, and all whose outcome is known."""
    timeouts: dict[str, tuple[int, int]] = {}
    for case in cases_with_accounts(cases):
        for failure_mode in case.metrics.failure_modes:
            if failure_mode.name == _TIMEOUT:
                hits, of = timeouts.get(case.component, (0, 0))
                timeouts[case.component] = hits + failure_mode.hits, of + failure_mode.of
    return timeouts


def _spreads(
    cases: Sequence[CaseEntry], of: Callable[[CaseMetricsEntry], Percentiles | None]
) -> dict[str, list[Percentiles]]:
    """Percentiles of one metric for each component, of each case that has it."""
    spreads: dict[str, list[Percentiles]] = {}
    for case in cases_with_accounts(cases):
        if (spread := of(case.metrics)) is not None:
            spreads.setdefault(case.component, []).append(spread)
    return spreads


def _percentiles(spreads: Sequence[Percentiles], greatest: str, format_spec: str) -> str:
    """Median, 95th percentile and greatest, in s."""
    median = _range_text("median", [spread.p50 for spread in spreads], format_spec)
    high = _range_text("95th percentile", [spread.p95 for spread in spreads], format_spec)
    return f"{median}, {high}, {greatest} {max(spread.max for spread in spreads):{format_spec}} s"


def _range_text(label: str, values: Sequence[float], format_spec: str) -> str:
    """Percentiles of several cases do not add up: the text has the least and the greatest."""
    least, greatest = f"{min(values):{format_spec}}", f"{max(values):{format_spec}}"
    if least == greatest:
        return f"{label} {least} s"
    return f"{label} {least} to {greatest} s by case"
