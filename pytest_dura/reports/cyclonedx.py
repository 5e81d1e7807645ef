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
- ``affirmation`` is left out: nobody has reviewed what is generated.
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
from urllib.parse import quote, unquote

from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.gate import NOTHING_FOUND, OBJECTIONABLE_OUTCOMES, outcome_status
from pytest_dura.evidence.model import Counts, SessionRecord, components_under_test, plain_data
from pytest_dura.evidence.text import name, one_line, visible
from pytest_dura.reports.wording import (
    NAME_LIMIT,
    UNREVIEWED,
    is_incomplete,
    rate_bound,
    sample_text,
    shard_text,
    valid_sha256,
)
from pytest_dura.requirements.campaign_verdicts import CAMPAIGN_STATUSES

_PREFIX = "pytest-dura:"
Data = Mapping[str, Any]
JsonObject = dict[str, Any]


def _requirement_ref(number: int) -> str:
    """``bom-ref`` of a requirement, by its place in the record: ids may hold anything."""
    return f"requirement/{number}"


def _property_entries(properties: Mapping[str, str]) -> list[JsonObject]:
    """Name-value pairs under our prefix."""
    return [{"name": f"{_PREFIX}{key}", "value": value} for key, value in properties.items()]


def _component_entry(component: Mapping[str, Any], ref: str) -> JsonObject:
    """A component under test, with version and digest as far as the record has them."""
    entry: JsonObject = {
        "type": "application",
        "bom-ref": ref,
        "name": name(component["name"] or "unknown", NAME_LIMIT),
    }
    if component.get("version"):
        entry["version"] = name(str(component["version"]), NAME_LIMIT)
    if digest := valid_sha256(component.get("digest")):
        entry["hashes"] = [{"alg": "SHA-256", "content": digest}]
    properties = {"path": visible(component["path"])} if component.get("path") else {}
    if component.get("opaque"):
        properties["opaque"] = "true"
    return entry | ({"properties": _property_entries(properties)} if properties else {})


MAX_LISTED = 5
"""Counterexamples that are listed with one claim; the record has all of them."""

_PREDICATES = {
    "supported": "The evidence supports, on the episodes run, that {what}",
    "violated": "The evidence refutes that {what}",
    "undecided": "The evidence does not decide whether {what}",
}
_FIGURES = (
    "verdict", "planned", "run", "episodes", "violations", "open", "without_effect", "invalid",
    "missing", "bound",
)  # fmt: skip


