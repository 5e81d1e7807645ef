"""Faults from the command line, their causal chains, and the smallest set that does harm."""

from __future__ import annotations

import json

import pytest
from corridors import scenario

from pytest_dura.__main__ import main
from pytest_dura.evidence import verify_bundle

INJECTOR = "pytest_dura.faults.injector:CampaignInjector"
BIAS = "{type: bias, target: gap, activation: {at: 0.5}, parameters: {offset: 5.0}}"
NOISE = "{type: noise, target: gap, activation: {at: 0.0}, parameters: {sigma: 0.001}}"
DRIFT = "{type: drift, target: gap, activation: {at: 1.0}, parameters: {rate: 0.01}}"
LATE = "{type: gain, target: gap, activation: {when: 'time > 99'}, parameters: {factor: 2.0}}"


def near_the_wall(project, **given):
    """Careful stays where it is, 1.5 m before the wall, unless it sees another gap."""
    given = {"fault_injector": INJECTOR, "requirements": "[GAP-1]"} | given
    scenario(project, world="{wall: 1.5}", duration=3.0, **given)


def campaigns(project, *entries):
    project.write("campaigns.yaml", "campaigns:\n" + "".join(f"  - {one}\n" for one in entries))


def words(project):
    return {one.case: one.verdict for one in project.evidence().verdicts}


def test_campaigns_of_a_file_are_cases_of_their_own(project):
    near_the_wall(project)
    grid = f"{{fault: {BIAS}, grid: {{parameters.offset: [0.1, 5.0], activation.at: [0, 1]}}}}"
    campaigns(project, "none", NOISE, grid)
    result = project.scenarios(
        "-v", "--dura-faults=campaigns.yaml", "-n", "2", select="corridor/it*"
    )
    assert result.ret == 1
    assert words(project) == {
        "corridor/it": "supported",
        "corridor/it+noise": "supported",
        "corridor/it+bias-offset=0.1-at=0": "supported",
        "corridor/it+bias-offset=0.1-at=1": "supported",
        "corridor/it+bias-offset=5-at=0": "violated",
        "corridor/it+bias-offset=5-at=1": "violated",
    }
    item = "corridor/it+bias-offset=5-at=1::GAP-1"
    assert f"  rerun:    pytest {item} --dura-faults=campaigns.yaml" in result.outlines
    again = project.run("-v", item, "--dura-faults=campaigns.yaml")
    assert (again.ret, list(words(project))) == (1, ["corridor/it+bias-offset=5-at=1"])


def test_a_scenario_holds_its_own_campaigns(project):
    near_the_wall(project, faults=f"[{BIAS}, {NOISE}]\ncampaigns: [none, noise, bias+noise]")
    result = project.scenarios(select="corridor/it*")
    assert words(project) == {
        "corridor/it+none": "supported",
        "corridor/it+noise": "supported",
        "corridor/it": "violated",
    }
    order = [line.split()[0] for line in result.outlines if line.startswith("corridor/it")][:3]
    assert order == ["corridor/it", "corridor/it+noise", "corridor/it+none"]


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["--dura-faults=nois"], "unknown fault 'nois'"),
        (["--dura-faults=catalogue"], "name each fault as data"),
        (["--dura-faults=,"], "has no name"),
        (["--dura-faults=gone.yaml"], "gone.yaml"),
        (["--dura-faults=campaigns.yaml"], "campaigns.yaml:2: "),
    ],
)
def test_faults_that_cannot_be_used_are_one_error(project, arguments, told):
    near_the_wall(project)
    campaigns(project, "{type: noise, target: gap, activation: {at: -1}}")
    result = project.scenarios("-v", *arguments, select="corridor/it")
    assert result.ret == 4
    assert told in result.stderr.str()
    assert "Traceback" not in result.stderr.str() + result.stdout.str()


def test_faults_need_scenario_cases(project):
    result = project.run("--dura-faults=none")
    assert result.ret == 4
    assert "add --dura-scenarios" in result.stderr.str()


