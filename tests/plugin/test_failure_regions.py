"""Where failures lie: searches that go on after a violation, in sessions of their own."""

from __future__ import annotations

import pytest
import yaml
from outputs import output, shown_of

from pytest_dura.evidence import verify_bundle
from pytest_dura.search.region_table import regions_of

TWO = """
from corridor import Careful
from pytest_dura import Proposal

class TwoFold(Careful):
    \"\"\"Blind where the wall is 9.2 to 9.4 m away at first, and from 10.5 m on.\"\"\"

    def reset(self, context):
        super().reset(context)
        self.first = None

    def propose(self, view):
        gap = view.percept["gap"]
        self.first = self.first or gap
        blind = 9.2 <= self.first <= 9.4 or self.first >= 10.5
        return Proposal(90.0 if blind else 1.0 if gap > 3.0 else 0.0)
"""
SEARCH = """
import pytest

@pytest.mark.dura(scenario="corridor/free")
@pytest.mark.requirement("GAP-1")
@pytest.mark.falsify({arguments})
def test_it(campaign):
    pass
"""


@pytest.fixture
def searched(project):
    """Runs a search with some arguments; its result."""

    def run(arguments, *options):
        project.write("two.py", TWO)
        project.write("test_search.py", SEARCH.format(arguments=arguments))
        own = any("--dura-generator" in option for option in options)
        component = () if own else ("--dura-generator=two:TwoFold",)
        return project.run("test_search.py", *component, *options)

    return run


def test_two_regions_are_found_with_an_example_and_a_probability_of_each(project, searched):
    result = searched("budget=150, all=True, shrink=20, region_runs=40", "-v")
    assert result.ret == 1
    record = project.evidence()
    (search,) = record.searches
    assert search.simulations == 150
    *regions, whole = regions_of(record)
    spans = [(bound.low, bound.high) for region in regions for bound in region.bounds]
    assert any(10.4 <= low <= 10.6 and high == 11.0 for low, high in spans)
    assert any(9.1 <= low < 9.3 < high <= 9.5 for low, high in spans)
    for region in regions:
        assert region.event.startswith("always (gap > 0)")
        assert region.mass.low <= region.mass.estimate <= region.mass.high
        assert region.example.confirmed
        wall = yaml.safe_load((project.path / f"scenarios/{region.example.name}.yaml").read_text())[
            "world"
        ]["wall"]
        (bound,) = region.bounds
        assert 9.2 <= wall <= 9.4 or wall >= 10.5
        assert region.map.violating
        assert bound.axis.name == "world.wall"
    # Of 2 m, 0.2 and 0.5 m violate.
    assert whole.bounds == ()
    assert whole.mass.volume == 1.0
    assert whole.mass.low <= 0.35 <= whole.mass.high
    assert "Where failures lie" in output(result)
    page = (project.path / "dura-evidence/report.html").read_text()
    assert 'id="region-0-title"' in page
    assert "world.wall" in page
    assert verify_bundle(project.path / "dura-evidence").problems == []
    name = regions[0].example.name
    assert project.run(name, "--dura-generator=two:TwoFold").ret == 1


def test_a_search_ends_once_it_has_as_many_violations_as_it_was_asked_for(project, searched):
    searched("budget=150, at_least=5, shrink=0, region_runs=0")
    record = project.evidence()
    (search,) = record.searches
    assert search.outcomes[0].simulations < search.simulations < 150
    *regions, whole = regions_of(record)
    assert regions
    assert whole.kept == 5
    assert all(region.mass is None for region in (*regions, whole))


def test_one_violation_ends_a_search_and_shows_no_region(project, searched):
    searched("budget=150, shrink=0")
    record = project.evidence()
    assert regions_of(record) == []
    assert "failure_regions" not in record.conclusions


def test_a_search_of_many_violations_does_not_depend_on_who_simulates(project, searched):
    known = []
    for executor in ("in-process", "processes:1", "processes:2"):
        searched("budget=60, all=True, shrink=20, region_runs=10", f"--dura-executor={executor}")
        record = project.evidence()
        (search,) = record.searches
        known.append((search.searchers, search.outcomes, regions_of(record)))
    assert known[0] == known[1] == known[2]
    assert len(known[0][2]) > 1


