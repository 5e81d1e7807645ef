"""The rules of gsn2x: each is broken once, and told by its code."""

import pytest
from gsn_rules import rule_problems

from pytest_dura.reports.gsn.element import derived_id, kind_of

GOOD = {
    "G1": {"text": "top", "supportedBy": ["S1"], "inContextOf": ["C1", "A1", "J1"]},
    "S1": {"text": "argue", "supportedBy": ["G2", "G3"]},
    "G2": {"text": "met", "supportedBy": ["Sn1"], "defeated": True},
    "G3": {"text": "open", "undeveloped": True},
    "Sn1": {"text": "evidence"},
    "C1": {"text": "context"},
    "A1": {"text": "assumption"},
    "J1": {"text": "justification"},
    "CG1": {"text": "not so", "challenges": "G2", "supportedBy": ["CSn1"]},
    "CSn1": {"text": "counterexample"},
}


def broken(**changes):
    """The good argument with elements changed, added, or left out where ``None``."""
    told = {**GOOD, **{id_: {**GOOD.get(id_, {}), **node} for id_, node in changes.items() if node}}
    return {id_: node for id_, node in told.items() if changes.get(id_, node) is not None}


def test_a_good_argument_breaks_no_rule():
    assert rule_problems(GOOD) == []


@pytest.mark.parametrize(
    "code,changes",
    [
        ("V01", {"X1": {"text": "what?"}}),
        ("V02", {"G3": {"undeveloped": False}}),
        ("V02", {"S1": {"supportedBy": []}}),
        ("V03", {"G2": {"undeveloped": True}}),
        ("V03", {"C1": {"undeveloped": True}}),
        ("V04", {"S1": {"supportedBy": ["G2", "G3", "C1"]}}),
        ("V04", {"G1": {"inContextOf": ["C1", "A1", "J1", "G3"]}}),
        ("V04", {"Sn1": {"inContextOf": ["C1"]}}),
        ("V04", {"CG1": {"supportedBy": ["Sn1"]}}),
        ("V05", {"S1": {"supportedBy": ["G2", "G3", "G3"]}}),
        ("V06", {"G2": {"supportedBy": ["Sn1", "G2"]}}),
        ("V10", {"CG1": {"challenges": "G3"}}),
        ("V12", {"Sn1": {"challenges": "G3"}}),
        ("V13", {"G2": {"defeatedRelation": ["G3"]}}),
        ("C01", {"G9": {"text": "another", "undeveloped": True}}),
        ("C02", {"G1": None}),
        ("C03", {"S1": {"supportedBy": ["G2", "G3", "G4"]}}),
        ("C04", {"G2": {"supportedBy": ["Sn1", "S1"]}}),
        ("C13", {"CG1": {"challenges": "CG1"}}),
        ("C14", {"CG1": {"challenges": "G7"}}),
        ("C15", {"CG1": {"challenges": "G2 -> G2"}}),
        ("C16", {"CG1": {"challenges": "G1 -> G3"}}),
    ],
)  # fmt: skip
def test_each_rule_is_told_by_its_code(code, changes):
    assert any(one.startswith(code) for one in rule_problems(broken(**changes)))


def test_elements_beside_the_tree_are_not_reached():
    circle = {
        "G8": {"text": "one", "supportedBy": ["G9"]}, "G9": {"text": "two", "supportedBy": ["G8"]}
    }  # fmt: skip
    found = rule_problems(GOOD | circle)
    assert [one for one in found if one.startswith("C08")] == [
        "C08 G8: it cannot be reached from the top", "C08 G9: it cannot be reached from the top"
    ]  # fmt: skip
    assert any(one.startswith("C04") for one in found)


@pytest.mark.parametrize(
    "node",
    [
        "text alone", {}, {"text": ""}, {"text": 3}, {"text": "a", "supportedBy": 3},
        {"text": "a", "supportedBy": [3]}, {"text": "a", "undeveloped": "yes"},
        {"text": "a", "name": "gsn2x would read a module"},
    ],
)  # fmt: skip
def test_what_is_no_element_is_told(node):
    assert any(one.startswith("G3: ") for one in rule_problems({**GOOD, "G3": node}))


def test_a_challenge_to_a_relation_defeats_neither_of_its_ends():
    assert rule_problems(broken(CG1={"challenges": "S1 -> G2"}, G2={"defeated": False})) == []
    assert any(
        one.startswith("V10") for one in rule_problems(broken(CG1={"challenges": "S1 -> G2"}))
    )


def test_an_argument_deeper_than_the_stack_is_judged():
    deep = {f"G{i}": {"text": "x", "supportedBy": [f"G{i + 1}"]} for i in range(5000)}
    assert rule_problems(deep | {"G5000": {"text": "x", "undeveloped": True}}) == []


def test_ids_keep_their_kind_whatever_they_are_about():
    hostile = [
        "G1",
        "n1",
        "Sn",
        "a/b",
        "a-b",
        "a.b",
        "a\0b",
        "",
        "<script>",
        "../x",
        "\ud800",
        "x" * 999,
    ]
    for prefix in ("G", "S", "Sn", "C", "CG", "CSn", "J"):
        ids = [derived_id(prefix, one) for one in hostile]
        ids += [derived_id(prefix, "a", "b"), derived_id(prefix, "a", apart=("b",))]
        ids += [derived_id(prefix, "a@b"), derived_id(prefix, "a:b")]
        ids += [derived_id(prefix, "b", what="a"), derived_id(prefix, "a", what="b")]
        assert len(set(ids)) == len(ids)
        assert {kind_of(one) for one in ids} == {kind_of(prefix)}
        assert all(
            one.isascii() and len(one) < 130 and "->" not in one and "<" not in one for one in ids
        )
    assert derived_id("G", "SAF-1") == "G-SAF-1"
    # A name that is made to look like the id of another is no such id.
    assert derived_id("G", derived_id("G", "a b")[2:]) != derived_id("G", "a b")
    assert derived_id("G", "SAF-1", "road/wet+ghost") == "G-SAF-1@road/wet+ghost"
