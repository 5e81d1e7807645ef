"""Pairs of what scenarios vary, and declared exposure, as the record counts them."""

import pytest
from entries import make
from session_records import episode

from pytest_dura.evidence import coverage
from pytest_dura.evidence import operating_domain as module
from pytest_dura.evidence.case_model import CasePlan, CoverageEntry, RequirementEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.verdict_model import VerdictEntry

SQUARE = {"world.x": {"min": 0.0, "max": 10.0}, "world.y": {"min": 0.0, "max": 10.0}}


def case(name, variation=None, *, component="C", without=(), **changes):
    return make(
        CasePlan, id=name, scenario=name.partition("+")[0].partition("~")[0], component=component,
        variation=variation or {}, without=list(without), **changes,
    )  # fmt: skip


def run(name, seed, world=None, **changes):
    plain = episode(name, seed, **changes)
    plain["component"] = "C"
    plain["spec"]["seed"] = seed
    plain["spec"]["scenario"] = {
        "name": name.partition("+")[0].partition("~")[0], "world": world or {}
    }  # fmt: skip
    return make(EpisodeEntry, **plain)


def verdict(name, *violating, requirement="S-1", without=(), pairs=None):
    counterexamples = [
        {"episode": f"{name}#{seed}", "time": None, "margin": None, "valid": seed not in without}
        for seed in violating
    ]
    return make(
        VerdictEntry, case=name, requirement=requirement, component="C", pairs=pairs,
        verdict="supported", counterexamples=counterexamples,
    )  # fmt: skip


REQUIREMENTS = [
    make(RequirementEntry, id="S-1", kind="safety"),
    make(RequirementEntry, id="P-1", kind="performance"),
]


def computed(cases, episodes, verdicts=()):
    made = coverage(cases, list(verdicts), iter(episodes), REQUIREMENTS)
    return CoverageEntry.model_validate(made)


def test_a_pair_is_counted_in_fifths_of_both_ranges():
    drawn = [(0.0, 0.0), (1.9, 9.9), (2.1, 10.0), (0.5, 0.5)]
    episodes = [run("a", seed, {"x": x, "y": y}) for seed, (x, y) in enumerate(drawn)]
    found = computed([case("a", SQUARE)], episodes).combinations
    assert (found.pairs, found.cells, found.met, found.unpaired) == (1, 25, 3, 0)
    (pair,) = found.worst
    assert (pair.scenario, pair.first, pair.second) == ("a", "world.x", "world.y")
    assert pair.counts == [[2, 0, 0, 0, 1], [0, 0, 0, 0, 1], *[[0] * 5] * 3]
    assert (pair.drawn, pair.met, pair.covered) == (4, 3, 3 / 25)


def test_pairs_stand_worst_first_and_too_many_are_counted(monkeypatch):
    variation = {**SQUARE, "world.side": {"choice": ["left", "right"]}}
    episodes = [
        run("a", seed, {"x": 2.0 * seed + 1, "y": 1.0, "side": "left"}) for seed in range(5)
    ]
    found = computed([case("a", variation)], episodes).combinations
    shares = [(pair.first, pair.second, pair.covered) for pair in found.worst]
    assert shares == [
        ("world.side", "world.y", 0.1), ("world.x", "world.y", 0.2), ("world.side", "world.x", 0.5),
    ]  # fmt: skip
    monkeypatch.setattr(module, "MAX_PAIRS", 1)
    bounded = computed([case("a", variation)], episodes).combinations
    assert (len(bounded.worst), bounded.pairs, bounded.met) == (1, 3, found.met)


def test_a_seed_counts_once_and_a_case_adds_what_another_leaves_out():
    variation = {"world.x": SQUARE["world.x"], "faults.f.at": {"min": 0.0, "max": 1.0}}
    cases = [case("a", variation), case("a+none", variation)]
    with_fault = run("a", 1, {"x": 1.0}).to_json()
    with_fault["spec"]["faults"] = [{"id": "f", "target": "t", "at": 0.1}]
    with_fault = make(EpisodeEntry, **with_fault)
    for episodes in ([run("a+none", 1, {"x": 1.0}), with_fault, with_fault], [with_fault]):
        (pair,) = computed(cases, episodes).combinations.worst
        assert (pair.drawn, pair.counts[0][0]) == (1, 1)
    left = [run("a", 1, {"x": 1.0}, validity="invalid"), run("a", 2, {"x": 1.0}, planned=False)]
    assert computed(cases, left).combinations.met == 0


def test_what_has_no_single_value_stands_in_no_pair():
    variation = {
        **SQUARE,
        "world.input": {"min": 0.0, "max": 1.0, "pieces": 3},
        "world.many": {"choice": list(range(21))},
    }
    found = computed([case("a", variation)], []).combinations
    assert (found.pairs, found.unpaired) == (1, 2)
    single = {"world.x": {"min": 3.0, "max": 3.0}, "world.y": SQUARE["world.y"]}
    (pair,) = computed([case("a", single)], [run("a", 0, {"x": 3.0, "y": 1.0})]).combinations.worst
    assert (pair.met, pair.covered, len(pair.counts)) == (1, 0.2, 1)


