"""``campaign.falsify`` and the marker ``falsify``, in sessions of their own."""

from __future__ import annotations

import re

import yaml
from outputs import output, shown_of

from pytest_dura.core.codec import encode
from pytest_dura.evidence import verify_bundle
from pytest_dura.requirements.searches import ReplayCount

HASTY = """
from corridor import Careful
from pytest_dura import Proposal

class Hasty(Careful):
    \"\"\"Blind where the wall is 10.6 to 10.8 m away at first, or gap is reported too large.\"\"\"

    def reset(self, context):
        super().reset(context)
        self.first = None

    def propose(self, view):
        gap = view.percept["gap"]
        self.first = self.first or gap
        return Proposal(90.0 if {condition} else 1.0 if gap > 3.0 else 0.0)

class Mended(Careful):
    pass
"""
WINDOW = "10.6 <= self.first <= 10.8"
RARE = "self.first >= 10.5 and gap < 9.3"

SEARCH = """
import pytest

@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
def test_it(campaign):
    campaign.falsify({arguments})
"""


def hasty(project, condition=WINDOW, arguments="budget=60", generator="hasty:Hasty"):
    project.write("hasty.py", HASTY.format(condition=condition))
    project.write("test_search.py", SEARCH.format(arguments=arguments))
    return ["test_search.py", f"--dura-generator={generator}"]


def found_files(project):
    return sorted(project.path.glob("scenarios/found/*.yaml"))


def the_search(project):
    (one,) = project.evidence().searches
    return one


def test_what_is_found_is_confirmed_kept_and_run_from_then_on(project):
    free = project.path / "scenarios/corridor/free.yaml"
    free.write_text(free.read_text().replace("max: 11.0}", "max: 11.0, unit: m}"))
    result = project.run(*hasty(project))
    assert result.ret == 1
    (file,) = found_files(project)
    search = the_search(project)
    (outcome,) = search.outcomes
    counterexample = outcome.counterexample
    assert outcome.status == "falsified"
    (wall,) = counterexample.changes[:1]
    assert (wall.path, wall.unit, search.parameters[0].unit) == ("world.wall", "m", "m")
    assert re.search(r"inputs: +world.wall: 10.[67]\d* instead of [\d.]+ m\n", output(result))
    assert counterexample.repeats == ReplayCount(1, 1, 1)
    assert counterexample.file == f"scenarios/found/{file.name}"
    assert (
        f"kept:      scenarios/found/{file.name}, which --dura-scenarios runs from now on"
        in output(result)
    )
    kept = yaml.safe_load(file.read_text())
    assert 10.6 <= kept["world"]["wall"] <= 10.8
    assert kept["requirements"] == ["GAP-1"]
    assert verify_bundle(project.path / "dura-evidence").problems == []

    again = project.scenarios("--dura-generator=hasty:Hasty", select="found/*")
    assert again.ret == 1
    assert project.verdict("GAP-1", kept["name"]).verdict == "violated"
    mended = project.run(f"{kept['name']}::GAP-1", "--dura-generator=hasty:Mended")
    assert mended.ret == 0
    assert project.verdict("GAP-1", kept["name"]).verdict == "supported"


def test_what_finds_nothing_passes_and_claims_nothing(project):
    result = project.run(*hasty(project, arguments="budget=20", generator="hasty:Mended"))
    assert result.ret == 0
    assert found_files(project) == []
    record = project.evidence()
    (outcome,) = the_search(project).outcomes
    assert (outcome.status, outcome.simulations) == ("nothing found", 20)
    assert record.verdicts == []
    assert record.episodes == []
    text = output(result)
    assert "nothing found in 20 simulations" in text
    assert not {"safe", "supported", "holds"} & set(text.split())
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_a_surrogate_takes_part_where_it_is_asked_for(project):
    arguments = "budget=60, surrogate=True"
    result = project.run(*hasty(project, arguments=arguments, generator="hasty:Mended"))
    assert result.ret == 0
    search = the_search(project)
    assert "a surrogate, a Gaussian process" in search.rule
    counts = {each.name: each for each in search.searchers}
    assert counts["surrogate"].simulations >= 4
    assert not counts["surrogate"].trivial
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_the_marker_searches_before_the_body(project):
    hasty(project)
    project.write(
        "test_search.py",
        """
import pytest

@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
@pytest.mark.falsify(budget=60, shrink=0)
def test_it(campaign):
    raise AssertionError("the body ran")
""",
    )
    result = project.run("test_search.py", "--dura-generator=hasty:Hasty")
    assert result.ret == 1
    assert "falsified: GAP-1 on corridor/free (Hasty)" in output(result)
    assert "the body ran" not in output(result)
    result = project.run("test_search.py", "--dura-generator=hasty:Mended")
    assert "the body ran" in output(result)


