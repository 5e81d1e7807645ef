"""Searches in words: sentences, headlines and cells of tables, for every format and the terminal.

No search supports a requirement: of a search without a violation its effort is reported.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.core.percepts import NOTHING
from pytest_dura.evidence.gate import (
    NOTHING_FOUND,
    OBJECTIONABLE_OUTCOMES,
    VIOLATED_OUTCOMES,
    outcome_status,
)
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.text import counted, first_few, name, one_line
from pytest_dura.requirements.checks import is_function_path
from pytest_dura.requirements.searches import (
    Falsification,
    FoundCounterexample,
    ParameterChange,
    SearcherReport,
    SearchOutcome,
)
from pytest_dura.requirements.shortfalls import shortfall

_OUTCOME_RANK = {status: rank for rank, status in enumerate(OBJECTIONABLE_OUTCOMES)}
NOTHING_SUPPORTED = (
    "A search that finds nothing supports no requirement: no rate follows from where it looked."
)


def outcome_rank(search: Falsification, outcome: SearchOutcome) -> int:
    """Place of an outcome in a list that begins with the worst."""
    return _OUTCOME_RANK.get(outcome_status(search, outcome), len(_OUTCOME_RANK))


def simulations_text(search: Falsification) -> str:
    """Simulations that were run, of the budget: ``37 of 100 simulations``."""
    text = f"{search.simulations} of {counted(search.budget, 'simulation')}"
    if search.unknown:
        text += f", {search.unknown} without an answer"
    if search.not_manifested:
        text += f", {search.not_manifested} with an added fault that never came to act"
    if search.refused:
        text += f"; {counted(search.refused, 'point')} refused"
    return text


def ordered_outcomes(record: SessionRecord) -> list[tuple[RecordedSearch, SearchOutcome]]:
    """Searches with their outcomes, the worst first."""
    outcomes = [(search, outcome) for search in record.head.searches for outcome in search.outcomes]
    return sorted(outcomes, key=lambda pair: outcome_rank(*pair))


def outcome_counts_text(record: SessionRecord) -> str:
    """Outcomes by status: ``1 falsified, 2 nothing found``; empty without a search."""
    counts = Counter[str](outcome.status for _, outcome in ordered_outcomes(record))
    return ", ".join(
        f"{counts[status]} {status}"
        for status in (*OBJECTIONABLE_OUTCOMES, NOTHING_FOUND)
        if counts[status]
    )


def outcome_headline(search: Falsification, outcome: SearchOutcome, where: str = "") -> str:
    """The outcome, the requirement, and what the outcome rests on.

    Args:
        search: Of the record.
        outcome: One of its outcomes.
        where: What stands behind the requirement, such as `` on a/clear``.
    """
    status, requirement = outcome.status, f"{name(outcome.requirement)}{where}"
    counterexample = outcome.counterexample
    if counterexample is not None:
        repeats = counterexample.repeats
        by = f"at simulation {outcome.simulations}, by {one_line(outcome.searcher or '')}"
        if status == "falsified":
            again = f"confirmed by {counted(repeats.runs, 'equal replay')}"
        else:
            runs = counted(repeats.runs, "replay")
            again = f"and in {repeats.violated} of {runs}, {repeats.equal} of them equal"
        return f"{status}: {requirement} violated {by}; {again}"
    least = "none measured" if outcome.best is None else f"{outcome.best:.4g}"
    start = f"{requirement}: " if status == NOTHING_FOUND else f"{status}: {requirement}: "
    return (
        f"{start}nothing found in {counted(search.simulations, 'simulation')}: "
        f"least robustness {least}, coverage {search_coverage_text(search)}"
    )


def change_entries(
    counterexample: FoundCounterexample, most: int, rest_is: str = ""
) -> Iterator[tuple[str, str]]:
    """Label and text of each changed parameter; the label is empty but for the first."""
    changes = [f"{path}: {change}" for path, change in parameter_changes(counterexample, most)]
    for number, change in enumerate(changes or ["in nothing: the case violates it as it stands"]):
        yield "" if number else "differs", change
    if len(counterexample.changes) > most:
        yield "", f"and {len(counterexample.changes) - most} more{rest_is}"


def baseline_note(search: RecordedSearch, outcome: SearchOutcome) -> str:
    """Note on an outcome that a baseline alone violated; empty for any other."""
    status = outcome_status(search, outcome)
    return OBJECTIONABLE_OUTCOMES[status] if status == "baseline" else ""


def kept_text(outcome: SearchOutcome) -> str:
    """The scenario file that keeps the counterexample; empty where none does."""
    counterexample = outcome.counterexample
    return one_line((counterexample and counterexample.file) or "")


MOST_CHANGES = 12
"""Changed parameters that a card and the message of a failing test name."""
_KEPT_FOR = ", which --dura-scenarios runs from now on"


def failure_lines(search: Falsification, units: Mapping[str, str] = NOTHING) -> Iterator[str]:
    """Lines of the message of a test that fails by its search; the cards have the rest.

    Args:
        search: What the test asked for.
        units: Of signals, by name.
    """
    where = f" on {name(search.case)} ({name(search.component)})"
    for outcome in search.outcomes:
        yield outcome_headline(search, outcome, where)
        if outcome.status == NOTHING_FOUND:
            continue
        example = outcome.counterexample
        worst = counterexample_text(example, outcome.check, units) if example else ""
        entries = [("worst", worst)] if example else []
        if kept := kept_text(outcome):
            entries.append(("kept", f"{kept}{_KEPT_FOR}"))
        yield from map(_entry_line, entries)


def kept_lines(counterexample: FoundCounterexample, rerun: str) -> Iterator[str]:
    """Lines on a counterexample that a property test kept.

    Args:
        counterexample: As a search records it.
        rerun: The command that runs it again.
    """
    entries = [*change_entries(counterexample, MOST_CHANGES)]
    entries += [("kept", f"{one_line(counterexample.file or '')}{_KEPT_FOR}"), ("rerun", rerun)]
    yield from map(_entry_line, entries)


def _entry_line(entry: tuple[str, str]) -> str:
    label, text = entry
    return f"{f'{label}:' if label else '':<11}{text}"


def search_coverage_text(search: Falsification) -> str:
    """The share of the ranges that was simulated, on average, and of their pairs."""
    shares, pairs = list(search.coverage.parameters.values()), search.coverage.pairs
    text = f"{100 * sum(shares) / len(shares):.0f} % of each range" if shares else "unknown"
    return text if pairs is None else f"{text}, {100 * pairs:.0f} % of their pairs"


def baselines_text(search: Falsification, requirement: str) -> str:
    """The simulation at which each trivial baseline violated the requirement by itself."""
    results = []
    for baseline in search.baselines:
        first = baseline.first.get(requirement)
        end = f"none in {baseline.simulations}" if first is None else f"at {first}"
        results.append(f"{name(baseline.name)} {end}")
    return "; ".join(results) or "none was run"


def is_notable_outcome(search: RecordedSearch, outcome: SearchOutcome) -> bool:
    """Whether a search or a baseline violated it, so that its searchers are listed."""
    return outcome_status(search, outcome) in (*VIOLATED_OUTCOMES, "baseline")


def searcher_name(searcher: SearcherReport) -> str:
    """Name of a searcher, and whether it learns from what it sees."""
    shown = name(searcher.name)
    return shown if searcher.trivial else f"{shown} (learns)"


def counterexample_text(
    counterexample: FoundCounterexample, check: str, units: Mapping[str, str] = NOTHING
) -> str:
    """By how much a counterexample misses its check, when, and why if the check is a function."""
    amount = shortfall(check, counterexample.margin, counterexample.time, units)
    # What a formula says in detail is the amount again.
    detail = one_line(counterexample.detail, 300) if is_function_path(check) else ""
    return ": ".join(filter(None, [amount, detail]))


def shrinking_text(counterexample: FoundCounterexample) -> str:
    """Result of shrinking; empty where none was requested."""
    shrinking = counterexample.shrinking
    if shrinking is None:
        return ""
    spent = counted(shrinking.simulations, "simulation")
    limit = "" if shrinking.finished else f", all of {shrinking.budget} that it was allowed"
    before, after = shrinking.before, shrinking.after
    return f"from {before} to {after} parameters that differ ({spent}{limit})"


def parameter_changes(counterexample: FoundCounterexample, most: int) -> Sequence[tuple[str, str]]:
    """Path and change of each parameter: ``world.wall``, ``2 instead of 4``."""
    return [
        (name(change.path), _parameter_change(change)) for change in counterexample.changes[:most]
    ]


def _parameter_change(change: ParameterChange) -> str:
    if change.value is None:
        return "left out"
    unit = f" {name(change.unit)}" if change.unit not in ("", "1") else ""
    if change.nominal is None:
        return f"{_value_text(change.value)}{unit}, added"
    return f"{_value_text(change.value)} instead of {_value_text(change.nominal)}{unit}"


def _value_text(value: Any) -> str:
    """A value on one line, such as ``{type: delay, target: lidar}``."""
    if value is None:
        return "nothing"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(
                f"{name(str(key))}: {_value_text(element)}" for key, element in value.items()
            )
            + "}"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value_text, value)) + "]"
    return one_line(str(value), 120)


def _outcomes_of(
    record: SessionRecord, statuses: tuple[str, ...]
) -> list[tuple[RecordedSearch, SearchOutcome]]:
    """Searches and their outcomes of these statuses."""
    return [
        (search, outcome)
        for search in record.head.searches
        for outcome in search.outcomes
        if outcome.status in statuses
    ]


def violation_sentences(record: SessionRecord) -> Iterator[str]:
    """Sentences on violations by searches, confirmed or not."""
    for violated_outcome, how in zip(
        VIOLATED_OUTCOMES, ("confirmed by replay", "and not each time again"), strict=True
    ):
        search_outcomes = _outcomes_of(record, (violated_outcome,))
        if search_outcomes:
            claims = [
                f"{name(outcome.requirement)} on {name(search.case)}"
                for search, outcome in search_outcomes
            ]
            names = first_few(list(dict.fromkeys(claims)))
            yield f"Violated in a search, {how}: {names}. It is part of no rate."


def unviolated_sentences(record: SessionRecord) -> Iterator[str]:
    """Sentences on searches without a violation: how far they looked."""
    search_outcomes = _outcomes_of(record, (NOTHING_FOUND, "undecided"))
    if search_outcomes:
        most = max(search.simulations for search, _ in search_outcomes)
        yield (
            f"Searches found nothing against {counted(len(search_outcomes), 'requirement')}"
            " on a case, in up to "
            f"{most} simulations each: that supports none of them. {NOTHING_SUPPORTED}"
        )
