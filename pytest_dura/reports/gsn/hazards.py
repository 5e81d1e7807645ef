"""The argument over hazards: each is mitigated as far as requirements on it were tested.

No more is claimed than the requirements that name a hazard show. That the list of hazards is
complete, and that these requirements suffice, is not shown by any run.
"""

from __future__ import annotations

from collections.abc import Iterator

from pytest_dura.evidence.hazards import HazardEvidence
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.gsn.requirements import ACCEPTED, RequirementElements
from pytest_dura.reports.hazards import (
    bound_sentence,
    condition_lines,
    criterion_met,
    criterion_text,
    short_bound,
    status_sentence,
)
from pytest_dura.reports.verdicts import MAX_TEXT, as_sentence

HAZARDS_ID = "SHazards"
_OTHERS_ID = "GWithoutHazard"


def hazard_elements(
    places: dict[int, HazardEvidence],
    requirements: list[RequirementElements],
    what: str,
    contexts: tuple[str, ...],
) -> Iterator[Element]:
    """Yield the strategy over hazards, and the goals between it and those of requirements.

    Args:
        places: What the session has on each that a requirement names, by its place in the record.
        requirements: All of the record.
        what: These in words, as the top goal has them.
        contexts: Ids of the contexts of the strategy.
    """
    hazards = list(places.values())
    by_name = {requirement.name: requirement for requirement in requirements}
    groups = [
        [by_name[name(requirement.id)] for requirement in evidence.requirements]
        for evidence in hazards
    ]
    named = {requirement.name for group in groups for requirement in group}
    others = [requirement for requirement in requirements if requirement.name not in named]
    count = "1 hazard" if len(hazards) == 1 else f"{len(hazards)} hazards"
    rest = ", and over those that mitigate none" if others else ""
    yield Element(
        HAZARDS_ID,
        f"Argument over the {what}, by the {count} that they mitigate{rest}.",
        supported_by=(*map(_goal_id, hazards), *([_OTHERS_ID] if others else ())),
        in_context_of=contexts,
        url="evidence.json#/hazards",
        alias="strategy:hazards",
    )
    for (place, evidence), group in zip(places.items(), groups, strict=True):
        yield from _elements_of_hazard(f"evidence.json#/hazards/{place}", evidence, group)
    if others:
        yield Element(
            _OTHERS_ID,
            "Each requirement that names no hazard is met in each tested case.",
            supported_by=tuple(requirement.goal for requirement in others),
            alias="without-hazard",
        )


def _goal_id(evidence: HazardEvidence) -> str:
    return derived_id("G", evidence.hazard.id, what="hazard")


def _elements_of_hazard(
    url: str, evidence: HazardEvidence, requirements: list[RequirementElements]
) -> Iterator[Element]:
    hazard = evidence.hazard
    hazard_id = name(hazard.id)
    context = derived_id("C", hazard.id, what="hazard")
    against = [requirement for requirement in requirements if requirement.challenge]
    criterion = list(_criterion(url, evidence))
    yield Element(
        _goal_id(evidence),
        f"{hazard_id} is mitigated to the extent tested: {as_sentence(hazard.text)} "
        f"{bound_sentence(evidence)} {status_sentence(evidence)}",
        supported_by=(
            *(requirement.goal for requirement in requirements),
            *(element.id for element in criterion[:1]),
        ),
        in_context_of=(context,),
        defeated=any(requirement.refuted for requirement in against),
        url=url,
        alias=f"hazard:{hazard_id}",
        layers={
            "hazard": evidence.status,
            "bound": short_bound(evidence),
            **({"severity": hazard.severity} if hazard.severity else {}),
        },
        brief=(
            f"{hazard_id} is mitigated to the extent tested: {as_sentence(hazard.text)}",
            f"Weakest bound {short_bound(evidence)}. {status_sentence(evidence)}",
        ),
    )
    yield Element(
        context,
        " ".join(
            f"{label}: {as_sentence(one_line(text, MAX_TEXT))}"
            for label, text in condition_lines(hazard)
        ),
        url=url,
        alias=f"hazard-context:{hazard_id}",
    )
    if against:
        waived = ACCEPTED if all(requirement.accepted for requirement in against) else ""
        ids = ", ".join(requirement.name for requirement in against)
        verb = "is" if len(against) == 1 else "are"
        yield Element(
            derived_id("CG", hazard.id, what="hazard"),
            f"Of what is to mitigate {hazard_id}, {ids} {verb} violated.{waived}",
            supported_by=tuple(requirement.challenge for requirement in against),
            challenges=_goal_id(evidence),
            alias=f"challenge:hazard:{hazard_id}",
        )
    yield from criterion


def _criterion(url: str, evidence: HazardEvidence) -> Iterator[Element]:
    """The goal that the bounds show what the hazard's author accepts, where that is declared."""
    hazard = evidence.hazard
    criterion = one_line(criterion_text(hazard), MAX_TEXT)
    if not criterion:
        return
    met = criterion_met(evidence)
    solution = derived_id("Sn", hazard.id, what="accepted")
    text = f"The acceptance criterion of {name(hazard.id)} is met: {as_sentence(criterion)}"
    if hazard.at_most is None:
        text += " Not shown: it has no rate that a bound could be held against."
    elif not met:
        text += f" Not shown: {bound_sentence(evidence)} {status_sentence(evidence)}"
    yield Element(
        derived_id("G", hazard.id, what="accepted"),
        text,
        supported_by=(solution,) if met else (),
        undeveloped=not met,
        url=url,
        alias=f"accepted:{name(hazard.id)}",
    )
    if met:
        yield Element(
            solution,
            f"Verdicts on {name(hazard.id)} in evidence.json: {bound_sentence(evidence)}",
            url="evidence.json#/verdicts",
            brief=("verdicts", *short_bound(evidence).split(" (")[:1]),
        )
