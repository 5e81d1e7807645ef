"""Measures: figures of an episode that its simulator declares."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from loops import Says, spec_of
from thermostat import Thermostat

from pytest_dura import (
    DOMAINS,
    ConfigurationError,
    Measure,
    Orchestrator,
    Proposal,
    RoleSpec,
)
from pytest_dura.core.measures import measured
from pytest_dura.driving import MEASURES, HighwaySimulator


def warmest(episode: Any) -> float:
    return float(episode.signal("temperature").max())


def hot(episode: Any) -> bool:
    return episode.ever("temperature")


def heat(view: Any) -> Proposal:
    return Proposal(0.5)


WARMEST = Measure(
    "warmest", "warm", "greatest temperature", warmest, "mean", "°C", signals=("temperature",)
)
HOT = Measure("hot", "hot", "runs above half a degree", hot, "share", signals=("temperature",))


class Room(Thermostat):
    measures = (WARMEST, HOT)


@pytest.fixture(scope="module")
def episode() -> Any:
    spec = spec_of({"generator": Says(heat)}, simulator=RoleSpec.of(Room))
    return Orchestrator.build(spec).run(spec)


def test_a_measure_is_an_attribute_of_the_episode(episode: Any) -> None:
    assert episode.warmest == warmest(episode)
    assert episode.hot is True
    assert not hasattr(episode, "collided")
    assert not hasattr(episode, "coldest")
    assert copy.copy(episode).warmest == episode.warmest


def test_what_lacks_its_signals_has_no_measure(episode: Any) -> None:
    silent = replace(episode, signals={})
    assert measured(Room.measures, silent) == {}
    with pytest.raises(ConfigurationError, match="no signal 'temperature'"):
        _ = silent.warmest
    assert list(measured(Room.measures, episode)) == ["warmest", "hot"]


def failing(episode: Any) -> float:
    raise LookupError("no such room")


@pytest.mark.parametrize(
    "shown, function, message",
    [
        ("mean", failing, "the measure 'm' failed on .*LookupError: no such room"),
        ("mean", lambda _: "warm", "is of another type"),
        ("mean", lambda _: True, "is of another type"),
        ("share", lambda _: 1.0, "is of another type"),
    ],
)
def test_a_function_that_measures_nothing_is_named(
    episode: Any, shown: Any, function: Any, message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Measure("m", "m", "", function, shown).value(episode)


@pytest.mark.parametrize(
    "shown, value, told",
    [
        ("mean", math.nan, None), ("mean", np.float64(2.0), 2.0), ("mean", None, None),
        ("count", np.True_, True), ("share", None, None),
    ],
)  # fmt: skip
def test_values(episode: Any, shown: Any, value: Any, told: Any) -> None:
    found = Measure("m", "m", "", lambda _: value, shown).value(episode)
    assert found == told
    assert type(found) is type(told)


def test_a_domain_has_the_measures_of_its_simulator() -> None:
    assert DOMAINS["driving"].measures == HighwaySimulator.measures == MEASURES
