"""The argument of a session, from its record alone; it claims no more than was tested.

A violated verdict defeats its goal: one episode is enough against a claim on all. It defeats the
requirement and the top goal as well, unless a waiver accepts it: then it challenges them, and
the waiver's reason stays beside the verdict. What was not decided or not tested is undeveloped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby

from pytest_dura.evidence import all_tables
from pytest_dura.evidence.hazards import HazardEvidence, hazard_evidence
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.text import counted, name, one_line
from pytest_dura.reports.gsn.element import Argument, Element, derived_id
from pytest_dura.reports.gsn.hazards import hazard_elements
from pytest_dura.reports.gsn.monitors import monitor_elements
from pytest_dura.reports.gsn.requirements import (
    ACCEPTED,
    RequirementElements,
    requirement_elements,
)
from pytest_dura.reports.gsn.verdicts import (
    EpisodeFacts,
    scenario_text,
    verdict_elements,
)
from pytest_dura.reports.provenance import commit_text, component_text
from pytest_dura.reports.verdicts import MAX_TEXT
from pytest_dura.reports.wording import (
    coverage_sentence,
    is_incomplete,
    merge_text,
    names_text,
    review_text,
    shard_text,
)
from pytest_dura.requirements.model import KINDS

REVIEW_ID, SESSION_ID = "CReview", "CSession"
_REVIEW_KEYS = ("reviewer", "reviewDate", "opinion")
"""Keys that a reviewer fills in, or that come from a signed review."""


def _argument_contexts(record: SessionRecord, facts: EpisodeFacts) -> Iterator[Element]:
    """Contexts and assumptions of the whole argument."""
    yield _review(record)
    yield _session(record)
    for subject, url, text in (
        ("Component", "component_under_test", _component(record)),
        ("Recovery", "cases", _recovery(facts)),
        ("Domain", "coverage", _domain(record)),
        ("Versions", "environment", _versions(record)),
        ("Seeds", "base_seed", _seeds(record, facts)),
    ):
        alias = f"context:{subject.lower()}"
        yield Element(f"C{subject}", text, url=f"evidence.json#/{url}", alias=alias)
    for subject, text in _ASSUMPTIONS.items():
        yield Element(f"A{subject}", text, alias=f"assumption:{subject.lower()}")


def _scenario_contexts(record: SessionRecord) -> Iterator[Element]:
    """One context for each scenario, with its variation ranges."""
    rows = sorted(record.head.coverage.parameters, key=lambda parameter: str(parameter.scenario))
    ranges = {key: list(group) for key, group in groupby(rows, lambda row: row.scenario)}
    for scenario in sorted({case.scenario for case in record.head.cases} | set(ranges)):
        yield Element(
            derived_id("C", scenario, what="scenario"),
            scenario_text(scenario, ranges.get(scenario, [])),
            url="evidence.json#/coverage/parameters",
            alias=f"scenario:{name(scenario)}",
        )


def _review(record: SessionRecord) -> Element:
    text, parts = f"{review_text(record)}.", ("",) * 3
    if record.review is None:
        text += " No element of this argument is asserted until a reviewer says so."
    else:
        review = record.review.review
        parts = (review.who, review.when, review.decision)
    return Element(
        REVIEW_ID,
        text[0].upper() + text[1:],
        alias="context:review",
        layers=dict(zip(_REVIEW_KEYS, (name(part) for part in parts), strict=True)),
    )


def _session(record: SessionRecord) -> Element:
    counts = record.head.totals
    reasons = record.head.gate.reasons
    more = f" and {len(reasons) - 1} more" if len(reasons) > 1 else ""
    why = f" ({one_line(reasons[0], MAX_TEXT)}{more})" if reasons else ""
    shard, shards = shard_text(record), merge_text(record)
    session = f"Session of {shards}," if shards else "Session"
    if shard:
        session = f"{shard.capitalize()} of a session,"
    return Element(
        SESSION_ID,
        f"{session} {name(record.head.status)}, gate {counts.gate}{why}. "
        f"{counts.episodes} episodes of {counts.cases} cases: {counts.valid} valid, "
        f"{counts.invalid} invalid, {counts.missing} missing. "
        f"Verdicts: {counts.supported} supported, {counts.violated} violated, "
        f"{counts.undecided} undecided; {counts.waived} of them waived.",
        url="evidence.json#/gate",
        alias="context:session",
        layers=counts.to_json(include={"gate", "cases", "episodes", "valid", "invalid", "missing"}),
    )


def _component(record: SessionRecord) -> str:
    declared = sorted({case.repeat.declared for case in record.head.cases if case.repeat} - {""})
    draws = f" The runs count as draws: {one_line('; '.join(declared), MAX_TEXT)}."
    under_test = component_text(record.head.component_under_test)
    return f"Component under test: {under_test}.{draws if declared else ''}"


def _recovery(facts: EpisodeFacts) -> str:
    planners = names_text(sorted(facts.recoveries)) or "none"
    return (
        f"Recovery policy: {names_text(sorted(facts.policies)) or 'unknown'}. Recovery planner: "
        f"{planners}. Recovery acted in {facts.recovered} of "
        f"{counted(facts.judged, 'judged run')}."
    )


def _domain(record: SessionRecord) -> str:
    scenarios = sorted({case.scenario for case in record.head.cases})
    faults = sorted({fault.id for case in record.head.cases for fault in case.faults})
    return (
        f"Scenarios: {names_text(scenarios) or 'none'}. Faults: {names_text(faults) or 'none'}. "
        f"{coverage_sentence(record)}"
    )


def _versions(record: SessionRecord) -> str:
    environment, tool = record.head.environment, record.head.tool
    return (
        f"{name(tool.name)} {name(tool.version)}, Python {name(environment.python)}, "
        f"{name(environment.platform)}, commit {commit_text(environment) or 'unknown'}. "
        f"Versions of {counted(len(environment.packages), 'package')} and digests of "
        f"{counted(len(record.head.inputs), 'input file')} are recorded."
    )


def _seeds(record: SessionRecord, facts: EpisodeFacts) -> str:
    count, least, greatest = facts.seeds or (0, 0, 0)
    span = f"{count} episodes with seeds from {least} to {greatest}" if count else "no episode"
    return (
        f"Base seed {record.head.base_seed}: {span}."
        f" Command: {one_line(record.head.command, MAX_TEXT)}"
    )


_ASSUMPTIONS = {
    "Sampling": "The runs of a case are independent draws from the ranges of its scenario, each "
    "with random streams of its own. The bounds hold for these distributions, not for those of "
    "the road.",
    "Faults": "The fault models stand for the faults and attacks of the field, in kind and in "
    "size. How often those occur is no part of the argument.",
    "Sensors": "The simulated sensors without faults report what real ones would, as far as the "
    "requirements depend on it. The verdicts read the ground truth.",
}
BASIS_ID = "SBasis"


def _basis_elements(
    record: SessionRecord, facts: EpisodeFacts, hazards: list[HazardEvidence]
) -> Iterator[Element]:
    """The strategy over what the verdicts rest on, whose goals no session can develop."""
    goals = [*_open_goals(record, facts, hazards)]
    yield Element(
        BASIS_ID,
        "Argument over what the verdicts rest on and this session does not show.",
        supported_by=tuple(goal.id for goal in goals),
        alias="strategy:basis",
    )
    yield from goals


def _open_goals(
    record: SessionRecord, facts: EpisodeFacts, hazards: list[HazardEvidence]
) -> Iterator[Element]:
    tool, git = record.head.tool, record.head.environment.git
    simulators = names_text(sorted(facts.simulators)) or "unknown"
    texts = {
        "Simulator": f"The simulator ({simulators}) represents the system and its surroundings "
        "well enough for these requirements. Not shown: no run was one of the real system.",
        "Tool": f"{name(tool.name)} {name(tool.version)} and the simulator are qualified as "
        "software tools for this use. Not shown: classification and qualification (ISO 26262-8) "
        "are up to their user.",
    }
    if hazards:
        unnamed = [evidence.hazard.id for evidence in hazards if not evidence.requirements]
        more = f", and no requirement of the session names {names_text(unnamed)}" if unnamed else ""
        texts["Hazards"] = (
            "The hazards of this argument are all that have to be considered, and the "
            "requirements that name a hazard suffice to mitigate it. Not shown: no run shows "
            f"either{more}."
        )
    if git.commit is None or git.dirty:
        why = "no commit is recorded" if git.commit is None else "it had uncommitted changes"
        texts["Commit"] = (
            f"The code that was run can be obtained again by its commit. Not shown: {why}."
        )
    unidentified = [
        str(component.name)
        for component in components_under_test(record)
        if component.digest is None or component.opaque
    ]
    if unidentified:
        texts["Component"] = (
            f"The component under test is identified by its content. Not shown: "
            f"{names_text(unidentified)} has no digest of all that it consists of."
        )
    for subject, text in texts.items():
        yield Element(f"G{subject}", text, undeveloped=True, alias=f"not-shown:{subject.lower()}")


def table_elements(record: SessionRecord) -> Iterator[list[Element]]:
    """Yield the elements of each table that claims something, its goal first."""
    for table in all_tables():
        claims = table.claims(record.head) if table.name in record.head.conclusions else ()
        if not claims:
            continue
        top, *below = claims
        source = derived_id("Sn", table.name, what="table")
        url = f"evidence.json#/conclusions/{table.name}"
        goals = [
            Element(
                derived_id("G", table.name, claim.about, what="table"),
                one_line(claim.text, MAX_TEXT),
                supported_by=(source,) if claim.shown else (),
                undeveloped=not claim.shown,
                url=url,
                alias=f"table:{table.name}:{claim.about}",
            )
            for claim in below
        ]
        solution = Element(source, f"Table in evidence.json: {table.title}.", url=url)
        has_support = any(claim.shown for claim in below)
        yield [
            Element(
                derived_id("G", table.name, what="table"),
                one_line(top.text, MAX_TEXT),
                supported_by=tuple(goal.id for goal in goals),
                url=url,
                alias=f"table:{table.name}",
            ),
            *goals,
            *([solution] if has_support else []),
        ]


TOP_ID, KINDS_ID, INCOMPLETE_ID = "GTop", "SKinds", "GIncomplete"


def generated_argument(record: SessionRecord) -> Argument:
    """The argument of a record, root first.

    It argues over hazards where the record has any, and else over kinds of requirements.

    Raises:
        ValueError: If a verdict is on a requirement that the record does not list.
    """
    listed = {requirement.id for requirement in record.head.requirements}
    for verdict in record.head.verdicts:
        if verdict.requirement not in listed:
            raise ValueError(f"a verdict is on {name(verdict.requirement)}, which is not listed")
    facts = EpisodeFacts.of(record)
    components = sorted({verdict.component for verdict in record.head.verdicts})
    several = len(components) > 1
    verdicts = list(verdict_elements(record, facts, several=several))
    requirements = list(requirement_elements(record, verdicts))
    around = list(_argument_contexts(record, facts))
    domain = list(_scenario_contexts(record))
    contexts = tuple(element.id for element in domain)
    hazards = hazard_evidence(record)
    named = {place: evidence for place, evidence in enumerate(hazards) if evidence.requirements}
    what = _requirements_text(requirements)
    leg = [
        *(
            hazard_elements(named, requirements, what, contexts)
            if named
            else _kinds_strategy(requirements, what, contexts)
        )
    ]
    monitors = list(monitor_elements(record.head.monitors))
    tables = list(table_elements(record))
    basis = list(_basis_elements(record, facts, hazards))
    below = [
        *leg,
        *(element for requirement in requirements for element in requirement.elements),
        *(element for judged in verdicts for element in judged.elements),
        *monitors,
        *(element for of_table in tables for element in of_table),
        *basis,
        *domain,
        *around,
    ]
    names = components or [str(record.head.component_under_test.name)]
    beside = [*monitors[:1], *(of_table[0] for of_table in tables)]
    support = (leg[0].id, *(element.id for element in beside), basis[0].id)
    surrounding = tuple(element.id for element in around)
    top = _top_goal(names, sorted(facts.policies), what, shard_text(record))
    if is_incomplete(record):
        head = _incomplete_argument(record, top, support, surrounding)
    else:
        searched = bool(record.head.searches)
        head = [*_contested_top(top, requirements, support, surrounding, searched=searched)]
    return {element.id: element for element in [*head, *below]}


def _requirements_text(requirements: list[RequirementElements]) -> str:
    """The requirements by their kinds: ``safety, security and recovery requirements``."""
    kinds = [name(kind) for kind in _by_kind(requirements)]
    if not kinds:
        return "requirements"
    return f"{' and '.join(filter(None, (', '.join(kinds[:-1]), kinds[-1])))} requirements"


def _by_kind(requirements: list[RequirementElements]) -> dict[str, list[RequirementElements]]:
    """Requirements by those kinds that are among them, in the order of kinds."""
    groups: dict[str, list[RequirementElements]] = {kind: [] for kind in KINDS}
    for requirement in requirements:
        groups.setdefault(requirement.kind, []).append(requirement)
    return {kind: group for kind, group in groups.items() if group}


def _top_goal(names: list[str], policies: list[str], what: str, shard: str) -> Element:
    policy = f"recovery policy {names_text(policies)}" if policies else "its recovery policy"
    return Element(
        TOP_ID,
        f"In the scenarios and under the faults that were tested{f' in {shard} alone' if shard else ''}, "  # noqa: E501
        f"{names_text(names)} with {policy} meets its {what}.",
        alias="top",
    )


def _contested_top(
    top: Element,
    requirements: list[RequirementElements],
    support: tuple[str, ...],
    surrounding: tuple[str, ...],
    *,
    searched: bool,
) -> Iterator[Element]:
    """The top goal, and the counter goal against it if a requirement is challenged."""
    against = [requirement for requirement in requirements if requirement.challenge]
    refuted, accepted = (
        any(element.refuted for element in against),
        all(element.accepted for element in against),
    )
    yield replace(top, supported_by=support, in_context_of=surrounding, defeated=refuted)
    if against:
        names = names_text([element.name for element in against])
        verb = "is" if len(against) == 1 else "are"
        found = " or by what a search found" if searched else ""
        yield Element(
            "CGTop",
            f"{len(against)} of {counted(len(requirements), 'requirement')} {verb} violated in a "
            f"tested case{found}: {names}."
            f"{ACCEPTED if accepted else ''}",
            supported_by=tuple(element.challenge for element in against),
            challenges=TOP_ID,
            url="evidence.json#/gate/reasons",
        )


def _incomplete_argument(
    record: SessionRecord, top: Element, support: tuple[str, ...], surrounding: tuple[str, ...]
) -> list[Element]:
    """A root that claims nothing of the component; the top goal is undeveloped and says so."""
    reasons = [one_line(reason, MAX_TEXT) for reason in record.head.gate.reasons]
    root = Element(
        INCOMPLETE_ID,
        "INCOMPLETE SESSION. The record holds what was run before the session ended"
        f"{' (' + '; '.join(reasons[:3]) + ')' if reasons else ''}. The claim on the component "
        "as a whole rests on none of it.",
        supported_by=(TOP_ID, *support),
        in_context_of=surrounding,
        url="evidence.json#/gate",
        alias="incomplete",
    )
    text = f"{top.text} UNDEVELOPED: the session is incomplete, so nothing supports this claim."
    return [root, replace(top, text=text, undeveloped=True)]


def _kinds_strategy(
    requirements: list[RequirementElements], what: str, contexts: tuple[str, ...]
) -> Iterator[Element]:
    goals = [
        Element(
            f"G{kind.capitalize()}" if kind in KINDS else derived_id("G", kind, what="kind"),
            f"Each {name(kind)} requirement is met in each tested case.",
            supported_by=tuple(requirement.goal for requirement in group),
            alias=f"kind:{kind}",
        )
        for kind, group in _by_kind(requirements).items()
    ]
    yield Element(
        KINDS_ID,
        f"Argument over the {what}, kind by kind.",
        supported_by=tuple(goal.id for goal in goals),
        in_context_of=contexts,
        undeveloped=not goals,
        alias="strategy:kinds",
    )
    yield from goals
