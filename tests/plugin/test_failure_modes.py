"""Failure modes that a component's own accounts show: from a scenario file to every report."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from stated_counts import stated_counts

from pytest_dura.evidence import SessionRecord, verify_bundle
from pytest_dura.evidence.verify import conclusion_problems

CHATTY = '''
"""Components that tell how they came to their proposals."""
from pytest_dura import Generator, Proposal
from pytest_dura.core.roles import RoleContext


class Chatty(Generator):
    """Decides each 0.5 s, on the world of 0.2 s before. With an odd seed it cites a phantom."""

    def reset(self, context: RoleContext):
        self.phantom = ["V99"] if context.seed % 2 else ["WALL"]

    def propose(self, view):
        fresh = view.index % 5 == 0
        at = max(view.index - view.index % 5 - 2, 0)  # it takes two ticks to decide
        told = {"decided": fresh, "at": at, "age": (view.index - at) / 10, "outcome": "answered",
                "fallback": False, "perceived": ["WALL"], "cited": self.phantom,
                "intent": "speed_up", "maneuver": "proceed"}
        if fresh:
            answered = {"outcome": "answered", "maneuver": "proceed"}
            told |= {"seconds": 0.25, "beside": {"conflict": answered, "blind": answered}}
            null = {"cited": [], "intent": "hold", "maneuver": "wait", "outcome": "answered"}
            told["null"] = null | {"beside": {"conflict": {"maneuver": "wait"}}}
        return Proposal("proceed", account=told)


class Silent(Generator):
    def propose(self, view):
        return Proposal("proceed")
'''
SCENARIO = """
name: talk/{name}
simulator: driving
duration: 1.5
runs: 4
world: {{ego: {{speed: 5.0, distance: 60.0}}}}
variation: {{world.ego.distance: {{min: 60.0, max: 61.0}}}}
roles: {{generator: "chatty:{generator}"}}
requirements: [{requirements}]
"""
REQUIREMENTS = """
requirements:
  - id: CITE-1
    text: It never cites what it was not shown.
    kind: safety
    check: always (proposal.threat_ids_unperceived < 0.5 and proposal.age <= 0.6)
  - {id: BOTH-1, text: t, kind: safety,
     check: always (speed < 0.5) and always (proposal.fallback < 0.5)}
