"""The rule that drives by the prompt's text: it reads the same in both wordings, and all of it."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from roads import Body, car, channels_of

from pytest_dura.llm import driving_templates, percept_prompt

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def rule(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("text_rule")


def read(rule: Any, percept: Any, wording: str = "") -> Any:
    prompt = replace(percept_prompt(percept), wording=wording)
    messages = driving_templates().messages(prompt)
    return rule.read(messages[0].text, messages[-1].text)


CROSSES = car("V1", -38.0, 2.0, 0.0, 8.0)
WALKS = Body("P1", 6.5, 20.0, 3.14159, -1.0, 0.0, 0.6, 0.6)


def test_both_wordings_are_read_alike_and_whole(rule: Any) -> None:
    percept = channels_of(CROSSES, WALKS, radar=[WALKS], speed=8.0)
    own, other = (read(rule, percept, wording) for wording in ("", "paraphrased"))
    assert own == other
    assert (own.speed, own.line, own.hold, own.braking) == (8.0, 47.5, 1.0, 8.0)
    assert own.giving_way == {"wait": 1.0, "yield": -3.0}
    assert [met["id"] for met in own.conflicts] == ["P1", "V1"]
    assert (own.walkers, own.doubted) == ({"P1"}, {"V1"})
    assert own.drives["accelerate"] == (10.0, 3.5, 3.0)
    for s in (105.0, 160.0):
        inside = channels_of(s=s, speed=8.0)
        assert read(rule, inside) == read(rule, inside, "paraphrased")


def test_it_gives_way_to_who_crosses_and_goes_when_nobody_does(rule: Any) -> None:
    far = channels_of(CROSSES, s=90.0, speed=6.0)
    assert rule.decide(read(rule, far))[0] == "accelerate", "it is through a second before"
    near = channels_of(CROSSES._replace(x=-20.0), s=90.0, speed=6.0)
    maneuver, against = rule.decide(read(rule, near))
    assert (maneuver, against) == ("wait", ["V1"])
    assert rule.decide(read(rule, channels_of(s=90.0, speed=6.0))) == ("accelerate", [])
    stands = car("V2", 2.0, 12.0, -1.5708, 0.0)
    assert rule.decide(read(rule, channels_of(stands, s=90.0, speed=6.0)))[0] == "emergency_brake"
