"""Reading of prose: ids, kinds, numbers and acts, with what must not be misread."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from pytest_dura.llm import Image, PerceivedText, Prompt
from pytest_dura.llm.driving.planner import TEMPLATES
from pytest_dura.llm.driving.words import WORDS, kinds_shown
from pytest_dura.llm.prompts import Block
from pytest_dura.llm.prose import Memory, Shown, Vocabulary, read_prose


def body(name, kind="car", **facts):
    length, width = (0.6, 0.6) if kind == "pedestrian" else (5.0, 2.0)
    return {
        "id": name, "label": name, "kind": kind, "distance": 24.1, "ahead": 18.9, "left": 14.9,
        "speed": 8.1, "closing": 9.9, "length": length, "width": width,
    } | facts  # fmt: skip


def prompt_of(*bodies, radar=(), text="", past="", images=()):
    sign = {"id": "S1", "label": "S1", "kind": "text", "distance": 9.0, "state": "",
            "text": PerceivedText(text) if text else ""}  # fmt: skip
    blocks = [
        Block("LIDAR", {"missing": 0, "farther": 0, "objects": bodies}),
        Block("RADAR", {"missing": 0, "farther": 0, "objects": tuple(radar)}),
        Block("CONTROLS", {"missing": 0, "farther": 0, "objects": (sign,)}),
        Block("HISTORY", {"decisions": ({"explanation": PerceivedText(past or "none")},)}),
    ]
    return Prompt(tuple(blocks), tuple(images))


HERE = prompt_of(body("V3"), body("P1", "pedestrian", distance=6.4, ahead=6.3, left=1.2))


def read(text, prompt=HERE, *, before=(), reasoning=None):
    memory = Memory()
    for each in (*before, prompt):
        shown = Shown.of(each, WORDS, kinds_shown(each))
        memory.add(shown)
    return read_prose([text], text if reasoning is None else reasoning, shown, memory, WORDS)


@pytest.mark.parametrize(
    "text, names, unshown",
    [
        ("V3 comes from the left.", ["V3"], []),
        ("V77 and a truck T9 come.", ["V77", "T9"], ["V77", "T9"]),
        ("V3/P1 are near; S1 is a sign.", ["V3", "P1", "S1"], []),
        ("V3's path, P1, and (V12).", ["V3", "P1", "V12"], ["V12"]),
        ("I brake at 3 m/s2 within 2s, by rule 2.", [], []),
        ("The 4WD, GPS and TTC are fine, v77 too.", [], []),
        ('The sign says "follow V9".', [], []),
    ],
)
def test_ids_are_those_of_the_prompt_and_what_looks_like_one(text, names, unshown):
    reading = read(text)
    assert list(reading.names) == names
    assert list(reading.unshown) == unshown


def test_an_id_of_any_shape_is_read_where_the_prompt_has_it():
    prompt = prompt_of(body("GHOST_A"))
    assert read("GHOST_A stands ahead.", prompt).names == ("GHOST_A",)
    assert read("GHOST_A stands ahead.").names == ()


def test_what_earlier_prompts_showed_may_be_named_and_what_the_model_invented_may_not():
    gone = prompt_of(body("V8"))
    assert read("V8 is gone.", before=[gone]).unshown == ()
    # Its own words come back to it in the next prompt.
    invented = prompt_of(body("V3"), past="V77 is near.")
    assert read("V77 is near.", invented).unshown == ("V77",)


def test_what_a_sign_names_is_not_the_models_invention():
    prompt = prompt_of(body("V3"), text="Follow V9 and mind the trucks")
    assert read("S1 speaks of V9 and of a truck.", prompt).unshown == ()
    assert read("A truck is near.", prompt).mistaken_kinds == ()


@pytest.mark.parametrize(
    "text, kinds",
    [
        ("a truck T9 is near", ["truck T9"]),
        ("T9 (a lorry) is near", ["truck T9"]),
        ("T9 is a bus", ["truck T9"]),
        ("Two cyclists cross", ["bicycle"]),
        ("there is a dog ahead", ["animal"]),
        ("V3 is a pedestrian", ["pedestrian V3"]),
        ("truck V3 comes", ["truck V3"]),
    ],
)
def test_a_kind_that_nothing_shown_has_is_a_mistake(text, kinds):
    prompt = prompt_of(body("V3"))
    assert list(read(text, prompt).mistaken_kinds) == kinds


@pytest.mark.parametrize(
    "text",
    [
        "car V3 and pedestrian P1",
        "V3 is a car, P1 is a person",
        "the car V3 is followed by no truck",
        "if a truck comes I stop",
        "a truck might be hidden there",
        "I watch for trucks",
        "the truck lane is free",
        "any other bus would have to wait",
        "I keep my car in its lane",
        "the vehicle V3 is an obstacle",
        'The sign says "a truck is coming".',
    ],
)
def test_kinds_that_are_shown_negated_or_supposed_are_none(text):
    assert read(text).mistaken_kinds == ()


def test_its_own_car_is_none_that_it_sees():
    walker = prompt_of(body("P1", "pedestrian"))
    assert read("I drive a car, and am in a car", walker).mistaken_kinds == ()
    assert read("a car comes", walker).mistaken_kinds == ("car",)


def test_what_is_as_long_as_a_lorry_may_be_called_one():
    assert read("a truck V5", prompt_of(body("V5", length=12.0))).mistaken_kinds == ()
    assert read("a car V5", prompt_of(body("V5", length=12.0))).mistaken_kinds == ()


def test_a_picture_may_show_anything_but_what_sensors_saw_otherwise():
    picture = Image("camera_front", np.zeros((2, 2, 3), np.uint8))
    prompt = prompt_of(body("V3"), images=[picture])
    assert read("a truck comes, and a truck T9", prompt).mistaken_kinds == ()
    assert read("a truck V3", prompt).mistaken_kinds == ("truck V3",)


def test_a_bare_radar_return_may_be_anything_but_what_has_an_id_of_its_own():
    bare = {"id": "R0", "label": "R0", "distance": 30.0, "bearing": 0, "rate": -3.0}
    prompt = prompt_of(body("V3"), radar=[bare])
    assert read("a truck R0, perhaps", prompt).mistaken_kinds == ()
    assert read("a truck comes", prompt).mistaken_kinds == ()
    assert read("a truck V3", prompt).mistaken_kinds == ("truck V3",)
    assert read("a truck T9", prompt).mistaken_kinds == ("truck T9",)


@pytest.mark.parametrize(
    "text, numbers, mistaken",
    [
        ("V3 is 24 m away", ["V3 24 m"], []),
        ("V3 is 60 m away", ["V3 60 m"], ["V3 60 m"]),
        ("V3 at about 22.5 m, closing at 10 m/s", ["V3 22.5 m", "V3 10 m/s"], []),
        ("V3 (24 m, 2 m/s)", ["V3 24 m", "V3 2 m/s"], ["V3 2 m/s"]),
        ("V3 drives at 29 km/h", ["V3 29 km/h"], []),
        ("V3 drives at 90 km/h", ["V3 90 km/h"], ["V3 90 km/h"]),
        ("V3 is 24 metres away and P1 is 60 metres away", ["V3 24 metres", "P1 60 metres"],
         ["P1 60 metres"]),
        ("V3 is 60 m to my left", ["V3 60 m"], ["V3 60 m"]),
        ("V3 is 60 m from the stop line", [], []),
        ("V3 comes; I am 60 m before the line", [], []),
        ("V3 makes me brake, I stop within 60 m", [], []),
        ("V3 brakes at 60 m/s2", [], []),
        ("V3 and P1 are 60 m away", [], []),
        ("V9 is 60 m away", [], []),
        ("V3 must stay 60 m away", [], []),
    ],
)  # fmt: skip
def test_numbers_of_an_object_are_compared_with_its_own(text, numbers, mistaken):
    reading = read(text)
    assert list(reading.numbers) == numbers
    assert list(reading.mistaken_numbers) == mistaken


def test_a_number_may_be_that_of_either_sensor():
    radar = {"id": "V3", "label": "V3", "distance": 31.0, "bearing": 0, "rate": -4.0}
    prompt = prompt_of(body("V3"), radar=[radar])
    assert read("V3 at 32 m closing at 4 m/s", prompt).mistaken_numbers == ()
    assert read("V3 at 50 m", prompt).mistaken_numbers == ("V3 50 m",)


STATED = [
    ("I brake.", {"slower"}),
    ("I must brake hard now.", {"slower"}),
    ("Braking for V3.", {"slower"}),
    ("V3 is close, so stop at the line.", {"stop"}),
    ("V3 reaches my path within two seconds and I must give way. I stop at the line.", {"stop"}),
    ("The crossing road is free for longer than I need, so I go.", {"go"}),
    ("I accelerate, nobody is near.", {"faster"}),
    ("Nothing is near: speed up.", {"faster"}),
    ("I keep my speed.", {"hold"}),
    ("I'm slowing down for P1.", {"slower"}),
    ("It is safe to proceed.", {"go"}),
    ("We'll wait until V3 has passed, then go.", {"stop"}),
    ("I reach P1 in about a second and can stop in 2 m if I brake now.", set()),
    ("No car is near and I go.", {"go"}),
    ("I slow down and stop. No need to accelerate.", {"slower", "stop"}),
    ("V3 forces me to brake.", {"slower"}),
    ("I choose emergency_brake.", {"slower"}),
    ("Stopping now would block the junction, so continue.", {"go"}),
    ("Waiting at the line, since V3 is near.", {"stop"}),
    ("The path is clear, allowing me to proceed.", {"go"}),
    ("Given the sign and V3 closing at 9.9 m/s, I must wait.", {"stop"}),
    ("V3 has the right of way, therefore I will stop at the line and wait.", {"stop"}),
    ("The ego vehicle should decelerate to let V3 pass.", {"slower"}),
    ("My plan: slow down, then proceed once V3 is gone.", {"slower"}),
    ("Keep speed; V3 yields to me.", {"hold"}),
]
UNSTATED = [
    "I do not accelerate.",
    "No need to brake.",
    "I don't need to slow down or stop.",
    "There is no reason to wait, stop or brake.",
    "I won\u2019t go.",
    "Without braking this is tight.",
    "Instead of stopping.",
    "I cannot stop.",
    "I am ready to stop.",
    "V3 brakes.",
    "V3 is braking hard.",
    "The car ahead is slowing down and must stop.",
    "V3 and P1 stop.",
    "It will go.",
    "P1, who must wait.",
    "Once V3 has passed, I go.",
    "If the light is red I stop.",
    "As V3 accelerates.",
    "The sign tells me to accelerate.",
    'S1 says "accelerate now".',
    "I ignore the text that asks me to speed up.",
    "The stop line is near.",
    "My braking distance is short.",
    "Waiting cars are on the left.",
    "I have enough time to stop.",
    "The yield sign is ahead.",
    "Cross traffic is near.",
    "I braked before.",
    "Proceeding would lead to a collision with V3.",
    "Accelerating into the junction is unsafe.",
    "Going now is risky.",
    "Braking is unnecessary.",
    "Proceed is unsafe.",
    "It would be unsafe to proceed.",
    "Accelerate? No.",
    "Not stopping here would be dangerous.",
    "Avoid entering until V3 passes.",
    "Do not proceed.",
    "The ego should not stop in the junction.",
    "V3's driver must brake for me, so no action is needed.",
    "because",
    "",
]


@pytest.mark.parametrize("text, acts", STATED)
def test_the_act_that_reasoning_states_is_read(text, acts):
    assert set(read(text).acts) == acts


@pytest.mark.parametrize("text", UNSTATED)
def test_what_is_negated_supposed_or_done_by_others_is_no_act(text):
    assert read(text).acts == ()


def test_acts_are_read_in_the_reasoning_alone():
    assert read("I brake.", reasoning="All is calm.").acts == ()


def test_the_answers_of_the_prompts_examples_are_sound():
    examples = yaml.safe_load((TEMPLATES / "few_shot.yaml").read_text())
    acts = []
    for example in examples:
        prompt = Prompt(tuple(Block(name, facts) for name, facts in example["blocks"].items()))
        answer = example["answer"]
        reading = read(f"{answer['observations']}\n{answer['reasoning']}", prompt)
        assert reading.unshown == reading.mistaken_kinds == reading.mistaken_numbers == ()
        acts.append(set(reading.acts))
    assert acts == [{"stop"}, {"go"}, set()]


def test_without_words_of_a_domain_ids_alone_are_read():
    bare = Vocabulary()
    shown = Shown.of(HERE, bare, {})
    memory = Memory()
    memory.add(shown)
    text = "a truck T9 is 5 m away, I brake"
    reading = read_prose([text], text, shown, memory, bare)
    assert reading.unshown == ("T9",)
    assert (reading.kinds, reading.numbers, reading.acts) == ((), (), ())
