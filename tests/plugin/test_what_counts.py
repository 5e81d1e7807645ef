"""What counts, and what it counts as: every rule, seen in terminal, exit code and evidence.

``RULES`` names the tests of each rule, here and in the files beside this one.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from corridors import IDLE, expect, requirement, scenario

from pytest_dura.requirements.campaign_verdicts import UncountedEpisode

RULES = {
    "the Generator raises, exceeds its time budget, or returns no valid action": [
        "test_what_counts.py::test_a_generator_that_fails_is_an_event_and_the_episode_is_judged",
        "test_failing_components.py::test_a_component_that_fails_is_judged",
        "test_failing_components.py::test_a_component_that_hangs_is_judged_in_a_worker_too",
    ],
    "the process ends in the middle of a call": [
        "test_deaths.py::test_a_component_that_ends_its_process_is_named_and_its_run_is_open",
        "test_deaths.py::test_a_role_or_simulator_that_ends_its_process_is_named_and_its_run_missing",
        "test_deaths.py::test_what_a_component_leaves_in_its_process_is_named_and_reaches_no_other_episode",
    ],
    "any other role, or the simulator, raises or yields NaN": [
        "test_what_counts.py::test_another_role_or_the_simulator_fails_and_the_episode_is_missing",
        "test_what_counts.py::test_a_missing_episode_is_not_replaced_and_undoes_the_others",
        "test_failing_components.py::test_a_role_that_fails_is_infrastructure",
        "test_failing_components.py::test_no_test_passes_on_missing_episodes",
        "test_requirement_files.py::test_a_check_that_fails_is_infrastructure",
    ],
    "a violation was observed": [
        "test_what_counts.py::test_a_violation_was_observed_and_counts_whatever_else_happens",
        "test_failing_components.py::test_a_violation_on_an_invalid_episode_is_a_violation",
    ],
    "a planned fault never manifested": [
        "test_what_counts.py::test_a_planned_fault_that_never_manifested_is_invalid",
        "test_what_counts.py::test_a_manifested_fault_that_changed_no_behaviour_is_valid",
        "test_what_counts.py::test_a_probabilistic_fault_that_drew_no_hit_is_valid",
        "test_failing_components.py::test_a_test_cannot_pass_on_an_invalid_episode",
    ],
    "an early end leaves a requirement open": [
        "test_early_ends.py::test_runs_that_crash_before_a_window_count_as_violations",
        "test_early_ends.py::test_one_open_run_leaves_a_requirement_without_a_rate_undecided",
        "test_early_ends.py::test_a_halt_leaves_open_what_was_to_hold_always",
        "test_early_ends.py::test_an_eventuality_that_is_due_at_a_crash_is_violated",
    ],
    "an end by goal": [
        "test_early_ends.py::test_an_end_by_goal_is_judged_on_the_trace_as_it_stands",
    ],
    "the time limit comes before a window ends": [
        "test_early_ends.py::test_a_window_beyond_the_duration_is_refused_at_its_place",
        "test_what_counts.py::test_the_trace_ends_before_a_window_and_is_invalid_for_it_alone",
        "test_what_counts.py::test_a_prefix_that_decides_counts_and_unbounded_operators_range_over_it",
    ],
    "a recorded log that reaches beyond what was judged, has gaps or changes its unit": [
        "test_black_box_sessions.py::test_a_log_is_judged_as_a_whole_or_not_at_all",
    ],
    "an episode ends critical and violates nothing of its case": [
        "test_early_ends.py::test_a_crash_that_no_requirement_sees_is_undecided",
        "test_early_ends.py::test_a_crash_that_another_requirement_sees_is_no_obstacle",
        "test_early_ends.py::test_a_crash_is_not_seen_by_a_requirement_on_pairs",
    ],
    "what an invalid run violates": [
        "test_early_ends.py::test_an_invalid_run_that_violates_fails_the_gate_in_words_of_its_own",
        "test_early_ends.py::test_every_format_agrees_on_runs_without_effect_of_the_fault",
    ],
    "an implication whose condition never held": [
        "test_what_counts.py::test_vacuous_passes_alone_are_undecided",
        "test_what_counts.py::test_vacuous_passes_beside_others_are_counted",
    ],
    "invalid episodes": [
        "test_what_counts.py::test_invalid_episodes_are_followed_by_further_runs_and_borne",
        "test_failing_components.py::test_a_fault_that_never_manifests_has_more_runs_follow",
        "test_failing_components.py::test_a_campaign_of_invalid_episodes_carries_no_pass",
    ],
    "fewer episodes than planned": [
        "test_partial_runs.py::test_fewer_episodes_than_planned_are_undecided",
        "test_partial_runs.py::test_last_failed_runs_fewer_episodes_than_planned",
        "test_partial_runs.py::test_a_time_limit_leaves_the_rest_undecided",
        "test_partial_runs.py::test_a_dead_worker_leaves_its_runs_undecided",
        "test_evidence_file.py::test_items_that_never_ran_are_undecided",
        "test_evidence_file.py::test_a_worker_that_dies_leaves_its_campaign_undecided",
        "test_evidence_file.py::test_a_killed_session_does_not_read_as_a_pass",
    ],
    "an interruption, once or twice, at any moment": [
        "test_interruptions.py::test_what_never_ran_leaves_no_complete_session",
        "test_interruptions.py::test_an_end_that_is_interrupted_leaves_the_episodes",
        "test_resume.py::test_a_session_that_was_killed_before_its_first_record_begins_anew",
    ],
    "a case whose repeated episode differs": [
        "test_repeats.py::test_verdicts_on_a_component_that_does_not_repeat_itself_are_undecided",
        "test_repeats.py::test_runs_of_what_declares_that_it_does_not_repeat_itself_count_as_draws",
        "test_repeats.py::test_a_verdict_on_pairs_rests_on_the_repetition_of_their_second_runs_too",
    ],
    "a requirement on pairs alone judges a case": [
        "test_early_ends.py::test_a_requirement_on_pairs_sees_the_crash_of_neither_run",
    ],
    "a formula that no signal can make false": [
        "test_checks_that_cannot_fail.py::test_a_formula_that_holds_always_is_refused_at_its_line",
        "test_checks_that_cannot_fail.py::test_a_weak_requirement_is_named_where_its_verdict_stands",
    ],
    "--dura-runs=N": [
        "test_what_counts.py::test_dura_runs_replaces_the_plan_and_cannot_support_a_rate",
        "test_scenario_items.py::test_runs_are_replaced_and_it_is_said",
    ],
    "undecided, invalid": [
        "test_undecided.py::test_undecided_fails_the_gate_and_is_relaxed_to_a_skip_where_runs_are_too_few",
        "test_undecided.py::test_a_violation_is_never_relaxed",
        "test_failing_components.py::test_the_gate_fails_on_a_verdict_for_which_no_test_failed",
    ],
    "xfail, reruns": [
        "test_waivers.py::test_an_expected_failure_is_recorded_as_a_waiver",
        "test_waivers.py::test_an_expected_failure_of_tests_on_one_episode",
        "test_waivers.py::test_a_strict_xfail_that_passes_fails",
        "test_waivers.py::test_a_rerun_keeps_every_attempt_of_a_campaign",
        "test_waivers.py::test_a_violation_in_any_attempt_at_an_episode_counts",
        "test_scenario_items.py::test_xfail_is_a_waiver",
    ],
    "a test that other plugins retry or repeat": [
        "test_waivers.py::test_a_retried_failure_is_a_waiver_whatever_plugin_retries",
        "test_waivers.py::test_a_retry_that_fails_each_time_is_no_waiver",
        "test_waivers.py::test_an_attempt_that_asks_for_no_verdict_is_no_pass",
        "test_waivers.py::test_repeats_of_a_test_are_one_verdict",
        "test_waivers.py::test_of_repeats_that_disagree_the_worst_counts_and_is_not_waived",
    ],
    "a malformed file, option or formula": [
        "test_what_counts.py::test_a_malformed_file_option_or_formula_is_one_error",
        "test_options.py::test_a_wrong_value_is_one_usage_error",
        "test_options.py::test_a_broken_scenario_file_is_one_usage_error",
        "test_requirement_files.py::test_a_requirement_that_cannot_be_used_is_one_error_at_its_place",
        "test_test_functions.py::test_a_marker_that_cannot_be_used_is_one_error",
    ],
}


@pytest.mark.parametrize("rule", RULES)
def test_every_rule_has_tests(rule):
    assert RULES[rule]
    for name in RULES[rule]:
        file, _, function = name.partition("::")
        tree = ast.parse(Path(__file__).with_name(file).read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert function in defined, f"{file} has no {function}"


@pytest.mark.parametrize(
    "generator, detail",
    [
        ("RaisesOnce", "raised ValueError: out of ideas"),
        ("HangsOnce", "overran its wall-clock time budget"),
        ("ReturnsNoneOnce", "returned NoneType, not a Proposal"),
    ],
    ids=["raises", "exceeds its time budget", "returns no valid action"],
)
def test_a_generator_that_fails_is_an_event_and_the_episode_is_judged(project, generator, detail):
    scenario(project, generator=f"oddities:{generator}", recovery_planner="Brake", runs=1)
    result = project.run("corridor/it::GAP-1", "--dura-time-budget=1")
    found = expect(project, result, "supported", requirement="GAP-1")
    assert (found.episodes, found.missing, found.invalid) == (1, 0, 0)
    (episode,) = project.evidence().episodes
    kinds = [event.kind for event in episode.events]
    assert kinds[:2] == ["component_failure", "recovery"]
    assert detail in episode.events[0].detail
    assert episode.termination == "time"


@pytest.mark.parametrize(
    "roles, start",
    [
        ({"world": "{breaks_at: 2}"}, "simulator at tick 1 (t = 0.1 s): RuntimeError: the corr"),
        (
            {"simulator": "oddities:TurnsNaN"},
            "simulator at tick 2 (t = 0.2 s): signal 'gap' is nan, not a fin",
        ),
        (
            {"monitor": "oddities:BrokenSafetyMonitor", "world": "{wall: 4.0}"},
            "safety_monitor at tick 2 (t = 0.2 s): RuntimeError: no opinion",
        ),
        (
            {"monitor": "oddities:NaNSafetyMonitor", "world": "{wall: 4.0}"},
            "safety_monitor at tick 2 (t = 0.2 s): ValueError: its score is not a number (NaN)",
        ),
    ],
    ids=["simulator raises", "simulator yields NaN", "role raises", "role yields NaN"],
)
def test_another_role_or_the_simulator_fails_and_the_episode_is_missing(project, roles, start):
    scenario(project, requirements="[GAP-1]", **roles)
    result = project.run("corridor/it")
    reason = "2 of 2 episodes are missing (infrastructure); none of the episodes was valid"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    assert (found.planned, found.run, found.missing) == (2, 2, 2)
    assert found.first_uncounted.detail.startswith(f"infrastructure: {start}")
    message = result.stdout.str().partition("corridor/it::GAP-1 _")[2].splitlines()[1]
    assert message.startswith(f"infrastructure: {start}")


def test_a_missing_episode_is_not_replaced_and_undoes_the_others(project):
    variation = "{world.breaks_at: {choice: [2, 100]}}"
    scenario(project, runs=6, world="{breaks_at: 100}", variation=variation)
    result = project.run("corridor/it::GAP-1")
    found = expect(project, result, "undecided", "missing (infrastructure)", requirement="GAP-1")
    assert (found.planned, found.run) == (6, 6)
    assert found.missing + found.episodes == 6
    assert 0 < found.missing < 6


@pytest.mark.parametrize(
    "check, keys",
    [
        ("always (gap > 0)", {"world": "{wall: 1.0, breaks_at: 3}"}),
        ("always[0:0.5] (gap > 0)", {}),
        ("always (gap > 0)", {"generator": "Reckless", "monitor": "oddities:LateNaN"}),
    ],
    ids=["then the simulator fails", "before a window ends", "then NaN"],
)
def test_a_violation_was_observed_and_counts_whatever_else_happens(project, check, keys):
    requirement(project, check)
    keys = {"generator": "Reckless", "world": "{wall: 1.0}", "requirements": "[R-1]"} | keys
    scenario(project, **keys)
    result = project.run("corridor/it", "--dura-undecided=warn")
    found = expect(project, result, "violated", "valid episodes violated it")
    assert found.violations == found.run >= 2
    assert (found.invalid, found.missing) == (0, 0)
    assert found.counterexamples[0].time == pytest.approx(0.1)


def test_a_planned_fault_that_never_manifested_is_invalid(project):
    scenario(project, faults=IDLE, fault_injector="Idle", requirements="[GAP-1]")
    result = project.run("-v", "corridor/it")
    reason = "3 of 3 episodes are invalid, more than 20%; none of the episodes was valid"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    detail = "never manifested: ghost-obstacle"
    assert found.first_uncounted == UncountedEpisode("corridor/it#0", "invalid", detail)
    assert "invalid:  corridor/it#0: never manifested: ghost-obstacle" in result.stdout.str()


def test_a_manifested_fault_that_changed_no_behaviour_is_valid(project):
    scenario(project, "bare", requirements="[GAP-1]", runs=1)
    scenario(project, faults=IDLE, fault_injector="oddities:Nudge", requirements="[GAP-1]", runs=1)
    result = project.run("corridor/it", "corridor/bare")
    found = expect(project, result, "supported", requirement="GAP-1")
    assert (found.episodes, found.invalid) == (1, 0)
    bare, nudged = project.evidence().episodes
    assert [event.kind for event in nudged.events] == ["fault_manifested"]
    assert nudged.outcome == bare.outcome


def test_a_probabilistic_fault_that_drew_no_hit_is_valid(project):
    injector = "pytest_dura.faults.injector:CampaignInjector"
    faults = "[{type: 'oddities:Drizzle', id: drizzle, activation: {at: 0.0}}]"
    scenario(project, faults=faults, fault_injector=injector, requirements="[GAP-1]")
    result = project.run("corridor/it")
    # The episodes are, and say nothing of the fault as long as it hits in none of them.
    reason = "drizzle manifested in none of the 2 valid episodes"
    found = expect(project, result, "undecided", reason, requirement="GAP-1")
    assert (found.episodes, found.invalid) == (2, 0)


def test_a_probabilistic_fault_that_hit_in_some_episodes_supports_a_claim(project):
    noise = "{type: noise, target: gap, activation: {probability: 0.1}, duration: once}"
    injector = "pytest_dura.faults.injector:CampaignInjector"
    scenario(project, faults=f"[{noise}]", fault_injector=injector, requirements="[GAP-1]", runs=12)
    result = project.run("corridor/it")
    found = expect(project, result, "supported", requirement="GAP-1")
    assert (found.episodes, found.invalid) == (12, 0)
    hits = [one.faults[0].manifested_at for one in project.evidence().episodes]
    assert None in hits
    assert any(time is not None for time in hits)


TIME_LIMITS = pytest.mark.parametrize(
    "limit, end",
    [
        ({"duration": 0.5}, "time"),
        ({"duration": 5.0, "simulator": "oddities:EndsByItself"}, "truncated"),
    ],
    ids=["of the scenario", "of the plant"],
)


@TIME_LIMITS
def test_the_trace_ends_before_a_window_and_is_invalid_for_it_alone(project, limit, end):
    requirement(project, "always ((x > 0.25) implies eventually[0:0.3] (x >= 100))")
    scenario(project, requirements="[R-1, GAP-1]", runs=1, **limit)
    result = project.run("corridor/it")
    reason = "1 of 1 episodes are invalid, more than 20%; none of the episodes was valid"
    found = expect(project, result, "undecided", reason)
    assert "robustness between -0.25 and 0.05" in found.first_uncounted.detail
    assert "robustness between -0.25 and 0.05" in result.stdout.str()
    other = expect(project, result, "supported", requirement="GAP-1", ret=1)
    assert (other.episodes, other.invalid) == (1, 0)
    (episode,) = project.evidence().episodes
    assert (episode.termination, episode.validity) == (end, "valid")


DECIDED = {
    "eventually[0:0.5] (x >= 0.3)": "supported",
    "always[0:0.5] (x < 0.3)": "violated",
    "eventually (x >= 100)": "violated",
    "always (x < 0.6)": "supported",
}


@TIME_LIMITS
def test_a_prefix_that_decides_counts_and_unbounded_operators_range_over_it(project, limit, end):
    for number, check in enumerate(DECIDED):
        requirement(project, check, f"R-{number}")
    scenario(project, requirements="[R-0, R-1, R-2, R-3]", **limit)
    result = project.run("corridor/it")
    for number, word in enumerate(DECIDED.values()):
        found = expect(project, result, word, requirement=f"R-{number}", ret=1)
        assert (found.episodes, found.invalid) == (2, 0)
    assert {episode.termination for episode in project.evidence().episodes} == {end}


def test_vacuous_passes_alone_are_undecided(project):
    requirement(project, "always (gap < 3.5 -> gap > 1)")
    scenario(project, requirements="[R-1]")
    result = project.run("-v", "corridor/it")
    reason = "its condition held in none of the 2 valid episodes (vacuous)"
    found = expect(project, result, "undecided", reason)
    assert (found.episodes, found.vacuous) == (2, 2)
    told = " ".join(result.stdout.str().split())
    assert "R-1: undecided, 0 of 2 runs violate it, 2 vacuous." in told


def test_vacuous_passes_beside_others_are_counted(project):
    requirement(project, "always (gap < 3.5 -> gap > 1)")
    variation = "{world.wall: {choice: [3.2, 10.0]}}"
    scenario(project, world="{wall: 10.0}", variation=variation, runs=6, requirements="[R-1]")
    result = project.run("-v", "corridor/it")
    found = expect(project, result, "supported")
    assert found.episodes == 6
    assert 0 < found.vacuous < 6
    header, row = (
        next(line for line in result.outlines if line.startswith(start)).split()
        for start in ("verdict ", "R-1 on corridor/it ")
    )
    # The row is named by two more words than the header.
    assert row[header.index("vac") + 2 + 1] == str(found.vacuous)


def test_invalid_episodes_are_followed_by_further_runs_and_borne(project):
    faults = "[{type: ghost-obstacle, activation: {at: 0.1}}]"
    often = "[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.4]"  # after 0.4 s nothing is decided any more
    scenario(
        project,
        runs=10,
        faults=faults,
        variation=f"{{faults.ghost-obstacle.activation.at: {{choice: {often}}}}}",
        fault_injector="oddities:Nudge",
        requirements="[GAP-1]",
    )
    result = project.run("corridor/it")
    found = expect(project, result, "supported", "all 10 valid episodes", requirement="GAP-1")
    assert 0 < found.invalid <= 2
    assert (found.planned, found.episodes) == (10, 10)
    assert found.run == 10 + found.invalid
    runs = [int(one.id.partition("#")[2]) for one in project.evidence().episodes]
    assert runs == list(range(found.run))
    row = next(line for line in result.outlines if line.startswith("corridor/it  "))
    assert row.split()[1] == "10"
    assert row.split()[-1] == str(found.invalid)


def test_dura_runs_replaces_the_plan_and_cannot_support_a_rate(project):
    requirement(project, "always (gap > 0)", at_most=0.1)
    scenario(project, runs=30, requirements="[R-1]")
    expect(project, project.run("corridor/it"), "supported", "the rate is at most 0.095")
    result = project.run("corridor/it", "--dura-runs=5")
    reason = "a new plan on a fresh seed of 29 runs, which may hold no violations"
    found = expect(project, result, "undecided", reason)
    assert (found.planned, found.run) == (5, 5)
    assert "--dura-runs=5 replaces the planned number of runs" in result.stdout.str()
    assert "gate: failed, 5 runs instead of 30, 1 undecided" in result.stdout.str()
    assert [case.runs_override for case in project.evidence().cases] == [5]


@pytest.mark.parametrize(
    "text, arguments, told",
    [
        (
            "check: always (gap > 0)",
            ["--dura-seed=x"],
            ["ERROR: --dura-seed takes*", "*key:*--dura-seed", "*found:*'x'", "*expected:*"],
        ),
        (
            "chekc: always (gap > 0)",
            [],
            [
                "ERROR: *requirements_R-1.yaml:3: *",
                "*key:*requirements.0.chekc*",
                "*remedy:*check*",
            ],
        ),
        (
            'check: "always (gap >> 0)"',
            [],
            [
                "ERROR: *requirements_R-1.yaml:3: *",
                "*always (gap >> 0)",
                "*^*",
                "*key:*requirements.0.check",
                "*expected:*",
            ],
        ),
    ],
    ids=["option", "file", "formula"],
)
def test_a_malformed_file_option_or_formula_is_one_error(project, text, arguments, told):
    entry = f"requirements:\n  - {{id: R-1, text: t, kind: safety,\n     {text}}}\n"
    project.write("scenarios/requirements_R-1.yaml", entry)
    result = project.scenarios(*arguments)
    assert result.ret == 4
    result.stderr.fnmatch_lines(told)
    message = result.stdout.str() + result.stderr.str()
    assert message.count("ERROR") == 1
    assert "Traceback" not in message
    assert not (project.path / "dura-evidence").exists()