def test_a_record_without_pairs_or_exposure_has_no_such_key():
    found = computed([case("a", {"world.x": SQUARE["world.x"]})], [])
    assert (found.combinations, found.exposure) == (None, None)
    assert "combinations" not in found.to_json()


def exposed(name, weight, variation=None, parameters=None, **changes):
    plan = {"weight": weight, "source": "counted", "parameters": parameters or {}}
    return case(name, variation, exposure=plan, **changes)


def test_the_share_of_the_declared_exposure_that_was_exercised():
    cases = [exposed("often", 9.0), exposed("rare", 1.0), case("unknown")]
    (entry,) = computed(cases, [run("rare", 0), run("unknown", 0)]).exposure
    assert (entry.component, entry.declared, entry.undeclared) == ("C", 10.0, ["unknown"])
    assert entry.exercised == pytest.approx(0.1)
    rows = [(each.scenario, each.share, each.runs, each.exercised) for each in entry.scenarios]
    assert rows == [("often", 0.9, 0, 0.0), ("rare", 0.1, 1, 1.0)]
    both = [run("rare", 0), run("often", 1)]
    assert computed(cases, both).exposure[0].exercised == 1.0


def test_a_scenario_is_exercised_as_far_as_its_least_parameter():
    weights = {"world.x": [6.0, 2.0, 2.0], "world.y": [1.0, 1.0]}
    cases = [exposed("a", 2.0, SQUARE, weights)]
    runs = [run("a", 0, {"x": 1.0, "y": 1.0}), run("a", 1, {"x": 9.0, "y": 9.0})]
    (entry,) = computed(cases, runs).exposure
    (scenario,) = entry.scenarios
    shares = {each.parameter: (each.runs, each.exercised) for each in scenario.parameters}
    assert shares == {"world.x": ([1, 0, 1], 0.8), "world.y": ([1, 1], 1.0)}
    assert (scenario.exercised, entry.exercised) == (0.8, 0.8)


def test_violations_are_weighed_by_the_exposure_of_their_scenarios():
    cases = [exposed("often", 9.0), exposed("rare", 1.0)]
    runs = [*(run("often", seed) for seed in range(10)), *(run("rare", seed) for seed in range(2))]
    verdicts = [verdict("often", 3), verdict("rare", 0, 1), verdict("rare", 1, requirement="P-1")]
    (entry,) = computed(cases, runs, verdicts).exposure
    safety, performance = entry.violations
    assert (safety.kind, safety.runs, safety.violating, safety.scenarios) == ("safety", 12, 3, 2)
    assert safety.weighed == pytest.approx(0.9 * 0.1 + 0.1 * 1.0)
    assert safety.of_exposure == 1.0
    # No verdict of this kind is on the other scenario, which weighs nothing here.
    assert (performance.runs, performance.violating, performance.weighed) == (2, 1, 0.5)
    assert performance.of_exposure == pytest.approx(0.1)


def test_runs_weigh_by_the_parts_that_they_drew_from():
    cases = [exposed("a", 1.0, SQUARE, {"world.x": [3.0, 1.0]})]
    runs = [run("a", 0, {"x": 1.0}), run("a", 1, {"x": 9.0})]
    (entry,) = computed(cases, runs, [verdict("a", 1)]).exposure
    assert entry.violations[0].weighed == pytest.approx(0.25)
    cases = [exposed("a", 1.0, SQUARE, {"world.x": [0.0, 1.0]})]
    (entry,) = computed(cases, runs[:1], [verdict("a", 0)]).exposure
    assert (entry.violations[0].weighed, entry.violations[0].of_exposure) == (None, 0.0)


def test_what_is_no_sample_of_the_situation_weighs_nothing():
    arm = exposed("a~recovery_planner", 1.0, without=["recovery_planner"])
    cases = [exposed("a", 1.0), arm, exposed("a+none", 1.0)]
    pairs = make(VerdictEntry, pairs={"case": "a+none", "without": "faults"}).pairs
    verdicts = [verdict("a", 0, 1, without=[1], pairs=pairs)]
    runs = [
        run("a", 0), run("a", 1), run("a", 2, validity="invalid"), run("a", 3, planned=False),
        run("a~recovery_planner", 0), run("a+none", 0),
    ]  # fmt: skip
    (entry,) = computed(cases, runs, verdicts).exposure
    assert entry.scenarios[0].runs == 2
    assert (entry.violations[0].runs, entry.violations[0].violating) == (2, 1)


def test_the_order_of_episodes_changes_nothing():
    weights = {"world.x": [0.1, 0.7, 0.3], "world.y": [0.3, 0.6]}
    cases = [exposed("a", 0.3, SQUARE, weights), exposed("b", 0.1)]
    runs = [run("a", seed, {"x": seed % 10, "y": seed * 7 % 10}) for seed in range(20)]
    verdicts = [verdict("a", 1, 3, 8, 9)]
    one, other = computed(cases, runs, verdicts), computed(cases, reversed(runs), verdicts)
    assert one.exposure == other.exposure
