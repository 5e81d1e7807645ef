"""``cyclonedx.json``: CycloneDX 1.6 declarations, for tools that keep a product's attestations.

The requirements are a standard of their own; each verdict is a claim on the component under test,
with evidence that points into ``evidence.json``; an attestation maps requirements to claims.

What a reader may conclude, and what not:

- A violated verdict is a counter claim. An undecided one is a claim that says no more than that.
- ``conformance.score`` is 1, 0 or absent, never a share: a share would let many cases outweigh the
  one in which a requirement is violated. It is 1 only where the session is complete, every verdict
  on the requirement is supported, none is waived, and each planned case that declares it has one.
  It is 0 where a verdict is violated, or a search falsified it, and no waiver excuses that. Where
  it is neither, there is none: conformance is not attested, and the rationale says why. Cells that
  no scenario and no test declares do not count.
- ``confidence`` is left out: it is the belief in the claim, which a tool has not. The confidence of
  an interval stands with its bound and its n in the evidence.
- ``affirmation`` is left out: what is generated was not reviewed.
- A waiver is recorded with the evidence. It excuses a verdict; it mitigates nothing.
"""

from __future__ import annotations

import hashlib
import json
import uuid
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from pytest_dura.core.codec import encode
from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.conclusions.totals import verdict_counts
from pytest_dura.evidence.entry import JsonObject, plain_data
from pytest_dura.evidence.gate import NOTHING_FOUND, OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.session_model import ComponentEntry, ComponentUnderTest
from pytest_dura.evidence.text import name, one_line, visible
from pytest_dura.reports.verdicts import rate_bound, sample_text
from pytest_dura.reports.wording import (
    NAME_LIMIT,
    is_incomplete,
    review_text,
    shard_text,
    valid_sha256,
)
from pytest_dura.requirements.model import Requirement

_PREFIX = "pytest-dura:"


def _requirement_ref(number: int) -> str:
    """``bom-ref`` of a requirement, by its place in the record: ids may hold anything."""
    return f"requirement/{number}"


def _property_entries(properties: Mapping[str, str]) -> list[JsonObject]:
    """Name-value pairs under our prefix."""
    return [{"name": f"{_PREFIX}{key}", "value": value} for key, value in properties.items()]


def _component_entry(component: ComponentUnderTest | ComponentEntry, ref: str) -> JsonObject:
    """A component under test, with version and digest as far as the record has them."""
    entry: JsonObject = {
        "type": "application",
        "bom-ref": ref,
        "name": name(component.name or "unknown", NAME_LIMIT),
    }
    if component.version:
        entry["version"] = name(str(component.version), NAME_LIMIT)
    if digest := valid_sha256(component.digest):
        entry["hashes"] = [{"alg": "SHA-256", "content": digest}]
    properties = {"path": visible(component.path)} if component.path else {}
    if component.opaque:
        properties["opaque"] = "true"
    return entry | ({"properties": _property_entries(properties)} if properties else {})


MAX_LISTED = 5
"""Counterexamples that are listed with one claim; the record has all of them."""

_PREDICATES = {
    "supported": "The evidence supports, on the episodes run, that {what}",
    "violated": "The evidence refutes that {what}",
    "undecided": "The evidence does not decide whether {what}",
}
_FIGURES = ("verdict", "planned", "run", "episodes", "violations", "open", "without_effect",
            "invalid", "missing", "bound")  # fmt: skip


def declarations(record: SessionRecord) -> JsonObject:
    """Declarations of the session, as a self-assessment.

    Raises:
        ValueError: If a verdict names a requirement that the record does not list.
    """
    targets = _Targets.of(record)
    places = _counterexample_places(record)
    texts = {requirement.id: requirement.text for requirement in record.head.requirements}
    claims, evidence = [], []
    for number, verdict in enumerate(record.head.verdicts):
        if verdict.requirement not in texts:
            requirement = name(verdict.requirement)
            raise ValueError(f"a verdict is on {requirement}, which is not among the requirements")
        entries = list(_evidence(number, verdict, places))
        for entry in entries:
            entry["created"] = record.head.finished or record.head.created
        evidence += entries
        claims.append(_claim(number, verdict, texts, targets.refs[verdict.component], entries))
    return {
        "assessors": [
            {
                "bom-ref": "assessor",
                "thirdParty": False,
                "organization": {"name": name(record.head.tool.name, NAME_LIMIT)},
            }
        ],
        "attestations": [
            {
                "summary": f"By a test tool, {review_text(record)}. "
                f"The gate of {_component_names(record)}: {record.head.gate.result}.",
                "assessor": "assessor",
                "map": list(_attestation_map(record)),
            }
        ],
        "claims": claims,
        "evidence": evidence,
        "targets": {"components": targets.described},
    }


