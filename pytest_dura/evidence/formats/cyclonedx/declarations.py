"""Claims, evidence and attestations of a session, as CycloneDX declares them."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from pytest_dura.evidence.bundle.directory import RECORD
from pytest_dura.evidence.formats.cyclonedx.parts import (
    NAME_LIMIT,
    PREFIX,
    described,
    requirement_ref,
)
from pytest_dura.evidence.formats.stated import UNREVIEWED, bound, part, sample
from pytest_dura.evidence.plain import plain
from pytest_dura.evidence.record.searches import AGAINST, NOTHING, standing
from pytest_dura.evidence.record.session_record import SessionRecord, components_under_test
from pytest_dura.evidence.text import name, one_line, visible

Data = dict[str, Any]
LISTED = 5
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


def declarations(record: SessionRecord) -> Data:
    """All that the session declares, as one self-assessment.

    Raises:
        ValueError: If a verdict names a requirement that the record does not list.
    """
    targets = _Targets.of(record)
    places = _places(record)
    texts = {one["id"]: one["text"] for one in record["requirements"]}
    claims, evidence = [], []
    for number, verdict in enumerate(record["verdicts"]):
        if verdict["requirement"] not in texts:
            told = name(verdict["requirement"])
            raise ValueError(f"a verdict is on {told}, which is not among the requirements")
        entries = list(_evidence(number, verdict, places))
        for one in entries:
            one["created"] = record["finished"] or record["created"]
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
                "summary": f"By a test tool, {UNREVIEWED}. The gate of {_which(record)}: "
                f"{record['gate']['result']}.",
                "assessor": "assessor",
                "map": list(_map(record)),
            }
        ],
        "claims": claims,
        "evidence": evidence,
        "targets": {"components": targets.described},
    }


def _which(record: SessionRecord) -> str:
    found = part(record)
    return f"{found}, a part of a session" if found else "the session"


@dataclass(frozen=True)
class _Targets:
    """What claims are made on: every component that the record describes or a verdict names."""

    described: list[Data]
    refs: Mapping[str, str]

    @classmethod
    def of(cls, record: SessionRecord) -> _Targets:
        known: dict[str, Any] = {}
        for one in components_under_test(record):
            known.setdefault(one["name"], one)
        for verdict in record["verdicts"]:
            known.setdefault(verdict["component"], {"name": verdict["component"]})
        refs = {component: f"target/{number}" for number, component in enumerate(known)}
        return cls([described(known[one], ref) for one, ref in refs.items()], refs)


def _places(record: SessionRecord) -> dict[tuple[str, str], tuple[int, str | None]]:
    """Index and trace of each episode that will be listed as a counterexample."""
    wanted = {
        (one["episode"], verdict["component"])
        for verdict in record["verdicts"]
        for one in verdict["counterexamples"][:LISTED]
    }
    found: dict[tuple[str, str], tuple[int, str | None]] = {}
    for number, episode in enumerate(record.episodes()):
        key = episode["id"], episode["component"]
        if key in wanted and (episode["planned"] or key not in found):
            found[key] = number, episode["trace"] and episode["trace"]["file"]
    return found


def _claim(
    number: int, verdict: Data, texts: Mapping[str, str], target: str, entries: list[Data]
) -> Data:
    word = verdict["verdict"]
    requirement = name(verdict["requirement"], NAME_LIMIT)
    what = f"{requirement} holds on {name(verdict['case'], NAME_LIMIT)}"
    text = one_line(texts[verdict["requirement"]])
    first, *counterexamples = (one["bom-ref"] for one in entries)
    claim = {
        "bom-ref": f"claim/{number}",
        "target": target,
        "predicate": _PREDICATES[word].format(what=what) + (f": {text}" if text else ""),
        "reasoning": f"{visible(verdict['reason'])} ({sample(verdict)}; {bound(verdict)})",
        "evidence": [first],
    }
    # A counterexample is what a counter claim rests on, and speaks against any other.
    if word == "violated":
        claim["evidence"] = [first, *counterexamples]
    elif counterexamples:
        claim["counterEvidence"] = counterexamples
    return claim


def _evidence(number: int, verdict: Data, places: Mapping[Any, Any]) -> Iterator[Data]:
    data = [
        {
            "name": "verdict",
            "contents": _json({key: verdict[key] for key in _FIGURES})
            | {"url": f"{RECORD}#/verdicts/{number}"},
        }
    ]
    if verdict["waiver"] is not None:
        waiver = {key: visible(str(text)) for key, text in verdict["waiver"].items()}
        data.append({"name": "waiver", "contents": _json(waiver)})
    yield {
        "bom-ref": f"evidence/{number}",
        "propertyName": f"{PREFIX}verdict:{verdict['verdict']}",
        "description": f"{sample(verdict)}; {bound(verdict)} ({verdict['bound']['method']})",
        "data": data,
    }
    if verdict["counterexamples"]:
        yield _counterexamples(number, verdict, places)


def _counterexamples(number: int, verdict: Data, places: Mapping[Any, Any]) -> Data:
    found = verdict["counterexamples"]
    data = []
    for one in found[:LISTED]:
        index, trace = places.get((one["episode"], verdict["component"]), (None, None))
        shown = name(one["episode"], NAME_LIMIT)
        contents = _json({key: one[key] for key in ("time", "margin", "valid")})
        if index is not None:
            contents["url"] = f"{RECORD}#/episodes/{index}"
        data.append({"name": shown, "contents": contents})
        if trace is not None:
            url = quote(trace, errors="surrogatepass")
            data.append({"name": f"trace of {shown}", "contents": {"url": url}})
    return {
        "bom-ref": f"evidence/{number}/counterexamples",
        "propertyName": f"{PREFIX}counterexamples",
        "description": (
            f"{min(len(found), LISTED)} of {len(found)} listed, the largest violation first."
        ),
        "data": data,
    }


def _json(told: Mapping[str, Any]) -> Data:
    content = json.dumps(plain(told))
    return {"attachment": {"contentType": "application/json", "content": content}}


def _map(record: SessionRecord) -> Iterator[Data]:
    """Each requirement with its claims, also one on which there is none."""
    verdicts: dict[str, list[tuple[int, Data]]] = defaultdict(list)
    for number, verdict in enumerate(record["verdicts"]):
        verdicts[verdict["requirement"]].append((number, verdict))
    untested = _declared_and_untested(record)
    for number, requirement in enumerate(record["requirements"]):
        own = verdicts[requirement["id"]]
        against = [f"claim/{place}" for place, one in own if one["verdict"] == "violated"]
        claims = [f"claim/{place}" for place, one in own if one["verdict"] != "violated"]
        yield {
            "requirement": requirement_ref(number),
            "claims": claims,
            "counterClaims": against,
            "conformance": _conformance(
                record, requirement["id"], [one for _, one in own], untested[requirement["id"]]
            ),
        }


def _declared_and_untested(record: SessionRecord) -> Counter[str]:
    """Of each requirement, how many planned cases declare it and have no verdict on it.

    Other cells of the coverage table, a fault of one scenario in another one, nobody declared.
    """
    judged = {(one["requirement"], one["case"], one["component"]) for one in record["verdicts"]}
    compared = {one["pairs"]["case"] for one in record["verdicts"] if one["pairs"] is not None}
    compared -= {case for _, case, _ in judged}
    return Counter(
        requirement
        for case in record["cases"]
        if case["planned"] and not case["without"] and case["id"] not in compared
        for requirement in case["requirements"]
        if (requirement, case["id"], case["component"]) not in judged
    )


def _searched(record: SessionRecord, requirement: str) -> Counter[str]:
    """What searches have against a requirement that no waiver excuses, counted by word."""
    return Counter(
        word
        for one in record["searches"]
        if one["waiver"] is None
        for outcome in one["outcomes"]
        if outcome["requirement"] == requirement and (word := standing(one, outcome)) != NOTHING
    )


def _conformance(
    record: SessionRecord, requirement: str, verdicts: list[Data], untested: int
) -> Data:
    """The score where it is decided: 1 or 0, see the package; and the reason, always."""
    words = Counter(one["verdict"] for one in verdicts)
    refuted = any(one["verdict"] == "violated" and one["waiver"] is None for one in verdicts)
    searched = _searched(record, requirement)
    doubts = [f"{words[word]} {word}" for word in ("violated", "undecided") if words[word]]
    doubts += [f"{count} {AGAINST[word]}" for word, count in searched.items()]
    if waived := sum(one["waiver"] is not None for one in verdicts):
        doubts.append(f"{waived} waived")
    if untested:
        doubts.append(f"{untested} untested")
    if record["status"] != "complete" or record["gate"]["result"] == "incomplete":
        doubts.append("the session is incomplete")
    if part(record):
        doubts.append(f"{part(record)} alone")
    if not verdicts:
        doubts.append("no verdict")
    told = f"{words['supported']} of {len(verdicts)} verdicts supported"
    if not doubts:
        rationale = f"{told}, each on the episodes and with the bound in its evidence"
        return {"score": 1, "rationale": f"{rationale}; {UNREVIEWED}."}
    rationale = f"{told}; {', '.join(doubts)}"
    if refuted or searched["falsified"]:
        return {"score": 0, "rationale": f"{rationale}. 0: it was violated; {UNREVIEWED}."}
    rationale = f"{rationale}. No score: conformance is not attested, nor refuted"
    return {"rationale": f"{rationale}; {UNREVIEWED}."}