REFUSED = [
    (None, "falsify()", "", "looks at no campaign"),
    ("free", "falsify()", "episode", "looks at no campaign"),
    ("free", "falsify(bugdet=3)", "campaign", "did you mean 'budget'"),
    ("free", "falsify('GAP-1', budget=0)", "campaign", "budget is a whole number of at least"),
    ("free", "falsify('GAP-1', surrogate=1)", "campaign", "a surrogate takes part in a search, or"),
    ("tight", "falsify('GAP-1')", "campaign", "nothing to search in the case 'corridor/tight'"),
    ("free", "falsify('GAP-9')", "campaign", "unknown requirement 'GAP-9'"),
    ("free", "falsify()", "campaign", "there is no requirement to search a violation of"),
    ("free", "falsify([])", "campaign", "the search is asked for nothing"),
    ("free", "falsify(7)", "campaign", "this is nothing that an episode could violate"),
    ("free", "falsify('always (gap > )')", "campaign", "always (gap > )"),
    ("free", "falsify('GAP-1', faults='no-fault')", "campaign", "unknown fault 'no-fault'"),
    ("free", None, "campaign", "this names no faults", "'GAP-1', faults=7"),
    ("free", None, "campaign", "the seed of a search is a whole number", "'GAP-1', seed='a'"),
    ("free", None, "campaign", "the seed of a search is a whole number", "'GAP-1', seed=1.5"),
]
"""Scenario, marker, fixture, what is said; and what a call in the test is given instead."""


def test_a_search_that_cannot_be_made_is_one_clear_error(project):
    text = "import pytest\n"
    for n, (scenario, marker, fixture, _, *called) in enumerate(REFUSED):
        text += f'@pytest.mark.dura(scenario="corridor/{scenario}")\n' if scenario else ""
        text += f"@pytest.mark.{marker}\n" if marker else ""
        body = f"campaign.falsify({called[0]})" if called else "pass"
        text += f"def test_{n}({fixture}): {body}\n"
    project.write("test_search.py", text)
    result = project.run("test_search.py")
    assert result.ret != 0
    shown = shown_of(result)
    for n, (_, _, _, told, *_) in enumerate(REFUSED):
        assert told in str(shown[f"test_{n}"])
    assert "Traceback" not in output(result)
    assert "TypeError" not in output(result)


def test_a_violation_that_does_not_repeat_is_told_with_its_rate_and_not_kept(project):
    project.write(
        "moody.py",
        """
from corridor import Careful
from pytest_dura import Proposal

class Moody(Careful):
    count = 0

    def reset(self, context):
        super().reset(context)
        type(self).count += 1
        self.bad = type(self).count % 3 == 0

    def propose(self, view):
        return Proposal(9.0 + self.count / 100) if self.bad else super().propose(view)
""",
    )
    project.write("test_search.py", SEARCH.format(arguments="budget=30"))
    # One process counts, which is asked for one simulation after the other.
    given = ["--dura-generator=moody:Moody", "--dura-executor=in-process"]
    result = project.run("test_search.py", *given)
    assert result.ret == 1
    (outcome,) = the_search(project).outcomes
    repeats = outcome.counterexample.repeats
    assert outcome.status == "not repeatable"
    assert (repeats.runs, repeats.equal) == (10, 0)
    assert repeats.violated in (3, 4)
    assert f"and in {repeats.violated} of 10 replays, 0 of them equal" in output(result)
    assert found_files(project) == []
    assert outcome.counterexample.shrinking is None