def test_the_front_of_two_requirements_has_points_that_none_beats(project, searched):
    opposed = '["always (gap <= 10.5)", "eventually (gap >= 9.5)"]'
    searched(f"{opposed}, budget=60, all=True, shrink=0, region_runs=0")
    record = project.evidence()
    points = [fact.data["margins"] for fact in record.facts if fact.table == "pareto_front"]
    pairs = [tuple(margins.values()) for margins in points]
    assert len(pairs) > 1
    for one in pairs:
        assert not any(a <= one[0] and b <= one[1] for a, b in pairs if (a, b) != one)
    assert len(record.conclusions["pareto_front"].rows) == len(pairs)
    assert verify_bundle(project.path / "dura-evidence").problems == []


@pytest.mark.parametrize(
    "arguments, message",
    [
        ("at_least=0", "at_least is a whole number of at least 1"),
        ("at_least=2.5", "at_least is a whole number of at least 1"),
        ("region_runs=-1", "region_runs is a whole number of at least 0"),
        ("all='yes'", "a search goes on to the end of its budget, or does not"),
    ],
)
def test_what_cannot_be_asked_for_is_one_clear_error(project, searched, arguments, message):
    result = searched(arguments)
    assert result.ret == 1
    assert message in str(shown_of(result)["test_it"])
    assert "Traceback" not in output(result)


def test_a_search_compares_margins_in_units_of_importance(project, searched):
    file = project.path / "scenarios/requirements.yaml"
    entry = "check: always (gap > 0)"
    assert entry in file.read_text()
    searched("budget=12, shrink=0")
    (plain,) = project.evidence().searches[0].outcomes
    file.write_text(file.read_text().replace(entry, f"{entry}\n    scale: {{gap: 0.01}}"))
    searched('["GAP-1", "always (x <= 1000)"], budget=12, shrink=0')
    search = project.evidence().searches[0]
    outcome = search.outcomes[0]
    assert outcome.status == plain.status == "falsified"
    # The unit guides the search; what is told of the counterexample stays in the signal's.
    assert outcome.counterexample.margin == plain.counterexample.margin
    assert min(each.best["GAP-1"] for each in search.searchers) == outcome.best
    assert verify_bundle(project.path / "dura-evidence").problems == []


@pytest.mark.parametrize(
    "scale, message",
    [
        ("{gab: 1}", "names a signal that its check does not read"),
        ("{gap: 0}", "greater than 0"),
        ("{gap: .inf}", "finite"),
    ],
)
def test_a_unit_of_importance_that_makes_no_sense_is_refused_with_its_line(project, scale, message):
    file = project.path / "scenarios/requirements.yaml"
    entry = "check: always (gap > 0)"
    file.write_text(file.read_text().replace(entry, f"{entry}\n    scale: {scale}"))
    result = project.scenarios()
    text = output(result)
    assert result.ret != 0
    assert message in text.replace("\n", " ")
    assert "scale" in text
    assert "Traceback" not in text


WAITING = """
import os, time
from two import TwoFold

class Waiting(TwoFold):
    \"\"\"Takes as long as its process happens to: answers come in any order.\"\"\"

    def propose(self, view):
        time.sleep(0.0004 * (os.getpid() * 7919 % 5))
        return super().propose(view)
"""


def test_a_search_gives_the_same_by_one_two_and_sixteen_processes_that_wait(project, searched):
    project.write("waiting.py", WAITING)
    arguments = "budget=48, at_least=4, shrink=10, region_runs=6"
    known = []
    for count in (1, 2, 16):
        result = searched(
            arguments, f"--dura-executor=processes:{count}", "--dura-generator=waiting:Waiting"
        )
        assert result.ret == 1
        record = project.evidence()
        (search,) = record.searches
        known.append((search.simulations, search.searchers, search.outcomes, regions_of(record)))
    assert known[0] == known[1] == known[2]
    assert known[0][3]
