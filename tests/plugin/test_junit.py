from __future__ import annotations

import json
from collections import Counter

import pytest
from junitparser import JUnitXml, Properties

from pytest_dura.evidence import LINE, junit_name, open_record
from pytest_dura.evidence.conclusions.verdicts import test_function as function_of
from pytest_dura.evidence.junit import junit_key, junit_outcomes, junit_verdicts
from pytest_dura.reports.story import document_of

RECKLESS = "--dura-generator=corridor:Reckless"
ON_EPISODES = """
import pytest

@pytest.mark.dura(scenario="corridor/tight", runs=3)
@pytest.mark.requirement("GAP-1")
@pytest.mark.requirement("OWN-1", text="Stays.", kind="security")
def test_each(episode):
    assert not episode.collided or episode.spec.run
"""
ON_CAMPAIGNS = """
import pytest

@pytest.mark.dura(scenario="corridor/tight", runs=4)
@pytest.mark.requirement("OWN-1", text="Rarely collides.", kind="security")
def test_rate(campaign):
    campaign.require("always (gap > 0)", at_most=0.9)

@pytest.mark.dura(scenario="corridor/tight", runs=4)
@pytest.mark.requirement("OWN-2", text="Nothing is asked.")
def test_silent(campaign):
    assert campaign.planned == 4

@pytest.mark.dura(scenario="corridor/tight", runs=4)
@pytest.mark.requirement("OWN-3", text="Two questions.")
def test_two(campaign):
    campaign.require("always (gap >= 0)")
    with pytest.raises(Exception):
        campaign.require("always (gap > 5)")

@pytest.fixture
def breaks():
    raise RuntimeError("no")

@pytest.mark.dura(scenario="corridor/tight", runs=4)
@pytest.mark.requirement("OWN-4", text="Never begins.")
def test_setup(breaks, campaign):
    pass
"""


class Results:
    """A JUnit file as a public reader sees it: properties of each test, in order."""

    def __init__(self, file):
        self.text = file.read_text()
        self.tests = {}
        for suite in JUnitXml.fromstring(self.text.encode()):
            for test in suite:
                pairs = [
                    (one.name, one.value)
                    for every in test.iterchildren(Properties)
                    for one in every
                ]
                self.tests[f"{test.classname}::{test.name}"] = pairs

    def of(self, test):
        """The properties of a test that has each name once."""
        pairs = self.tests[test]
        found = dict(pairs)
        assert len(found) == len(pairs)
        return found


@pytest.fixture
def junit(project):
    def run(*arguments):
        result = project.run("--junit-xml=junit.xml", *arguments)
        assert "INTERNALERROR" not in result.stdout.str() + result.stderr.str()
        return Results(project.path / "junit.xml")

    return run


def card_of(project):
    """The one card of the session."""
    (card,) = document_of(open_record(project.path / "dura-evidence/evidence.json")).cards
    return card


def by_words(record):
    """The verdicts of the record as a JUnit file tells them, per-episode tests apart."""
    found = {}
    for one in record.verdicts:
        key = junit_key(one.case, one.requirement, one.item)
        found.setdefault(key, []).append(one.verdict)
    return {key: tuple(sorted(words)) for key, words in found.items()}


