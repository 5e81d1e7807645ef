"""Reading ``cyclonedx.json`` back: its counts, and whether its references lead anywhere."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import unquote

from pytest_dura.evidence.record.counts import Counts
from pytest_dura.evidence.record.session_record import SessionRecord
from pytest_dura.requirements.verdicts.campaigns import CAMPAIGN_STATUSES

Data = Mapping[str, Any]
_PREFIX = "pytest-dura:"
_LINKS = ("assessor", "requirement", "target", "parent")
_LISTS = ("claims", "counterClaims", "evidence", "counterEvidence", "mitigationStrategies")


def read_counts(text: str) -> Counts:
    """What the document states: verdicts counted among its claims, the rest from its properties.

    Raises:
        ValueError: If the text is no such document, or a claim is not mapped as its evidence says.
    """
    try:
        document = json.loads(text)
        stated = {one["name"]: one["value"] for one in document["metadata"]["properties"]}
        words, waived = _verdicts(document["declarations"])
        requirements = len(document["definitions"]["standards"][0]["requirements"])
        numbers = ("cases", "episodes", "valid", "invalid", "missing")
        return Counts(
            gate=stated[f"{_PREFIX}gate"],
            requirements=requirements,
            **{key: int(stated[f"{_PREFIX}{key}"]) for key in numbers},
            **{word: words[word] for word in CAMPAIGN_STATUSES},
            waived=waived,
        )
    except (LookupError, TypeError, AttributeError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise ValueError(f"not the declarations of a session ({problem})") from None


def _verdicts(declared: Data) -> tuple[Counter[str], int]:
    """Claims by the word of their verdict, and how many of them are waived."""
    entries = {one["bom-ref"]: one for one in declared["evidence"]}
    mapped: Counter[tuple[str, str]] = Counter()
    for attestation in declared["attestations"]:
        for one in attestation["map"]:
            mapped.update((ref, "claims") for ref in one["claims"])
            mapped.update((ref, "counterClaims") for ref in one["counterClaims"])
    words: Counter[str] = Counter()
    waived = 0
    for claim in declared["claims"]:
        evidence = entries[claim["evidence"][0]]
        word = evidence["propertyName"].removeprefix(f"{_PREFIX}verdict:")
        if word not in CAMPAIGN_STATUSES:
            raise ValueError(f"{claim['bom-ref']} rests on evidence of no verdict")
        place = "counterClaims" if word == "violated" else "claims"
        if mapped.pop((claim["bom-ref"], place), 0) != 1:
            raise ValueError(f"{claim['bom-ref']} is {word}, and not once among the {place}")
        words[word] += 1
        waived += any(one["name"] == "waiver" for one in evidence["data"])
    if mapped:
        raise ValueError(f"{min(mapped)[0]} is mapped, and is no claim, or of another verdict")
    return words, waived


def dangling(document: Data) -> list[str]:
    """References in the document to a ``bom-ref`` that is not there, and references given twice.

    The strict validator of the format looks at neither.
    """
    given = Counter(_refs(document))
    told = [
        f"the bom-ref {ref} is given {count} times" for ref, count in given.items() if count > 1
    ]
    return told + [
        f"{where} refers to {ref}" for where, ref in _links(document) if ref not in given
    ]


def broken_references(text: str, record: SessionRecord) -> Iterator[str]:
    """References that lead nowhere: inside the document, into the record, to its traces."""
    document = json.loads(text)
    yield from dangling(document)
    there = {f"evidence.json#/verdicts/{number}" for number in range(len(record["verdicts"]))}
    for number, episode in enumerate(record.episodes()):
        there.add(f"evidence.json#/episodes/{number}")
        if episode["trace"] is not None:
            there.add(episode["trace"]["file"])
    for entry in document["declarations"]["evidence"]:
        for data in entry["data"]:
            url = data["contents"].get("url")
            if url is not None and unquote(url, errors="surrogatepass") not in there:
                yield f"{entry['bom-ref']} refers to {url}, which is not there"


def _refs(value: Any) -> Iterator[str]:
    if isinstance(value, Mapping):
        if "bom-ref" in value:
            yield value["bom-ref"]
        value = list(value.values())
    if isinstance(value, list):
        for one in value:
            yield from _refs(one)


def _links(document: Data) -> Iterator[tuple[str, str]]:
    """Every reference of the declarations, with where it stands."""
    declared = document["declarations"]
    holders = [(one["bom-ref"], one) for one in declared["claims"]]
    for number, attestation in enumerate(declared["attestations"]):
        holders.append((f"attestation {number}", attestation))
        for one in attestation["map"]:
            where = f"the map of attestation {number}"
            holders += [(where, one), (where, one.get("conformance", {}))]
    for standard in document["definitions"]["standards"]:
        holders += [(one["bom-ref"], one) for one in standard["requirements"]]
    for where, holder in holders:
        for key in _LINKS:
            if key in holder:
                yield f"{where}, {key},", holder[key]
        for key in _LISTS:
            for ref in holder.get(key, ()):
                yield f"{where}, {key},", ref
