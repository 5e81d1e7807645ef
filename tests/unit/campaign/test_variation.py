"""Variation: drawing values and putting them into plain data."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.library import Choice, Range, load_scenarios, replace_value, split_path
from pytest_dura.library.scenario import draw_value

ROOM = (
    "name: room\nsimulator: rooms:Room\nduration: 4.0\n"
    'roles: {generator: "thermostat:Controller"}\n'
)


def test_each_path_and_each_seed_has_draws_of_its_own() -> None:
    spread = Range(min=0.0, max=1.0)
    drawn = {draw_value(path, spread, seed) for path in ("world.a", "world.b") for seed in (1, 2)}
    assert len(drawn) == 4
    assert draw_value("world.a", spread, 1) == draw_value("world.a", spread, 1)


def test_an_interval_of_one_point() -> None:
    assert draw_value("world.a", Range(min=2.0, max=2.0), 1) == 2.0


def test_a_choice_of_one() -> None:
    assert draw_value("world.a", Choice(choice=({"x": 1},)), 1) == {"x": 1}


@pytest.mark.parametrize(
    "path,value",
    [
        ("a", {"a": 9, "b": [1, {"c": 2}]}),
        ("b.0", {"a": 0, "b": [9, {"c": 2}]}),
        ("b.1.c", {"a": 0, "b": [1, {"c": 9}]}),
    ],
)
def test_a_value_is_replaced_in_a_copy(path: str, value: Any) -> None:
    data = {"a": 0, "b": [1, {"c": 2}]}
    before = copy.deepcopy(data)
    assert replace_value(data, path, 9) == value
    assert data == before


@pytest.mark.parametrize("path", ["x", "a.x", "b.2", "b.x", "b.-1", "b.1.x"])
def test_a_place_that_does_not_exist(path: str) -> None:
    with pytest.raises(ConfigurationError, match="to vary"):
        replace_value({"a": 0, "b": [1, {"c": 2}]}, path, 9)


def test_only_the_last_key_may_be_new() -> None:
    assert replace_value({"a": {}}, "a.b", 1, create=True) == {"a": {"b": 1}}
    with pytest.raises(ConfigurationError):
        replace_value({"a": {}}, "a.b.c", 1, create=True)


def test_paths_into_world_and_faults() -> None:
    assert split_path("world.traffic.headway") == ("", "traffic.headway")
    assert split_path("faults.ghost.activation.at") == ("ghost", "activation.at")
    for path in ("world", "faults.ghost", "faults", "duration", "roles.generator"):
        with pytest.raises(ConfigurationError, match="cannot be varied"):
            split_path(path)


def test_a_key_that_the_world_leaves_out_may_vary_where_the_simulator_allows_it(
    tmp_path: Path,
) -> None:
    file = tmp_path / "room.yaml"
    file.write_text(ROOM + "variation:\n  world.outside: {min: 1, max: 2}\n")
    assert "room" in load_scenarios([file])
    file.write_text(ROOM + "variation:\n  world.inside: {min: 1, max: 2}\n")
    with pytest.raises(ConfigurationError, match="no such thing in a room") as caught:
        load_scenarios([file])
    assert caught.value.line == 6


@pytest.mark.parametrize("world,key", [("{door: 1}", "world.door"), ("{start: -1}", "world.start")])
def test_what_a_simulators_own_check_refuses_is_placed_in_the_file(
    tmp_path: Path, world: str, key: str
) -> None:
    file = tmp_path / "room.yaml"
    file.write_text(ROOM + f"world: {world}\n")
    with pytest.raises(ConfigurationError) as caught:
        load_scenarios([file])
    assert (caught.value.file, caught.value.line, caught.value.key) == (str(file), 5, key)
    assert caught.value.remedy
