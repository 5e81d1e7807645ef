"""Laws of the machine formats: valid for whoever reads them, whatever the record holds."""

import json
import re
from functools import cache
from hashlib import sha256

import pytest
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from google.protobuf import json_format
from hostile_records import hostile_records
from hypothesis import given, settings
from in_toto_attestation.predicates.test_result.v0 import test_result_pb2
from in_toto_attestation.v1 import statement_pb2
from in_toto_attestation.v1.resource_descriptor import ResourceDescriptor
from in_toto_attestation.v1.statement import Statement
from markdown_it import MarkdownIt
from stated_counts import dead_references, stated_counts

from pytest_dura.evidence import write_record
from pytest_dura.reports import cyclonedx, intoto, needs, summary
from pytest_dura.reports.cards import cards_of

some = settings(derandomize=True, deadline=None, max_examples=25)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return tmp_path_factory.mktemp("bundle")


@cache
def strict():
    return JsonStrictValidator(SchemaVersion.V1_6)


def no_control(text):
    return not re.search(
        r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]", text
    )


def strings(value):
    if isinstance(value, str):
        return [value]
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [text for part in parts for text in strings(part)]


@settings(some, max_examples=10)  # the validator parses each address with a grammar
@given(record=hostile_records())
def test_declarations_are_valid_and_state_the_records_counts(record):
    text = cyclonedx.render(record)
    assert strict().validate_str(text) is None
    assert dead_references(text, record) == []
    assert stated_counts(cyclonedx, text) == record.head.totals.to_json()
    assert all(map(no_control, strings(json.loads(text))))
    assert len(text) < 200_000
    assert cyclonedx.render(record) == text


@some
@given(record=hostile_records())
def test_conformance_is_scored_where_it_is_shown_or_refuted_and_nowhere_else(record):
    document = json.loads(cyclonedx.render(record))
    entries = document["declarations"]["attestations"][0]["map"]
    assert len(entries) == len(record.head.requirements)
    judged = {(one.requirement, one.case, one.component) for one in record.head.verdicts}
    compared = {one["pairs"]["case"] for one in record.head.verdicts if one.pairs}
    whole = record.head.status == "complete" and record.head.gate.result != "incomplete"
    for requirement, entry in zip(record.head.requirements, entries, strict=True):
        name = requirement.id
        own = [one for one in record.head.verdicts if one.requirement == name]
        clean = all(one.verdict == "supported" and one.waiver is None for one in own)
        refuted = any(one.verdict == "violated" and one.waiver is None for one in own)
        searched = {
            outcome.status
            for one in record.head.searches
            if not one.waiver
            for outcome in one.outcomes
            if outcome.requirement == name
        }
        tested = all(
            (name, one.id, one.component) in judged
            for one in record.head.cases
            if name in one.requirements and one.planned and not one.without
            if one.id not in compared or any(one["id"] == case for _, case, _ in judged)
        )
        score = entry["conformance"].get("score")
        assert (score == 0) == (refuted or "falsified" in searched)
        shown = own and clean and whole and tested and searched <= {"nothing found"}
        assert (score == 1) == bool(shown)
        assert entry["conformance"]["rationale"]
        assert "confidence" not in entry


def valid_statement(text):
    """The predicate of a statement that the format's own library accepts."""
    message = json_format.Parse(text, statement_pb2.Statement())
    Statement.copy_from_pb(message).validate()
    result = json_format.ParseDict(json.loads(text)["predicate"], test_result_pb2.TestResult())
    for one in result.configuration:
        ResourceDescriptor.copy_from_pb(one).validate()
    assert all(re.fullmatch("[0-9a-f]{64}", one.digest["sha256"]) for one in message.subject)
    return result


@some
@given(record=hostile_records())
def test_the_statement_is_valid_and_states_the_records_counts(record, bundle):
    record = type(record).of(record.to_json(), bundle)
    write_record(bundle, record)
    text = intoto.render(record)
    result = valid_statement(text)
    tests = [*result.passed_tests, *result.warned_tests, *result.failed_tests]
    assert len(set(tests)) == len(record.head.verdicts)
    clean = all(one.verdict == "supported" and not one.waiver for one in record.head.verdicts)
    clean &= not record.head.searches  # each of them found something
    passed = record.head.gate.result == "passed" and record.head.status == "complete"
    # Of a session that decided nothing, nothing has passed.
    assert (result.result == "PASSED") == (passed and clean and bool(tests))
    assert passed or result.result == "FAILED"
    assert stated_counts(intoto, text) == record.head.totals.to_json()
    assert all(map(no_control, strings(json.loads(text))))
    subject = json.loads(text)["subject"][-1]
    assert (
        subject["digest"]["sha256"] == sha256((bundle / "evidence.json").read_bytes()).hexdigest()
    )


@some
@given(record=hostile_records())
def test_needs_are_linked_without_markup_and_state_the_records_counts(record):
    text = needs.render(record)
    assert stated_counts(needs, text) == record.head.totals.to_json()
    assert all(map(no_control, strings(json.loads(text))))
    (version,) = json.loads(text)["versions"].values()
    found = version["needs"].values()
    assert {need["content"] for need in found} == {""}
    assert not any("[[" in told or "<<" in told for told in strings(version["needs"]))
    hazards = [need["id"] for need in found if need["type"] == "hazard"]
    assert len(hazards) == len(record.head.hazards)
    mitigated = [need["links"] for need in found if need["type"] == "requirement"]
    named = [requirement.mitigates for requirement in record.head.requirements]
    assert [len(links) for links in mitigated] == [len(ids) for ids in named]


def tokens_of(text):
    """All tokens of the page as Markdown; HTML and links are not switched off."""
    for token in MarkdownIt("gfm-like", {"linkify": False, "html": True}).parse(text):
        yield token
        yield from token.children or ()


@some
@given(record=hostile_records())
def test_the_summary_is_harmless_and_states_the_records_counts(record):
    text = summary.render(record)
    tokens = list(tokens_of(text))
    kinds = {token.type for token in tokens}
    assert not kinds & {"html_block", "html_inline", "link_open", "image", "fence", "code_block"}
    prose = "".join(token.content for token in tokens if token.type == "text")
    assert not re.search(r"@|://|www\.|#\d|\$", prose)
    headings = sum(token.type == "heading_open" for token in tokens)
    outcomes = [one for search in record.head.searches for one in search.outcomes]
    cards = len(re.findall(r"^## `*Cause \d+, ", text, re.MULTILINE))
    assert bool(cards) == bool(cards_of(record))
    concluded = record.head.conclusions.values()
    assert headings == 6 + cards + bool(outcomes) + len(concluded)
    rows = [token for token in tokens if token.type == "tr_open"]
    head = record.head
    held = head.verdicts, head.hazards, head.requirements, head.cases, outcomes
    assert len(rows) == 1 + sum(map(len, held)) + 5 + bool(outcomes) + sum(
        1 + len(each.rows) for each in concluded
    )
    assert no_control(text)
    assert len(text.encode()) <= summary.MAX_BYTES
    assert stated_counts(summary, text) == record.head.totals.to_json()
