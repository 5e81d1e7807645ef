"""Whatever a record holds: the argument keeps the rules and states the record's counts."""

import re
from pathlib import Path
from xml.etree import ElementTree as ET

from gsn_rules import rule_problems
from hypothesis import given, settings
from hypothesis import strategies as st
from printed import blocks_of
from session_records import REQUIREMENTS, episode, session_record, verdict
from stated_counts import dead_references, elements_of, stated_counts

from pytest_dura.core.codec import encode
from pytest_dura.reports import root_ids
from pytest_dura.reports.gsn import svg_file, yaml_file

HOSTILE = st.sampled_from(
    [
        "<script>alert(1)</script>", "../../etc/passwd", "\"'`", "a\0b\x1b[31m", "\ud800",
        "\u202eabc", "line\nline\r\n", "]]>", "&amp;", "--- # {x: y}", "G1 -> G2", "x" * 5000,
        "", " ", "- a", "*a",
        "\ufffe\uffff", "1e3", "語" * 300, "\x85\u2028", "'; rm -rf /", "%s{}", "💥",
    ]
)  # fmt: skip
PAGE = Path(__file__).parents[2] / "docs/evidence/assurance-case.md"
(OWN,) = (block.text for block in blocks_of(PAGE) if block.file == "argument.gsn.yaml")
"""The argument of an assessor, as the documentation has it."""
CASE = session_record().head.cases[0]
TEXTS = HOSTILE | st.text(max_size=40)
WORDS = st.lists(st.sampled_from(["satisfied", "violated", "invalid", "missing"]), max_size=4)


@st.composite
def records(draw):
    names = draw(st.lists(TEXTS | st.sampled_from(["SAF-1", "PERF-2"]), min_size=1, max_size=4,
                          unique=True))  # fmt: skip
    requirements = [
        {
            **encode(REQUIREMENTS[draw(st.sampled_from(sorted(REQUIREMENTS)))]),
            "id": one, "text": draw(TEXTS), "reason": draw(TEXTS), "source": draw(TEXTS),
        }
        for one in names
    ]  # fmt: skip
    cases = draw(st.lists(TEXTS, min_size=1, max_size=3, unique=True))
    verdicts = []
    for _ in range(draw(st.integers(0, 5))):
        kind = draw(st.sampled_from(sorted(REQUIREMENTS)))
        one = verdict(kind, draw(st.sampled_from(cases)), draw(WORDS), planned=4)
        waiver = draw(st.none() | st.builds(lambda text: {"kind": "xfail", "reason": text}, TEXTS))
        changes = {
            "requirement": draw(st.sampled_from(names)), "waiver": waiver, "reason": draw(TEXTS),
            "component": draw(st.sampled_from(["C", "<b>"])),
        }  # fmt: skip
        verdicts.append({**one, **changes})
    cells = [
        {"requirement": draw(st.sampled_from(names)), "scenario": draw(TEXTS),
         "faults": draw(TEXTS), "case": draw(TEXTS), "component": "C", "applies": "test",
         "verdict": None}
        for _ in range(draw(st.integers(0, 3)))
    ]  # fmt: skip
    listed = [CASE.replace(id=one, scenario=one) for one in cases]
    validities = st.sampled_from(["valid", "invalid", "missing"])
    runs = [episode(one, validity=draw(validities)) for one in cases]
    return session_record(
        requirements=requirements, verdicts=verdicts, cases=listed, episodes=runs,
        coverage={"cells": cells, "left_out": 0, "parameters": []}, command=draw(TEXTS),
        status=draw(st.sampled_from(["complete", "interrupted"])),
        gate={"result": draw(st.sampled_from(["passed", "failed", "incomplete"])), "exit_code": 0,
              "reasons": draw(st.lists(TEXTS, max_size=4))},
    )  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=15)
@given(record=records())
def test_the_rules_hold_and_the_counts_are_the_records(record):
    text = yaml_file.render(record)
    assert rule_problems(elements_of(text)) == []
    assert stated_counts(yaml_file, text) == record.head.totals.to_json()
    assert dead_references(text, record) == []
    assert yaml_file.render(record) == text
    assert text.encode()


@settings(derandomize=True, deadline=None, max_examples=15)
@given(record=records())
def test_an_argument_of_ones_own_takes_the_module_up_by_its_public_ids(record):
    own, module = elements_of(OWN), elements_of(yaml_file.render(record))
    assert own.keys().isdisjoint(module)
    problems, tops = rule_problems(own | module), root_ids(own | module)
    if record.head.status == "complete" and record.head.gate.result != "incomplete":
        assert (problems, tops) == ([], ["G1"])
    else:  # the module has a top element that tells so, beside that of the argument
        assert [problem[:3] for problem in problems] == ["C01"]
        assert tops == ["G1", "GIncomplete"]
    for id_, element in module.items():
        kind, _, named = element.get("alias", "").partition(":")
        if kind == "requirement" and re.fullmatch(r"[A-Z]+-\d", named):
            assert id_ == f"G-{named}"


@settings(derandomize=True, deadline=None, max_examples=15)
@given(record=records())
def test_the_picture_is_sound_and_states_the_records_counts(record):
    text = svg_file.render(record)
    root = ET.fromstring(text)
    assert stated_counts(svg_file, text) == record.head.totals.to_json()
    assert {one.tag.rpartition("}")[2] for one in root.iter()} <= {
        "svg", "title", "desc", "style", "defs", "marker", "path", "g", "text", "rect", "circle",
        "ellipse", "polygon", "polyline", "view",
    }  # fmt: skip
    assert not re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\ud800-\udfff]", text)
    assert text.encode()