def _component_names(record: SessionRecord) -> str:
    text = shard_text(record)
    return f"{text}, a part of a session" if text else "the session"


@dataclass(frozen=True)
class _Targets:
    """Targets of the claims: every component that the record describes or a verdict names."""

    described: list[JsonObject]
    refs: Mapping[str | None, str]

    @classmethod
    def of(cls, record: SessionRecord) -> _Targets:
        known: dict[str | None, ComponentUnderTest | ComponentEntry] = {}
        for component in components_under_test(record):
            known.setdefault(component.name, component)
        for verdict in record.head.verdicts:
            unknown = ComponentUnderTest(
                name=verdict.component, distribution=None, version=None, digest=None
            )
            known.setdefault(verdict.component, unknown)
        refs = {component: f"target/{number}" for number, component in enumerate(known)}
        return cls(
            [_component_entry(known[component], ref) for component, ref in refs.items()], refs
        )


def _counterexample_places(record: SessionRecord) -> dict[tuple[str, str], tuple[int, str | None]]:
    """Index and trace of each episode that will be listed as a counterexample."""
    listed = {
        (counterexample.episode, verdict.component)
        for verdict in record.head.verdicts
        for counterexample in verdict.counterexamples[:MAX_LISTED]
    }
    places: dict[tuple[str, str], tuple[int, str | None]] = {}
    for number, episode in enumerate(record.episodes()):
        key = episode.id, episode.component
        if key in listed and (episode.planned or key not in places):
            places[key] = number, episode.trace.file if episode.trace else None
    return places


def _claim(
    number: int,
    verdict: ItemVerdict,
    texts: Mapping[str, str],
    target: str,
    entries: list[JsonObject],
) -> JsonObject:
    status = verdict.verdict
    requirement = name(verdict.requirement, NAME_LIMIT)
    what = f"{requirement} holds on {name(verdict.case, NAME_LIMIT)}"
    text = one_line(texts[verdict.requirement])
    first, *counterexamples = (entry["bom-ref"] for entry in entries)
    claim = {
        "bom-ref": f"claim/{number}",
        "target": target,
        "predicate": _PREDICATES[status].format(what=what) + (f": {text}" if text else ""),
        "reasoning": f"{visible(verdict.reason)} ({sample_text(verdict)}; {rate_bound(verdict)})",
        "evidence": [first],
    }
    # A counterexample is what a counter claim rests on, and speaks against any other.
    if status == "violated":
        claim["evidence"] = [first, *counterexamples]
    elif counterexamples:
        claim["counterEvidence"] = counterexamples
    return claim


def _evidence(number: int, verdict: ItemVerdict, places: Mapping[Any, Any]) -> Iterator[JsonObject]:
    data = [
        {
            "name": "verdict",
            "contents": _json_text({key: encode(getattr(verdict, key)) for key in _FIGURES})
            | {"url": f"{RECORD_FILE}#/verdicts/{number}"},
        }
    ]
    if verdict.waiver is not None:
        waiver = {key: visible(str(text)) for key, text in encode(verdict.waiver).items()}
        data.append({"name": "waiver", "contents": _json_text(waiver)})
    yield {
        "bom-ref": f"evidence/{number}",
        "propertyName": f"{_PREFIX}verdict:{verdict.verdict}",
        "description": f"{sample_text(verdict)}; {rate_bound(verdict)} ({verdict.bound.method})",
        "data": data,
    }
    if verdict.counterexamples:
        yield _counterexamples(number, verdict, places)


