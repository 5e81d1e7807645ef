"""The elements of each requirement: goal, reason, untested cells, and what speaks against it.

No search supports anything. A counterexample defeats a requirement that asks for all episodes;
one that bounds a rate is challenged by it, since no rate follows from where a search looked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from pytest_dura.evidence.case_model import CellEntry
from pytest_dura.evidence.gate import NOTHING_FOUND, outcome_status
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.searches import RecordedSearch
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.contents import requirement_anchor
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.gsn.verdicts import VerdictElements
from pytest_dura.reports.searches import (
    NOTHING_SUPPORTED,
    baseline_note,
    counterexample_text,
    kept_text,
    outcome_headline,
)
from pytest_dura.reports.verdicts import MAX_TEXT, requirement_text
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.searches import SearchOutcome

_MAX_SEARCH_ELEMENTS = 5
"""Counterexamples of a requirement that are elements; the record has all."""
_MAX_SEARCH_TEXT = 300
_MAX_REASON = 800


@dataclass(frozen=True)
class SearchElements:
    """The elements that searches add to a requirement.

    Args:
        against: The counter solutions.
        contexts: On searches without a violation.
        violations: Counterexamples of searches, those without an element among them.
        refuted: Whether one of them is against a claim on all episodes, and not waived.
        accepted: Whether waivers accept all of them.
    """

    against: tuple[Element, ...]
    contexts: tuple[Element, ...]
    violations: int
    refuted: bool
    accepted: bool


def _search_elements(record: SessionRecord, requirement: Requirement) -> SearchElements:
    violations: list[tuple[int, int, RecordedSearch, SearchOutcome]] = []
    unviolated: list[tuple[int, int, RecordedSearch, SearchOutcome]] = []
    for number, search in enumerate(record.head.searches):
        for place, outcome in enumerate(search.outcomes):
            if outcome.requirement == requirement.id:
                violated = outcome_status(search, outcome) not in (NOTHING_FOUND, "undecided")
                entry = (number, place, search, outcome)
                (violations if violated else unviolated).append(entry)
    not_waived = [entry for entry in violations if entry[2].waiver is None]
    return SearchElements(
        tuple(_counter_solution(*entry) for entry in violations[:_MAX_SEARCH_ELEMENTS]),
        _search_contexts(requirement, [(search, outcome) for _, _, search, outcome in unviolated]),
        len(violations),
        refuted=bool(not_waived) and requirement.at_most is None,
        accepted=not not_waived,
    )


def _counter_solution(
    number: int, place: int, search: RecordedSearch, outcome: SearchOutcome
) -> Element:
    counterexample, case = outcome.counterexample, name(search.case)
    text = f"A search of {case} with {name(search.component)}: {outcome_headline(search, outcome)}."
    layers = {}
    if counterexample is None:
        text += f" {baseline_note(search, outcome).capitalize()}."
    else:
        text += (
            f" {one_line(counterexample_text(counterexample, outcome.check), _MAX_SEARCH_TEXT)}."
        )
        layers = {"kept": kept} if (kept := kept_text(outcome)) else {}
    if search.waiver is not None:
        reason = one_line(search.waiver.reason, _MAX_SEARCH_TEXT) or "none was given"
        text += f" Waived ({name(search.waiver.kind)}), reason: {reason}."
    apart = (str(number), str(place))
    return Element(
        derived_id("CSn", outcome.requirement, search.case, *apart, what="search"),
        text,
        url=f"evidence.json#/searches/{number}/outcomes/{place}",
        alias=f"found:{name(outcome.requirement)}@{case} ({number}.{place})",
        layers=layers,
        brief=("search", *name(outcome_status(search, outcome)).split()),
    )


def _search_contexts(
    requirement: Requirement, unviolated: list[tuple[RecordedSearch, SearchOutcome]]
) -> tuple[Element, ...]:
    if not unviolated:
        return ()
    headlines = [
        f"{name(search.case)}: {outcome_headline(search, outcome)}"
        for search, outcome in unviolated[:_MAX_SEARCH_ELEMENTS]
    ]
    more = (
        f"; and {len(unviolated) - _MAX_SEARCH_ELEMENTS} more"
        if len(unviolated) > _MAX_SEARCH_ELEMENTS
        else ""
    )
    return (
        Element(
            derived_id("C", requirement.id, what="search"),
            f"Searched without a find: {'; '.join(headlines)}{more}. {NOTHING_SUPPORTED}",
            url="evidence.json#/searches",
            alias=f"searched:{name(requirement.id)}",
        ),
    )


@dataclass(frozen=True)
class RequirementElements:
    """A requirement and its elements.

    Args:
        name: Its id, visible.
        kind: Its kind.
        goal: Id of its goal.
        challenge: Id of the counter goal against it, empty if nothing violated it.
        refuted: Whether a violation is not waived.
        accepted: Whether waivers accept all violations.
        elements: All its elements, the goal first; those of verdicts are not among them.
    """

    name: str
    kind: str
    goal: str
    challenge: str
    refuted: bool
    accepted: bool
    elements: tuple[Element, ...]


def requirement_elements(
    record: SessionRecord, elements: list[VerdictElements]
) -> Iterator[RequirementElements]:
    """Each requirement of the record, in its order, with its elements."""
    for index, requirement in enumerate(record.head.requirements):
        own = [element for element in elements if element.verdict.requirement == requirement.id]
        cells = [
            (i, cell)
            for i, cell in enumerate(record.head.coverage.cells)
            if cell.requirement == requirement.id and cell.verdict is None
        ]
        yield _elements_of_requirement(
            requirement, index, own, cells, _search_elements(record, requirement)
        )


def _elements_of_requirement(
    requirement: Requirement,
    index: int,
    own: list[VerdictElements],
    cells: list[tuple[int, CellEntry]],
    searches: SearchElements,
) -> RequirementElements:
    requirement_id = requirement.id
    times = Counter(cell.case for _, cell in cells)
    untested = [_untested_goal(i, cell, alone=times[cell.case] == 1) for i, cell in cells]
    goals = [element.goal for element in own] + [element.id for element in untested]
    violated = [element for element in own if element.verdict.verdict == "violated"]
    accepted = searches.accepted and not any(element.refuted for element in violated)
    refuted = searches.refuted or any(element.refuted for element in violated)
    strategy = Element(
        derived_id("S", requirement_id),
        _strategy_text(own, untested),
        supported_by=tuple(goals),
        alias=f"strategy:{name(requirement_id)}",
    )
    reason = _justification(requirement, index)
    challenge = []
    if violated or searches.against:
        challenge = _counter_goal(requirement_id, own, violated, searches, accepted=accepted)
    url = f"evidence.json#/requirements/{index}"
    goal = Element(
        derived_id("G", requirement_id),
        requirement_text(requirement) + ("" if goals else " No case was judged by it."),
        supported_by=(strategy.id,) if goals else (),
        in_context_of=tuple(element.id for element in (*reason, *searches.contexts)),
        undeveloped=not goals,
        defeated=refuted,
        url=url,
        alias=f"requirement:{name(requirement_id)}",
        layers={
            "kind": requirement.kind,
            "source": one_line(requirement.source, MAX_TEXT),
            "report": f"report.html#{requirement_anchor(requirement_id)}",
        },
    )
    return RequirementElements(
        name(requirement_id),
        requirement.kind,
        goal.id,
        challenge[0].id if challenge else "",
        refuted,
        accepted,
        (
            goal,
            *reason,
            *searches.contexts,
            *([strategy] if goals else ()),
            *challenge,
            *searches.against,
            *untested,
        ),
    )


def _justification(requirement: Requirement, index: int) -> list[Element]:
    reason = one_line(requirement.reason, _MAX_REASON)
    if not reason:
        return []
    return [
        Element(
            derived_id("J", requirement.id),
            reason,
            url=f"evidence.json#/requirements/{index}/reason",
            alias=f"reason:{name(requirement.id)}",
        )
    ]


def _strategy_text(own: list[VerdictElements], untested: list[Element]) -> str:
    rest = f", {counted(len(untested), 'untested cell')}" if untested else ""
    return f"Argument over scenarios and faults: {counted(len(own), 'judged case')}{rest}."


def _untested_goal(index: int, cell: CellEntry, *, alone: bool) -> Element:
    faults = f"under {name(cell.faults)}" if cell.faults else "without faults"
    return Element(
        derived_id(
            "G", cell.requirement, cell.case, what="untested", apart=() if alone else (str(index),)
        ),
        f"{name(cell.requirement)} holds in {name(cell.scenario)} {faults}. "
        "Untested: no episode of this session says anything of it.",
        undeveloped=True,
        url=f"evidence.json#/coverage/cells/{index}",
        alias=f"untested:{name(cell.requirement)}@{name(cell.case)}",
        brief=("Untested.",),
    )


def _counter_goal(
    requirement_id: str,
    own: list[VerdictElements],
    violated: list[VerdictElements],
    searches: SearchElements,
    *,
    accepted: bool,
) -> list[Element]:
    how = f" in {len(violated)} of {counted(len(own), 'judged case')}" if own else ""
    if searches.against:
        count = searches.violations
        how += f"{' and' if own else ''} by what {counted(count, 'search', 'searches')} found"
    waived = " Waivers accept all of these violations." if accepted else ""
    return [
        Element(
            derived_id("CG", requirement_id),
            f"{name(requirement_id)} is violated{how}.{waived}",
            supported_by=(
                *(element.challenge for element in violated),
                *(element.id for element in searches.against),
            ),
            challenges=derived_id("G", requirement_id),
            alias=f"challenge:{name(requirement_id)}",
        )
    ]