"""


def prepare(project, *scenarios):
    """The project with these scenarios: name, generator and requirements of each."""
    project.write("chatty.py", CHATTY)
    project.write("scenarios/talk/requirements.yaml", REQUIREMENTS)
    for name, generator, requirements in scenarios:
        text = SCENARIO.format(name=name, generator=generator, requirements=requirements)
        project.write(f"scenarios/talk/{name}.yaml", text)


@pytest.fixture
def chatty(project):
    prepare(project, ("it", "Chatty", "CITE-1"))
    return project


def modes_of(case):
    return {one.name: one for one in case.metrics.failure_modes}


def test_a_session_says_how_its_component_fails_beside_a_null_component(chatty):
    result = chatty.scenarios("-v", select="talk/*")
    record = chatty.evidence()
    (case,) = record.cases
    odd = sum(one.metrics.tallies["threat_ids_unperceived"].hits > 0 for one in record.episodes)
    assert 0 < odd < 4, "seeds of both kinds"
    found = modes_of(case)
    cites, control = found["threat_ids_unperceived"], found["accelerates_into_conflict"]
    assert (cites.hits, cites.of, cites.null_of) == (3 * odd, 12, 0)
    assert (cites.episodes, cites.of_episodes) == (odd, 4)
    assert cites.upper > odd / 4
    assert (control.kind, control.share, control.null_share) == ("control", 1.0, 0.0)
    assert found["intent_against_maneuver"].null_share == 1.0
    assert found["threat_ids_miss_nearest"].of == 0
    times = {"decisions": 12, "p50": 0.25, "p95": 0.25, "max": 0.25}
    assert case.metrics.answer_times.to_json() == times
    ages = {"decisions": 12, "p50": 0.2, "p95": 0.2, "max": 0.2}
    assert case.metrics.answer_ages.to_json() == ages
    assert chatty.verdicts() == {("talk/it", "CITE-1"): "violated"}
    violated = chatty.verdict("CITE-1", "talk/it")
    assert violated.violations == odd

    lines = result.outlines
    table = lines.index(next(line for line in lines if line.startswith("failure modes ")))
    rows = [" ".join(line.split()) for line in lines[table:]]
    rows = rows[: rows.index("") if "" in rows else None]
    assert f"threat ids unperceived {3 * odd}/12 {300 * odd / 12:.1f} - {odd}/4" in rows
    assert "negative control:" in rows
    assert rows.index("negative control:") < rows.index(
        "accelerates into conflict 12/12 100.0 0.0 4/4"
    )
    assert "no failure by itself:" in rows
    answers = "answers: 12 decisions, median 0.25 s, 95th percentile 0.25 s, longest 0.25 s; "
    whole = " ".join(" ".join(lines).split())
    assert f"{answers}0 of 12 (0.0 %) past the time budget" in whole
    aged = "median 0.2 s, 95th percentile 0.2 s, oldest 0.2 s"
    assert f"decisions came into force at an age of {aged}" in whole
    assert not any("threat ids miss nearest" in row for row in rows)
    assert "ignores its input" in " ".join(" ".join(lines).split())


def test_each_case_has_its_own_table_where_asked_for(project):
    prepare(project, ("it", "Chatty", "CITE-1"), ("again", "Chatty", "CITE-1"))
    brief = project.scenarios("--dura-runs=1", select="talk/*").outlines
    assert sum("failure modes" in line for line in brief) == 1
    full = project.scenarios("--dura-runs=1", "-v", select="talk/*").outlines
    for case in ("talk/it", "talk/again"):
        assert sum(line.startswith(f"failure modes on {case}") for line in full) == 1


def test_reports_show_the_same_table(chatty):
    chatty.scenarios(select="talk/*")
    bundle = chatty.path / "dura-evidence"
    (case,) = chatty.evidence().cases
    cites = modes_of(case)["threat_ids_unperceived"]
    summary = (bundle / "summary.md").read_text()
    row = f"| `threat ids unperceived` | failure | `Chatty` | {cites.hits} of 12 |"
    assert row in summary
    totals = chatty.evidence().totals.to_json()
    assert stated_counts("summary.md", summary) == totals
    page = (bundle / "report.html").read_text()
    table = page[page.index('id="failure-modes"') :]
    assert f">{cites.hits}/12<" in table
    assert "Negative control" in table
    assert "ignores its input" in table
    for report in (summary, table):
        assert "0 of 12 (0.0 %) past the time budget" in report
        assert "came into force at an age of median 0.2 s" in report
    assert verify_bundle(bundle).problems == []


def test_a_component_without_accounts_has_no_table_and_supports_nothing(project):
    prepare(project, ("silent", "Silent", "CITE-1"))
    result = project.scenarios(select="talk/*")
    assert result.ret == 1
    assert project.verdicts() == {("talk/silent", "CITE-1"): "undecided"}
    result.stdout.fnmatch_lines(["*the component gives no account of its proposals*"])
    assert "failure modes" not in result.stdout.str()
    (case,) = project.evidence().cases
    assert case.metrics.failure_modes == []
    assert case.metrics.answer_times is None
    assert case.metrics.answer_ages is None
    bundle = project.path / "dura-evidence"
    assert "Failure modes" not in (bundle / "summary.md").read_text()
    assert 'id="failure-modes"' not in (bundle / "report.html").read_text()
    assert project.verdict("CITE-1", "talk/silent").invalid == 4


def test_what_is_violated_without_any_account_is_violated(project):
    prepare(project, ("silent", "Silent", "BOTH-1"))
    project.scenarios(select="talk/*")
    assert project.verdicts() == {("talk/silent", "BOTH-1"): "violated"}


def test_a_misspelt_failure_mode_is_an_error_of_the_collection(project):
    prepare(project, ("it", "Chatty", "CITE-1"))
    wrong = REQUIREMENTS.replace("threat_ids_unperceived", "threat_ids_unpercieved")
    project.write("scenarios/talk/requirements.yaml", wrong)
    result = project.scenarios(select="talk/*")
    assert result.ret == 4
    text = result.stdout.str() + result.stderr.str()
    assert "unknown signal 'proposal.threat_ids_unpercieved'" in text
    assert "did you mean 'proposal.threat_ids_unperceived'?" in text
    assert "Traceback" not in text


def forged_mode(record, name):
    """A failure mode in the plain data of a record."""
    (found,) = [
        one for one in record["cases"][0]["metrics"]["failure_modes"] if one["name"] == name
    ]
    return found


FORGED = (
    (
        lambda record: record["episodes"][0]["metrics"]["tallies"]["fallback"].update(of=1),
        "metrics/failure_modes",
    ),
    (
        lambda record: forged_mode(record, "threat_ids_unperceived").update(hits=0),
        "metrics/failure_modes",
    ),
    (
        lambda record: forged_mode(record, "timeout").update(upper=0.01),
        "metrics/failure_modes",
    ),
    (
        lambda record: forged_mode(record, "threat_ids_unperceived").update(kind="comparison"),
        "metrics/failure_modes",
    ),
    (
        lambda record: record["cases"][0]["metrics"]["answer_times"].update(max=0.1),
        "metrics/answer_times/max",
    ),
    (
        lambda record: record["episodes"][0]["metrics"]["answer_seconds"].pop(),
        "metrics/answer_times/decisions",
    ),
    (
        lambda record: record["cases"][0]["metrics"]["answer_ages"].update(p95=0.0),
        "metrics/answer_ages/p95",
    ),
    (
        lambda record: record["episodes"][0]["metrics"]["answer_ages"].append(0.2),
        "metrics/answer_ages/decisions",
    ),
)


def test_forged_tallies_are_found(chatty):
    chatty.scenarios(select="talk/*")
    text = json.dumps(chatty.evidence().to_json())
    for change, place in (None, ""), *FORGED:
        record = json.loads(text)
        if change is not None:
            change(record)
        problems = list(conclusion_problems(SessionRecord.of(record, chatty.path)))
        # What an episode says counts in all cases together, too.
        own = [problem for problem in problems if ": /overall/" not in problem]
        assert bool(own) == (change is not None)
        assert len(problems) - len(own) <= len(own)
        assert any(place in problem for problem in own) == (change is not None)


def problems_of(record):
    """What is wrong with the only episode of a record."""
    (episode,) = record.episodes
    return list(episode.contradictions())


def test_more_failures_than_decisions_are_found(chatty):
    chatty.scenarios("--dura-runs=1", select="talk/*")
    record = chatty.evidence()
    (episode,) = record.episodes
    assert problems_of(record) == []
    metrics = episode.metrics
    episode = episode.replace(
        metrics=replace(
            metrics,
            tallies=metrics.tallies
            | {"fallback": replace(metrics.tallies["fallback"], hits=16, of=16)},
            answer_seconds=metrics.answer_seconds * 9,
            answer_ages=metrics.answer_ages * 8,
        )
    )
    problems = problems_of(record.replace(episodes=[episode]))
    assert problems == [
        "16 of 16 for fallback (hits), in 15 decisions",
        "the times of 27 answers, in 15 decisions",
        "the ages of 24 answers, in 15 decisions",
    ]


def test_a_decision_that_is_older_than_its_episode_is_found(chatty):
    chatty.scenarios("--dura-runs=1", select="talk/*")
    record = chatty.evidence()
    (episode,) = record.episodes
    for age, problems in (1.5, 0), (1.6, 1):
        ages = (*episode.metrics.answer_ages[:-1], age)
        changed = episode.replace(metrics=replace(episode.metrics, answer_ages=ages))
        found = problems_of(record.replace(episodes=[changed]))
        assert len(found) == problems
    assert found[0].endswith("a decision came into force 1.6 s after its percept, within 1.5 s")