def test_test_functions_alone_do_not_read_as_judged_under_those_faults(project):
    near_the_wall(project)
    project.write(
        "test_own.py",
        "import pytest\n"
        "@pytest.mark.dura(scenario='corridor/it', runs=1)\n"
        "@pytest.mark.requirement('GAP-1')\n"
        "def test_own(campaign):\n"
        "    campaign.require()\n",
    )
    result = project.run("test_own.py", "--dura-faults=none")
    assert result.ret == 4
    assert "--dura-faults is about scenario cases" in result.stderr.str()
    assert "a test function names its faults in the marker" in result.stderr.str()
    campaigns(project, BIAS)
    both = ["test_own.py", "--dura-scenarios", "--dura-select=corridor/it"]
    result = project.run(*both, "--dura-faults=campaigns.yaml")
    assert result.ret == 1
    assert words(project) == {"corridor/it": "supported", "corridor/it+bias": "violated"}


def marked(project, *offsets):
    """A test function for each offset of a fault that has the same id in all of them."""
    text = "import pytest\n"
    for number, offset in enumerate(offsets):
        fault = {"type": "bias", "target": "gap", "activation": {"at": 0.5}}
        fault["parameters"] = {"offset": offset}
        text += (
            f"@pytest.mark.dura(scenario='corridor/it', runs=1, faults=[{fault}])\n"
            f"@pytest.mark.requirement('GAP-1')\n"
            f"def test_{number}(campaign):\n"
            "    campaign.require()\n"
        )
    project.write("test_own.py", text)


def test_two_tests_cannot_run_other_faults_under_one_id(project):
    near_the_wall(project)
    marked(project, 0.1, 0.1)
    assert project.run("test_own.py").ret == 0
    marked(project, 0.1, 0.2)
    result = project.run("test_own.py")
    assert result.ret == 1
    told = "test_own.py:6: the case 'corridor/it+bias' stands for other faults elsewhere"
    result.stdout.fnmatch_lines([f"*{told}*"])
    marked(project, 0.1)
    campaigns(project, BIAS)
    result = project.scenarios("test_own.py", "--dura-faults=campaigns.yaml", select="corridor/it")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["*test_own.py:2: the case 'corridor/it+bias' stands for other*"])


def test_a_case_among_the_arguments_is_run_under_its_faults(project):
    near_the_wall(project)
    campaigns(project, BIAS)
    result = project.run("corridor/it+bias::GAP-1", "--dura-faults=campaigns.yaml")
    assert (result.ret, words(project)) == (1, {"corridor/it+bias": "violated"})


def test_the_causal_chain_is_in_the_record_the_table_and_the_failure(project):
    near_the_wall(project, faults=f"[{BIAS}, {NOISE}]", runs=3)
    result = project.run("-v", "corridor/it")
    record = project.evidence()
    for episode in record.episodes:
        bias, noise = episode.faults
        assert (bias.planned_at, bias.activated_at, bias.manifested_at) == (0.5, 0.5, 0.5)
        assert (bias.propagation, bias.propagated_at) == ("propagated", 0.5)
        assert (bias.outcome, bias.violated) == ("violated", ("GAP-1",))
        assert bias.violated_without == ()
        # The noise was there before the proposals changed, and may have had its part in it.
        assert (noise.manifested_at, noise.propagation) == (0.0, "propagated")
    assert {one.case for one in record.episodes} == {"corridor/it"}, "twins are no runs"
    (case,) = record.cases
    first, second = case.metrics.faults
    assert first.id == "bias"
    assert [getattr(first, key) for key in ("run", "activated", "manifested", "followed")] == [
        3
    ] * 4
    assert [getattr(first, key) for key in ("propagated", "violated", "detected")] == [3, 3, 0]
    assert second.id == "noise"
    lines = result.outlines
    head = next(line for line in lines if line.startswith("fault "))
    assert head.split()[1:6] == ["runs", "act", "manif", "prop", "det"]
    row = next(line for line in lines if line.startswith("bias on corridor/it "))
    assert row.split()[3:] == ["3", "3", "3", "3", "0", "-", "0", "-", "3"]
    start = next(i for i, line in enumerate(lines) if line.startswith("  fault:    bias: "))
    end = next(i for i in range(start + 1, len(lines)) if not lines[i].startswith(" " * 12))
    assert " ".join(line.strip() for line in lines[start:end]) == (
        "fault:    bias: planned 0.50 s, activated 0.50 s, manifested 0.50 s "
        "(read by generator, safety_monitor), propagated 0.50 s, violated"
    )


