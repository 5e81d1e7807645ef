"""What excuses a failure is recorded as a waiver, beside the verdict; every attempt is kept."""

from __future__ import annotations

import pytest
from corridors import expect, scenario
from entries import make

from pytest_dura.evidence.item_verdicts import Waiver
from pytest_dura.requirements.campaign_verdicts import UncountedEpisode

CAMPAIGN_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
@pytest.mark.xfail(reason="ticket 7"{strict})
def test_it(campaign):
    campaign.require()
"""
EPISODE_TEST = """
import pytest

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
@pytest.mark.xfail(reason="ticket 7")
def test_it(episode):
    assert not episode.collided
"""
WAIVER = make(Waiver, kind="xfail", reason="ticket 7")
RECKLESS = {"generator": "Reckless", "world": "{wall: 1.0}"}


@pytest.mark.parametrize("strict", ["", ", strict=True"], ids=["not strict", "strict"])
@pytest.mark.parametrize(
    "situation, word",
    [(RECKLESS, "violated"), ({"world": "{breaks_at: 2}"}, "undecided")],
    ids=["violated", "undecided"],
)
def test_an_expected_failure_is_recorded_as_a_waiver(project, situation, word, strict):
    scenario(project, **situation)
    project.write("test_it.py", CAMPAIGN_TEST.format(strict=strict))
    result = project.run("test_it.py")
    result.assert_outcomes(xfailed=1)
    found = expect(project, result, word, requirement="GAP-1", ret=0)
    assert found.waiver == WAIVER
    assert "[xfail]" in result.stdout.str().partition("= dura =")[2]


def test_an_expected_failure_of_tests_on_one_episode(project):
    scenario(project, **RECKLESS)
    project.write("test_it.py", EPISODE_TEST)
    result = project.run("test_it.py")
    result.assert_outcomes(xfailed=2)
    found = expect(project, result, "violated", requirement="GAP-1", ret=0)
    assert (found.violations, found.waiver) == (2, WAIVER)


def test_a_strict_xfail_that_passes_fails(project):
    scenario(project)
    project.write("test_it.py", CAMPAIGN_TEST.format(strict=", strict=True"))
    result = project.run("test_it.py")
    result.assert_outcomes(failed=1)
    expect(project, result, "supported", requirement="GAP-1", ret=1)


def test_an_xfail_that_passes_is_supported_and_its_waiver_is_kept(project):
    scenario(project)
    project.write("test_it.py", CAMPAIGN_TEST.format(strict=""))
    result = project.run("test_it.py")
    result.assert_outcomes(xpassed=1)
    found = expect(project, result, "supported", requirement="GAP-1", ret=0)
    assert found.waiver == WAIVER


def test_a_skip_inside_a_test_on_an_episode_is_no_pass(project):
    scenario(project)
    body = "if episode.spec.run == 1: pytest.skip('too cold')"
    text = EPISODE_TEST.replace("assert not episode.collided", body)
    project.write("test_it.py", text.replace('@pytest.mark.xfail(reason="ticket 7")\n', ""))
    result = project.run("test_it.py")
    result.assert_outcomes(passed=1, skipped=1)
    reason = "1 of 2 episodes are invalid"
    found = expect(project, result, "undecided", reason, requirement="GAP-1", ret=1)
    assert found.first_uncounted == make(
        UncountedEpisode, episode="corridor/it#1", verdict="invalid", detail="too cold"
    )
    assert "the gate fails: GAP-1 on corridor/it is undecided, though" in result.stdout.str()


@pytest.mark.parametrize(
    "word, ret, told",
    [
        ("skip('too cold')", 1, "the gate fails: GAP-1 on corridor/it is undecided, though"),
        ("exit('enough', returncode=0)", 2, "gate: incomplete"),
    ],
)
def test_a_test_on_a_campaign_that_ends_before_its_verdict_is_no_pass(project, word, ret, told):
    scenario(project)
    text = CAMPAIGN_TEST.replace("campaign.require()", f"pytest.{word}")
    project.write("test_it.py", text.replace('@pytest.mark.xfail(reason="ticket 7"{strict})\n', ""))
    result = project.run("test_it.py")
    expect(project, result, "undecided", requirement="GAP-1", ret=ret)
    assert told in result.stdout.str()


@pytest.mark.parametrize("text", [CAMPAIGN_TEST, EPISODE_TEST], ids=["campaign", "episode"])
def test_a_test_that_is_skipped_is_recorded_as_a_waiver(project, text):
    scenario(project)
    text = text.replace("{strict}", "").replace("xfail(reason", "skip(reason")
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    found = expect(project, result, "undecided", requirement="GAP-1", ret=0)
    assert found.waiver == make(Waiver, kind="skip", reason="Skipped: ticket 7")
    assert (found.planned, found.run) == (2, 0)


def test_a_skip_after_a_verdict_does_not_hide_it(project):
    scenario(project, **RECKLESS)
    body = "try: campaign.require()\n    except Exception: pytest.skip('never mind')"
    text = CAMPAIGN_TEST.replace("campaign.require()", body)
    project.write("test_it.py", text.replace('@pytest.mark.xfail(reason="ticket 7"{strict})\n', ""))
    result = project.run("test_it.py")
    result.assert_outcomes(skipped=1)
    expect(project, result, "violated", requirement="GAP-1", ret=1)


RERUN = ["-p", "rerunfailures", "--reruns", "1", "-p", "no:xdist"]
RETRIED = make(Waiver, kind="rerun", reason="the item was run again")
PLUGINS = {
    "rerunfailures": ["-p", "rerunfailures", "--reruns", "2"],
    "flaky": ["-p", "flaky", "--force-flaky", "--max-runs", "3"],
    "pytest-retry": ["-p", "pytest-retry", "--retries", "2"],
}
"""Options with which each of these plugins runs a test at most three times."""
FAILS_FIRST = """
import pytest

