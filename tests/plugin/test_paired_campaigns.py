"""Pairs of runs with equal seeds: with something, and without it."""

from __future__ import annotations

import json
import shutil

import pytest
from corridors import IDLE, expect, requirement, scenario
from outputs import shown_of

from pytest_dura.__main__ import main
from pytest_dura.core.codec import encode
from pytest_dura.evidence import SessionRecord, record_problems
from pytest_dura.requirements import Change

HARM = {
    "duration": 2.0,
    "runs": 3,
    "world": "{wall: 4.0}",
    "monitor": "oddities:Early",
    "recovery_planner": "oddities:Push",
}
FAR = {
    "runs": 3,
    "world": "{wall: 40.0}",
    "requirements": "[R-1]",
    "recovery_planner": "Brake",
}
"""Nothing is refused here."""
HELP = HARM | {"duration": 0.5, "generator": "Reckless", "recovery_planner": "Brake"}


def run(project, body, scenario_name="corridor/it", *arguments):
    project.write(
        "test_it.py",
        "import pytest\n"
        f"@pytest.mark.dura(scenario='{scenario_name}')\n"
        "def test_it(campaign):\n" + "".join(f"    {line}\n" for line in body.splitlines()),
    )
    return project.run("test_it.py", "-v", *arguments)


def test_a_role_that_makes_a_pair_worse_violates_the_requirement(project):
    scenario(project, **HARM)
    body = "campaign.paired(without='recovery_planner').require('always (gap > 0)')"
    result = run(project, body)
    result.assert_outcomes(failed=1)
    reason = "3 of 3 valid pairs violated it"
    found = expect(project, result, "violated", reason, requirement="always (gap > 0)")
    pairs = found.pairs
    assert pairs.without == "recovery_planner"
    assert pairs.case == "corridor/it~recovery_planner"
    assert (pairs.only_with, pairs.only_without, pairs.both, pairs.neither) == (
        3,
        0,
        0,
        0,
    )
    text = result.stdout.str()
    assert "E       pairs:    with recovery_planner, and without" in text
    told = "3 of 3 pairs with and without recovery_planner violate it"
    assert told in " ".join(text.split())
    assert "pytest_dura/" not in text.partition("= dura =")[0]
    episodes = {one.id: one.seed for one in project.evidence().episodes}
    assert len(episodes) == 6
    for run_number in range(3):
        own, twin = f"corridor/it#{run_number}", f"corridor/it~recovery_planner#{run_number}"
        assert episodes[own] == episodes[twin]


def test_a_role_that_helps_supports_it(project):
    scenario(project, **HELP)
    body = """pairs = campaign.paired(without='recovery_planner')
counts = pairs.counts('always (gap > 0)')
assert (counts.pairs, counts.only_with, counts.only_without) == (3, 0, 3), counts
assert (counts.both, counts.neither, counts.acted_only_without) == (0, 0, 3)
pairs.require('always (gap > 0)')"""
    result = run(project, body)
    found = expect(project, result, "supported", requirement="always (gap > 0)")
    assert found.pairs.only_without == 3
    assert found.margin == pytest.approx(2.0)


@pytest.mark.parametrize("at_most, word", [("0.7", "supported"), ("0.1", "undecided")])
def test_a_rate_of_pairs(project, at_most, word):
    scenario(project, **HELP)
    body = f"""campaign.paired(without='recovery_planner').require(
    'always (gap > 0)', at_most={at_most}, confidence=0.9)"""
    found = expect(project, run(project, body), word, requirement="always (gap > 0)")
    assert (found.method, found.bound.confidence) == ("fixed", 0.9)


def test_pairs_end_once_their_rate_is_decided(project):
    scenario(project, **HARM | {"runs": 40})
    body = """campaign.paired(without='recovery_planner').require(
    'always (gap > 0)', at_most=0.3, method='sprt', p0=0.01)"""
    result = run(project, body)
    found = expect(project, result, "violated", requirement="always (gap > 0)")
    assert found.run <= 5
    assert found.saved == 40 - found.run
    assert len(project.evidence().episodes) == 2 * found.run
    # How many pairs there are depended on what they showed, which McNemar's test does not allow.
    lines = iter(result.outlines)
    p = next(line for line in lines if line.startswith("recovery ")).split().index("p")
    next(line for line in lines if line == "always (gap > 0) on corridor/it")
    assert next(lines).split()[p - 1] == "-"