def test_no_fault_is_blamed_for_what_happens_without_it(project):
    project.write(
        "heedless.py",
        "from corridor import Reckless\n"
        "class Heedless(Reckless):\n"
        "    def propose(self, view):\n"
        "        view.percept['gap']\n"
        "        return super().propose(view)\n",
    )
    scenario(
        project,
        world="{wall: 3.0}",
        duration=3.0,
        generator="heedless:Heedless",
        fault_injector=INJECTOR,
        requirements="[GAP-1]",
        faults=f"[{NOISE}]",
        runs=3,
    )
    result = project.run("-v", "corridor/it")
    assert result.ret == 1
    record = project.evidence()
    for episode in record.episodes:
        (noise,) = episode.faults
        assert (noise.violated, noise.violated_without) == (("GAP-1",), ("GAP-1",))
        assert noise.outcome == "violated also without it"
    (fault,) = record.cases[0].metrics.faults
    assert (fault.judged, fault.violated, fault.violated_without) == (3, 0, 3)
    (verdict,) = record.verdicts
    assert verdict.verdict == "violated"
    assert (verdict.violations, verdict.also_without) == (3, 3)
    terminal = result.stdout.str()
    row = next(line for line in result.outlines if line.startswith("noise on corridor/it "))
    assert row.split()[-1] == "0+3"
    told = "3 of 3 runs violate it (3 of them also without the faults)"
    assert told in " ".join(terminal.split())
    assert "violated also without it" in " ".join(terminal.split())
    bundle = project.path / "dura-evidence"
    assert told in (bundle / "summary.md").read_text()
    report = " ".join((bundle / "report.html").read_text().split())
    assert "3 of 3 violations also without the faults, by the same seed" in report
    assert "<small>3 also without it</small>" in report
    assert "<td>3 violated also without it</td>" in report
    argument = " ".join((bundle / "assurance-case.gsn.yaml").read_text().split())
    assert "violations: 3 (3 of them also without the faults)" in argument
    assert verify_bundle(bundle).problems == []


def test_an_alert_on_what_the_component_has_not_read_yet_has_detected_it(project):
    project.write(
        "slow.py",
        "from pytest_dura import Alert, Generator, Proposal, SecurityAssessment, SecurityAssessor\n"
        "class Slow(Generator):\n"
        "    def propose(self, view):\n"
        "        if view.index % 10 == 0:\n"
        "            view.percept['gap']\n"
        "        return Proposal(0.0)\n"
        "class Quick(SecurityAssessor):\n"
        "    def run(self, view):\n"
        "        alerts = (Alert('jump', 'gap'),) if view.percept['gap'] > 4 else ()\n"
        "        return SecurityAssessment(alerts=alerts)\n",
    )
    once = BIAS.replace("at: 0.5}", "at: 0.5}, duration: 0.6")
    near_the_wall(
        project,
        generator="slow:Slow",
        security_assessor="slow:Quick",
        faults=f"[{once}]",
        runs=3,
    )
    result = project.run("-v", "corridor/it")
    record = project.evidence()
    for episode in record.episodes:
        (bias,) = episode.faults
        times = [getattr(bias, f"{step}_at") for step in ("activated", "detected", "manifested")]
        assert times == pytest.approx([0.5, 0.5, 0.5])
        assert bias.read_by == ("generator", "safety_monitor", "security_assessor")
        assert bias.detection_latency == 0.0
    (fault,) = record.cases[0].metrics.faults
    assert (fault.manifested, fault.detected, fault.rates.detection) == (3, 3, 1.0)
    row = next(line for line in result.outlines if line.startswith("bias on corridor/it "))
    assert row.split()[7:9] == ["3", "0.0"]
    assert verify_bundle(project.path / "dura-evidence").problems == []


