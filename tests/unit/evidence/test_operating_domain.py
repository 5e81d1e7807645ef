"""Pairs of what scenarios vary, as the record counts them."""

from conclusions import concluded
from entries import make
from session_records import episode

from pytest_dura import Fault
from pytest_dura.core.codec import encode
from pytest_dura.evidence import Coverage
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclusions import operating_domain as module
from pytest_dura.evidence.episode_model import EpisodeEntry

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


def computed(cases, episodes):
    return concluded(Coverage, episodes, cases=cases)["coverage"]


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
    variation = {"world.x": SQUARE["world.x"], "faults.f.activation.at": {"min": 0.0, "max": 1.0}}
    cases = [case("a", variation), case("a+none", variation)]
    with_fault = run("a", 1, {"x": 1.0}).to_json()
    with_fault["spec"]["faults"] = [encode(Fault("noise", "f", "t", {"at": 0.1}))]
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


def test_a_record_without_pairs_has_no_such_key():
    found = computed([case("a", {"world.x": SQUARE["world.x"]})], [])
    assert found.combinations is None
    assert "combinations" not in found.to_json()