@pytest.mark.parametrize(
    "bound, word, line",
    [
        ("0.5", "violated", "farthest grows by 27.6 with recovery_planner where 0.5 is allowed"),
        ("30", "supported", "checks:farthest on corridor/it  supported  3"),
    ],
)
def test_the_change_of_a_measure(project, capsys, bound, word, line):
    scenario(project, **HARM)
    body = f"""pairs = campaign.paired(without='recovery_planner')
change = pairs.change('checks:farthest')
assert change.n == 3
assert change.mean == pytest.approx(27.6)
assert pairs.change(lambda one: one.signals['x'].max()).values == change.values
pairs.require(measure='checks:farthest', change_at_most={bound})"""
    result = run(project, body)
    found = expect(project, result, word, requirement="checks:farthest")
    assert found.margin == pytest.approx(float(bound) - 27.6)
    assert found.pairs.change.values == pytest.approx([27.6] * 3)
    assert line in result.stdout.str()
    folder = project.path / "dura-evidence"
    assert main(["verify", str(folder)]) == 0
    problems = {
        "/pairs/change/mean: found 1.0": lambda change: change.update(mean=1.0),
        "/pairs/change/values/0: found": lambda change: change.update(encode(REVERSED)),
    }
    for problem, forge in problems.items():
        forged = shutil.copytree(folder, project.path / "forged", dirs_exist_ok=True)
        record = json.loads((forged / "evidence.json").read_text())
        pairs = next(one["pairs"] for one in record["verdicts"] if one["pairs"])
        forge(pairs["change"])
        (forged / "evidence.json").write_text(json.dumps(record))
        capsys.readouterr()
        assert main(["verify", str(forged)]) == 1
        assert problem in capsys.readouterr().out


REVERSED = Change.between("m", {f"corridor/it#{run}": (0.0, 1.0) for run in range(3)})
"""Pairs in which the measure shrinks, so that no bound is passed."""


def test_what_faults_cost_has_a_table_of_its_own(project):
    scenario(
        project,
        duration=2.0,
        world="{wall: 4.0}",
        fault_injector="pytest_dura.faults.injector:CampaignInjector",
        faults="[{type: bias, target: gap, activation: {at: 0.0}, parameters: {offset: 0.3}}]",
    )
    body = """pairs = campaign.paired(without='faults')
pairs.require(measure='checks:farthest', change_at_most=1.0)"""
    result = run(project, body)
    assert result.ret == 0
    lines = result.outlines
    header = next(line for line in lines if line.startswith("attack "))
    cells = lines[lines.index(header) + 1].split()
    row = dict(zip(header.split()[1:], cells[-8:], strict=True))
    assert row["pairs"] == "2"
    assert (row["caused"], row["never"]) == ("-", "0")
    change = project.verdict("checks:farthest", "corridor/it").pairs.change
    assert change.mean > 0.1
    assert float(row["cost"]) == pytest.approx(change.mean, abs=0.05)
    assert float(row["max"]) == pytest.approx(change.max, abs=0.05)
    assert not any(line.startswith("recovery ") for line in lines)
    report = (project.path / "dura-evidence/report.html").read_text()
    assert "Attacks: runs of equal seeds" in report


@pytest.mark.parametrize(
    "situation, word, detail",
    [
        (HARM, "supported", None),
        (HARM | {"recovery_planner": "Brake"}, "undecided", "the measure has no value in either"),
        (HELP, "violated", None),
    ],
    ids=["a value with it alone", "no value at all", "a value without it alone"],
)
def test_a_measure_without_a_value_is_more_than_any_number(project, situation, word, detail):
    """When the wall was touched: NaN, if never."""
    scenario(project, **situation)
    body = """campaign.paired(without='recovery_planner').require(
    measure='checks:touched_at', change_at_most=5.0)"""
    found = expect(project, run(project, body), word, requirement="checks:touched_at")
    assert (found.first_uncounted is None) is (detail is None)
    if detail is not None:
        assert detail in found.first_uncounted.detail


def test_without_faults(project):
    faults = {"faults": IDLE, "fault_injector": "oddities:Nudge"}
    scenario(project, world="{wall: 4.0}", **faults)
    body = """pairs = campaign.paired(without='faults')
assert pairs.change('checks:farthest').values == (0.0, 0.0)
pairs.require('always (gap > 0)')"""
    result = run(project, body)
    found = expect(project, result, "supported", requirement="always (gap > 0)")
    assert found.pairs.without == "faults"
    assert found.pairs.case == "corridor/it+none"
    ids = [one.id for one in project.evidence().episodes]
    assert ids == ["corridor/it#0", "corridor/it#1", "corridor/it+none#0", "corridor/it+none#1"]