def test_a_scenario_item_has_the_figures_of_its_verdict(junit, project):
    found = junit("--dura-scenarios", "--dura-select=corridor/tight", RECKLESS, "--dura-seed=7")
    told = found.of("corridor.tight::GAP-1")
    verdict = project.verdict("GAP-1", "corridor/tight")
    episode = project.evidence().episodes[0]
    assert told.pop("reason") == verdict.reason
    card = card_of(project)
    assert told.pop("card") == card.title
    assert told.pop("card_headline") == card.headline
    entries = {each.label: each for each in card.entries}
    finding = entries["GAP-1"]
    assert told.pop("card_GAP-1") == f"{finding.text} [{finding.code}]"
    assert told.pop("card_episode") == "corridor/tight#0"
    assert told.pop("card_replay") == told["replay"]
    assert (
        told.pop("card_rerun")
        == "pytest corridor/tight::GAP-1 --dura-generator=corridor:Reckless --dura-seed=7"
    )
    assert told.pop("card_next") == entries["next"].text
    assert told == {
        "item": "corridor/tight::GAP-1",
        "base_seed": "7",
        "requirement": "GAP-1",
        "kind": "safety",
        "case": "corridor/tight",
        "component": "Reckless",
        "verdict": "violated",
        "planned": "2",
        "run": "2",
        "valid": "2",
        "violations": "2",
        "open": "0",
        "without_effect": "0",
        "invalid": "0",
        "missing": "0",
        "vacuous": "0",
        "bound_upper": "1.0",
        "bound_confidence": "0.95",
        "bound_method": verdict.bound.method,
        "margin": str(verdict.margin),
        "counterexample": "corridor/tight#0",
        "counterexample_seed": str(episode.seed),
        "replay": "pytest --dura-replay='corridor/tight#0'",
    }


@pytest.mark.parametrize("mode", ["n2", "without xdist"], indirect=True)
def test_the_same_file_in_every_mode_and_family(junit, reference, mode):
    arguments = ["--dura-scenarios", "--dura-select=corridor/*", RECKLESS]
    plain = Results(reference("plain").path / "junit.xml").tests
    found = junit(*arguments, *mode, "-W", "error", "-o", "junit_family=xunit1")
    assert found.tests == plain
    assert len(plain) == 3
    assert 'file="scenarios/corridor/tight.yaml"' in found.text


def test_a_test_on_an_episode_names_it(junit, project):
    project.write("test_it.py", ON_EPISODES)
    found = junit("test_it.py", RECKLESS)
    pairs = found.tests["test_it::test_each[corridor/tight#0]"]
    episode = project.evidence().episodes[0]
    head, group = pairs[:7], pairs[7:]
    assert dict(head) == {
        "item": "test_it.py::test_each[corridor/tight#0]",
        "base_seed": "0",
        "episode": "corridor/tight#0",
        "seed": str(episode.seed),
        "digest": episode.digest,
        "validity": "valid",
        "replay": "pytest --dura-replay='corridor/tight#0' test_it.py",
    }
    names = [value for name, value in group if name == "requirement"]
    assert sorted(names) == ["GAP-1", "OWN-1"]
    assert ("kind", "security") in group
    assert [value for name, value in group if name == "episode_verdict"] == ["violated"] * 2
    outcomes = junit_outcomes(found.text)
    assert outcomes == {
        ("corridor/tight", "GAP-1", "test_it.py::test_each"): Counter(violated=3),
        ("corridor/tight", "OWN-1", "test_it.py::test_each"): Counter(satisfied=0, violated=3),
    }
    assert junit_verdicts(found.text) == {}
    for one in project.evidence().verdicts:
        counts = outcomes[junit_key(one.case, one.requirement, function_of(one.item))]
        assert (counts["violated"], counts.total()) == (one.violations, one.run)


def test_verdicts_are_those_of_the_record(junit, project):
    project.write("test_it.py", ON_CAMPAIGNS)
    arguments = ["--dura-scenarios", "--dura-select=corridor/*", "test_it.py"]
    found = junit(*arguments)
    verdicts = junit_verdicts(found.text)
    assert verdicts == by_words(project.evidence())
    case = "corridor/tight"
    assert verdicts[case, "OWN-1", "test_it.py::test_rate[corridor/tight]"] == ("supported",)
    assert verdicts[case, "OWN-2", "test_it.py::test_silent[corridor/tight]"] == ("undecided",)
    assert verdicts[case, "OWN-3", "test_it.py::test_two[corridor/tight]"] == (
        "supported",
        "violated",
    )
    assert verdicts[case, "OWN-4", "test_it.py::test_setup[corridor/tight]"] == ("undecided",)
    rate = found.of("test_it::test_rate[corridor/tight]")
    assert (rate["at_most"], rate["planned"]) == ("0.9", "4")
    assert 0.5 < float(rate["bound_upper"]) < 0.6


