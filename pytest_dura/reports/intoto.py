"""``test-result.intoto.json``: an in-toto Statement with the test-result predicate, version 0.1.

What a policy may conclude, and what not:

- The subjects are the components under test that have a digest, and always ``evidence.json``: the
  statement stands for what that record holds. A component without a digest is named among the
  annotations of the campaign only, because a statement on it could not be tied to anything.
- ``PASSED``: the gate passed and every verdict is supported, none of them waived. ``WARNED``: the
  gate passed, without any verdict, with waivers, or with undecided verdicts that it was configured
  to let through; and at best that of a shard, which is a part of a session, whatever it came to.
  ``FAILED``: all else, an incomplete session included.
- What a search found is no test: unless it is waived, its gate has failed. A waived one is a
  warning.
- Each verdict is one test, ``case::requirement``. Supported ones passed, waived ones are warned,
  and violated and undecided ones failed, whatever the gate lets through.
- The campaign is the first configuration. Its digest is that of the plan: cases, faults, number of
  runs, requirements and base seed. Sessions of one plan have the same one.
- There is no ``url``: the record knows no address of the session.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter

from pytest_dura.evidence.bundle import RECORD_FILE
from pytest_dura.evidence.entry import JsonObject, plain_data
from pytest_dura.evidence.files import file_entry
from pytest_dura.evidence.gate import NOTHING_FOUND, outcome_status
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import SessionRecord, components_under_test
from pytest_dura.evidence.session_model import InputEntry
from pytest_dura.evidence.text import name, visible
from pytest_dura.reports.wording import NAME_LIMIT, review_text, shard_text, valid_sha256

FILE = "test-result.intoto.json"
EXPORT = "in-toto"
_STATEMENT = "https://in-toto.io/Statement/v1"
_PREDICATE = "https://in-toto.io/attestation/test-result/v0.1"
_MAX_REASONS = 20
"""Reasons of the gate that are annotated; the record has all of them."""
_PLANNED = {"id", "scenario", "faults", "component", "without", "requirements", "planned"}
_LISTS = ("passedTests", "warnedTests", "failedTests")


def render(record: SessionRecord) -> str:
    """The statement as text. Its record lies in the bundle already, and its digest is taken.

    Raises:
        ValueError: If ``evidence.json`` is not in the record's directory.
    """
    names = _test_names(record.head.verdicts)
    lists: dict[str, list[str]] = {key: [] for key in _LISTS}
    for test, verdict in zip(names, record.head.verdicts, strict=True):
        lists[_test_list(verdict)].append(test)
    statement = {
        "_type": _STATEMENT,
        "subject": _subjects(record),
        "predicateType": _PREDICATE,
        "predicate": {
            "result": _result(record),
            "configuration": [_campaign(record, names), *map(_input_entry, record.head.inputs)],
            **lists,
        },
    }
    return json.dumps(statement, indent=1) + "\n"


def _test_list(verdict: ItemVerdict) -> str:
    if verdict.waiver is not None:
        return "warnedTests"
    return "passedTests" if verdict.verdict == "supported" else "failedTests"


def _result(record: SessionRecord) -> str:
    if record.head.gate.result != "passed" or record.head.status != "complete":
        return "FAILED"
    # Without a verdict nothing was shown, and by one shard nothing of the whole.
    clean = bool(record.head.verdicts) and not shard_text(record)
    for verdict in record.head.verdicts:
        if verdict.verdict == "violated" and verdict.waiver is None:
            return "FAILED"  # no gate lets it through; what says so is damaged
        clean &= _test_list(verdict) == "passedTests"
    for search in record.head.searches:
        statuses = {outcome_status(search, outcome) for outcome in search.outcomes} - {
            NOTHING_FOUND
        }
        if statuses - {"undecided"} and search.waiver is None:
            return "FAILED"  # likewise
        clean &= not statuses
    return "PASSED" if clean else "WARNED"


def _test_names(verdicts: list[ItemVerdict]) -> list[str]:
    """``case::requirement`` of each verdict, with as much more as tells it from the others."""
    parts = [
        [
            f"{verdict.case}::{verdict.requirement}",
            f" [{verdict.component}]",
            f" ({verdict.item})",
        ]
        for verdict in verdicts
    ]
    names = ["".join(part[:1]) for part in parts]
    for more in (2, 3):
        counts = Counter(names)
        names = [
            "".join(part[:more]) if counts[test] > 1 else test
            for test, part in zip(names, parts, strict=True)
        ]
    unique_names: list[str] = []
    taken: set[str] = set()
    repeats: Counter[str] = Counter()
    for test in (name(text, NAME_LIMIT) for text in names):
        unique = test
        while unique in taken:
            repeats[test] += 1
            unique = f"{test} #{repeats[test] + 1}"
        taken.add(unique)
        unique_names.append(unique)
    return unique_names


def _subjects(record: SessionRecord) -> list[JsonObject]:
    file = record.directory / RECORD_FILE
    if not file.is_file():
        raise ValueError(f"{RECORD_FILE} has to be written before the statement on it")
    components = [
        {"name": name(component.name or "unknown", NAME_LIMIT), "digest": {"sha256": digest}}
        for component in components_under_test(record)
        if (digest := valid_sha256(component.digest))
    ]
    return [*components, {"name": RECORD_FILE, "digest": {"sha256": file_entry(file)["sha256"]}}]


def _campaign(record: SessionRecord, names: list[str]) -> JsonObject:
    plan = {
        "base_seed": record.head.base_seed,
        "requirements": record.head.requirements,
        "cases": [case.to_json(include=_PLANNED) for case in record.head.cases],
    }
    canonical = json.dumps(plain_data(plan), sort_keys=True, separators=(",", ":"))
    counts = record.head.totals.to_json()
    statuses = [verdict.verdict for verdict in record.head.verdicts]
    for status in ("supported", "violated", "undecided"):
        counts[status] = [
            test
            for test, verdict_status in zip(names, statuses, strict=True)
            if verdict_status == status
        ]
    del counts["supported"], counts["waived"]  # those that passed, and those that are warned
    return {
        "name": "campaign",
        "digest": {"sha256": hashlib.sha256(canonical.encode()).hexdigest()},
        "annotations": {
            **counts,
            "status": record.head.status,
            "part": shard_text(record) or "whole",
            "reasons": [visible(reason) for reason in record.head.gate.reasons[:_MAX_REASONS]],
            "components": [
                name(component.name or "unknown", NAME_LIMIT)
                for component in components_under_test(record)
            ],
            "command": visible(record.head.command),
            "base_seed": str(record.head.base_seed),  # as a number, JSON readers would round it
            "created": record.head.created,
            "review": review_text(record),
        },
    }


def _input_entry(file: InputEntry) -> JsonObject:
    entry: JsonObject = {
        "name": name(file.path, NAME_LIMIT),
        "annotations": {"kind": visible(file.kind)},
    }
    if digest := valid_sha256(file.sha256):
        entry["digest"] = {"sha256": digest}
    return entry