TRIES = []

@pytest.fixture
def attempt(request):
    TRIES.append(request.node.name)
    return TRIES.count(request.node.name)

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_episode(episode, attempt):
    assert not episode.collided
    assert attempt == 3, "flaky"

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("OWN-1", text="Keeps away.")
def test_campaign(campaign, attempt):
    campaign.require(lambda episode: episode.signals["gap"].min() - (0 if attempt == 3 else 99))
"""


@pytest.fixture(params=list(PLUGINS))
def retrying(request):
    return PLUGINS[request.param]


@pytest.mark.parametrize("first, second", [(5, 0), (0, 5)], ids=["then passes", "passed before"])
def test_a_rerun_keeps_every_attempt_of_a_campaign(project, first, second):
    scenario(project, runs=1, world="{wall: 4.0}")
    project.write(
        "test_it.py",
        "import pytest\n"
        "LIMITS = []\n"
        "@pytest.mark.dura(scenario='corridor/it')\n"
        "@pytest.mark.requirement('OWN-1', text='Keeps away.')\n"
        "def test_it(campaign):\n"
        f"    LIMITS.append({first} if not LIMITS else {second})\n"
        "    campaign.require(lambda one: one.signals['gap'].min() - LIMITS[-1])\n"
        f"    assert len(LIMITS) == 2 or {first} == 5, 'once more'\n",
    )
    result = project.run("test_it.py", *RERUN)
    found = expect(project, result, "violated", requirement="OWN-1", ret=0 if first else 1)
    assert found.waiver == (RETRIED if first else None)
    assert {attempt.verdict for attempt in found.attempts} == {"supported", "violated"} - {
        found.verdict
    }
    assert "1 rerun" in result.stdout.str()


def test_a_violation_in_any_attempt_at_an_episode_counts(project):
    scenario(project)
    body = "FAILED.append(episode.id)\n    assert FAILED.count(episode.id) > 1, 'flaky'"
    text = EPISODE_TEST.replace("assert not episode.collided", body)
    text = text.replace('@pytest.mark.xfail(reason="ticket 7")\n', "")
    project.write("test_it.py", text.replace("import pytest\n", "import pytest\nFAILED = []\n"))
    result = project.run("test_it.py", *RERUN)
    result.assert_outcomes(passed=2)
    found = expect(project, result, "violated", requirement="GAP-1", ret=0)
    assert (found.planned, found.run, found.violations) == (2, 2, 2)
    assert found.waiver.kind == "rerun"
    assert "[rerun]" in result.stdout.str().partition("= dura =")[2]


def test_a_retried_failure_is_a_waiver_whatever_plugin_retries(project, retrying):
    scenario(project)
    project.write("test_it.py", FAILS_FIRST)
    result = project.run_apart("test_it.py", *retrying, "-n", "2")
    assert result.ret == 0
    for requirement in ("GAP-1", "OWN-1"):
        verdict = project.verdict(requirement)
        assert (verdict.verdict, verdict.violations, verdict.waiver) == ("violated", 2, RETRIED)
        assert [attempt.verdict for attempt in verdict.attempts] == ["violated", "supported"]
    result.stdout.fnmatch_lines(["gate: passed, 2 violated, 2 waived"])


def test_a_test_that_is_run_again_after_its_worker_died_is_a_waiver(project):
    scenario(project)
    project.write(
        "test_it.py",
        "import os, pathlib, pytest, signal\n"
        "@pytest.mark.dura(scenario='corridor/it')\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_it(campaign):\n"
        "    campaign.require()\n"
        "    if not pathlib.Path('died').exists():\n"
        "        pathlib.Path('died').touch()\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n",
    )
    result = project.run_apart("test_it.py", *RERUN[:4], "-n", "1", "--dist", "worksteal")
    assert result.ret == 0
    verdict = project.verdict("GAP-1")
    assert (verdict.verdict, verdict.waiver.kind) == ("supported", "rerun")


def test_a_retry_that_fails_each_time_is_no_waiver(project, retrying):
    scenario(project)
    project.write("test_it.py", FAILS_FIRST.replace("attempt == 3", "attempt == 4"))
    result = project.run_apart("test_it.py", *retrying)
    assert result.ret == 1
    for requirement in ("GAP-1", "OWN-1"):
        verdict = project.verdict(requirement)
        assert (verdict.verdict, verdict.waiver) == ("violated", None)
        assert [attempt.verdict for attempt in verdict.attempts] == ["violated"] * 2
    result.stdout.fnmatch_lines(["gate: failed, 2 violated"])


def test_an_attempt_that_asks_for_no_verdict_is_no_pass(project, retrying):
    scenario(project)
    asks = "if attempt == 1:\n        campaign.require("
    project.write("test_it.py", FAILS_FIRST.replace("campaign.require(", asks))
    result = project.run_apart("test_it.py", *retrying, "-k", "campaign")
    assert result.ret == 1
    verdict = project.verdict("OWN-1")
    assert (verdict.verdict, verdict.waiver, verdict.attempts) == ("violated", None, ())


def test_attempts_that_all_pass_need_no_waiver(project):
    scenario(project)
    project.write("test_it.py", FAILS_FIRST.replace("attempt == 3", "attempt"))
    result = project.run_apart("test_it.py", *PLUGINS["flaky"], "--min-passes", "2")
    result.assert_outcomes(passed=3)
    for requirement in ("GAP-1", "OWN-1"):
        verdict = expect(project, result, "supported", requirement=requirement)
        assert verdict.waiver is None
        assert [attempt.verdict for attempt in verdict.attempts] == ["supported"]


def test_a_rerun_of_a_scenario_item_is_recorded(project, retrying):
    scenario(project, **RECKLESS)
    result = project.run_apart("corridor/it::GAP-1", *retrying)
    assert result.ret == 1
    verdict = project.verdict("GAP-1")
    assert (verdict.verdict, verdict.waiver) == ("violated", None)
    assert [attempt.verdict for attempt in verdict.attempts] == ["violated"] * 2


REPEATED = """
import pytest

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("GAP-1")
def test_episode(episode, request):
    assert not episode.collided
    assert "2-3" not in request.node.name or {steady}