def test_a_swallowed_violation_fails_the_gate(project):
    hasty(project)
    project.write(
        "test_search.py",
        """
import pytest
from pytest_dura import Falsified

@pytest.mark.dura(scenario="corridor/free")
def test_it(campaign):
    with pytest.raises(Falsified):
        campaign.falsify("GAP-1", budget=60, shrink=0)
""",
    )
    result = project.run("test_search.py", "--dura-generator=hasty:Hasty")
    assert result.ret == 1
    assert project.evidence().gate.result == "failed"


def test_a_check_that_no_file_defines_is_kept_with_a_requirement_of_its_own(project):
    arguments = hasty(project, arguments='"always (gap > 0.01)", budget=60')
    assert project.run(*arguments).ret == 1
    (file,) = found_files(project)
    (name,) = yaml.safe_load(file.read_text())["requirements"]
    (other,) = sorted(project.path.glob("scenarios/found/requirements/*.yaml"))
    (entry,) = yaml.safe_load(other.read_text())["requirements"]
    assert (entry["id"], entry["check"]) == (name, "always (gap > 0.01)")
    scenario = yaml.safe_load(file.read_text())["name"]
    result = project.run(f"{scenario}::{name}", "--dura-generator=hasty:Hasty")
    assert result.ret == 1
    assert project.run(f"{scenario}::{name}", "--dura-generator=hasty:Mended").ret == 0


def test_episodes_that_may_end_early_are_found_and_kept_all_the_same(project):
    file = project.path / "scenarios/corridor/free.yaml"
    file.write_text(file.read_text() + "end_at_violation: true\n")
    arguments = hasty(project, arguments='"always (gap > 0.01)", budget=60')
    assert project.run(*arguments).ret == 1
    (outcome,) = the_search(project).outcomes
    assert outcome.status == "falsified"
    assert len(found_files(project)) == 1


def test_several_requirements_are_searched_at_once(project):
    arguments = hasty(project, arguments='["GAP-1", "always (x < 9.9)"], budget=60, shrink=0')
    project.run(*arguments)
    search = the_search(project)
    assert [one.status for one in search.outcomes] == ["falsified", "falsified"]
    assert search.simulations == max(one.simulations for one in search.outcomes)


def test_what_is_found_does_not_depend_on_who_simulates(project):
    told = []
    for executor in ("in-process", "processes:2"):
        project.run(*hasty(project, RARE), f"--dura-executor={executor}")
        (outcome,) = the_search(project).outcomes
        counterexample = encode(outcome.counterexample)
        told.append((outcome.simulations, outcome.searcher, counterexample))
    assert told[0] == told[1]


def test_faults_that_never_act_leave_the_search_undecided(project):
    late = '{"type": "bias", "target": "gap", "activation": {"when": "time > 1000"}}'
    injector = '"pytest_dura.faults.injector:CampaignInjector"'
    file = project.path / "scenarios/corridor/free.yaml"
    text = file.read_text().replace("roles: {", f"roles: {{fault_injector: {injector}, ")
    file.write_text(text)
    arguments = f"budget=20, faults=[{late}]"
    result = project.run(*hasty(project, arguments=arguments, generator="hasty:Mended"))
    assert result.ret == 1
    search = the_search(project)
    assert search.outcomes[0].status == "undecided"
    assert search.unknown == search.not_manifested > 4
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_where_nothing_can_be_simulated_the_search_says_so(project):
    project.write(
        "scenarios/corridor/broken.yaml",
        """
name: corridor/broken
simulator: corridor:Corridor
duration: 2.0
world: {wall: 10.0, breaks_at: 3}
variation: {world.wall: {min: 9.0, max: 11.0}}
roles: {generator: "corridor:Careful"}
requirements: [GAP-1]
""",
    )
    text = SEARCH.format(arguments="budget=10").replace("corridor/free", "corridor/broken")
    project.write("test_search.py", text)
    result = project.run("test_search.py")
    assert result.ret == 1
    (outcome,) = the_search(project).outcomes
    assert outcome.status == "undecided"
    assert "searched: 10 of 10 simulations, 10 without an answer" in output(result)


