"""The argument over hazards: each is mitigated as far as requirements on it were tested.

No more is claimed than the requirements that name a hazard show. That the list of hazards is
complete, and that these requirements suffice, are assumptions, which no run can show.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from pytest_dura.evidence.hazards import HazardEvidence
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.gsn.element import Element, derived_id
from pytest_dura.reports.gsn.requirements import RequirementElements
from pytest_dura.reports.hazards import condition_lines, status_sentence
from pytest_dura.reports.verdicts import MAX_TEXT

HAZARDS_ID = "SHazards"
_ASSUMPTION_ID, _OTHERS_ID = "AHazards", "GWithoutHazard"


def hazard_elements(
    hazards: list[HazardEvidence],
    requirements: list[RequirementElements],
    surrounding: Iterable[Element],
) -> Iterator[Element]:
    """Yield the strategy over hazards, and the goals between it and those of requirements.

    Args:
        hazards: What the session has on each; nothing is yielded without any.
        requirements: All of the record.
        surrounding: Contexts of the strategy.
    """
    if not hazards:
        return
    by_name = {requirement.name: requirement for requirement in requirements}
    groups = [
        [by_name[name(requirement.id)] for requirement in evidence.requirements]
        for evidence in hazards
    ]
    named = {requirement.name for group in groups for requirement in group}
    others = [requirement for requirement in requirements if requirement.name not in named]
    goals = [_goal_id(evidence) for evidence in hazards]
    yield Element(
        HAZARDS_ID,
        f"Argue over {counted(len(hazards), 'hazard')}, each requirement that mitigates it, and "
        "each scenario and fault.",
        supported_by=(*goals, *([_OTHERS_ID] if others else ())),
        in_context_of=(_ASSUMPTION_ID, *(element.id for element in surrounding)),
        url="evidence.json#/hazards",
        alias="strategy:hazards",
    )
    yield Element(
        _ASSUMPTION_ID,
        "The hazards are all that have to be considered, and the requirements that name a hazard "
        "suffice to mitigate it. Nothing in this session shows either.",
        alias="hazards:assumption",
    )
    for index, (evidence, group) in enumerate(zip(hazards, groups, strict=True)):
        yield from _elements_of_hazard(index, evidence, group)
    if others:
        yield Element(
            _OTHERS_ID,
            "Each requirement that names no hazard is met in each tested cell.",
            supported_by=tuple(requirement.goal for requirement in others),
            alias="without-hazard",
        )


def _goal_id(evidence: HazardEvidence) -> str:
    return derived_id("G", "hazard", evidence.hazard.id)


def _elements_of_hazard(
    index: int, evidence: HazardEvidence, requirements: list[RequirementElements]
) -> Iterator[Element]:
    hazard = evidence.hazard
    hazard_id, url = name(hazard.id), f"evidence.json#/hazards/{index}"
    context = derived_id("C", "hazard", hazard.id)
    against = [requirement for requirement in requirements if requirement.challenge]
    text = f"{hazard_id} is mitigated to the extent tested: {one_line(hazard.text, MAX_TEXT)}"
    yield Element(
        _goal_id(evidence),
        f"{text} {status_sentence(evidence)}",
        supported_by=tuple(requirement.goal for requirement in requirements),
        in_context_of=(context,),
        undeveloped=not requirements,
        defeated=any(requirement.refuted for requirement in against),
        url=url,
        alias=f"hazard:{hazard_id}",
        layers=_layers(evidence),
    )
    yield Element(
        context,
        " ".join(f"{label}: {_sentence(text)}" for label, text in condition_lines(hazard)),
        url=url,
        alias=f"hazard-context:{hazard_id}",
    )
    if against:
        accepted = all(requirement.accepted for requirement in against)
        waived = " Waivers accept all of these violations." if accepted else ""
        ids = ", ".join(requirement.name for requirement in against)
        verb = "is" if len(against) == 1 else "are"
        yield Element(
            derived_id("CG", "hazard", hazard.id),
            f"Of what is to mitigate {hazard_id}, {ids} {verb} violated.{waived}",
            supported_by=tuple(requirement.challenge for requirement in against),
            challenges=_goal_id(evidence),
            alias=f"challenge:hazard:{hazard_id}",
        )


def _layers(evidence: HazardEvidence) -> Mapping[str, str]:
    severity = evidence.hazard.severity
    return {"hazard": evidence.status, **({"severity": severity} if severity else {})}


def _sentence(text: str) -> str:
    line = one_line(text, MAX_TEXT)
    return line if line.endswith((".", "…")) else f"{line}."