def _counterexamples(number: int, verdict: ItemVerdict, places: Mapping[Any, Any]) -> JsonObject:
    counterexamples = verdict.counterexamples
    data = []
    for counterexample in counterexamples[:MAX_LISTED]:
        index, trace = places.get((counterexample.episode, verdict.component), (None, None))
        shown, encoded = name(counterexample.episode, NAME_LIMIT), encode(counterexample)
        contents = _json_text({key: encoded[key] for key in encoded if key != "episode"})
        if index is not None:
            contents["url"] = f"{RECORD_FILE}#/episodes/{index}"
        data.append({"name": shown, "contents": contents})
        if trace is not None:
            url = quote(trace, errors="surrogatepass")
            data.append({"name": f"trace of {shown}", "contents": {"url": url}})
    return {
        "bom-ref": f"evidence/{number}/counterexamples",
        "propertyName": f"{_PREFIX}counterexamples",
        "description": (
            f"{min(len(counterexamples), MAX_LISTED)} of {len(counterexamples)} listed,"
            " the largest violation first."
        ),
        "data": data,
    }


def _json_text(data: Mapping[str, Any]) -> JsonObject:
    content = json.dumps(data)
    return {"attachment": {"contentType": "application/json", "content": content}}


def _attestation_map(record: SessionRecord) -> Iterator[JsonObject]:
    """Each requirement with its claims, also one on which there is none."""
    verdicts: dict[str, list[tuple[int, ItemVerdict]]] = defaultdict(list)
    for number, verdict in enumerate(record.head.verdicts):
        verdicts[verdict.requirement].append((number, verdict))
    untested = _declared_and_untested(record)
    for number, requirement in enumerate(record.head.requirements):
        own = verdicts[requirement.id]
        against = [f"claim/{place}" for place, verdict in own if verdict.verdict == "violated"]
        claims = [f"claim/{place}" for place, verdict in own if verdict.verdict != "violated"]
        yield {
            "requirement": _requirement_ref(number),
            "claims": claims,
            "counterClaims": against,
            "conformance": _conformance(
                record,
                requirement.id,
                [verdict for _, verdict in own],
                untested[requirement.id],
            ),
        }


def _declared_and_untested(record: SessionRecord) -> Counter[str]:
    """Number of planned cases that declare a requirement and have no verdict on it, by its id.

    Other cells of the coverage table, a fault of one scenario in another one, were not declared.
    """
    judged = {
        (verdict.requirement, verdict.case, verdict.component) for verdict in record.head.verdicts
    }
    compared = {verdict.pairs.case for verdict in record.head.verdicts if verdict.pairs is not None}
    compared -= {case for _, case, _ in judged}
    return Counter(
        requirement
        for case in record.head.cases
        if case.planned and not case.without and case.id not in compared
        for requirement in case.requirements
        if (requirement, case.id, case.component) not in judged
    )


def _search_outcomes(record: SessionRecord, requirement: str) -> Counter[str]:
    """Objections of searches to a requirement that no waiver excuses, counted by status."""
    return Counter(
        status
        for search in record.head.searches
        if search.waiver is None
        for outcome in search.outcomes
        if outcome.requirement == requirement
        and (status := outcome_status(search, outcome)) != NOTHING_FOUND
    )


def _conformance(
    record: SessionRecord, requirement: str, verdicts: list[ItemVerdict], untested: int
) -> JsonObject:
    """The score where it is decided: 1 or 0, see the package; and the reason, always."""
    counts = verdict_counts(verdicts)
    refuted = any(verdict.verdict == "violated" and verdict.waiver is None for verdict in verdicts)
    searched = _search_outcomes(record, requirement)
    doubts = [
        f"{counts[status]} {status}" for status in ("violated", "undecided") if counts[status]
    ]
    doubts += [f"{count} {OBJECTIONABLE_OUTCOMES[status]}" for status, count in searched.items()]
    if counts["waived"]:
        doubts.append(f"{counts['waived']} waived")
    if untested:
        doubts.append(f"{untested} untested")
    if is_incomplete(record):
        doubts.append("the session is incomplete")
    if shard_text(record):
        doubts.append(f"{shard_text(record)} alone")
    if not verdicts:
        doubts.append("no verdict")
    text = f"{counts['supported']} of {len(verdicts)} verdicts supported"
    if not doubts:
        rationale = f"{text}, each on the episodes and with the bound in its evidence"
        return {"score": 1, "rationale": f"{rationale}; {review_text(record)}."}
    rationale = f"{text}; {', '.join(doubts)}"
    if refuted or searched["falsified"]:
        return {"score": 0, "rationale": f"{rationale}. 0: it was violated; {review_text(record)}."}
    rationale = f"{rationale}. No score: conformance is not attested, nor refuted"
    return {"rationale": f"{rationale}; {review_text(record)}."}


