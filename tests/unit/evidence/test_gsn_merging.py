"""A user's own argument on top: what it takes up, what it leaves out, and what is wrong with it."""

import json

import pytest
from session_records import session_record
from stated_counts import elements_of, stated_counts

from pytest_dura.core import ConfigurationError
from pytest_dura.reports import check_requirements, read_user_argument, root_ids, rule_problems
from pytest_dura.reports.gsn import svg_file, yaml_file

GOOD = """\
module:
  name: shuttle
G1:
  text: The shuttle is acceptably safe.
  supportedBy: [S1, G2]
  inContextOf: C1
S1:
  text: Argue over hazards.
  supportedBy: [requirement:SAF-1, G-SEC-1]
G2:
  text: Operators are trained.
  undeveloped: true
  layer1: more
C1:
  text: The campus.
"""


@pytest.fixture
def user(tmp_path):
    def read(text):
        file = tmp_path / "argument.gsn.yaml"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_user_argument(file)

    return read


def with_user(told, **changes):
    """The record as it is written: through JSON."""
    return session_record(argument=told, **changes)


def rendered(told, **changes):
    return elements_of(yaml_file.render(with_user(told, **changes)))


def test_the_users_goal_is_the_root_over_our_requirements(user):
    found = rendered(user(GOOD))
    assert root_ids(found) == ["G1"]
    assert rule_problems(found) == []
    assert found["S1"]["supportedBy"] == ["G-SAF-1", "G-SEC-1"]
    assert found["G2"] == {
        "text": "Operators are trained.", "undeveloped": True, "layer1": "more"
    }  # fmt: skip
    assert found["G-SAF-1"]["defeated"]  # the violation comes along
    assert "GTop" not in found
    assert {"C1", "CReview", "CSession", "CDomain", "ASimulator"} <= set(found["G1"]["inContextOf"])


def test_what_is_not_taken_up_is_told_and_counted(user):
    found = rendered(user(GOOD))
    assert "G-PERF-1" not in found
    left = next(one for one in found.values() if one.get("alias") == "unused:PERF-1")
    assert left["text"] == (
        "Not used by the argument: PERF-1, requirement, verdicts: 0 supported, 1 violated, "
        "0 undecided; 1 waived; untested cells: 1."
    )
    assert found["CGUnused"]["challenges"] == "G1"
    assert "PERF-1@a/clear" in found["CGUnused"]["text"]
    assert "CUnusedMonitors" in found
    record = with_user(user(GOOD))
    for one in (yaml_file, svg_file):
        assert stated_counts(one, one.render(record)) == record.head.totals.to_json()


def test_all_of_ours_may_be_taken_up_at_once(user):
    found = rendered(user("G1: {text: Safe., supportedBy: [top]}"))
    assert found["G1"]["supportedBy"] == ["GTop"]
    assert not any("Unused" in id_ or "unused" in id_ for id_ in found)


def test_a_part_of_a_requirement_leaves_the_rest_told(user):
    found = rendered(user("G1: {text: Safe., supportedBy: ['verdict:SAF-1@a/clear']}"))
    left = next(one for one in found.values() if one.get("alias") == "unused:SAF-1")
    assert (left["requirements"], left["supported"], left["violated"]) == (1, 0, 1)
    record = with_user(user("G1: {text: Safe., supportedBy: ['verdict:SAF-1@a/clear']}"))
    assert stated_counts(yaml_file, yaml_file.render(record)) == record.head.totals.to_json()


def test_the_user_may_challenge_our_elements(user):
    text = GOOD + "CG1: {text: The sensor was new., challenges: 'assumption:sensors'}\n"
    assert rendered(user(text))["CG1"]["challenges"] == "ASensors"


def test_a_hostile_id_is_harmless_in_the_picture(user):
    text = svg_file.render(
        with_user(user("""'G"><script>': {text: <b>, undeveloped: true, url: 'javascript:x'}"""))
    )
    assert "<script" not in text
    assert "<b>" not in text
    assert "javascript" not in text


def test_an_incomplete_session_challenges_the_users_goal(user):
    found = rendered(user(GOOD), status="interrupted")
    assert found["CGIncomplete"]["challenges"] == "G1"
    assert "INCOMPLETE SESSION" in found["CGIncomplete"]["text"]


def test_two_parents_may_share_an_element(user):
    text = """
G1: {text: Safe., supportedBy: [G2, G3]}
G2: {text: By day., supportedBy: [requirement:SAF-1]}
G3: {text: By night., supportedBy: [requirement:SAF-1]}
"""
    record = with_user(user(text))
    assert stated_counts(svg_file, svg_file.render(record)) == record.head.totals.to_json()
    assert 'data-kind="Reference"' in svg_file.render(record)


def test_the_digest_and_the_path_are_told_for_provenance(user):
    told = user("G1: {text: a, undeveloped: true}")
    assert len(told.sha256) == 64
    assert told.path.endswith("argument.gsn.yaml")
    assert told.lines["G1.undeveloped"] == 1


