import json

import pytest
from conclusions import concluded
from entries import make
from session_records import episode, session_record

from pytest_dura.core.codec import encode
from pytest_dura.evidence import Coverage
from pytest_dura.evidence.case_model import CasePlan
from pytest_dura.evidence.conclusions import coverage as module
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict


def case(name, *faults, component="C", requirements=("R",), variation=None, without=()):
    return make(
        CasePlan, id=name, scenario=name.partition("+")[0].partition("~")[0], component=component,
        faults=[{"id": one, "type": one} for one in faults], without=list(without),
        requirements=list(requirements), variation=variation or {},
    )  # fmt: skip


def verdict(name, word="supported", requirement="R", component="C"):
    return make(ItemVerdict, case=name, requirement=requirement, component=component, verdict=word)


def coverage(cases, verdicts=(), episodes=()):
    return encode(concluded(Coverage, episodes, cases=cases, verdicts=verdicts)["coverage"])


def cells(cases, verdicts, *keys):
    keys = keys or ("scenario", "faults", "case", "verdict")
    return [tuple(cell[key] for key in keys) for cell in coverage(cases, verdicts, [])["cells"]]


def test_each_scenario_is_crossed_with_each_set_of_faults_and_with_none():
    cases = [case("a"), case("b+x+y", "x", "y")]
    assert cells(cases, [verdict("a"), verdict("b+x+y", "violated")]) == [
        ("a", "", "a", "supported"),
        ("a", "x+y", "a+x+y", None),
        ("b", "", "b+none", None),
        ("b", "x+y", "b+x+y", "violated"),
    ]


def test_a_scenario_with_faults_of_its_own_is_named_by_itself():
    cases = [case("a", "x"), case("b", "y")]
    assert cells(cases, [], "scenario", "faults", "case") == [
        ("a", "", "a+none"), ("a", "x", "a"), ("a", "y", "a+y"),
        ("b", "", "b+none"), ("b", "x", "b+x"), ("b", "y", "b"),
    ]  # fmt: skip


def test_a_requirement_that_does_not_apply_to_a_scenario_is_no_cell():
    cases = [case("a", requirements=["R"]), case("b", requirements=["S"])]
    assert cells(cases, [], "scenario", "requirement") == [("a", "R"), ("b", "S")]


def test_a_requirement_that_a_test_claims_applies_to_that_scenario():
    cases = [case("a", requirements=[]), case("a+x", "x", requirements=[]), case("b")]
    told = [verdict("a", requirement="T")]
    assert cells(cases, told, "scenario", "requirement", "faults", "applies", "verdict") == [
        ("a", "T", "", "test", "supported"),
        ("a", "T", "x", "test", None),
        ("b", "R", "", "scenario", None),
        ("b", "R", "x", "scenario", None),
    ]


def test_the_worst_of_several_verdicts_counts():
    words = ["supported", "undecided", "violated", "supported"]
    assert cells([case("a")], [verdict("a", word) for word in words], "verdict") == [("violated",)]
    assert cells([case("a")], [verdict("a", word) for word in words[:2]], "verdict") == [
        ("undecided",)
    ]


def test_each_component_has_cells_of_its_own():
    cases = [case("a"), case("a", component="D")]
    assert cells(cases, [verdict("a", component="D")], "component", "verdict") == [
        ("C", None),
        ("D", "supported"),
    ]


def test_second_runs_of_pairs_are_no_cells():
    cases = [case("a"), case("a~recovery_planner", without=["recovery_planner"])]
    assert cells(cases, [verdict("a~recovery_planner")], "case", "verdict") == [("a", None)]


def test_untested_cells_that_are_too_many_are_counted(monkeypatch):
    monkeypatch.setattr(module, "MAX_CELLS", 3)
    cases = [case("a+x", "x"), case("b+y", "y")]
    found = coverage(cases, [verdict("a+x")], [])
    # One of each requirement and scenario is listed: neither reads as tested throughout.
    listed = [(cell["case"], cell["verdict"]) for cell in found["cells"]]
    assert listed == [("a+none", None), ("a+x", "supported"), ("b+none", None)]
    assert found["left_out"] == 3
    found = coverage(cases[:1], [verdict("a+x")], [])
    assert (found["left_out"], len(found["cells"])) == (0, 2)


