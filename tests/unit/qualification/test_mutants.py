"""Mutants: what they change, how they are named, and what their results come to."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest

from pytest_dura.core.percepts import PerceptView
from pytest_dura.domains import DOMAINS
from pytest_dura.driving.bodies import Body, BodyList
from pytest_dura.driving.mutants import _beside, _mirrored, without_objects
from pytest_dura.driving.sensors import Pose
from pytest_dura.qualification import AlteredPercept, Kill, Qualified, with_numbers
from pytest_dura.qualification.mutant import registered_mutants
from pytest_dura.qualification.requirement import requirement_mutants
from pytest_dura.qualification.table import caught_text, quickest, runs_for_power
from pytest_dura.requirements.model import Paired, Requirement
from pytest_dura.requirements.stl.parser import parse


class Pair(NamedTuple):
    left: float
    right: float


@dataclass(frozen=True)
class Order:
    kind: str
    force: float | None


@pytest.mark.parametrize(
    "action, expected",
    [
        (1.5, -1.5),
        (2, 2),
        (True, True),
        ("brake", "brake"),
        (None, None),
        ((1.0, 2), (-1.0, 2)),
        (Pair(1.0, -2.0), Pair(-1.0, 2.0)),
        ({"a": 1.0, "b": [2.0]}, {"a": -1.0, "b": [-2.0]}),
        (Order("brake", 3.0), Order("brake", -3.0)),
        (Order("brake", None), Order("brake", None)),
    ],
)
def test_changes_the_floats_of_an_action_and_nothing_else(action, expected):
    changed = with_numbers(action, lambda number: -number)
    assert changed == expected
    assert type(changed) is type(expected)


def test_changes_arrays_of_floats_alone():
    before = np.array([1.0, -2.0])
    assert with_numbers(before, lambda number: 2 * number).tolist() == [2.0, -4.0]
    assert before.tolist() == [1.0, -2.0]
    whole = np.array([1, 2])
    assert with_numbers(whole, lambda number: 2 * number) is whole


def test_what_an_altered_percept_shows_counts_as_read():
    reads = set()
    percept = PerceptView({"lidar": 1, "odometry": 2}, reads, {"objects": "lidar"})
    altered = AlteredPercept(percept, lambda name, value: value + 10 * (name == "lidar"))
    assert altered["objects"] == altered["lidar"] == 11
    assert reads == {"lidar"}
    assert altered["odometry"] == 2
    assert set(altered) == {"lidar", "odometry"}
    assert "camera" not in altered


def test_every_mutant_has_a_name_of_its_own_and_says_what_is_wrong():
    mutants = registered_mutants(DOMAINS["driving"], ["gap", "percept.gap"])
    names = [mutant.name for mutant in mutants]
    assert len(set(names)) == len(names) > 30
    assert all(mutant.described for mutant in mutants)
    assert "driving.generator.harsh" in names
    assert "simulator.too_large[signal=gap]" in names
    assert not any("percept" in name for name in names)
    assert not any("driving." in each.name for each in registered_mutants(None))


def place_of(bodies):
    return [(body.id, round(body.x, 6), round(body.y, 6)) for body in bodies]


HEADING_SOUTH = Pose(0.0, 0.0, np.pi / 2)
"""With y to the south, west is on the right."""


def bodies_around():
    west = Body("W", -10.0, 5.0, 0.0, 3.0, 0.0, 5.0, 2.0)
    east = Body("E", 10.0, 5.0, 0.0, 3.0, 0.0, 5.0, 2.0)
    return BodyList.of([west, east])


@pytest.mark.parametrize("side, seen", [("left", "W"), ("right", "E")])
def test_who_is_blind_on_a_side_misses_what_is_there_in_lidar_and_radar(side, seen):
    azimuth = {"W": -np.arctan2(10, 5), "E": np.arctan2(10, 5)}  # to the left of ahead
    radar = np.array([[np.hypot(10, 5), azimuth[name], 0.0] for name in "WE"])
    percept = PerceptView(
        {"lidar": bodies_around(), "radar": radar, "localisation": HEADING_SOUTH}, set()
    )
    altered = without_objects(percept, _beside(side))
    assert altered["lidar"].ids == (seen,)
    assert altered["radar"][:, 1].tolist() == [azimuth[seen]]


def test_mirroring_swaps_the_sides_and_twice_is_nothing():
    bodies = bodies_around()
    mirrored = _mirrored(bodies, HEADING_SOUTH)
    assert place_of(mirrored) == [("W", 10.0, 5.0), ("E", -10.0, 5.0)]
    assert mirrored[0].vx == pytest.approx(-3.0)
    assert place_of(_mirrored(mirrored, HEADING_SOUTH)) == place_of(bodies)


def kill(run, violated, runs, requirement="R"):
    return Kill(requirement, "case", "", run, runs, violated, "violated")


@pytest.mark.parametrize("violated, runs, needed", [(3, 3, 1), (1, 2, 5), (1, 3, 8), (0, 3, None)])
def test_runs_that_catch_it_with_95_percent(violated, runs, needed):
    found = runs_for_power(kill(0, violated, runs))
    assert found == needed
    if needed is not None and violated < runs:
        assert 1 - (1 - violated / runs) ** needed >= 0.95
        assert 1 - (1 - violated / runs) ** (needed - 1) < 0.95


def test_the_quickest_requirement_stands_for_a_mutant():
    undecided = Kill("U", "case", "", 0, 3, 0, "undecided: so")
    late, early = kill(2, 1, 3, "late"), kill(0, 1, 3, "early")
    result = Qualified("m", "generator", "is wrong", "caught", 3, (undecided, late, early))
    assert quickest(result) is early


def test_the_interval_of_what_is_caught():
    results = [Qualified(str(i), "r", "", "caught" if i < 10 else "survived") for i in range(19)]
    # Clopper-Pearson of 10 in 19, two-sided.
    assert "10 of 19" in caught_text(results)
    assert "29 to 76 %" in caught_text(results)


@pytest.mark.parametrize(
    "check, looser, shorter",
    [
        ("always (gap >= 0.5)", "always (gap >= 0.4)", None),
        ("always (gap > 0)", "always (gap > -0.5)", None),
        ("always (jerk <= 45) and always (jerk >= -45)",
         "always (jerk <= 54) and always (jerk >= -54)", None),
        ("always (far < 50 implies margin >= 1)", "always (far < 40 implies margin >= 0.8)", None),
        ("eventually[0:35] (cleared >= 1)", "eventually[0:35] (cleared >= 0.8)",
         "eventually[0:17.5] (cleared >= 1)"),
        ("not eventually (gap < 2)", "not eventually (gap < 1.6)", None),
    ],
)  # fmt: skip
def test_a_defect_of_a_requirement_asks_for_less(check, looser, shorter):
    known = {
        mutant.name.split("[")[0].split(".")[1]: mutant.changed.check
        for mutant in requirement_mutants([Requirement("R", check=check)])
    }
    assert parse(known["looser"]) == parse(looser)
    assert parse(known["negated"]) == parse(f"not ({check})")
    assert ("shorter" in known) == (shorter is not None)
    assert shorter is None or parse(known["shorter"]) == parse(shorter)


def test_a_function_and_pairs_are_left_as_they_are():
    given = [Requirement("F", check="module:function"), Requirement("T")]
    given.append(Requirement("P", check="always (gap > 0)", paired=Paired("faults")))
    assert not [*requirement_mutants(given)]