FILE = "cyclonedx.json"
EXPORT = "cyclonedx"
_SCHEMA = "http://cyclonedx.org/schema/bom-1.6.schema.json"
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "urn:pytest-dura")


def render(record: SessionRecord) -> str:
    """The document as text.

    Raises:
        ValueError: If a verdict names a requirement that the record does not list.
    """
    document = {
        "$schema": _SCHEMA,
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{_serial_number(record)}",
        "version": 1,
        "metadata": _metadata(record),
        "components": _packages(record.head.environment.packages),
        "definitions": {"standards": [_standard(record)]},
        "declarations": declarations(record),
    }
    return json.dumps(document, indent=1) + "\n"


def _serial_number(record: SessionRecord) -> uuid.UUID:
    """Serial number from the whole record, of episodes their digests: equal for equal records."""
    state = hashlib.sha256(json.dumps(plain_data(record.head), sort_keys=True).encode())
    for episode in record.episodes():
        identity = [episode.id, episode.component, episode.digest, episode.validity]
        state.update(json.dumps(identity).encode())
    return uuid.uuid5(_NAMESPACE, state.hexdigest())


def _metadata(record: SessionRecord) -> JsonObject:
    tool = record.head.tool
    counts = {key: str(value) for key, value in record.head.totals.to_json().items()}
    properties = {
        **counts,
        "status": record.head.status,
        "review": review_text(record),
        "command": visible(record.head.command),
        "base_seed": str(record.head.base_seed),
    }
    return {
        "timestamp": record.head.created,
        "tools": {
            "components": [
                {
                    "type": "application",
                    "bom-ref": "tool",
                    "name": name(tool.name, NAME_LIMIT),
                    "version": name(tool.version, NAME_LIMIT),
                }
            ]
        },
        "component": _component_entry(components_under_test(record)[0], "component-under-test"),
        "properties": _property_entries(properties),
    }


def _packages(packages: Mapping[str, str]) -> list[JsonObject]:
    components = []
    for number, package in enumerate(sorted(packages)):
        shown = name(package, NAME_LIMIT)
        version = name(packages[package] or "unknown", NAME_LIMIT)
        # The purl of PyPI has lower case, and a dash for an underscore.
        purl = (
            f"pkg:pypi/{quote(shown.lower().replace('_', '-'), safe='')}@{quote(version, safe='')}"
        )
        components.append(
            {
                "type": "library",
                "bom-ref": f"package/{number}",
                "name": shown,
                "version": version,
                "purl": purl,
            }
        )
    return components


def _standard(record: SessionRecord) -> JsonObject:
    return {
        "bom-ref": "standard",
        "name": "Requirements of the session",
        "description": f"The requirements that the session judged; {review_text(record)}.",
        "requirements": [
            _requirement(number, requirement)
            for number, requirement in enumerate(record.head.requirements)
        ],
    }


def _requirement(number: int, requirement: Requirement) -> JsonObject:
    at_most = "every valid episode satisfies it"
    if requirement.at_most is not None:
        at_most = (
            f"at most {requirement.at_most:g} of episodes violate it, at {requirement.confidence:g}"
        )
    texts = (
        ("check", requirement.check),
        ("criterion", at_most),
        ("reason", requirement.reason),
        ("source", requirement.source),
    )
    return {
        "bom-ref": _requirement_ref(number),
        "identifier": name(requirement.id, NAME_LIMIT),
        "title": visible(requirement.text or requirement.id, 200),
        "text": visible(requirement.text),
        "descriptions": [f"{label}: {visible(text)}" for label, text in texts if text],
        "properties": [
            {"name": f"{_PREFIX}kind", "value": visible(requirement.kind or "")},
            *(
                {"name": f"{_PREFIX}mitigates", "value": name(hazard, NAME_LIMIT)}
                for hazard in requirement.mitigates
            ),
        ],
    }
