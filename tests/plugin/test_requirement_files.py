"""Requirements as files define them: rates, methods, functions, globs, and what is refused."""

from __future__ import annotations

import pytest
from corridors import expect, requirement, scenario

RATES = """
requirements:
  - {id: FIX-1, text: t, kind: safety, check: always (gap > 0), at_most: 0.2, confidence: 0.9}
  - {id: SPRT-1, text: t, kind: safety, check: always (gap > 0), at_most: 0.3, method: sprt,
     p0: 0.01}
  - {id: E-1, text: t, kind: safety, check: always (gap > 0), at_most: 0.3, method: e-process}
  - {id: FUN-1, text: t, kind: safety, check: "checks:touches_nothing"}
  - {id: GLOB-1, text: t, kind: safety, check: "checks:half_a_metre", applies_to: ["corridor/i*"]}
  - {id: PAIR-1, text: t, kind: recovery, check: always (gap > 0),
     paired: {without: recovery_planner}}
  - id: PAIR-2
    text: It does not get much farther.
    kind: recovery
    paired: {without: recovery_planner, measure: "checks:farthest", change_at_most: 0.1}
"""


def write_all(project):
    project.write("scenarios/requirements_rates.yaml", RATES)
    scenario(
        project,
        runs=12,
        world="{wall: 4.0}",
        monitor="oddities:Early",
        recovery_planner="Brake",
        requirements="[FIX-1, SPRT-1, E-1, FUN-1, PAIR-1, PAIR-2]",
    )


@pytest.fixture
def rates(project, made_once):
    """What a session printed that judged them all, as items of their scenario."""

    def judged():
        write_all(project)
        return project.run("corridor/it")

    return made_once(project, "rates", judged)


def told(project):
    names = ("verdict", "method", "run", "saved", "margin", "bound", "pairs", "check", "reason")
    verdicts = project.evidence().verdicts
    return {one.requirement: {name: getattr(one, name) for name in names} for one in verdicts}


def test_every_kind_of_requirement_is_judged_alike_plain_and_distributed(project, rates):
    rates.assert_outcomes(passed=7)
    plain = told(project)
    assert {name: (one["verdict"], one["method"]) for name, one in plain.items()} == {
        "FIX-1": ("supported", "fixed"),
        "SPRT-1": ("supported", "sprt"),
        "E-1": ("supported", "e-process"),
        "FUN-1": ("supported", "every episode"),
        "GLOB-1": ("supported", "every episode"),
        "PAIR-1": ("supported", "every episode"),
        "PAIR-2": ("supported", "every episode"),
    }
    assert plain["FIX-1"]["bound"].confidence == 0.9
    assert plain["FIX-1"]["bound"].upper == pytest.approx(1 - 0.1 ** (1 / 12))
    assert plain["SPRT-1"]["saved"] > 0
    assert plain["FUN-1"]["margin"] is None
    assert plain["GLOB-1"]["margin"] == pytest.approx(3.0)
    assert plain["PAIR-2"]["pairs"].without == "recovery_planner"
    project.run("corridor/it", "-n", "2").assert_outcomes(passed=7)
    assert told(project) == plain


def test_a_requirement_of_the_file_is_what_a_test_may_ask_for(project, rates):
    project.write(
        "test_it.py",
        "import pytest\n"
        + "".join(
            f"@pytest.mark.dura(scenario='corridor/it')\n"
            f"@pytest.mark.requirement('{name}')\n"
            f"def test_{name[:3].lower()}(campaign): campaign.require()\n"
            for name in ("FIX-1", "SPRT-1", "PAIR-1")
        ),
    )
    items = told(project)
    project.run("test_it.py").assert_outcomes(passed=3)
    assert told(project) == {name: items[name] for name in ("FIX-1", "SPRT-1", "PAIR-1")}


@pytest.mark.parametrize(
    "check, word, margin, line",
    [
        ("touches_nothing", "violated", None, "worst:    corridor/it#0"),
        ("half_a_metre", "violated", -0.5, "worst:    corridor/it#0: the margin is -0.5"),
        (
            "in_words",
            "violated",
            -2.5,
            "worst:    corridor/it#0: the margin is -2.5, first at t = 0.50 s",
        ),
        ("never_concerned", "undecided", None, "(vacuous)"),
    ],
)
def test_what_a_check_function_returns(project, check, word, margin, line):
    requirement(project, f"checks:{check}")
    scenario(project, requirements="[R-1]", generator="Reckless", world="{wall: 1.0}")
    result = project.run("corridor/it")
    found = expect(project, result, word)
    assert (found.margin, found.check) == (margin, f"checks:{check}")
    assert line in result.stdout.str()
    card = " ".join(result.stdout.str().split())
    assert ("first at t = 0.50 s: too far." in card) == (check == "in_words")