@pytest.mark.dura(scenario="corridor/it")
@pytest.mark.requirement("OWN-1", text="Keeps away.")
def test_campaign(campaign, request):
    limit = 99 if "2-3" in request.node.name and not {steady} else 0
    campaign.require(lambda episode: episode.signals["gap"].min() - limit)
"""


def test_repeats_of_a_test_are_one_verdict(project):
    scenario(project, requirements="[GAP-1]")
    project.write("test_it.py", REPEATED.format(steady=True))
    scenarios = "--dura-scenarios", "--dura-select=corridor/it"
    result = project.run_apart("test_it.py", "--count", "3", "-n", "2", *scenarios)
    result.assert_outcomes(passed=10)
    result.stdout.fnmatch_lines(["gate: passed, 3 supported"])
    repeated = [
        verdict for verdict in project.evidence().verdicts if verdict.item.startswith("test_it")
    ]
    for verdict in repeated:
        assert (verdict.planned, verdict.run, verdict.waiver) == (2, 2, None)
        assert [attempt.verdict for attempt in verdict.attempts] == ["supported"] * 2


def test_of_repeats_that_disagree_the_worst_counts_and_is_not_waived(project):
    scenario(project)
    project.write("test_it.py", REPEATED.format(steady=False))
    result = project.run_apart("test_it.py", "--count", "3", "-n", "2")
    result.assert_outcomes(passed=6, failed=3)
    for requirement in ("GAP-1", "OWN-1"):
        verdict = expect(project, result, "violated", requirement=requirement)
        assert (verdict.run, verdict.waiver) == (2, None)
        assert [attempt.verdict for attempt in verdict.attempts] == ["supported"] * 2


BY_FIXTURE = """
@pytest.fixture(autouse=True, params=[0, 99])
def given(request):
    global limit
    limit = request.param
"""


@pytest.mark.parametrize(
    "given, arguments",
    [
        ("@pytest.mark.parametrize('limit', [0, 99])", "campaign, limit"),
        (BY_FIXTURE, "campaign"),
    ],
    ids=["argument", "fixture"],
)
def test_parameters_of_a_test_are_no_repeats(project, given, arguments):
    scenario(project)
    project.write(
        "test_it.py",
        f"import pytest\n\n{given}\n"
        "@pytest.mark.dura(scenario='corridor/it')\n"
        "@pytest.mark.requirement('OWN-1', text='Keeps away.')\n"
        f"def test_campaign({arguments}):\n"
        "    campaign.require(lambda episode: episode.signals['gap'].min() - limit)\n",
    )
    result = project.run("test_it.py", "-p", "no:xdist", "--count", "2")
    result.assert_outcomes(passed=2, failed=2)
    verdicts = [verdict.verdict for verdict in project.evidence().verdicts]
    assert sorted(verdicts) == ["supported", "violated"]
