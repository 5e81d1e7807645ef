"""The argument of a session, from its record alone; it claims no more than was tested.

A violated verdict defeats its goal: one episode is enough against a claim on all. It defeats the
requirement and the top goal as well, unless a waiver accepts it: then it challenges them, and
the waiver's reason stays beside the verdict. What was not decided or not tested is undeveloped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby

from pytest_dura.evidence.hazards import hazard_evidence
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.gsn.element import Argument, Element, derived_id
from pytest_dura.reports.gsn.hazards import hazard_elements
from pytest_dura.reports.gsn.requirements import RequirementElements, requirement_elements
from pytest_dura.reports.gsn.verdicts import (
    EpisodeFacts,
    monitor_text,
    scenario_text,
    verdict_elements,
)
from pytest_dura.reports.verdicts import MAX_TEXT
from pytest_dura.reports.wording import (
    is_incomplete,
    merge_text,
    names_text,
    review_text,
    shard_text,
)
from pytest_dura.requirements.monitoring.quality import MonitorQuality

REVIEW_ID, SESSION_ID = "CReview", "CSession"
_REVIEW_KEYS = ("reviewer", "reviewDate", "opinion")
"""Keys that a reviewer fills in, or that come from a signed review."""


def _argument_contexts(record: SessionRecord, facts: EpisodeFacts) -> list[Element]:
    """Contexts and assumptions of the whole argument."""
    return [
        _review(record),
        _session(record),
        _component(record, facts),
        _domain(record),
        _versions(record),
        _seeds(record, facts),
        *_assumptions(facts),
    ]


def _scenario_contexts(record: SessionRecord) -> Iterator[Element]:
    """One context for each scenario, with its variation ranges."""
    rows = sorted(record.head.coverage.parameters, key=lambda parameter: str(parameter.scenario))
    ranges = {key: list(group) for key, group in groupby(rows, lambda row: row.scenario)}
    for scenario in sorted({case.scenario for case in record.head.cases} | set(ranges)):
        yield Element(
            derived_id("C", "scenario", scenario),
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
    reasons = [one_line(reason, MAX_TEXT) for reason in record.head.gate.reasons]
    more = f" and {len(reasons) - 3} more" if len(reasons) > 3 else ""
    why = f" ({'; '.join(reasons[:3])}{more})" if reasons else ""
    return Element(
        SESSION_ID,
        f"{_case_names(record)} {name(record.head.status)}, gate {counts.gate}{why}. "
        f"{counts.episodes} episodes of {counts.cases} cases: {counts.valid} valid, "
        f"{counts.invalid} invalid, {counts.missing} missing. "
        f"Verdicts: {counts.supported} supported, {counts.violated} violated, "
        f"{counts.undecided} undecided; {counts.waived} of them waived.",
        url="evidence.json#/gate",
        alias="context:session",
        layers=counts.to_json(include={"gate", "cases", "episodes", "valid", "invalid", "missing"}),
    )


def _case_names(record: SessionRecord) -> str:
    shards = merge_text(record)
    whole = f"Session of {shards}," if shards else "Session"
    return f"{shard_text(record).capitalize()} of a session," if shard_text(record) else whole


def _component(record: SessionRecord, facts: EpisodeFacts) -> Element:
    under_test = record.head.component_under_test
    version, digest = under_test.version, under_test.digest
    parts = [
        f"Component under test: {name(str(under_test.name))}",
        f"from {name('unknown' if under_test.path is None else under_test.path)}",
        f"version {name(str(version))}" if version is not None else "no version",
        f"digest {name(str(digest))}" if digest is not None else "no digest",
    ]
    if under_test.opaque:
        parts.append("an instance whose state the record does not hold")
    policies = names_text(sorted(facts.policies)) or "unknown"
    declared = sorted({case.repeat.declared for case in record.head.cases if case.repeat} - {""})
    draws = f" The runs count as draws: {one_line('; '.join(declared), MAX_TEXT)}."
    return Element(
        "CComponent",
        f"{', '.join(parts)}. Recovery policy: {policies}.{draws if declared else ''}",
        url="evidence.json#/component_under_test",
        alias="context:component",
    )


def _domain(record: SessionRecord) -> Element:
    cells, left_out = record.head.coverage.cells, record.head.coverage.left_out
    untested = left_out + sum(cell.verdict is None for cell in cells)
    scenarios = sorted({case.scenario for case in record.head.cases})
    faults = sorted({fault.id for case in record.head.cases for fault in case.faults})
    return Element(
        "CDomain",
        f"Operational domain as tested: {len(cells) + left_out} cells of requirement, scenario and "
        f"faults, {untested} of them untested. Scenarios: {names_text(scenarios) or 'none'}. "
        f"Faults: {names_text(faults) or 'none'}.",
        url="evidence.json#/coverage",
        alias="context:domain",
    )


def _versions(record: SessionRecord) -> Element:
    environment, tool = record.head.environment, record.head.tool
    git = environment.git
    dirty = " with changes that are not committed" if git.dirty else ""
    packages = [f"{key} {value}" for key, value in sorted(environment.packages.items())]
    return Element(
        "CVersions",
        f"{name(tool.name)} {name(tool.version)}, Python {name(environment.python)}, "
        f"{name(environment.platform)}, commit {name(git.commit or 'unknown')}"
        f"{dirty}. Packages: {names_text(packages, 12) or 'unknown'}. "
        f"{len(record.head.inputs)} input files with their digests.",
        url="evidence.json#/environment",
        alias="context:versions",
    )


def _seeds(record: SessionRecord, facts: EpisodeFacts) -> Element:
    count, least, greatest = facts.seeds or (0, 0, 0)
    span = f"{count} episodes with seeds from {least} to {greatest}" if count else "no episode"
    return Element(
        "CSeeds",
        f"Base seed {record.head.base_seed}: {span}."
        f" Command: {one_line(record.head.command, MAX_TEXT)}",
        url="evidence.json#/base_seed",
        alias="context:seeds",
    )


def _assumptions(facts: EpisodeFacts) -> Iterator[Element]:
    simulators = names_text(sorted(facts.simulators)) or "unknown"
    for subject, text in {
        "Simulator": f"The simulator ({simulators}) is faithful enough for these requirements. "
        "Nothing in this session shows it.",
        "Sampling": "The episodes of a case are independent, identically distributed draws: each "
        "seed gives its own streams, and parameters are drawn from the variation ranges. The "
        "bounds hold for these distributions, not for those of the road.",
        "Faults": "The fault models stand for the faults and attacks of the field, in kind and in "
        "size. How often those occur is no part of the argument.",
        "Sensors": "The simulated sensors without faults report what real ones would, as far as "
        "the requirements depend on it. The verdicts read the ground truth.",
    }.items():
        yield Element(f"A{subject}", text, alias=f"assumption:{subject.lower()}")


_MONITORS_ID = "GMonitors"


def _monitor_elements(rows: Sequence[MonitorQuality]) -> Iterator[Element]:
    """A goal that the quality is known, and for each monitor and target what was measured.

    The goal is on what is known and not on how good it is: low figures are evidence as well.
    """
    if not rows:
        return
    groups: dict[tuple[str, str, str], list[MonitorQuality]] = {}
    for row in rows:
        groups.setdefault((row.component, row.monitor, row.target), []).append(row)
    measured = [_quality(key, own) for key, own in groups.items()]
    yield Element(
        _MONITORS_ID,
        "The quality of the runtime monitors is known from violations that they could have "
        "missed, where recovery did not act. The verdicts do not rest on the monitors.",
        supported_by=tuple(element.id for element in measured),
        url="evidence.json#/monitors",
        alias="monitors",
    )
    yield from measured


def _quality(key: tuple[str, str, str], rows: list[MonitorQuality]) -> Element:
    _, monitor, target = key
    known = any(row.true_positives or row.false_negatives for row in rows)
    text = monitor_text(monitor, target, rows)
    return Element(
        derived_id("Sn" if known else "G", "monitor", monitor, target, apart=key[:1]),
        text if known else f"The quality of {text}",
        undeveloped=not known,
        url="evidence.json#/monitors",
        alias=f"monitor:{name(monitor)}:{name(target)}",
        brief=(name(monitor), name(target)),
    )


TOP_ID, KINDS_ID, INCOMPLETE_ID = "GTop", "SKinds", "GIncomplete"
_KIND_IDS = {
    "safety": "GSafety",
    "security": "GSecurity",
    "performance": "GPerformance",
    "recovery": "GRecovery",
}


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
    around = _argument_contexts(record, facts)
    domain = list(_scenario_contexts(record))
    hazards = hazard_evidence(record)
    leg = [
        *(
            hazard_elements(hazards, requirements, domain)
            if hazards
            else _kinds_strategy(requirements, domain)
        )
    ]
    below = [
        *leg,
        *(element for requirement in requirements for element in requirement.elements),
        *(element for judged in verdicts for element in judged.elements),
        *_monitor_elements(record.head.monitors),
        *domain,
        *around,
    ]
    names = components or [str(record.head.component_under_test.name)]
    support = (leg[0].id, *([_MONITORS_ID] if record.head.monitors else ()))
    surrounding = tuple(element.id for element in around)
    top = _top_goal(names, sorted(facts.policies), requirements, shard_text(record))
    if is_incomplete(record):
        head = _incomplete_argument(record, top, support, surrounding)
    else:
        searched = bool(record.head.searches)
        head = [*_contested_top(top, requirements, support, surrounding, searched=searched)]
    return {element.id: element for element in [*head, *below]}


def _top_goal(
    names: list[str], policies: list[str], requirements: list[RequirementElements], shard: str
) -> Element:
    kinds = [
        kind for kind in _KIND_IDS if any(requirement.kind == kind for requirement in requirements)
    ]
    policy = f"recovery policy {names_text(policies)}" if policies else "its recovery policy"
    return Element(
        TOP_ID,
        f"Within the tested cells of the operational domain{f' in {shard} alone' if shard else ''} "
        f"{names_text(names)} with {policy} "
        f"meets its {names_text(kinds) or 'dependability'} requirements.",
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
        yield Element(
            "CGTop",
            f"{len(against)} of {len(requirements)} requirements are violated in a tested cell"
            f"{' or by what a search found' if searched else ''}: {names}."
            f"{' Waivers accept all of these violations.' if accepted else ''}",
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
    requirements: list[RequirementElements], domain: list[Element]
) -> Iterator[Element]:
    present = {
        kind: [requirement for requirement in requirements if requirement.kind == kind]
        for kind in [
            *_KIND_IDS,
            *sorted({requirement.kind for requirement in requirements} - set(_KIND_IDS)),
        ]
    }
    absent = [kind for kind, group in present.items() if not group]
    goals = [_kind_goal(kind, group) for kind, group in present.items() if group]
    nothing = f" No requirement of the session is on {names_text(absent)}." if absent else ""
    yield Element(
        KINDS_ID,
        "Argue over each kind of requirement, each requirement, and each scenario and fault."
        f"{nothing}",
        supported_by=tuple(goal.id for goal in goals),
        in_context_of=tuple(element.id for element in domain),
        undeveloped=not goals,
        alias="strategy:kinds",
    )
    yield from goals


def _kind_goal(kind: str, elements: Iterable[RequirementElements]) -> Element:
    return Element(
        _KIND_IDS.get(kind) or derived_id("G", "kind", kind),
        f"Each {kind} requirement is met in each tested cell.",
        supported_by=tuple(element.goal for element in elements),
        alias=f"kind:{kind}",
    )