def declarations(record: SessionRecord) -> JsonObject:
    """Declarations of the session, as a self-assessment.

    Raises:
        ValueError: If a verdict names a requirement that the record does not list.
    """
    targets = _Targets.of(record)
    places = _counterexample_places(record)
    texts = {requirement["id"]: requirement["text"] for requirement in record["requirements"]}
    claims, evidence = [], []
    for number, verdict in enumerate(record["verdicts"]):
        if verdict["requirement"] not in texts:
            requirement = name(verdict["requirement"])
            raise ValueError(f"a verdict is on {requirement}, which is not among the requirements")
        entries = list(_evidence(number, verdict, places))
        for entry in entries:
            entry["created"] = record["finished"] or record["created"]
        evidence += entries
        claims.append(_claim(number, verdict, texts, targets.refs[verdict["component"]], entries))
    return {
        "assessors": [
            {
                "bom-ref": "assessor",
                "thirdParty": False,
                "organization": {"name": name(record["tool"]["name"], NAME_LIMIT)},
            }
        ],
        "attestations": [
            {
                "summary": f"By a test tool, {UNREVIEWED}. The gate of {_component_names(record)}: "
                f"{record['gate']['result']}.",
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
    refs: Mapping[str, str]

    @classmethod
    def of(cls, record: SessionRecord) -> _Targets:
        known: dict[str, Any] = {}
        for component in components_under_test(record):
            known.setdefault(component["name"], component)
        for verdict in record["verdicts"]:
            known.setdefault(verdict["component"], {"name": verdict["component"]})
        refs = {component: f"target/{number}" for number, component in enumerate(known)}
        return cls(
            [_component_entry(known[component], ref) for component, ref in refs.items()], refs
        )


def _counterexample_places(record: SessionRecord) -> dict[tuple[str, str], tuple[int, str | None]]:
    """Index and trace of each episode that will be listed as a counterexample."""
    listed = {
        (counterexample["episode"], verdict["component"])
        for verdict in record["verdicts"]
        for counterexample in verdict["counterexamples"][:MAX_LISTED]
    }
    places: dict[tuple[str, str], tuple[int, str | None]] = {}
    for number, episode in enumerate(record.episodes()):
        key = episode["id"], episode["component"]
        if key in listed and (episode["planned"] or key not in places):
            places[key] = number, episode["trace"] and episode["trace"]["file"]
    return places


def _claim(
    number: int,
    verdict: JsonObject,
    texts: Mapping[str, str],
    target: str,
    entries: list[JsonObject],
) -> JsonObject:
    status = verdict["verdict"]
    requirement = name(verdict["requirement"], NAME_LIMIT)
    what = f"{requirement} holds on {name(verdict['case'], NAME_LIMIT)}"
    text = one_line(texts[verdict["requirement"]])
    first, *counterexamples = (entry["bom-ref"] for entry in entries)
    claim = {
        "bom-ref": f"claim/{number}",
        "target": target,
        "predicate": _PREDICATES[status].format(what=what) + (f": {text}" if text else ""),
        "reasoning": f"{visible(verdict['reason'])} ({sample_text(verdict)};"
        f" {rate_bound(verdict)})",
        "evidence": [first],
    }
    # A counterexample is what a counter claim rests on, and speaks against any other.
    if status == "violated":
        claim["evidence"] = [first, *counterexamples]
    elif counterexamples:
        claim["counterEvidence"] = counterexamples
    return claim


def _evidence(number: int, verdict: JsonObject, places: Mapping[Any, Any]) -> Iterator[JsonObject]:
    data = [
        {
            "name": "verdict",
            "contents": _json_text({key: verdict[key] for key in _FIGURES})
            | {"url": f"{RECORD_FILE}#/verdicts/{number}"},
        }
    ]
    if verdict["waiver"] is not None:
        waiver = {key: visible(str(text)) for key, text in verdict["waiver"].items()}
        data.append({"name": "waiver", "contents": _json_text(waiver)})
    yield {
        "bom-ref": f"evidence/{number}",
        "propertyName": f"{_PREFIX}verdict:{verdict['verdict']}",
        "description": f"{sample_text(verdict)}; {rate_bound(verdict)}"
        f" ({verdict['bound']['method']})",
        "data": data,
    }
    if verdict["counterexamples"]:
        yield _counterexamples(number, verdict, places)


def _counterexamples(number: int, verdict: JsonObject, places: Mapping[Any, Any]) -> JsonObject:
    counterexamples = verdict["counterexamples"]
    data = []
    for counterexample in counterexamples[:MAX_LISTED]:
        index, trace = places.get((counterexample["episode"], verdict["component"]), (None, None))
        shown = name(counterexample["episode"], NAME_LIMIT)
        contents = _json_text({key: counterexample[key] for key in ("time", "margin", "valid")})
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
    content = json.dumps(plain_data(data))
    return {"attachment": {"contentType": "application/json", "content": content}}


def _attestation_map(record: SessionRecord) -> Iterator[JsonObject]:
    """Each requirement with its claims, also one on which there is none."""
    verdicts: dict[str, list[tuple[int, JsonObject]]] = defaultdict(list)
    for number, verdict in enumerate(record["verdicts"]):
        verdicts[verdict["requirement"]].append((number, verdict))
    untested = _declared_and_untested(record)
    for number, requirement in enumerate(record["requirements"]):
        own = verdicts[requirement["id"]]
        against = [f"claim/{place}" for place, verdict in own if verdict["verdict"] == "violated"]
        claims = [f"claim/{place}" for place, verdict in own if verdict["verdict"] != "violated"]
        yield {
            "requirement": _requirement_ref(number),
            "claims": claims,
            "counterClaims": against,
            "conformance": _conformance(
                record,
                requirement["id"],
                [verdict for _, verdict in own],
                untested[requirement["id"]],
            ),
        }


def _declared_and_untested(record: SessionRecord) -> Counter[str]:
    """Number of planned cases that declare a requirement and have no verdict on it, by its id.

    Other cells of the coverage table, a fault of one scenario in another one, nobody declared.
    """
    judged = {
        (verdict["requirement"], verdict["case"], verdict["component"])
        for verdict in record["verdicts"]
    }
    compared = {
        verdict["pairs"]["case"] for verdict in record["verdicts"] if verdict["pairs"] is not None
    }
    compared -= {case for _, case, _ in judged}
    return Counter(
        requirement
        for case in record["cases"]
        if case["planned"] and not case["without"] and case["id"] not in compared
        for requirement in case["requirements"]
        if (requirement, case["id"], case["component"]) not in judged
    )


def _search_outcomes(record: SessionRecord, requirement: str) -> Counter[str]:
    """Objections of searches to a requirement that no waiver excuses, counted by status."""
    return Counter(
        status
        for search in record["searches"]
        if search["waiver"] is None
        for outcome in search["outcomes"]
        if outcome["requirement"] == requirement
        and (status := outcome_status(search, outcome)) != NOTHING_FOUND
    )


def _conformance(
    record: SessionRecord, requirement: str, verdicts: list[JsonObject], untested: int
) -> JsonObject:
    """The score where it is decided: 1 or 0, see the package; and the reason, always."""
    counts = Counter(verdict["verdict"] for verdict in verdicts)
    refuted = any(
        verdict["verdict"] == "violated" and verdict["waiver"] is None for verdict in verdicts
    )
    searched = _search_outcomes(record, requirement)
    doubts = [
        f"{counts[status]} {status}" for status in ("violated", "undecided") if counts[status]
    ]
    doubts += [f"{count} {OBJECTIONABLE_OUTCOMES[status]}" for status, count in searched.items()]
    if waived := sum(verdict["waiver"] is not None for verdict in verdicts):
        doubts.append(f"{waived} waived")
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
        return {"score": 1, "rationale": f"{rationale}; {UNREVIEWED}."}
    rationale = f"{text}; {', '.join(doubts)}"
    if refuted or searched["falsified"]:
        return {"score": 0, "rationale": f"{rationale}. 0: it was violated; {UNREVIEWED}."}
    rationale = f"{rationale}. No score: conformance is not attested, nor refuted"
    return {"rationale": f"{rationale}; {UNREVIEWED}."}


FILE = "cyclonedx.json"
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
        "components": _packages(record["environment"]["packages"]),
        "definitions": {"standards": [_standard(record["requirements"])]},
        "declarations": declarations(record),
    }
    return json.dumps(document, indent=1) + "\n"


def _serial_number(record: SessionRecord) -> uuid.UUID:
    """Serial number from the whole record, of episodes their digests: equal for equal records."""
    state = hashlib.sha256(json.dumps(plain_data(record.head), sort_keys=True).encode())
    for episode in record.episodes():
        identity = [episode[key] for key in ("id", "component", "digest", "validity")]
        state.update(json.dumps(identity).encode())
    return uuid.uuid5(_NAMESPACE, state.hexdigest())


def _metadata(record: SessionRecord) -> JsonObject:
    tool = record["tool"]
    counts = {key: str(value) for key, value in Counts.of(record).to_json().items()}
    properties = {
        **counts,
        "status": record["status"],
        "review": UNREVIEWED,
        "command": visible(record["command"]),
        "base_seed": str(record["base_seed"]),
    }
    return {
        "timestamp": record["created"],
        "tools": {
            "components": [
                {
                    "type": "application",
                    "bom-ref": "tool",
                    "name": name(tool["name"], NAME_LIMIT),
                    "version": name(tool["version"], NAME_LIMIT),
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


def _standard(requirements: list[JsonObject]) -> JsonObject:
    return {
        "bom-ref": "standard",
        "name": "Requirements of the session",
        "description": f"The requirements that the session judged; {UNREVIEWED}.",
        "requirements": [
            _requirement(number, requirement) for number, requirement in enumerate(requirements)
        ],
    }


def _requirement(number: int, requirement: JsonObject) -> JsonObject:
    at_most = "every valid episode satisfies it"
    if requirement["at_most"] is not None:
        at_most = (
            f"at most {requirement['at_most']:g} of episodes violate it, "
            f"at {requirement['confidence']:g}"
        )
    texts = (
        ("check", requirement["check"]),
        ("criterion", at_most),
        ("reason", requirement["reason"]),
        ("source", requirement["source"]),
    )
    return {
        "bom-ref": _requirement_ref(number),
        "identifier": name(requirement["id"], NAME_LIMIT),
        "title": visible(requirement["text"] or requirement["id"], 200),
        "text": visible(requirement["text"]),
        "descriptions": [f"{label}: {visible(text)}" for label, text in texts if text],
        "properties": [{"name": f"{_PREFIX}kind", "value": visible(requirement["kind"] or "")}],
    }


_LINKS = ("assessor", "requirement", "target", "parent")
_LISTS = ("claims", "counterClaims", "evidence", "counterEvidence", "mitigationStrategies")


def read_counts(text: str) -> Counts:
    """Counts that the document states: verdicts from its claims, the rest from its properties.

    Raises:
        ValueError: If the text is no such document, or a claim is not mapped as its evidence says.
    """
    try:
        document = json.loads(text)
        stated = {entry["name"]: entry["value"] for entry in document["metadata"]["properties"]}
        counts, waived = _claimed_verdicts(document["declarations"])
        requirements = len(document["definitions"]["standards"][0]["requirements"])
        numbers = ("cases", "episodes", "valid", "invalid", "missing")
        return Counts(
            gate=stated[f"{_PREFIX}gate"],
            requirements=requirements,
            **{key: int(stated[f"{_PREFIX}{key}"]) for key in numbers},
            **{campaign_status: counts[campaign_status] for campaign_status in CAMPAIGN_STATUSES},
            waived=waived,
        )
    except (LookupError, TypeError, AttributeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise ValueError(f"not the declarations of a session ({problem})") from None


def _claimed_verdicts(declared: Data) -> tuple[Counter[str], int]:
    """The number of claims of each verdict, and how many of them are waived."""
    entries = {entry["bom-ref"]: entry for entry in declared["evidence"]}
    mapped: Counter[tuple[str, str]] = Counter()
    for attestation in declared["attestations"]:
        for mapping in attestation["map"]:
            mapped.update((ref, "claims") for ref in mapping["claims"])
            mapped.update((ref, "counterClaims") for ref in mapping["counterClaims"])
    counts: Counter[str] = Counter()
    waived = 0
    for claim in declared["claims"]:
        evidence = entries[claim["evidence"][0]]
        status = evidence["propertyName"].removeprefix(f"{_PREFIX}verdict:")
        if status not in CAMPAIGN_STATUSES:
            raise ValueError(f"{claim['bom-ref']} rests on evidence of no verdict")
        place = "counterClaims" if status == "violated" else "claims"
        if mapped.pop((claim["bom-ref"], place), 0) != 1:
            raise ValueError(f"{claim['bom-ref']} is {status}, and not once among the {place}")
        counts[status] += 1
        waived += any(data["name"] == "waiver" for data in evidence["data"])
    if mapped:
        raise ValueError(f"{min(mapped)[0]} is mapped, and is no claim, or of another verdict")
    return counts, waived


def _dangling_references(document: Data) -> list[str]:
    """References in the document to a ``bom-ref`` that is not there, and references given twice.

    The strict validator of the format looks at neither.
    """
    counts = Counter(_bom_refs(document))
    problems = [
        f"the bom-ref {ref} is given {count} times" for ref, count in counts.items() if count > 1
    ]
    return problems + [
        f"{where} refers to {ref}"
        for where, ref in _declared_references(document)
        if ref not in counts
    ]


def broken_references(text: str, record: SessionRecord) -> Iterator[str]:
    """References that lead nowhere: inside the document, into the record, to its traces."""
    document = json.loads(text)
    yield from _dangling_references(document)
    places = {f"evidence.json#/verdicts/{number}" for number in range(len(record["verdicts"]))}
    for number, episode in enumerate(record.episodes()):
        places.add(f"evidence.json#/episodes/{number}")
        if episode["trace"] is not None:
            places.add(episode["trace"]["file"])
    for entry in document["declarations"]["evidence"]:
        for data in entry["data"]:
            url = data["contents"].get("url")
            if url is not None and unquote(url, errors="surrogatepass") not in places:
                yield f"{entry['bom-ref']} refers to {url}, which is not there"


def _bom_refs(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        if "bom-ref" in value:
            yield value["bom-ref"]
        value = list(value.values())
    if isinstance(value, list):
        for element in value:
            yield from _bom_refs(element)


def _declared_references(document: Data) -> Iterator[tuple[str, str]]:
    """Every reference of the declarations, with where it stands."""
    declared = document["declarations"]
    holders = [(claim["bom-ref"], claim) for claim in declared["claims"]]
    for number, attestation in enumerate(declared["attestations"]):
        holders.append((f"attestation {number}", attestation))
        for mapping in attestation["map"]:
            where = f"the map of attestation {number}"
            holders += [(where, mapping), (where, mapping.get("conformance", {}))]
    for standard in document["definitions"]["standards"]:
        holders += [
            (requirement["bom-ref"], requirement) for requirement in standard["requirements"]
        ]
    for where, holder in holders:
        for key in _LINKS:
            if key in holder:
                yield f"{where}, {key},", holder[key]
        for key in _LISTS:
            for ref in holder.get(key, ()):
                yield f"{where}, {key},", ref
