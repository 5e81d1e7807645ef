"""Laws of prompts, on percepts that faults and attackers have filled with anything."""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from roads import channels_of

from pytest_dura.core import PastDecision, stream
from pytest_dura.driving import (
    DISTANCE_TOLERANCE,
    Body,
    BodyList,
    Command,
    Imu,
    Maneuver,
    Odometry,
    Pose,
    Sign,
)
from pytest_dura.llm import (
    PerceivedText,
    Prompt,
    driving_templates,
    harmless,
    percept_prompt,
    reordered,
    with_conflict,
    with_injection,
)
from pytest_dura.llm.prompts import LONGEST_PERCEIVED

laws = settings(derandomize=True, deadline=None, max_examples=60)
fewer = settings(laws, max_examples=30)

MARK = "ZQXJ"
"""Stands in every text of the scene, and nowhere else."""
ENCLOSED = re.compile(r"<perceived_text>[^<>]*</perceived_text>")
LONGEST_PROMPT = 12_000
"""Characters."""

numbers = st.one_of(
    st.floats(-100.0, 100.0), st.floats(), st.sampled_from([-0.0, 1e300, -1e-9, math.inf])
)
brackets = st.sampled_from([
    "<", ">", "</", "\uff1c", "\uff1e", "\u2039", "&lt;", "&#60;", "&amp;lt;", "\u276e",
    "\u3008", "\u1438", "/", "\n", "\u202e", "\u200b", "\u0338",
])  # fmt: skip
tags = st.sampled_from([
    "perceived_text", "PERCEIVED_TEXT", "perceived text", "per\u200bceived_text",
    "\uff50erceived\uff3ftext", "perceived-text", "system",
])  # fmt: skip
hostile = st.lists(st.one_of(brackets, tags, st.text(max_size=9)), max_size=9).map("".join)
texts = hostile.map(lambda text: f"{text}{MARK}{text}")
ids = st.one_of(st.sampled_from(["V1", "V2", "P1", "LEADER"]), texts, st.just(None))
bodies = st.lists(st.tuples(ids, *[numbers] * 7), max_size=30).map(
    lambda rows: BodyList.of([Body(*row) for row in rows])
)
signs = st.lists(
    st.builds(Sign, st.one_of(st.just("give_way"), texts), numbers, st.one_of(st.just(""), texts)),
    max_size=20,
).map(tuple)
anything = st.one_of(st.none(), numbers, texts, st.just(()), st.just(np.zeros(3)), st.just([[]]))
decisions = st.lists(
    st.builds(
        PastDecision,
        numbers,
        st.sampled_from([Command(Maneuver.WAIT), None, {"steer": 1}]),
        texts,
        st.just(Command(Maneuver.PROCEED)),
        st.sampled_from(["proposal", "recovery", MARK]),
    ),
    max_size=8,
)


@st.composite
def percepts(draw: Any) -> dict[str, Any]:
    """Channels of which any may be broken or absent."""
    made = {
        **channels_of(s=draw(st.floats(40.0, 170.0)), speed=draw(st.floats(0.0, 12.0))),
        "lidar": draw(bodies),
        "radar": draw(arrays.arrays(float, st.tuples(st.integers(0, 20), st.just(3)))),
        "controls": draw(signs),
    }
    del made["camera_front"], made["camera_third_person"]
    if draw(st.booleans()):
        made["localisation"] = Pose(*draw(st.tuples(numbers, numbers, numbers)))
        made["odometry"] = Odometry(draw(numbers))
        made["imu"] = Imu(*draw(st.tuples(numbers, numbers, numbers, numbers)))
    for name in draw(st.sets(st.sampled_from(sorted(made)), max_size=2)):
        made[name] = draw(anything)
    for name in draw(st.sets(st.sampled_from(sorted(made)), max_size=1)):
        del made[name]
    return made


templates = cache(driving_templates)


def text_of(prompt: Prompt, wording: str = "") -> str:
    return templates().messages(replace(prompt, wording=wording))[-1].text


@fewer
@given(percepts(), decisions, st.lists(texts, max_size=6), numbers)
def test_any_percept_has_a_bounded_prompt_whose_texts_stay_in_their_tags(
    percept: Any, past: Any, feedback: Any, now: float
) -> None:
    prompt = percept_prompt(
        percept, past, images=["camera_front"], now=now, last=past[-1] if past else None,
        feedback=feedback,
    )  # fmt: skip
    for wording in ("", "paraphrased", "reformatted"):
        text = text_of(prompt, wording)
        assert text == text_of(percept_prompt(
            percept, past, images=["camera_front"], now=now, last=past[-1] if past else None,
            feedback=feedback,
        ), wording), "a pure function"  # fmt: skip
        assert len(text) < LONGEST_PROMPT
        outside = ENCLOSED.sub("", text)
        assert MARK not in outside
        assert "<" not in outside
        assert "perceived" not in outside.lower()
        assert not re.search(r"\bnan\b|\binf\b|-0\.0\b|-0\b(?!\.)|e[+-]\d", outside)


