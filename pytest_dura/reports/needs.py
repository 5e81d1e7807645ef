"""``needs.json``: hazards, requirements, cases and verdicts with their links, for sphinx-needs.

The directive ``needimport`` reads it. Every need links to what it serves: a requirement to the
hazards that it mitigates, a verdict to its requirement and its case, a case to the session.

Ids begin with capital letters, as sphinx-needs asks for by default, and have none of the dots that
mean a part of a need there. What a user wrote stands in titles and fields alone, which are no
markup, and what would be a function of sphinx-needs in them is broken up.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterator

from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.conclusions.coverage import faults_of
from pytest_dura.evidence.conclusions.verdicts import question_key
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.hazards import HazardEvidence, hazard_evidence
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.text import first_few, name, one_line
from pytest_dura.reports.verdicts import rate_bound
from pytest_dura.reports.wording import gate_title, review_text
from pytest_dura.requirements.model import Requirement

FILE = "needs.json"
EXPORT = "needs"
TYPES = ("hazard", "requirement", "testcase", "verdict", "session")
"""Types of needs, which a project that imports the file declares."""
FIELDS = (
    "severity", "loss", "operating_condition", "triggering_condition", "source", "kind", "check",
    "faults", "component", "reason", "bound", "episodes", "counterexamples", "totals", "review",
)  # fmt: skip
"""Fields of needs beyond those that sphinx-needs has by itself."""
_VERSION = "1.0"
_READABLE = 60
_TITLE, _TEXT = 200, 600
_MAX_COUNTEREXAMPLES = 10
_SESSION_ID = "SESSION"


def render(record: SessionRecord) -> str:
    """The file's text."""
    needs: dict[str, JsonObject] = {}
    times: Counter[str] = Counter()
    for need in _needs(record):
        times[need["id"]] += 1
        id_ = need["id"] if times[need["id"]] == 1 else f"{need['id']}__{times[need['id']]}"
        needs[id_] = {**need, "id": id_}
    for need in needs.values():  # also of a record that names what it does not list
        need["links"] = [link for link in need["links"] if link in needs]
    created, tool = name(record.head.created), record.head.tool
    version = {
        "created": created,
        "creator": {"program": name(tool.name), "version": name(tool.version)},
        "needs": needs,
        "needs_amount": len(needs),
    }
    content = {
        "created": created,
        "current_version": _VERSION,
        "project": _plain(str(record.head.component_under_test.name), _TITLE),
        "versions": {_VERSION: version},
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def _needs(record: SessionRecord) -> Iterator[JsonObject]:
    yield _session(record)
    for evidence in hazard_evidence(record):
        yield _hazard(evidence)
    for requirement in record.head.requirements:
        yield _requirement(requirement)
    for case in record.head.cases:
        yield _case(case)
    for verdict in record.head.verdicts:
        yield _verdict(verdict)


def _session(record: SessionRecord) -> JsonObject:
    totals = record.head.totals.to_json()
    return _need(
        "session",
        _SESSION_ID,
        gate_title(record),
        totals["gate"],
        totals=", ".join(f"{key} {value}" for key, value in totals.items()),
        review=review_text(record),
        component=name(str(record.head.component_under_test.name)),
    )


def _hazard(evidence: HazardEvidence) -> JsonObject:
    hazard = evidence.hazard
    return _need(
        "hazard",
        _hazard_id(hazard.id),
        f"{name(hazard.id)}: {hazard.text}",
        evidence.status,
        severity=hazard.severity or "",
        loss=hazard.loss,
        operating_condition=hazard.operating_condition,
        triggering_condition=hazard.triggering_condition,
        source=hazard.source,
    )


def _requirement(requirement: Requirement) -> JsonObject:
    return _need(
        "requirement",
        _requirement_id(requirement.id),
        f"{name(requirement.id)}: {requirement.text}",
        links=[_hazard_id(hazard) for hazard in requirement.mitigates],
        kind=requirement.kind,
        source=requirement.source,
        check=requirement.check,
        reason=requirement.reason,
    )


def _case(case: CaseEntry) -> JsonObject:
    valid = case.metrics.valid
    return _need(
        "testcase",
        _case_id(case.id, case.component),
        name(case.id),
        links=[_SESSION_ID],
        component=name(case.component),
        faults=name(faults_of(case)) if case.faults else "",
        episodes=f"{valid} valid of {case.planned} planned",
    )


def _verdict(verdict: ItemVerdict) -> JsonObject:
    examples = [name(each.episode) for each in verdict.counterexamples]
    key = question_key(verdict.item, verdict)
    return _need(
        "verdict",
        _need_id("VERDICT", verdict.requirement, verdict.case, apart=key),
        f"{name(verdict.requirement)} on {name(verdict.case)}: {verdict.verdict}",
        verdict.verdict,
        links=[
            _requirement_id(verdict.requirement),
            _case_id(verdict.case, verdict.component),
        ],
        tags=["waived"] if verdict.waiver else [],
        component=name(verdict.component),
        reason=verdict.reason,
        check=verdict.check,
        bound=rate_bound(verdict),
        episodes=f"{verdict.episodes} valid of {verdict.planned} planned",
        counterexamples=first_few(examples, _MAX_COUNTEREXAMPLES),
    )


def _need(
    type_: str,
    id_: str,
    title: str,
    status: str | None = None,
    *,
    links: list[str] | None = None,
    tags: list[str] | None = None,
    **fields: str,
) -> JsonObject:
    """Make a need; fields without a value are left out."""
    return {
        "id": id_,
        "type": type_,
        "title": _plain(title, _TITLE),
        "status": status,
        "content": "",
        "tags": tags or [],
        "links": links or [],
        **{key: _plain(text, _TEXT) for key, text in fields.items() if text},
    }


def _plain(text: str, limit: int) -> str:
    """Put text on one line, without what sphinx-needs would take for a function or a variant."""
    return re.sub(r"\[(?=\[)|<(?=<)|:(?=ndf:)", r"\g<0> ", one_line(text, limit))


def _hazard_id(hazard: str) -> str:
    return _need_id("HAZARD", hazard)


def _requirement_id(requirement: str) -> str:
    return _need_id("REQUIREMENT", requirement)


def _case_id(case: str, component: str) -> str:
    return _need_id("TESTCASE", case, apart=(component,))


def _need_id(prefix: str, *parts: str, apart: tuple[str, ...] = ()) -> str:
    """An id such as ``HAZARD-H-1``; with a hash where that loses what tells it from another."""
    text = "-".join(parts)
    readable = re.sub(r"[^A-Za-z0-9_]+", "-", text[: 4 * _READABLE]).strip("-")[:_READABLE]
    if len(parts) == 1 and not apart and readable == text:
        return f"{prefix}-{readable}"
    digest = hashlib.sha256(repr((parts, apart)).encode()).hexdigest()[:10]
    return f"{prefix}-{readable}__{digest}"