def test_the_table_names_the_whole_case_of_several_faults(project):
    near_the_wall(project, faults=f"[{BIAS}, {NOISE}, {DRIFT}]\ncampaigns: [bias, bias+noise]")
    result = project.scenarios("-v", select="corridor/it*")
    lines = [line.split()[:3] for line in result.outlines]
    assert ["bias", "on", "corridor/it"] in lines
    assert ["bias", "on", "corridor/it+bias+noise"] in lines
    assert ["noise", "on", "corridor/it+bias+noise"] in lines
    assert ["noise", "on", "corridor/it+bias"] not in lines


def test_a_fault_that_changes_no_proposal_is_contained(project):
    near_the_wall(project, faults=f"[{NOISE}]")
    project.run("corridor/it")
    for episode in project.evidence().episodes:
        (noise,) = episode.faults
        assert (noise.propagation, noise.outcome) == ("contained", "contained")


def test_without_twins_it_is_unknown_what_a_fault_changed(project):
    near_the_wall(project, faults=f"[{NOISE}]")
    result = project.run("-v", "corridor/it", "--dura-no-twins")
    (noise,) = project.evidence().episodes[0].faults
    assert (noise.propagation, noise.outcome) == (None, "tolerated")
    row = next(line for line in result.outlines if line.startswith("noise on corridor/it "))
    assert row.split()[3:7] == ["2", "2", "2", "-"]


def test_a_component_that_is_not_deterministic_is_told_apart_from_a_fault(project):
    project.write(
        "erratic.py",
        "import itertools\n"
        "from pytest_dura import Generator, Proposal\n"
        "numbers = itertools.count()\n"
        "class Erratic(Generator):\n"
        "    def propose(self, view):\n"
        "        return Proposal(view.percept['gap'] * 0.0 + next(numbers) * 1e-9)\n",
    )
    near_the_wall(project, generator="erratic:Erratic", faults=f"[{NOISE}]", runs=1)
    project.run("corridor/it")
    (noise,) = project.evidence().episodes[0].faults
    assert (noise.manifested_at, noise.propagation) == (0.0, "unknown")
    assert noise.unknown == "two runs without faults differ from 0.00 s on"


def test_an_instance_that_remembers_earlier_episodes_is_told_apart_from_a_fault(project):
    project.write(
        "conftest.py",
        "import pytest\n"
        "from pytest_dura import Generator, Proposal\n"
        "class Ageing(Generator):\n"
        "    episodes = 0\n"
        "    def reset(self, context):\n"
        "        self.episodes += 1\n"
        "    def propose(self, view):\n"
        "        return Proposal(view.percept['gap'] * 0.0 + self.episodes * 1e-9)\n"
        "@pytest.fixture(scope='session')\n"
        "def generator():\n"
        "    return Ageing()\n",
    )
    near_the_wall(project, faults=f"[{BIAS}]", runs=1)
    project.run("corridor/it")
    (bias,) = project.evidence().episodes[0].faults
    assert bias.manifested_at is not None
    assert (bias.propagation, bias.propagated_at) == ("unknown", None)
    assert bias.unknown == "two runs without faults differ from 0.00 s on"


