"""What a language model is told of the road: in the system's message, and in the blocks."""

from __future__ import annotations

from typing import Any

import pytest
from models import PLANNER, answering, llm_episode, said
from roads import run, spec_of_drive

from pytest_dura.core import RoleSpec
from pytest_dura.driving import BUILT_IN
from pytest_dura.llm import driving_templates
from pytest_dura.llm.driving.planner import probes, right_of_way

EAST_WEST = ("east-west", "north-south")


def conversation(world: dict[str, Any]) -> tuple[str, str]:
    """The system's message and the first question of an episode in a world."""
    with answering(lambda *_: said()) as model:
        generator = RoleSpec(PLANNER, {"samples": 1, "beside": ()})
        episode = run(spec_of_drive(world, generator=generator, duration=1.0))
    assert episode.failure is None
    messages = model.requests[0].messages
    return messages[0].text, messages[-1].text


def test_the_model_is_told_the_signs_of_its_own_road() -> None:
    system, question = conversation({"road": "merge"})
    assert "At its arms stand these signs: ramp give_way, west priority_road." in system
    assert not any(name in system for name in EAST_WEST)
    assert "from the ramp arm, straight, to the east arm" in question
    assert "give_way" in question
    system, question = conversation({"road": "t_junction", "ego": {"arm": "east", "to": "south"}})
    assert "south give_way, west priority_road, east priority_road." in system
    assert "from the east arm, left, to the south arm" in question


def test_on_the_built_in_crossing_the_words_are_as_they_were() -> None:
    _, model = llm_episode(lambda *_: said(), seconds=1.0)
    system = model.requests[0].messages[0].text
    assert "The east-west road has priority over the north-south road.\nYour car:" in system
    wide, _ = conversation({"road": "four_way_wide"})
    assert wide == system, "the same signs on the same arms"


def test_another_wording_tells_the_signs_as_well() -> None:
    arms = right_of_way(BUILT_IN["t_junction"])
    prompt, *_ = probes()
    for wording in ("", "paraphrased"):
        templates = driving_templates(None, arms)
        varied = type(prompt)(prompt.blocks, (), wording)
        system = templates.messages(varied)[0].text
        for name, sign in arms or ():
            assert name in system
            assert sign in system
        assert not any(name in system for name in EAST_WEST)


@pytest.mark.parametrize("name", BUILT_IN)
def test_only_the_plain_crossing_is_told_in_words_of_its_own(name: str) -> None:
    assert (right_of_way(BUILT_IN[name]) is None) == name.startswith("four_way")
