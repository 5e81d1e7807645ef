"""Which cases a glob names, and what is said of one that names none."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from pytest_dura.core import ConfigurationError
from pytest_dura.core.errors import MAX_LISTED_NAMES
from pytest_dura.library import select_cases
from pytest_dura.library.cases import may_match_scenario


def case(name):
    return SimpleNamespace(id=name, scenario=SimpleNamespace(name=name.partition("+")[0]))


CASES = [case("a/x"), case("a/x+ghost"), case("b/y+ghost")]


def ids(*globs):
    return [one.id for one in select_cases(CASES, globs)]


def test_a_glob_names_cases_by_their_id_or_by_their_scenario_in_the_order_of_the_cases():
    assert ids() == ["a/x", "a/x+ghost", "b/y+ghost"]
    assert ids("a/x") == ["a/x"]  # the id of a case, which is its scenario's name as well
    assert ids("a/x*") == ["a/x", "a/x+ghost"]
    assert ids("b/y") == ["b/y+ghost"]
    assert ids("b/*", "*/x") == ["a/x", "a/x+ghost", "b/y+ghost"]
    assert ids("*+ghost") == ["a/x+ghost", "b/y+ghost"]


def test_one_glob_that_names_nothing_is_an_error_whatever_the_others_name():
    with pytest.raises(ConfigurationError, match="no case matches 'c/z'"):
        select_cases(CASES, ["a/x", "c/z"])


def test_of_a_great_many_cases_an_error_lists_the_first():
    many = [case(f"a/x+f{number:04}") for number in range(5000)]
    with pytest.raises(ConfigurationError) as caught:
        select_cases(many, ["nothing"])
    told = str(caught.value)
    assert f"a/x+f{MAX_LISTED_NAMES - 1:04}, {5000 - MAX_LISTED_NAMES} more" in told
    assert f"a/x+f{MAX_LISTED_NAMES:04}" not in told


def test_what_a_glob_says_of_faults_does_not_rule_out_the_scenario():
    assert may_match_scenario("a/x", ["a/*+ghost"])
    assert may_match_scenario("a/x", ["b/y", "a/x~recovery_planner"])
    assert not may_match_scenario("a/x", ["b/*+ghost"])