def test_the_smallest_set_of_faults_is_found_and_can_be_replayed(project):
    near_the_wall(project, faults=f"[{NOISE}, {BIAS}, {DRIFT}]", runs=1)
    assert project.run("corridor/it", "--dura-evidence=out").ret == 1
    result = project.run("--dura-reduce=corridor/it#0", "--dura-evidence=out")
    assert result.ret == 0
    lines = result.outlines
    assert "corridor/it#0 (Careful): 3 faults, violates GAP-1; at most 100 runs" in lines
    told = next(line for line in lines if line.startswith("smallest set"))
    assert told.startswith("smallest set that violates GAP-1: bias (every smaller set was tried; ")
    command = "pytest --dura-replay='corridor/it+bias#0' --dura-evidence=out-reduced"
    assert f"  replay: {command}" in lines
    replay = project.run("--dura-replay=corridor/it+bias#0", "--dura-evidence=out-reduced")
    assert replay.ret == 0
    assert "  the same" in replay.outlines


def test_a_budget_ends_the_reduction(project):
    near_the_wall(project, faults=f"[{NOISE}, {BIAS}, {DRIFT}]", runs=1)
    project.run("corridor/it")
    result = project.run("--dura-reduce=corridor/it#0", "--dura-runs=4")
    assert result.ret == 0
    told = next(line for line in result.outlines if line.startswith("smallest set"))
    assert "the budget ended before it was known" in told
    assert "4 of 4 runs" in told


def test_a_budget_of_one_run_leaves_open_whether_it_comes_up_again(project):
    near_the_wall(project, faults=f"[{BIAS}]", runs=1)
    project.run("corridor/it")
    result = project.run("--dura-reduce=corridor/it#0", "--dura-runs=1")
    assert result.ret == 1
    told = "the budget ended before it was known whether it comes up again (1 of 1 runs)"
    assert told in result.outlines


def test_what_does_not_come_up_again_is_told(project):
    near_the_wall(project, faults=f"[{BIAS}]", runs=1)
    project.run("corridor/it")
    source = (project.path / "corridor.py").read_text()
    project.write("corridor.py", source.replace("Proposal(1.0 if", "Proposal(0.0 if"))
    result = project.run("--dura-reduce=corridor/it#0")
    assert result.ret == 1
    assert "not reproduced: the same faults do not violate it again (2 of 100 runs)" in (
        result.outlines
    )


@pytest.mark.parametrize(
    "faults, episode, told",
    [
        (f"[{NOISE}]", "corridor/it#0", "is no counterexample to a requirement"),
        ("[]", "corridor/it#0", "has no faults to leave out"),
        (f"[{BIAS}]", "corridor/it#7", "the evidence has no episode 'corridor/it#7'"),
    ],
)
def test_what_cannot_be_reduced_is_one_error(project, faults, episode, told):
    near_the_wall(project, faults=faults, runs=1)
    project.run("corridor/it")
    result = project.run(f"--dura-reduce={episode}")
    assert result.ret == 4
    assert told in result.stderr.str()


def test_a_fault_whose_time_never_comes_leaves_the_episodes_invalid(project):
    near_the_wall(project, faults=f"[{LATE}]")
    result = project.run("-v", "corridor/it")
    assert result.ret == 1
    (verdict,) = project.evidence().verdicts
    assert verdict.verdict == "undecided"
    line = "invalid:  corridor/it#0: never manifested: gain (why: see its card)"
    assert line in result.outlines
    assert "  fault:    gain: idle" in result.outlines