@pytest.mark.parametrize(
    "text,line,problem",
    [
        ("", 1, "no elements"),
        ("- a", 1, "no elements"),
        ("module: {name: x}", 1, "no elements"),
        ("G1: [", 1, "not valid YAML"),
        ("G1: {text: \x01}", 1, "not valid YAML"),
        (b"G1: \xff", 1, "not UTF-8"),
        ("\nG1: {text: a}\nG1: {text: b}\n", 3, "twice"),
        ("G1:\n  text: a\n  text: b\n", 3, "twice"),
        ("? [a]\n: b", 1, "a key is text"),
        ("G1: &a {text: x}", 1, "anchors"),
        ("G1: *a", 1, "anchors"),
        ("G1: !!python/object:os.system {text: x}", 1, "anchors"),
        ("G1: " + "[" * 50 + "]" * 50, 1, "nested too deeply"),
        ("X1: {text: a}", 1, "no known prefix"),
        ('"G\\e[31m": {text: a}', 1, "odd or too many characters"),
        (f"G{'x' * 120}: {{text: a}}", 1, "odd or too many characters"),
        ("G1->G2: {text: a}", 1, "odd or too many characters"),
        ("'G1 ': {text: a}", 1, "odd or too many characters"),
        ("G1: text", 1, "a mapping"),
        ("G1: {undeveloped: true}", 1, "has a text"),
        ("G1: {text: [a]}", 1, "no text"),
        ("G1:\n  text: a\n  undeveloped: 'yes'", 3, "no truth value"),
        ("G1:\n  text: a\n  supportedBy: {a: b}", 3, "no list of ids"),
        ("G1:\n  text: a\n  name: b", 3, "cannot be used"),
        ("G1:\n  text: a\n  alias: verdict:x", 3, "cannot be used"),
        ("G1:\n  text: a\n  nodeType: Goal", 3, "cannot be used"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_used_is_one_clear_error(user, text, line, problem):
    with pytest.raises(ConfigurationError, match=problem) as caught:
        user(text)
    assert caught.value.line == line
    assert caught.value.file.endswith("argument.gsn.yaml")
    assert caught.value.expected
    assert caught.value.remedy


def test_a_file_that_is_not_there_or_too_large_is_refused(tmp_path, user):
    with pytest.raises(ConfigurationError, match="not a file"):
        read_user_argument(tmp_path / "nothing")
    with pytest.raises(ConfigurationError, match="too large"):
        user("#" * (1024 * 1024 + 1))


@pytest.mark.parametrize(
    "text,line,found",
    [
        ("G1:\n  text: a\n  supportedBy: [requirement:SAF-9]", 3, "requirement:SAF-9"),
        ("G1: {text: a, undeveloped: true}\nG-SAF-1: {text: b, undeveloped: true}", 2, "G-SAF-1"),
        ("G1: {text: a, undeveloped: true}\nG2: {text: b, undeveloped: true}", 2, "G1, G2"),
        ("G1: {text: a, supportedBy: G2}\nG2: {text: b, supportedBy: G1}", 1, "none"),
        ("S1: {text: a, supportedBy: top}", 1, "S1"),
        ("G1: {text: a, supportedBy: S1}\nS1:\n  text: b", 2, "nothing supports it"),
        ("G1: {text: a, supportedBy: ['context:domain']}", 1, "CDomain"),
        ("G1: {text: a, supportedBy: [top], defeated: true}", 1, "nothing challenges"),
    ],
)  # fmt: skip
def test_an_argument_that_does_not_fit_is_one_clear_error(user, text, line, found):
    with pytest.raises(ConfigurationError) as caught:
        rendered(user(text))
    assert caught.value.line == line
    assert found in f"{caught.value.found}"
    assert caught.value.expected


def test_a_users_own_key_is_harmless_and_remains_its_own(user):
    found = rendered(user('G1: {text: a, "\\uD800\\e": x, " text": y, undeveloped: true}'))["G1"]
    assert found["text"] == "a"
    assert [key for key in found if not key.isprintable()] == []
    assert {"x", "y"} < set(map(str, found.values()))


NONE = {"cells": [], "parameters": [], "left_out": 0}


@pytest.mark.parametrize("odd", ["a\x1bb", "x" * 2000])
def test_a_requirement_is_referred_to_by_its_id_as_it_is(user, odd):
    """Its alias is what can be shown of that."""
    told = user(json.dumps({"G1": {"text": "a", "supportedBy": [f"requirement:{odd}"]}}))
    check_requirements(told, [odd])
    asked = session_record().head.requirements[0].replace(id=odd)
    found = rendered(told, requirements=[asked], verdicts=[], coverage=NONE)
    (goal,) = found["G1"]["supportedBy"]
    assert found[goal]["alias"].startswith("requirement:")


def test_unknown_requirements_are_found_before_anything_runs(user):
    check_requirements(user(GOOD), ["SAF-1"])
    with pytest.raises(ConfigurationError, match="not part of the session") as caught:
        check_requirements(user(GOOD), ["SAF-2"])
    assert caught.value.line == 9
    assert caught.value.found == "requirement:SAF-1"
