"""The elements of each requirement: goal, reason, untested cells, and what speaks against it.

No search supports anything. A counterexample defeats a requirement that asks for all episodes;
one that bounds a rate is challenged by it, since no rate follows from where a search looked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

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
_UNVIOLATED = (NOTHING_FOUND, "undecided")
"""Outcomes of searches that speak against nothing."""
ACCEPTED = " Waivers accept all of these violations."
"""What is added to a counter goal that defeats nothing."""


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


def _search_context(
    requirement: str, unviolated: list[tuple[int, int, RecordedSearch, SearchOutcome]]
) -> Element:
    headlines = [
        f"{name(search.case)}: {outcome_headline(search, outcome)}"
        for _, _, search, outcome in unviolated[:_MAX_SEARCH_ELEMENTS]
    ]
    more = len(unviolated) - len(headlines)
    rest = f"; and {more} more" if more else ""
    return Element(
        derived_id("C", requirement, what="search"),
        f"Searched without a find: {'; '.join(headlines)}{rest}. {NOTHING_SUPPORTED}",
        url="evidence.json#/searches",
        alias=f"searched:{name(requirement)}",
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
        yield _elements_of_requirement(record, requirement, index, own)


def _elements_of_requirement(
    record: SessionRecord, requirement: Requirement, index: int, own: list[VerdictElements]
) -> RequirementElements:
    id_, shown, url = requirement.id, name(requirement.id), f"evidence.json#/requirements/{index}"
    outcomes = [
        (number, place, search, outcome)
        for number, search in enumerate(record.head.searches)
        for place, outcome in enumerate(search.outcomes)
        if outcome.requirement == id_
    ]
    found = [each for each in outcomes if outcome_status(*each[2:]) not in _UNVIOLATED]
    unviolated = [each for each in outcomes if outcome_status(*each[2:]) in _UNVIOLATED]
    waived = all(search.waiver is not None for _, _, search, _ in found)
    counter_solutions = [_counter_solution(*each) for each in found[:_MAX_SEARCH_ELEMENTS]]
    around = [_search_context(id_, unviolated)] if unviolated else []
    if reason := one_line(requirement.reason, _MAX_REASON):
        alias = f"reason:{shown}"
        around.insert(0, Element(derived_id("J", id_), reason, url=f"{url}/reason", alias=alias))

    untested = list(_untested_goals(record, id_))
    goals = [*(element.goal for element in own), *(element.id for element in untested)]
    rest = f", {counted(len(untested), 'untested cell')}" if untested else ""
    strategy = Element(
        derived_id("S", id_),
        f"Argument over scenarios and faults: {counted(len(own), 'judged case')}{rest}.",
        supported_by=tuple(goals),
        alias=f"strategy:{shown}",
    )
    violated = [element for element in own if element.verdict.verdict == "violated"]
    refuted_by_verdict = any(element.refuted for element in violated)
    refuted = refuted_by_verdict or (not waived and requirement.at_most is None)
    accepted = waived and not refuted_by_verdict
    how = f" in {len(violated)} of {counted(len(own), 'judged case')}" if own else ""
    if found:
        count = counted(len(found), "search", "searches")
        how += f"{' and' if own else ''} by what {count} found"
    challenge = Element(
        derived_id("CG", id_),
        f"{shown} is violated{how}.{ACCEPTED if accepted else ''}",
        supported_by=(*(element.challenge for element in violated),
                      *(element.id for element in counter_solutions)),
        challenges=derived_id("G", id_),
        alias=f"challenge:{shown}",
    )  # fmt: skip
    challenges = [challenge] if violated or found else []
    goal = Element(
        derived_id("G", id_),
        requirement_text(requirement) + ("" if goals else " No case was judged by it."),
        supported_by=(strategy.id,) if goals else (),
        in_context_of=tuple(element.id for element in around),
        undeveloped=not goals,
        defeated=refuted,
        url=url,
        alias=f"requirement:{shown}",
        layers={
            "kind": requirement.kind,
            "source": one_line(requirement.source, MAX_TEXT),
            "report": f"report.html#{requirement_anchor(id_)}",
        },
    )
    strategies = [strategy] if goals else []
    return RequirementElements(
        shown,
        requirement.kind,
        goal.id,
        challenge.id if challenges else "",
        refuted,
        accepted,
        (goal, *around, *strategies, *challenges, *counter_solutions, *untested),
    )


def _untested_goals(record: SessionRecord, requirement: str) -> Iterator[Element]:
    """An undeveloped goal for each cell of a requirement without a verdict."""
    cells = [
        (place, cell) for place, cell in enumerate(record.head.coverage.cells)
        if cell.requirement == requirement and cell.verdict is None
    ]  # fmt: skip
    times = Counter(cell.case for _, cell in cells)
    for place, cell in cells:
        apart = () if times[cell.case] == 1 else (str(place),)
        faults = f"under {name(cell.faults)}" if cell.faults else "without faults"
        yield Element(
            derived_id("G", requirement, cell.case, what="untested", apart=apart),
            f"{name(requirement)} holds in {name(cell.scenario)} {faults}. "
            "Untested: no episode of this session says anything of it.",
            undeveloped=True,
            url=f"evidence.json#/coverage/cells/{place}",
            alias=f"untested:{name(requirement)}@{name(cell.case)}",
            brief=("Untested.",),
        )