def test_a_violation_stands_whatever_a_rerun_finds(junit, project):
    project.write(
        "test_it.py",
        """
import pytest
ANSWERS = iter([False, True])

def holds_later(episode):
    return next(ANSWERS)

@pytest.mark.dura(scenario="corridor/tight", runs=1)
@pytest.mark.requirement("OWN-1", text="Flaky.")
def test_flaky(campaign):
    campaign.require(holds_later)
""",
    )
    found = junit("test_it.py", "-p", "rerunfailures", "--reruns=1")
    told = found.of("test_it::test_flaky[corridor/tight]")
    assert told["verdict"] == "violated"
    assert junit_verdicts(found.text) == by_words(project.evidence())
    first, second = (json.loads(told[f"attempt_{number}"]) for number in (1, 2))
    assert [each["outcome"] for each in (first, second)] == ["failed", "passed"]
    assert "OWN-1" in first["message"]
    assert first["verdicts"] == {"OWN-1": "violated"}
    assert second["message"] == ""
    assert first["seconds"] > 0
    assert "attempt_3" not in told


def test_an_item_that_ran_once_has_no_attempts(junit, project):
    found = junit("--dura-scenarios", "--dura-select=corridor/free")
    assert not any(
        name.startswith("attempt_") for pairs in found.tests.values() for name, _ in pairs
    )


def test_hostile_texts_come_out_harmless(junit, project):
    nasty = r"\0\x1b[31m\ud800\u202e<script>]]>&\n" + "x" * 10_000
    project.write(
        "test_it.py",
        f"""
import pytest

@pytest.mark.dura(scenario="corridor/tight", runs=2)
@pytest.mark.requirement("<R&1>\\n\\x1b\\ud800" + "i" * 1000, text="{nasty}")
def test_it(episode):
    assert False, "{nasty}"
""",
    )
    found = junit("test_it.py", "-n", "2")
    pairs = found.tests["test_it::test_it[corridor/tight#0]"]
    assert max(len(value) for _, value in pairs) <= LINE
    assert all(value.isprintable() for _, value in pairs)
    (name,) = [value for name, value in pairs if name == "requirement"]
    assert name.startswith(r"<R&1>\n\x1b\ud800iii")
    (outcome,) = list(junit_outcomes(found.text))
    (verdict,) = project.evidence().verdicts
    assert outcome == junit_key("corridor/tight", verdict.requirement, "test_it.py::test_it")


def test_tests_without_our_fixtures_have_nothing(junit, project):
    project.write(
        "test_it.py",
        "import pytest\n@pytest.mark.requirement('X-1', text='x')\ndef test_plain(): pass\n",
    )
    assert junit("test_it.py").tests == {"test_it::test_plain": []}


def test_names_that_differ_stay_different():
    assert junit_name("a" * 500) != junit_name("a" * 501)
    assert junit_key("a\n", "R", "i")[0] != junit_key("a", "R", "i")[0]


BOMB = '<!DOCTYPE a [<!ENTITY b "boom">]><testsuites><testsuite name="&b;"/></testsuites>'


@pytest.mark.parametrize(
    "xml, message",
    [
        (BOMB, "document type"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><testsuites/>', "document type"),
        ("<html/>", "<html>"),
        ("<testsuites>", "no XML"),
        ("\udc80", "no XML"),
    ],
    ids=["entities", "external", "other", "cut", "surrogate"],
)
def test_other_files_are_refused(xml, message):
    with pytest.raises(ValueError, match=message):
        junit_verdicts(xml)


def test_a_word_that_is_no_verdict_is_refused():
    xml = (
        '<testsuites><testcase><properties><property name="requirement" value="R"/>'
        '<property name="{}" value="fine"/></properties></testcase></testsuites>'
    )
    with pytest.raises(ValueError, match="fine"):
        junit_verdicts(xml.format("verdict"))
    with pytest.raises(ValueError, match="fine"):
        junit_outcomes(xml.format("episode_verdict"))