def test_a_run_that_is_missing_leaves_its_pair_undecided(project):
    roles = {"monitor": "oddities:BrokenSafetyMonitor", "recovery_planner": "Brake"}
    scenario(project, world="{wall: 4.0}", **roles)
    body = "campaign.paired(without='safety_monitor').require('always (gap > 0)')"
    result = run(project, body)
    reason = "2 of 2 pairs are missing (infrastructure)"
    found = expect(project, result, "undecided", reason, requirement="always (gap > 0)")
    assert found.first_uncounted.detail.startswith("infrastructure: safety_monitor at tick 2")
    assert "E       Failed: infrastructure: safety_monitor at tick 2" in result.stdout.str()


def test_the_twin_that_is_missing_is_named(project):
    scenario(project, simulator="oddities:Fragile", **HELP)
    body = "campaign.paired(without='recovery_planner').require('always (gap > 0)')"
    result = run(project, body)
    found = expect(project, result, "undecided", requirement="always (gap > 0)")
    assert found.first_uncounted.episode == "corridor/it#0"
    detail = found.first_uncounted.detail
    assert detail.startswith("infrastructure: simulator at tick 1 (t = 0.1 s): RuntimeError: the ")
    assert detail.endswith(", in corridor/it~recovery_planner#0")


REFUSED = [
    ("paired(without='security_assessor')", ["*has no role 'security_assessor' to switch off"]),
    (
        "paired(without='recovery_planer')",
        ["*there is no role 'recovery_planer' to switch off", "*did you mean 'recovery_plan*"],
    ),
    ("paired(without='generator')", ["*the generator cannot be switched off"]),
    ("paired(without='faults')", ["*the case 'corridor/it' has no faults to leave out"]),
    (
        "paired(without='recovery_planner').require()",
        ["*pairs are compared by a check or by a measure", "*found: *'neither'"],
    ),
    (
        "paired(without='recovery_planner').require(measure='checks:farthest')",
        ["*`measure` and `change_at_most` go together"],
    ),
    (
        "paired(without='recovery_planner').require('always (gap > 0)', change_at_most=1)",
        ["*`measure` and `change_at_most` go together"],
    ),
    (
        "paired('recovery_planner').require('x', measure='checks:farthest', change_at_most=1)",
        ["*pairs are compared by a check or by a measure"],
    ),
    (
        "paired(without='recovery_planner').counts('always (gapp > 0)')",
        ["*unknown signal 'gapp' in the formula"],
    ),
    (
        "paired(without='recovery_planner').change('checks:raises')",
        ["*the measure checks:raises failed on corridor/it#0: LookupError: no such map*"],
    ),
]


def test_a_comparison_that_cannot_be_made_shows_the_users_line_alone(project):
    scenario(project, **HARM)
    text = "import pytest\n"
    for n, (call, _) in enumerate(REFUSED):
        text += f"@pytest.mark.dura(scenario='corridor/it')\ndef test_{n}(campaign):\n"
        text += f"    campaign.{call}\n"
    project.write("test_it.py", text)
    result = project.run("test_it.py")
    result.assert_outcomes(failed=len(REFUSED))
    shown = shown_of(result)
    for n, (_, lines) in enumerate(REFUSED):
        shown[f"test_{n}"].fnmatch_lines(lines)
    assert "pytest_dura/" not in result.stdout.str()


@pytest.mark.parametrize(
    "reference, word, avoidable",
    [("corridor:Careful", "violated", 3), ("corridor:Reckless", "supported", 0)],
    ids=["avoids it", "has it as well"],
)
def test_a_reference_tells_violations_that_it_avoids_from_those_that_it_has_as_well(
    project, capsys, reference, word, avoidable
):
    """Recovery, which would save the reference too, does not act in its runs."""
    unavoidable = 3 - avoidable
    scenario(
        project,
        **HELP | {"recovery_planner": "oddities:Push"},
        requirements="[R-1]",
    )
    requirement(project, "always (gap > 0)", paired=f"{{reference: '{reference}'}}")
    result = project.run("--dura-scenarios", "--dura-select=corridor/it", "-v")
    found = expect(project, result, word)
    case = f"corridor/it~generator={reference}"
    assert (found.pairs.reference, found.pairs.without, found.pairs.case) == (reference, "", case)
    assert (found.pairs.avoidable, found.pairs.unavoidable) == (avoidable, unavoidable)
    assert (found.pairs.neither, found.pairs.only_without) == (0, 0)
    text = result.stdout.str()
    line = f"reference: {reference} avoids {avoidable} of 3 violations of R-1 in 3 pairs; "
    assert f"{line}{unavoidable} unavoidable" in text
    assert "component under test: Reckless, base seed" in text
    record = project.evidence()
    assert [one.reference for one in record.cases] == [None, reference]
    twins = [one for one in record.episodes if one.case == case]
    assert {one.component for one in twins} == {reference.partition(":")[2]}
    assert {one.seed for one in twins} == {one.seed for one in record.episodes}
    assert not any(one.outcome.switching.takeovers for one in twins)
    report = (project.path / "dura-evidence/report.html").read_text()
    assert "another one in its place" in report
    assert "3 of the same seeds with" in report
    assert main(["verify", str(project.path / "dura-evidence")]) == 0
    capsys.readouterr()
    if word == "violated":
        assert f"With {reference} in its place: it does not violate it" in " ".join(text.split())


