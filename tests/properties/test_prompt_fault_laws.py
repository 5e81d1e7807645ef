"""The law of each fault of a prompt; a test's name begins with its fault's type."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from injecting import DT
from roads import car, channels_of

from pytest_dura.core import ConfigurationError, Fault, RoleContext, stream
from pytest_dura.faults import (
    CampaignInjector,
    Moment,
    default_fault,
    fault_effect,
    parse_fault,
)
from pytest_dura.llm import BLOCKS, Prompt, percept_prompt

laws = settings(derandomize=True, deadline=None, max_examples=40)
counts = st.integers(0, 6)
seeds = st.integers(0, 99)
names = st.sets(st.sampled_from(BLOCKS))


def prompt_of(count: int) -> Prompt:
    return percept_prompt(channels_of(*(car(f"V{n}", 9.0 * n, 30.0) for n in range(count))))


def fault(kind: str, **parameters: Any) -> Fault:
    return parse_fault({"type": kind, "activation": {"at": 0.0}, "parameters": parameters})


def acted(one: Fault, prompt: Prompt, seed: int = 0) -> Prompt:
    moment = Moment(0.0, DT, 0.0, {}, [], lambda: stream(seed, "law"))
    effect = fault_effect(one)
    found: Prompt = effect.apply(effect.begin(prompt, moment), prompt, moment)
    return found


@laws
@given(counts, names)
def test_prompt_drop_leaves_out_the_named_blocks_and_nothing_else(count: int, lost: Any) -> None:
    prompt = prompt_of(count)
    found = acted(fault("prompt-drop", blocks=sorted(lost)), prompt)
    assert [one for one in prompt.blocks if one.name not in lost] == list(found.blocks)
    assert (found.images, found.wording) == (prompt.images, prompt.wording)
    assert acted(fault("prompt-drop", blocks=[]), prompt) is prompt


@laws
@given(counts, seeds)
def test_prompt_reorder_keeps_all_facts(count: int, seed: int) -> None:
    prompt = prompt_of(count)
    objects = acted(fault("prompt-reorder"), prompt, seed)
    assert [one.name for one in objects.blocks] == [one.name for one in prompt.blocks]
    assert sorted(objects.ids) == sorted(prompt.ids)
    assert (objects == prompt) == (count < 2)
    blocks = acted(fault("prompt-reorder", objects=False, blocks=True), prompt, seed)
    assert blocks != prompt
    assert sorted(one.name for one in blocks.blocks) == sorted(one.name for one in prompt.blocks)
    assert {one.name: one.facts for one in blocks.blocks} == {
        one.name: one.facts for one in prompt.blocks
    }
    assert acted(fault("prompt-reorder", objects=False), prompt, seed) is prompt
    assert acted(fault("prompt-reorder"), prompt, seed) == objects


@laws
@given(counts)
def test_prompt_paraphrase_changes_the_wording_alone(count: int) -> None:
    prompt = prompt_of(count)
    found = acted(fault("prompt-paraphrase"), prompt)
    assert found.wording == "paraphrased"
    assert (found.blocks, found.images) == (prompt.blocks, prompt.images)
    assert acted(fault("prompt-paraphrase"), found) is found
    assert acted(fault("prompt-paraphrase", wording="own"), prompt) is prompt


def test_they_act_on_the_prompt_on_its_way_and_are_noted() -> None:
    drop, turn = default_fault("prompt-drop"), default_fault("prompt-reorder")
    injector = CampaignInjector()
    injector.reset(RoleContext(1, DT, faults=(drop, turn)))
    returns = [car(f"V{n}", 9.0 * n, 30.0) for n in range(3)]  # which lidar does not explain
    prompt = percept_prompt(channels_of(*returns[:1], radar=returns))
    injector.corrupt({}, 0.0)
    assert injector.corrupt_message("prompt", prompt, 0.0) == (prompt, ())
    injector.corrupt({}, 2.0)
    found, by = injector.corrupt_message("prompt", prompt, 2.0)
    assert by == ("prompt-drop", "prompt-reorder")
    assert "LIDAR" not in [one.name for one in found.blocks]
    assert injector.corrupt_message("model", prompt, 2.0) == (prompt, ())
    injector.corrupt({}, 2.1)
    again, _ = injector.corrupt_message("prompt", prompt, 2.0)
    assert again != prompt


@pytest.mark.parametrize(
    "kind, parameters, told",
    [
        ("prompt-drop", {"blocks": ["LIDR"]}, "did you mean 'LIDAR'?"),
        ("prompt-drop", {"blocks": ["radar"]}, "did you mean 'RADAR'?"),
        ("prompt-drop", {"blocks": ["weather"]}, "names of EGO, LIDAR"),
        ("prompt-reorder", {"objects": "yes"}, "parameters.objects"),
        ("prompt-paraphrase", {"wording": "poem"}, "'own' or 'paraphrased'"),
    ],
)
def test_what_would_do_nothing_is_refused(kind: str, parameters: Any, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_fault({"type": kind, "activation": {"at": 1.0}, "parameters": parameters})
    assert told in str(caught.value)