def test_of_several_components_the_one_that_violates_is_reduced(project):
    near_the_wall(project, faults=f"[{NOISE}, {BIAS}]", runs=1)
    for folder, ahead in {"a": 0.0, "b": 1.0}.items():
        project.write(
            f"{folder}/conftest.py",
            "import pytest\n"
            "from pytest_dura import Generator, Proposal\n"
            f"class Own{folder.upper()}(Generator):\n"
            "    def propose(self, view):\n"
            f"        return Proposal({ahead} if view.percept['gap'] > 3.0 else 0.0)\n"
            "@pytest.fixture(scope='session')\n"
            "def generator():\n"
            f"    return Own{folder.upper()}\n",
        )
        project.write(
            f"{folder}/test_{folder}.py",
            "import pytest\n"
            "@pytest.mark.dura(scenario='corridor/it')\n"
            "@pytest.mark.requirement('GAP-1')\n"
            f"def test_{folder}(campaign, orchestrator):\n"
            "    orchestrator.run('corridor/it', seed=0, faults='none')\n"
            "    orchestrator.run('corridor/it', seed=0)\n"
            "    campaign.require()\n",
        )
    result = project.run("-v", "a", "b")
    result.assert_outcomes(passed=1, failed=1)
    rows = [line for line in result.outlines if line.startswith("bias on corridor/it ")]
    assert [row.split()[3:6] for row in rows] == [["(OwnA", "(a))", "1"], ["(OwnB", "(b))", "1"]]
    told = [line for line in result.outlines if line.startswith("  fault:    bias")]
    assert told == [
        "  fault:    bias: planned 0.50 s, activated 0.50 s, manifested 0.50 s (read by generator,"
    ]
    result = project.run("a", "b", "--dura-reduce=corridor/it#0")
    assert result.ret == 0
    head = "corridor/it#0 (OwnB (b)): 2 faults, violates GAP-1; at most 100 runs"
    assert head in result.outlines
    (case,) = project.evidence("dura-evidence-reduced").cases
    assert (case.id, case.component) == ("corridor/it+bias", "OwnB (b)")
    replay = ["--dura-replay=corridor/it+bias#0", "--dura-evidence=dura-evidence-reduced"]
    result = project.run("a", "b", *replay)
    assert result.ret == 0
    assert "  the same" in result.outlines


def conformance(project):
    """Of each requirement in the session's CycloneDX file: its score, if any, and why."""
    assert main(["export", "cyclonedx", str(project.path / "dura-evidence")]) == 0
    document = json.loads((project.path / "dura-evidence/cyclonedx.json").read_text())
    names = [one["identifier"] for one in document["definitions"]["standards"][0]["requirements"]]
    entries = document["declarations"]["attestations"][0]["map"]
    return {
        name: (entry["conformance"].get("score"), entry["conformance"]["rationale"])
        for name, entry in zip(names, entries, strict=True)
    }


def test_a_green_gate_reads_as_full_conformance_where_two_scenarios_have_other_faults(project):
    near_the_wall(project, name="it", faults=f"[{NOISE}]")
    near_the_wall(project, name="too", faults=f"[{DRIFT}]")
    result = project.run("corridor/it", "corridor/too")
    assert result.ret == 0
    untested = [one for one in project.evidence().coverage.cells if one.verdict is None]
    assert untested, "each fault in the other scenario, which nobody declared"
    assert [score for score, _ in conformance(project).values()] == [1]


def test_a_partly_decided_requirement_has_no_conformance_score_and_a_violated_one_has_0(project):
    near_the_wall(project, faults=f"[{NOISE}]", requirements="[GAP-1, GO-1]")
    assert project.run("corridor/it::GAP-1").ret == 0
    (score, _), (left_out, why) = conformance(project).values()
    assert (score, left_out) == (1, None)
    assert "1 untested, no verdict. No score" in why
    near_the_wall(project, name="bad", faults=f"[{BIAS}]")
    near_the_wall(project, name="too")
    assert project.run("corridor/bad", "corridor/too").ret == 1
    ((score, why),) = conformance(project).values()
    assert score == 0
    assert "1 of 2 verdicts supported; 1 violated. 0: it was violated" in why
    near_the_wall(project, name="bad", faults=f"[{LATE}]")
    assert project.run("corridor/bad", "corridor/too").ret == 1
    ((score, why),) = conformance(project).values()
    assert score is None
    assert "1 of 2 verdicts supported; 1 undecided. No score" in why