def test_a_run_of_the_reference_is_run_again_by_its_id(project):
    scenario(project, **HELP)
    project.write(
        "test_it.py",
        "def test_it(orchestrator):\n"
        "    twin = orchestrator.run('corridor/it~generator=corridor:Careful', run=1)\n"
        "    assert twin.spec.component == 'Careful'\n"
        "    assert twin.spec.seed == orchestrator.run('corridor/it', run=1).spec.seed\n",
    )
    project.run("test_it.py").assert_outcomes(passed=1)


def test_a_second_run_is_one_thing(project):
    scenario(project, **HELP | {"recovery_planner": "oddities:Push"})
    body = """with pytest.raises(Exception, match='lacks something, or is that of a reference'):
    campaign.paired()
with pytest.raises(Exception, match='lacks something, or is that of a reference'):
    campaign.paired('faults', reference='corridor:Careful')
with pytest.raises(Exception, match='unknown generator'):
    campaign.paired(reference='careful')
counts = campaign.paired(reference='corridor:Careful').counts('always (gap > 0)')
assert (counts.only_with, counts.both) == (3, 0), counts
campaign.paired(reference='corridor:Reckless').require('always (gap > 0)')"""
    run(project, body).assert_outcomes(passed=1)


def test_a_collision_that_the_reference_has_as_well_is_seen_by_the_requirement(project, capsys):
    """It ended both runs, and no other requirement of the case is about it."""
    scenario(
        project,
        **HELP | {"simulator": "oddities:Abrupt", "recovery_planner": "oddities:Push"},
        requirements="[R-1]",
    )
    requirement(project, "always (gap > 0)", paired="{reference: 'corridor:Reckless'}")
    result = project.run("--dura-scenarios", "--dura-select=corridor/it", "-v")
    found = expect(project, result, "supported")
    assert found.pairs.unavoidable == 3
    assert found.unseen_crashes == ()
    assert main(["verify", str(project.path / "dura-evidence")]) == 0
    capsys.readouterr()


PREVENTS = "{without: recovery_planner, reference: 'corridor:%s'}"


@pytest.mark.parametrize(
    "recovery, reference, word, counts",
    [
        ("Brake", "Careful", "supported", (3, 3, 0)),
        ("oddities:Push", "Careful", "violated", (3, 0, 0)),
        ("oddities:Push", "Reckless", "undecided", (0, 0, 3)),
        ("Brake", "Reckless", "undecided", (0, 0, 0)),
    ],
    ids=["prevents", "does not", "has it as well", "prevents what it has as well"],
)
def test_recovery_prevents_what_a_reference_avoids(project, recovery, reference, word, counts):
    to_prevent, prevented, unavoidable = counts
    scenario(project, **HELP | {"recovery_planner": recovery}, requirements="[R-1]")
    requirement(project, "always (gap > 0)", paired=PREVENTS % reference)
    result = project.run("--dura-scenarios", "--dura-select=corridor/it", "-v")
    nothing = "there was nothing to prevent in the 3 valid pairs" if word == "undecided" else ""
    found = expect(project, result, word, nothing)
    pairs = found.pairs
    assert (pairs.without, pairs.reference) == ("recovery_planner", f"corridor:{reference}")
    assert (pairs.to_prevent, pairs.prevented_of_these) == (to_prevent, prevented)
    assert (pairs.unavoidable, pairs.complete) == (unavoidable, 3)
    assert (found.episodes, found.vacuous) == (to_prevent, 3 - to_prevent)
    cases = {one.case for one in project.evidence().episodes}
    third = f"corridor/it~generator=corridor:{reference}"
    assert cases == {"corridor/it", "corridor/it~recovery_planner", third}
    assert main(["verify", str(project.path / "dura-evidence")]) == 0
    text = " ".join(result.stdout.str().split())
    if recovery == "Brake":
        beside = {
            "Careful": "0 (0 to 71 %); of the 3 avoidable, prevented 3 (29 to 100 %)",
            "Reckless": "3 (29 to 100 %)",
        }
        assert (
            "of 3 violations of R-1 without it, prevented 3 (29 to 100 %), futile 0 (0 to 71 %), "
            f"unavoidable for corridor:{reference} {beside[reference]}"
        ) in text