@pytest.mark.parametrize(
    "check, cause",
    [
        ("raises", "LookupError: no such map (checks.py:"),
        ("nan", "ValueError: its margin is not a number (NaN)"),
        ("nothing", "TypeError: returned NoneType, not a truth value (bool), a margin (float)"),
        ("exits", "SystemExit: 3"),
        ("at_no_time", "ValueError: its time is not a number (NaN)"),
        ("holds_by_number", "TypeError: its `holds` is -2.5, not a truth value"),
        ("writes", "ValueError: assignment destination is read-only"),
    ],
)
def test_a_check_that_fails_is_infrastructure(project, check, cause):
    requirement(project, f"checks:{check}")
    scenario(project, requirements="[R-1, GAP-1]")
    result = project.run("corridor/it")
    found = expect(project, result, "undecided", "2 of 2 episodes are missing (infrastructure)")
    assert found.missing == 2
    expect(project, result, "supported", requirement="GAP-1", ret=1)
    message = result.stdout.str().partition("corridor/it::R-1 _")[2].splitlines()[1]
    assert message.startswith(f"infrastructure: check checks:{check}: {cause}")
    card = " ".join(result.stdout.str().partition("= dura =")[2].split())
    assert f"a role or the simulator failed: check checks:{check}: {cause}" in card


ENTRY = "requirements:\n  - id: R-1\n    text: t\n    kind: safety\n    {}\n"
BOTH = """check: always (gap > 0)
    paired: {without: recovery_planner, measure: checks:farthest, change_at_most: 1}"""


@pytest.mark.parametrize(
    "lines, told",
    [
        (
            "check: nowhere:check",
            ["*.yaml:5: cannot import 'nowhere:check'*", "*requirements.0.check"],
        ),
        (
            "check: checks:absent",
            ["*.yaml:5: cannot import 'checks:absent'*", "*requirements.0.check"],
        ),
        (
            "check: checks:of_two",
            [
                "*.yaml:5: checks:of_two cannot be called with an episode: *",
                "*a function of one ep*",
            ],
        ),
        (
            "paired: {without: recovery_planner, measure: checks:absent, change_at_most: 1}",
            ["*.yaml:5: cannot import 'checks:absent'*", "*requirements.0.paired.measure"],
        ),
        (
            "paired: {without: recovery_planner, measure: checks:farthest}",
            ["*.yaml:5: *`measure` and `change_at_most` go together*"],
        ),
        (
            BOTH,
            ["*.yaml:6: pairs are compared by a check or by a measure", "*paired.measure"],
        ),
        (
            "check: always (gap > 0)\n    paired: {without: recovery_planer}",
            ["*it.yaml:*: there is no role 'recovery_planer' to switch off", "*did you mean*"],
        ),
        (
            "check: always (gap > 0)\n    paired: {without: faults}",
            ["*it.yaml:*: the requirement 'R-1' compares runs with faults to runs without*"],
        ),
        ("check: always (gap > 0)\n    at_most: 1.5", ["*.yaml:6: *", "*requirements.0.at_most"]),
        (
            "check: always (gap > 0)\n    at_most: 0.1\n    confidence: 0.4",
            ["*.yaml:7: *", "*requirements.0.confidence"],
        ),
        (
            "check: always (gap > 0)\n    method: sprt",
            ["*.yaml:6: a method decides on a rate*", "*key:*requirements.0.method"],
        ),
        (
            "check: always (gap > 0)\n    at_most: 0.1\n    method: sprt\n    p0: 0.5",
            ["*.yaml:8: *", "*key:*requirements.0.p0"],
        ),
        (
            "check: always (gap > 0)\n    at_most: 0.1\n    method: magic",
            ["*.yaml:7: *", "*requirements.0.method", "*'magic'*"],
        ),
        ("check: always (gap > 3 m/s)", ["*.yaml:5: *", "    always (gap > 3 m/s)", "*^*"]),
        ("check: always[0:0.25] (gap > 0)", ["*.yaml:5: *", "*0.25*", "*^*"]),
        ("check: always (gap > 0", ["*.yaml:5: *", "*^*", "*requirements.0.check"]),
    ],
)
def test_a_requirement_that_cannot_be_used_is_one_error_at_its_place(project, lines, told):
    project.write("scenarios/requirements_R-1.yaml", ENTRY.format(lines))
    scenario(project, requirements="[R-1]")
    refused(project, project.scenarios(), told)


def refused(project, result, told):
    assert result.ret == 4
    result.stderr.fnmatch_lines(told)
    text = result.stdout.str() + result.stderr.str()
    assert text.count("ERROR") == 1
    assert "Traceback" not in text
    assert not (project.path / "dura-evidence").exists()


DRIVING = """
name: corridor/it
simulator: driving
duration: 1.0
requirements: [R-1]
"""


@pytest.mark.parametrize(
    "check, told",
    [
        ("always (gapp > 0)", ["unknown signal 'gapp'*", "    always (gapp > 0)", "            ^"]),
        ("always (percept.gapp > 0)", ["*percept.gapp*", "*^*"]),
        ("always[0:0.25] (gap > 0)", ["a bound of the window*", "*^*", "*write 0.2 or 0.3*"]),
    ],
    ids=["signal", "percept signal", "window"],
)
def test_an_unknown_signal_is_refused_before_anything_runs(project, check, told):
    requirement(project, check)
    project.write("scenarios/corridor/it.yaml", DRIVING)
    refused(
        project, project.scenarios(), [f"ERROR: *requirements_R-1.yaml:2: {told[0]}", *told[1:]]
    )