def test_what_cannot_be_kept_is_found_all_the_same(project):
    project.write("scenarios/found", "a file where the folder would be")
    result = project.run(*hasty(project, arguments="budget=60, shrink=0"))
    assert result.ret == 1
    (outcome,) = the_search(project).outcomes
    assert (outcome.status, outcome.counterexample.file) == ("falsified", None)
    assert "falsified: GAP-1 on corridor/free" in output(result)
    assert "not kept: " in output(result)
    assert "a counterexample cannot be kept" in output(result)


FADING = """
from corridor import Careful
from pytest_dura import Proposal

class Fading(Careful):
    '''Drives into the wall, and from the third time on at the same wall a little slower.'''

    times = {}

    def reset(self, context):
        super().reset(context)
        wall = context.scenario["world"]["wall"]
        self.times[wall] = self.times.get(wall, 0) + 1
        self.slower = 0.1 * (self.times[wall] > 2)

    def propose(self, view):
        return Proposal(9.0 - self.slower)
"""


def test_a_file_that_brings_up_another_margin_is_not_kept(project):
    project.write("fading.py", FADING)
    check = "'always (x < 5)', budget=60, shrink=0"
    project.write("test_search.py", SEARCH.format(arguments=check))
    # One process counts how often it was asked.
    given = ["--dura-generator=fading:Fading", "--dura-executor=in-process"]
    result = project.run("test_search.py", *given)
    assert result.ret == 1
    (outcome,) = the_search(project).outcomes
    assert (outcome.status, outcome.counterexample.file) == ("falsified", None)
    assert "does not come up again from its file" in output(result)
    assert found_files(project) == []


def test_a_check_that_no_file_can_name_is_falsified_and_said_not_to_be_kept(project):
    check = "lambda episode: episode.signals['gap'].min() - 0.01, budget=60, shrink=0"
    result = project.run(*hasty(project, arguments=check))
    (outcome,) = the_search(project).outcomes
    assert outcome.status == "falsified"
    assert "no file can name this check" in output(result)
    assert found_files(project) == []


def test_nothing_is_kept_where_no_session_would_look(project):
    project.write(
        "pytest.ini",
        "[pytest]\npythonpath = .\ndura_scenario_paths = scenarios/corridor/free.yaml "
        "scenarios/requirements.yaml\n",
    )
    result = project.run(*hasty(project, arguments="budget=60, shrink=0"))
    assert "there is no folder of scenarios that a counterexample could be kept in" in output(
        result
    )
    assert found_files(project) == []


def test_a_search_adds_faults_where_no_role_is_named_to_inject_them(project):
    bias = "{'type': 'bias', 'target': 'gap', 'activation': {'at': 0.0}}"
    project.run(*hasty(project, condition="gap > 11", arguments=f"budget=60, faults={bias}"))
    (outcome,) = the_search(project).outcomes
    assert outcome.status == "falsified"
    (file,) = found_files(project)
    assert [fault["type"] for fault in yaml.safe_load(file.read_text())["faults"]] == ["bias"]


def test_a_search_that_adds_faults_needs_the_injector(project):
    file = project.path / "scenarios/corridor/free.yaml"
    file.write_text(file.read_text().replace("roles: {", "roles: {fault_injector: null, "))
    bias = "{'type': 'bias', 'target': 'gap', 'activation': {'at': 0.0}}"
    result = project.run(*hasty(project, arguments=f"faults={bias}"))
    assert result.ret == 1
    assert "for no role injects any" in output(result)
    assert "leave `fault_injector: null` out" in output(result)
