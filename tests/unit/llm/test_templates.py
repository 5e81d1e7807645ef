"""Templates: the built-in ones, a user's in their place, and what they cannot do."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from roads import car, channels_of

from pytest_dura.core import ConfigurationError
from pytest_dura.llm import (
    BLOCKS,
    INTENTS,
    MANEUVERS,
    Answer,
    PerceivedText,
    Prompt,
    driving_templates,
    percept_prompt,
    read_answer,
)
from pytest_dura.llm.driving.blocks import direction
from pytest_dura.llm.driving.planner import (
    SCHEMA,
    TEMPLATES,
    VOCABULARY,
    probes,
    shown_facts,
)
from pytest_dura.llm.prompts import FILTERS, LONGEST_RENDERED, Block, Sources, Templates

PERCEPT = channels_of(car("V1", -20.0, 40.0, 0.0, 8.0))
PROMPT = percept_prompt(PERCEPT)
WORDINGS = ("", "paraphrased")


def refusal(directory: Path) -> str:
    with pytest.raises(ConfigurationError) as caught:
        driving_templates(directory)
    return str(caught.value)


def last(directory: Path | None, prompt: Prompt = PROMPT) -> str:
    return driving_templates(directory).messages(prompt)[-1].text


@pytest.mark.parametrize("wording", WORDINGS)
def test_a_conversation_is_system_then_pairs_then_the_question_with_its_images(wording) -> None:
    picture = {"camera_front": np.zeros((4, 4, 3), np.uint8)}
    prompt = percept_prompt(PERCEPT | picture, images=["camera_front"])
    found = driving_templates().messages(replace(prompt, wording=wording))
    assert [one.role for one in found] == ["system", *["user", "assistant"] * 3, "user"]
    assert [one.images for one in found[:-1]] == [()] * 7
    assert found[-1].images == prompt.images
    assert "CAMERA" in found[-1].text


@pytest.mark.parametrize("wording", WORDINGS)
def test_the_system_s_message_says_all_that_an_answer_needs(wording) -> None:
    system = driving_templates().messages(replace(PROMPT, wording=wording))[0].text
    for word in (*SCHEMA["properties"], *MANEUVERS, *MANEUVERS.values(), *INTENTS):
        assert word in system
    assert "<perceived_text>" in system
    assert "instruction" in system
    places = [system.index(f"\n{key}:") for key in SCHEMA["properties"]]
    assert places == sorted(places), "in the schema's order, the reasoning before the decision"


def test_examples_are_what_a_model_might_answer_and_what_the_sensors_might_say() -> None:
    templates = driving_templates()
    answers = [one.text for one in templates.messages(PROMPT) if one.role == "assistant"]
    said = [read_answer(Answer(text), SCHEMA) for text in answers]
    assert [one.outcome for one in said] == ["answered"] * 3
    assert {one.content["maneuver"] for one in said} == {"wait", "accelerate", "emergency_brake"}
    for example, reading in zip(templates._examples["", True], said, strict=True):
        blocks = {one.name: one.facts for one in example.blocks}
        listed = blocks["LIDAR"]["objects"]
        assert set(reading.content["threat_ids"]) <= {one["id"] for one in listed}
        for one in listed:
            ahead, left = one["ahead"], one["left"]
            assert math.hypot(ahead, left) == pytest.approx(one["distance"], abs=0.06)
            assert direction(math.atan2(left, ahead)) == one["direction"]
            turned = {"same way": 0, "to the left": 90, "oncoming": 180, "to the right": -90}
            course = math.radians(turned[one["course"]])
            rate = ahead * (one["speed"] * math.cos(course) - blocks["EGO"]["speed"])
            rate += left * one["speed"] * math.sin(course)
            assert -rate / one["distance"] == pytest.approx(one["closing"], abs=0.06)


def changes(facts):
    """The facts with one of them changed, for each of them and of those of what they list."""
    for key, value in facts.items():
        if not isinstance(value, tuple):
            yield key, {**facts, key: 7 if isinstance(value, int) else "changed"}
            continue
        for place, one in enumerate(value):
            inner = changes(one) if isinstance(one, dict) else [("", "changed")]
            for name, other in inner:
                yield f"{key}.{name}", {**facts, key: (*value[:place], other, *value[place + 1 :])}


@pytest.mark.parametrize("wording", WORDINGS)
def test_every_fact_is_told(wording) -> None:
    templates, (prompt, *_) = driving_templates(), probes()
    text = templates.messages(replace(prompt, wording=wording))[-1].text
    seen = 0
    for place, block in enumerate(prompt.blocks):
        for key, facts in changes(block.facts):
            changed = (
                *prompt.blocks[:place],
                Block(block.name, facts),
                *prompt.blocks[place + 1 :],
            )
            told = templates.messages(Prompt(changed, prompt.images, wording))[-1].text
            # An id is told by its label.
            assert (told == text) == key.endswith(".id"), (block.name, key)
            seen += 1
    assert seen > 100


def test_both_wordings_tell_the_same_in_other_words() -> None:
    own, other = (last(None, replace(PROMPT, wording=one)) for one in WORDINGS)
    assert own != other
    (body,) = PROMPT.blocks[1].facts["objects"]
    motion = next(block.facts for block in PROMPT.blocks if block.name == "IMU")
    for value in (*body.values(), *motion.values()):
        assert str(value) in own
        assert str(value) in other


def test_each_block_has_a_template_in_either_wording() -> None:
    names = set(Sources.read(TEMPLATES).texts)
    for block in BLOCKS:
        assert {f"{block.lower()}.j2", f"paraphrased/{block.lower()}.j2"} <= names


def test_a_user_s_file_replaces_the_one_of_its_name_and_no_other(tmp_path) -> None:
    (tmp_path / "goal.j2").write_text("GOAL: home, {{ turn }}\n")
    (tmp_path / ".hidden").write_text("not a template")
    text = last(tmp_path)
    assert "GOAL: home, straight" in text
    assert text.partition("GOAL")[0] == last(None).partition("GOAL")[0]
    assert "GOAL: get" in last(tmp_path, replace(PROMPT, wording="paraphrased"))


def test_a_user_s_examples_go_through_the_templates(tmp_path) -> None:
    answer = json.loads(driving_templates().messages(PROMPT)[2].text)
    goal = {"missing": 0, "turn": {"perceived": "<left>"}, "destination": "west"}
    given = [{"blocks": {"GOAL": goal}, "answer": answer}]
    (tmp_path / "few_shot.yaml").write_text(json.dumps(given))
    _, question, reply, _ = driving_templates(tmp_path).messages(PROMPT)
    assert question.text.startswith("GOAL: go <perceived_text>(left)</perceived_text> through")
    assert json.loads(reply.text) == answer
    (tmp_path / "few_shot.yaml").write_text("")
    assert len(driving_templates(tmp_path).messages(PROMPT)) == 2


def test_the_digest_is_of_all_templates_in_use_wherever_they_stand(tmp_path) -> None:
    own = driving_templates().digest
    (tmp_path / "goal.j2").write_text(TEMPLATES.joinpath("goal.j2").read_text())
    assert driving_templates(tmp_path).digest == own
    (tmp_path / "goal.j2").write_text("GOAL: home")
    changed = driving_templates(tmp_path).digest
    assert len(changed) == 64
    assert changed != own
    (tmp_path / "goal.j2").write_text("GOAL: away")
    assert "GOAL: away" in last(tmp_path), "a changed file is read again"
    assert driving_templates(tmp_path).digest not in (own, changed)


@pytest.mark.parametrize(
    "name, told",
    [
        ("lida.j2", ["there is no template 'lida.j2'", "did you mean 'lidar.j2'?"]),
        ("paraphrased/sistem.j2", ["did you mean 'paraphrased/system.j2'?"]),
        ("few_shot.yml", ["did you mean 'few_shot.yaml'?"]),
        ("README.txt", ["one of camera.j2", "rename or remove it"]),
    ],
)
def test_a_file_that_replaces_nothing_is_refused(tmp_path, name, told) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("x")
    message = refusal(tmp_path)
    assert str(tmp_path / name) in message
    for words in told:
        assert words in message


def test_a_directory_must_be_there(tmp_path) -> None:
    assert "no such directory" in refusal(tmp_path / "absent")


@pytest.mark.parametrize(
    "name, text, line, told",
    [
        ("goal.j2", "GOAL\n{% if turn %}\n", 2, "no template"),
        ("goal.j2", "GOAL\n\n{{ turn", 3, "no template"),
        ("goal.j2", "{{ turn|tojson }}", 1, "No filter named 'tojson'"),
        ("goal.j2", "GOAL\n{{ trun }}", 2, "'trun' is undefined"),
        ("lidar.j2", "\n\n{% for o in objects %}{{ o.spede }}{% endfor %}", 3, "spede"),
        ("system.j2", "{{ maneuver }}", 1, "'maneuver' is undefined"),
        ("user.j2", "{{ blocks[0].text * 9999999999 }}", 1, "for two numbers only"),
        ("user.j2", "{{ 9 ** 9 }}", 1, "'**' not at all"),
        ("user.j2", "{{ 'x'.ljust(9999999999) }}", 1, "not safely callable"),
        ("user.j2", "\n{% for i in range(9) %}{% endfor %}", 2, "not safely callable"),
        ("user.j2", "{{ lipsum }}", 1, "'lipsum' is undefined"),
        ("user.j2", "{{ ''.__class__.__mro__ }}", 1, "unsafe"),
        ("user.j2", "{% include '/etc/hostname' %}", 1, "/etc/hostname"),
        ("user.j2", "{% include '../system.j2' %}", 1, "../system.j2"),
        ("user.j2", "{% macro f() %}{{ f() }}{% endmacro %}{{ f() }}", 1, "RecursionError"),
        ("controls.j2", "{% for o in objects %}{{ o.text._text }}{% endfor %}", 1, "_text"),
        ("goal.j2", "{% for a in 'GOALGOALGOALGOAL' %}" * 4 + "x" + "{% endfor %}" * 4, None,
         "more than 32768 characters"),
    ],
)  # fmt: skip
def test_a_template_that_fails_does_so_when_loaded_with_its_line(
    tmp_path, name, text, line, told
) -> None:
    (tmp_path / name).write_text(text)
    message = refusal(tmp_path)
    assert told in message
    place = f"{tmp_path / name}:{line}: " if line else str(tmp_path / name)
    assert message.startswith(place)


@pytest.mark.parametrize(
    "text, line, told",
    [
        ("- {blocks: {}, answer: {}}", 1, "schema_violation"),
        ("# x\n- blocks: {}\n  answr: {}", 2, "`blocks` and `answer`, and nothing else"),
        ("- blocks: [1]\n  answer: {}", 1, "facts by the block's name"),
        ("- blocks: {}\n  answer: 2020-01-01", 1, "no JSON"),
        ("- blocks: {}\n- [", 2, "no YAML"),
        ("a: b", 1, "no list"),
    ],
)
def test_examples_that_no_model_could_give_are_refused_with_their_line(
    tmp_path, text, line, told
) -> None:
    (tmp_path / "few_shot.yaml").write_text(text)
    message = refusal(tmp_path)
    assert told in message
    assert f"{tmp_path / 'few_shot.yaml'}:{line}: " in message


def test_an_example_with_an_unknown_maneuver_or_block_is_refused(tmp_path) -> None:
    answer = json.loads(driving_templates().messages(PROMPT)[2].text)
    file = tmp_path / "few_shot.yaml"
    file.write_text(json.dumps([{"blocks": {}, "answer": {**answer, "maneuver": "fly"}}]))
    assert "unknown_action" in refusal(tmp_path)
    file.write_text(json.dumps([{"blocks": {"GAOL": {}}, "answer": answer}]))
    assert "the block 'GAOL' has no template" in refusal(tmp_path)


def test_a_file_must_be_readable_text_of_bounded_size(tmp_path) -> None:
    (tmp_path / "goal.j2").write_bytes(b"\xff\xfe")
    assert "cannot be read" in refusal(tmp_path)
    (tmp_path / "goal.j2").write_text("x" * 70_000)
    assert "70000 bytes" in refusal(tmp_path)


def test_an_unknown_wording_or_block_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no wording 'poem'"):
        driving_templates().messages(replace(PROMPT, wording="poem"))
    with pytest.raises(ConfigurationError, match="the block 'SONAR' has no template"):
        driving_templates().messages(Prompt((Block("SONAR", {}),)))


def test_another_domain_has_templates_of_its_own(tmp_path) -> None:
    (tmp_path / "system.j2").write_text("Hold {{ what }}.")
    (tmp_path / "user.j2").write_text("{% for one in blocks %}[{{ one.text }}]{% endfor %}")
    (tmp_path / "cart.j2").write_text("at {{ x }}, sign {{ sign }}, {{ sign|upper }}{{ sign ~ 1 }}")
    templates = Templates.load(tmp_path, vocabulary={"what": "the pole"})
    cart = Block("CART", {"x": None, "sign": PerceivedText("<b>")})
    system, user = templates.messages(Prompt((cart, cart)))
    assert system.text == "Hold the pole."
    enclosed = "<perceived_text>(b)</perceived_text>"
    assert user.text == f"[at no data, sign {enclosed}, {enclosed.upper()}{enclosed}1]" * 2


def test_the_page_names_all_files_blocks_facts_and_filters() -> None:
    page = (Path(__file__).parents[3] / "docs" / "prompts.md").read_text("utf-8")
    for probe in probes():
        for block in probe.blocks:
            (row,) = (line for line in page.splitlines() if line.startswith(f"| `{block.name}` |"))
            keys = [*block.facts]
            for listed in ("objects", "pictures", "decisions"):
                keys += [key for one in block.facts.get(listed, ()) for key in one]
            assert all(f"`{key}`" in row for key in keys), block.name
    for word in (
        *FILTERS,
        *VOCABULARY,
        "system.j2",
        "user.j2",
        "few_shot.yaml",
        str(LONGEST_RENDERED),
    ):
        assert f"`{word}`" in page or f" {word} " in page, word


def test_claims_are_asked_for_where_the_system_and_each_example_have_them(tmp_path) -> None:
    def asks(directory):
        templates = driving_templates(directory)
        messages = templates.messages(PROMPT)
        answers = [json.loads(each.text) for each in messages if each.role == "assistant"]
        asked = "claims" in templates.schema["properties"]
        assert (
            asked == ("claims" in templates.schema["required"]) == ("\nclaims:" in messages[0].text)
        )
        assert all(("claims" in answer) == asked for answer in answers)
        return asked

    assert asks(None)
    (tmp_path / "few_shot.yaml").write_text("# none\n")
    assert not asks(tmp_path), "a request of templates without claims stays as it is"
    own = (TEMPLATES / "few_shot.yaml").read_text()
    (tmp_path / "few_shot.yaml").write_text(own)
    assert asks(tmp_path)
    (tmp_path / "system.j2").write_text("Choose one of {{ maneuvers|list|join(', ') }}.")
    assert not asks(tmp_path)


def test_examples_claim_what_they_show() -> None:
    templates = driving_templates()
    for hardened in (True, False):
        for example in templates._examples["", hardened]:
            shown = shown_facts(Prompt(example.blocks))
            for claim in json.loads(example.answer)["claims"]:
                assert {"id": claim["id"], **shown[claim["id"]]} == claim