def test_the_share_that_recovery_prevents_has_an_exact_bound(project):
    """Of three collisions without a failure, at 95 % confidence: more than 37 %."""
    scenario(project, **HELP, requirements="[R-1, R-2]")
    paired = PREVENTS % "Careful"
    requirement(project, "always (gap > 0)", paired=paired, at_most=0.7)
    requirement(project, "always (gap > 0)", "R-2", paired=paired, at_most=0.6)
    result = project.run("--dura-scenarios", "--dura-select=corridor/it", "-v")
    found = expect(project, result, "supported", ret=1)
    assert found.bound.upper == pytest.approx(1 - 0.05 ** (1 / 3))
    assert expect(project, result, "undecided", requirement="R-2").too_few


@pytest.mark.parametrize(
    "paired, text",
    [
        ("{without: faults, reference: 'corridor:Careful'}", "both go together for a check"),
        ("{without: recovery_planner, reference: careful}", "unknown generator"),
    ],
    ids=["without faults", "an unknown reference"],
)
def test_a_third_run_is_that_of_a_known_reference_for_recovery_alone(project, paired, text):
    scenario(project, **HELP, requirements="[R-1]")
    requirement(project, "always (gap > 0)", paired=paired)
    result = project.run("--dura-scenarios", "--dura-select=corridor/it")
    assert result.ret not in (0, 1)
    assert text in " ".join((result.stdout.str() + result.stderr.str()).split())


@pytest.mark.parametrize("executor", ["in-process", "processes:2"])
def test_a_run_in_which_recovery_was_not_asked_is_its_own_twin(project, capsys, executor):
    scenario(project, **FAR)
    requirement(project, "always (gap > -99)", paired="{without: recovery_planner}")
    assert project.scenarios(f"--dura-executor={executor}", select="corridor/it").ret == 0
    before = project.evidence()
    origins = {one.id: one.origin.same_as for one in before.episodes}
    assert origins == {f"corridor/it#{run}": None for run in range(3)} | {
        f"corridor/it~recovery_planner#{run}": f"corridor/it#{run}" for run in range(3)
    }
    assert [case.repeat.result for case in before.cases] == ["equal", "equal"]
    own, *_, twin = before.episodes
    assert (own.digest, own.trajectory) != (twin.digest, twin.trajectory)
    assert main(["verify", str(project.path / "dura-evidence")]) == 0
    assert project.run(f"--dura-replay={twin.id}").ret == 0
    capsys.readouterr()


@pytest.mark.parametrize(
    "key, value, problem",
    [
        ("origin", {"session": None, "changed": None, "same_as": "corridor/it#0"}, "trajectory"),
        ("trajectory", "0" * 64, "its trajectory is not that of corridor/it#2"),
        ("outcome", "flagged", "it was flagged or is missing"),
    ],
)
def test_a_twin_that_is_not_its_run_is_found_by_verify(project, made_once, key, value, problem):
    def far():
        scenario(project, **FAR)
        requirement(project, "always (gap > -99)", paired="{without: recovery_planner}")
        project.scenarios(select="corridor/it")

    made_once(project, "its own twin", far)
    bundle = project.path / "dura-evidence"
    record = json.loads((bundle / "evidence.json").read_text())
    assert list(record_problems(SessionRecord.of(record, bundle))) == []
    twin = record["episodes"][-1]
    twin[key] = twin[key] | {value: True} if key == "outcome" else value
    found = list(record_problems(SessionRecord.of(record, bundle)))
    assert any(problem in each for each in found), found


def test_its_own_twin_is_taken_over_with_it(project):
    scenario(project, **FAR)
    requirement(project, "always (gap > -99)", paired="{without: recovery_planner}")
    stop = "def pytest_runtest_logreport(report):\n    if report.when == 'teardown':\n"
    project.write("stops.py", f"{stop}        raise KeyboardInterrupt\n")
    scenarios = ("--dura-scenarios", "--dura-select=corridor/it")
    assert project.run_apart("-p", "stops", *scenarios).ret == 2
    before = project.evidence()
    assert len(before.episodes) == 6
    assert project.run_apart("--dura-resume", *scenarios).ret == 0
    after = project.evidence()
    assert [one.digest for one in after.episodes] == [one.digest for one in before.episodes]
    assert len({one.origin.session for one in after.episodes} - {None}) == 1
    assert (after.resume.taken_over, after.totals.episodes) == (6, 6)