def drawn(value, seed=0, name="a", **changes):
    told = episode(name, seed, **changes)
    told["spec"]["scenario"]["name"] = name.partition("+")[0]
    told["spec"]["scenario"]["world"] = {"wall": value, "cars": [{"turn": value}]}
    return told


def parameters(spread, episodes, path="world.wall", name="a"):
    entries = (make(EpisodeEntry, **one) for one in episodes)
    (found,) = coverage([case(name, variation={path: spread})], [], entries)["parameters"]
    return found


def test_the_parts_of_a_range_that_were_drawn():
    values = [2.0, 2.39, 2.41, 5.99, 6.0]
    found = parameters(
        {"min": 2.0, "max": 6.0}, [drawn(value, seed) for seed, value in enumerate(values)]
    )
    assert found == {
        "scenario": "a", "parameter": "world.wall", "low": 2.0, "high": 6.0, "choices": None,
        "drawn": 5, "least": 2.0, "greatest": 6.0, "bins": [2, 1, 0, 0, 0, 0, 0, 0, 0, 2],
        "covered": 0.3,
    }  # fmt: skip


def test_each_number_of_an_input_over_time_counts():
    found = parameters({"min": 2.0, "max": 6.0, "pieces": 3}, [drawn([2.0, 3.0, 5.9])])
    assert (found["drawn"], found["least"], found["greatest"]) == (3, 2.0, 5.9)
    assert found["bins"] == [1, 0, 1, 0, 0, 0, 0, 0, 0, 1]
    assert parameters({"min": 2.0, "max": 6.0, "pieces": 2}, [drawn(["x", 3.0])])["drawn"] == 0


def test_the_choices_that_were_drawn():
    found = parameters(
        {"choice": ["left", "right", True, 1]},
        [drawn("left"), drawn("left", 1), drawn(1, 2)],
        "world.cars.0.turn",
    )
    assert [one["count"] for one in found["choices"]] == [2, 0, 0, 1]
    assert (found["covered"], found["drawn"], found["bins"], found["low"]) == (0.5, 3, [], None)


def test_equal_seeds_count_once_and_episodes_that_say_nothing_do_not():
    episodes = [
        drawn(3.0, 1), drawn(3.0, 1, "a+x"), drawn(4.0, 2, validity="invalid"),
        drawn(4.0, 3, validity="missing"), drawn(4.0, 4, planned=False), drawn(5.0, 5, "b"),
    ]  # fmt: skip
    assert parameters({"min": 2.0, "max": 6.0}, episodes)["drawn"] == 1


def test_a_range_that_nothing_was_drawn_from():
    found = parameters({"min": 2.0, "max": 6.0}, [])
    assert (found["drawn"], found["least"], found["greatest"], found["covered"]) == (
        0, None, None, 0.0,
    )  # fmt: skip


def test_a_range_of_one_value_is_covered_by_it():
    assert parameters({"min": 3.0, "max": 3.0}, [drawn(3.0)])["covered"] == 1.0


@pytest.mark.parametrize("path", ["faults.ghost.activation.at", "faults.other.activation.at"])
def test_the_values_of_a_fault_where_it_was_planned(path):
    told = drawn(0)
    told["spec"]["faults"] = [{"id": "ghost", "activation": {"at": 1.0}}]
    found = parameters({"min": 0.0, "max": 2.0}, [told, drawn(0, 1)], path)
    assert found["drawn"] == (1 if "ghost" in path else 0)


def test_episodes_are_looked_at_one_at_a_time():
    alive = []

    def episodes():
        for run in range(50):
            alive.append(drawn(3.0, run))
            yield alive[-1]
            alive.clear()

    assert parameters({"min": 2.0, "max": 6.0}, episodes())["drawn"] == 50


def test_the_coverage_of_a_record_is_plain_data():
    record = session_record()
    found = coverage(record.head.cases, record.head.verdicts, record.episodes())
    assert json.loads(json.dumps(found)) == found
    words = {(cell["requirement"], cell["faults"]): cell["verdict"] for cell in found["cells"]}
    assert words["SAF-1", "ghost"] == "violated"
    assert words["PERF-1", "ghost"] is None