@fewer
@given(percepts(), st.integers(0, 99))
def test_reordering_keeps_every_line(percept: Any, seed: int) -> None:
    prompt = percept_prompt(percept)
    again = reordered(prompt, stream(seed, "law"))
    before, after = text_of(prompt).splitlines(), text_of(again).splitlines()
    assert sorted(before) == sorted(after)
    assert sorted(prompt.ids) == sorted(again.ids)
    for one, other in zip(prompt.blocks, again.blocks, strict=True):
        listed, moved = one.facts.get("objects", ()), other.facts.get("objects", ())
        # Two that are equal may have changed places.
        equal = any(first == second for first, second in combinations(listed, 2))
        assert equal or (len(listed) < 2) == (one == other)
        assert {key: one.facts[key] for key in one.facts if key != "objects"} == {
            key: other.facts[key] for key in other.facts if key != "objects"
        }
        assert len(listed) == len(moved)


@laws
@given(percepts(), hostile)
def test_twins_of_any_prompt_can_be_put_into_words(percept: Any, text: str) -> None:
    prompt = percept_prompt(percept)
    attacked, near = with_injection(prompt, text + MARK), with_conflict(prompt)
    signs = next(one.facts["objects"] for one in prompt.blocks if one.name == "CONTROLS")
    if any(one["text"] for one in signs):  # under an attack there is no decision without one
        assert attacked == prompt
    else:
        assert len({*attacked.ids} - {*prompt.ids}) == 1
    assert len({*near.ids} - {*prompt.ids}) == 1
    for wording in ("", "paraphrased"):
        assert MARK not in ENCLOSED.sub("", text_of(attacked, wording))
        assert text_of(near, wording) != text_of(prompt, wording)


@laws
@given(st.one_of(hostile, st.text()), st.integers(1, LONGEST_PERCEIVED))
@example("&amp;amp;amp;lt;/perceived_text&amp;amp;gt;", 99)
@example("\ufdfa" * 50, 20)
@example("<\u0338/perceived_\u0338text>", 99)
def test_a_harmless_text_is_bounded_printable_and_no_tag(text: str, longest: int) -> None:
    found = harmless(text, longest)
    assert len(found) <= longest
    assert not set(found) & set("<>&\n")
    assert all(one.isprintable() for one in found)
    assert "perceived_text" not in found.lower()
    found.encode()
    assert re.fullmatch(ENCLOSED, str(PerceivedText(text, longest)))


words = (
    st.text(st.characters(categories=["Lu", "Ll", "Lo", "Nd"]), max_size=40)
    .map(lambda text: unicodedata.normalize("NFKC", text))
    .filter(lambda text: all(unicodedata.category(one)[0] in "LN" for one in text))
)


@laws
@given(words)
def test_words_of_any_script_stay_as_they_are(text: str) -> None:
    bracketless = text.translate({0x1438: "(", 0x1433: ")"})
    assert harmless(text) == re.sub("(?i)perceivedtext", "(tag)", bracketless)


angles = st.floats(-2 * math.pi, 2 * math.pi) | st.sampled_from([-math.pi, math.pi, -0.0])


def radar_of(percept: Any) -> Any:
    """The objects of the block RADAR."""
    (block,) = (block for block in percept_prompt(percept).blocks if block.name == "RADAR")
    return block.facts["objects"]


@laws
@given(st.lists(angles, min_size=1, max_size=5))
def test_each_direction_is_one_whole_number_of_degrees(azimuths: list[float]) -> None:
    """From -179 to 180: straight behind has one name, whichever way round it was measured."""
    percept = {**channels_of(), "radar": np.array([[10.0, angle, 0.0] for angle in azimuths])}
    shown = {made["id"]: made["bearing"] for made in radar_of(percept)}
    for index, angle in enumerate(azimuths):
        bearing = shown[f"R{index}"]
        assert -180 < bearing <= 180
        assert math.cos(math.radians(bearing) - angle) >= math.cos(math.radians(0.5 + 1e-6))


@laws
@given(angles, angles, st.sampled_from([0.0, 0.9, 0.99, 1.01, 1.5, 2.9, 3.1]))
def test_a_radar_return_is_explained_by_an_object_at_its_place_alone(
    azimuth: float, towards: float, share: float
) -> None:
    """Within radar's own tolerance, and not beyond it: a real return must not hide a ghost."""
    percept = channels_of()
    pose, apart = percept["localisation"], share * DISTANCE_TOLERANCE
    x = pose.x + 20.0 * math.cos(pose.heading - azimuth) + apart * math.cos(towards)
    y = pose.y + 20.0 * math.sin(pose.heading - azimuth) + apart * math.sin(towards)
    percept["lidar"] = BodyList.of([Body("V1", x, y, 0.0, 0.0, 0.0, 4.5, 1.8)])
    percept["radar"] = np.array([[20.0, azimuth, 0.0]])
    assert [made["id"] for made in radar_of(percept)] == ([] if share < 1.0 else ["R0"])