def test_an_unknown_requirement_names_the_one_that_was_meant(project):
    scenario(project, requirements="[GAP-2]")
    told = ["*it.yaml:*: unknown requirement 'GAP-2'", "*requirements.0", "*did you mean 'GAP-1'?"]
    refused(project, project.scenarios(), told)


def test_a_requirement_that_is_defined_twice_is_one_error(project):
    requirement(project, "always (gap > 1)", "GAP-1")
    told = ["*the requirement 'GAP-1' is defined twice", "*requirements.0.id", "*found:*"]
    refused(project, project.scenarios(), told)


def test_unused_requirements_are_named_at_collection(project):
    requirement(project, "always (gap > 0)")
    requirement(project, "always (gap > 0)", "R-2")
    project.write(
        "test_it.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/tight')\n"
        "@pytest.mark.requirement('R-2')\n"
        "def test_it(campaign): campaign.require()\n",
    )
    result = project.scenarios("test_it.py")
    line = "requirements_R-1.yaml:2: no scenario and no collected test uses the requirement 'R-1'"
    warnings = [one for one in result.outlines if "uses the requirement" in one]
    assert [one.endswith(line) for one in warnings] == [True]
    assert result.ret == 0


COUNTED = """
import os
from pathlib import Path


def {name}(episode):
    with Path("calls.txt").open("a") as calls:
        calls.write(f"{{os.getpid()}} {{episode.id}}\\n")
    return float(episode.signals["gap"].min())
"""
NOTING = """
import os
from pathlib import Path

def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        Path("session.txt").write_text(str(os.getpid()))
"""
ASKED_THRICE = """
import os

import pytest

@pytest.mark.dura(scenario="corridor/it", runs=4)
@pytest.mark.requirement("OWN-1")
def test_each_run(episode):
    assert episode.satisfies("always (gap > 0)")

@pytest.mark.dura(scenario="corridor/it", runs=4)
@pytest.mark.requirement("OWN-1")
def test_all_runs(campaign):
    campaign.require()
"""
OWN = """
requirements:
  - {{id: OWN-1, text: t, kind: safety, check: "{check}"}}
  - {{id: OWN-2, text: t, kind: recovery, check: "{check}", paired: {{without: recovery_planner}}}}
"""


@pytest.mark.parametrize(
    "module, mode, is_here",
    [
        ("counted", ["--dura-executor=in-process"], True),
        ("conftest", ["--dura-executor=processes:2"], False),
        ("counted", ["-n", "2"], False),
    ],
    ids=["in-process", "processes", "xdist"],
)
def test_an_own_check_is_called_once_an_episode(project, module, mode, is_here):
    """However many items ask, and where it was simulated."""
    check = f"is_clear_in_{module}"
    project.write(f"{module}.py", COUNTED.format(name=check))
    project.write("test_asked.py", ASKED_THRICE)
    project.write("scenarios/requirements_own.yaml", OWN.format(check=f"{module}:{check}"))
    asked = {"monitor": "oddities:Early", "world": "{wall: 3.4}", "recovery_planner": "Brake"}
    scenario(project, runs=4, requirements="[OWN-1, OWN-2, GAP-1]", **asked)
    project.write("noting.py", NOTING)
    # In a process where no earlier test has left a thread that a copy would lack.
    given = ["-p", "noting", "--alluredir=allure", *mode]
    result = project.run_apart("corridor/it", "test_asked.py", *given)
    result.assert_outcomes(passed=8)
    calls = [line.split() for line in (project.path / "calls.txt").read_text().splitlines()]
    cases = ("corridor/it", "corridor/it~recovery_planner")
    expected = [f"{case}#{run}" for case in cases for run in range(4)]
    assert sorted(episode for _, episode in calls) == expected
    session = (project.path / "session.txt").read_text()
    assert {process == session for process, _ in calls} == {is_here}


def test_a_check_that_changed_is_called_again_on_episodes_that_a_session_takes_over(project):
    holds = "def holds(episode):\n    return {}\n"
    project.write("changing.py", holds.format(True))
    requirement(project, "changing:holds")
    scenario(project, "a", requirements="[R-1]")
    scenario(project, "b", requirements="[GAP-1]", generator="Reckless", world="{wall: 0.4}")
    scenario(project, "c", requirements="[GAP-1]")
    names = "corridor/a", "corridor/b", "corridor/c"
    assert project.run_apart(*names, "-x").ret == 1
    assert project.verdicts() == {
        ("corridor/a", "R-1"): "supported",
        ("corridor/b", "GAP-1"): "violated",
        ("corridor/c", "GAP-1"): "undecided",
    }
    project.write("changing.py", holds.format(False))
    project.run_apart(*names, "--dura-resume")
    assert project.verdicts()["corridor/a", "R-1"] == "violated"
