"""What every type of fault in the catalogue owes: one run asks all of it of a type.

What a type does to a value is in the ``*fault_laws.py`` beside it. A new type needs nothing here,
unless it changes something whatever its parameters are: then ``NO_IDENTITY`` names it.
"""

from __future__ import annotations

import copy
import math
import re
from typing import Any

import numpy as np
import pytest
from fault_runs import CHANNEL, check_place, commanded, through
from hypothesis import given, settings
from hypothesis import strategies as st
from roads import car, channels_of

from pytest_dura.core import ConfigurationError, Fault, Lazy, RoleContext
from pytest_dura.driving import CHANNELS, FAULT_TARGETS
from pytest_dura.faults import (
    FAULT_TYPES,
    Activation,
    CampaignInjector,
    Choices,
    FaultEffect,
    Span,
    default_fault,
    fault_class,
    fault_effect,
    parse_fault,
    spans_of,
)
from pytest_dura.faults.parts import Target, declared_span, parameters_of
from pytest_dura.library.fault_reference import reference_page
from pytest_dura.llm import Delivery, percept_prompt

NO_IDENTITY = {
    "stuck-at", "out-of-range", "freeze", "denial", "replay", "masquerade", "stuck-command",
    "inversion", "perturbation", "ghost-obstacle", "id-switch", "gnss-jam", "prompt-text",
    "prompt-drop", "prompt-reorder", "prompt-paraphrase", "model-failure",
}  # fmt: skip
"""Types that change something whatever their parameters are, or whose magnitude is no number."""
NO_MAGNITUDE = {("out-of-range", "low"), ("out-of-range", "high")}
"""Numbers that say what is there, and not how wrong it is: the valid range of the field."""
TICKS, DT = 30, 0.1
PAGE = reference_page(FAULT_TARGETS)


# A type on values of its kind


def planned(
    name: str, *, at: float = 0.0, ident: str = "", turns: Any = None, **given: Any
) -> Fault:
    """A fault of a type on a value of its kind; other keywords are its parameters."""
    link = dict.fromkeys(("number", "any", "image", "command"), CHANNEL)
    plain = default_fault(name, link).plain()
    plain |= {"id": ident or name, "duration": turns}
    parameters = {**plain["parameters"], **given}
    return parse_fault({**plain, "activation": {"at": at}, "parameters": parameters})


def worlds(kind: type[FaultEffect]) -> list[dict[str, Any]]:
    """All channels and messages at each tick, of which none may be written into."""
    ticks = []
    for index in range(6 if kind.acts_on == "image" else TICKS):
        about = [car(f"V{n}", 9.0 * n + 0.1 * index, 30.0) for n in range(3)]
        link: Any = math.sin(index) + 0.01 * index
        if kind.acts_on == "image":
            link = np.random.default_rng(index).integers(0, 256, (4, 5, 3), dtype=np.uint8)
            link.flags.writeable = False
        channels = {**channels_of(*about, s=50.0 + 0.8 * index), CHANNEL: link}
        ticks.append(channels | {"prompt": percept_prompt(channels), "model": Delivery()})
    return ticks


def shown(ticks: list[dict[str, Any]], own: Fault, *others: Fault, first: bool = True) -> list[Any]:
    """What stands at the target of a fault at each tick, through the injector."""
    place = Target.parse(own.target).channel
    injector = CampaignInjector()
    injector.reset(RoleContext(1, DT, {}, (own, *others) if first else (*others, own)))
    found = []
    for index, channels in enumerate(ticks):
        sent = dict(channels)
        message = sent.pop("prompt"), sent.pop("model")
        changed, tampered = injector.corrupt(sent, index * DT)
        value = changed.get(place)
        if place in ("prompt", "model"):
            before = message[place == "model"]
            value, ids = injector.corrupt_message(place, before, index * DT)
            tampered = {place: ids} if ids else {}
        assert (value is channels[place]) == (place not in tampered), "tampered says what changed"
        found.append(value.get() if type(value) is Lazy else value)
    return found


def plain(value: Any) -> Any:
    """A value that ``==`` compares whole."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    if isinstance(value, np.ndarray):
        return value.tolist()
    return (value.ids, value.data.tolist()) if hasattr(value, "with_body") else value


def corrupted(values: list[Any], own: Fault) -> None:
    """Let a fault act; a picture is not read."""
    injector = CampaignInjector()
    injector.reset(RoleContext(1, DT, {}, (own,)))
    for value in values:
        injector.corrupt({CHANNEL: value}, 0.0)


def changes(own: Fault) -> bool:
    """Whether a fault changes anything of a stream of values that it can act on."""
    ticks = worlds(fault_class(own.type))
    place = Target.parse(own.target).channel
    found = shown(ticks, own)
    return any(one is not channels[place] for one, channels in zip(found, ticks, strict=True))


WRONG = {
    "number": ["1", [1.0], math.nan, math.inf],
    "integer": ["1", [1], 1.5, math.nan],
    "string": [3.5],
    "boolean": [3.5, "no"],
    "array": [3.5, "V1"],
    "object": [3.5],
}
"""Values of other types than a parameter's, by that type in its JSON Schema."""
BEYOND = {"minimum": -1, "maximum": 1, "exclusiveMinimum": 0, "exclusiveMaximum": 0}
"""How far from a limit the next value lies that it excludes."""


def wrong_values(schema: dict[str, Any]) -> list[Any]:
    """Values that the JSON Schema of a parameter excludes: by type, limits or choices."""
    alternatives = [one for one in schema.get("anyOf", [schema]) if one.get("type") != "null"]
    if len(alternatives) > 1:
        return [[1.0]]
    (one,) = alternatives
    beyond = [one[key] + step for key, step in BEYOND.items() if key in one]
    return [*WRONG[one["type"]], *beyond, *(["nonsense"] if "enum" in one else [])]


# The questions


def the_default_is_complete_and_can_act_on_its_target(name: str, kind: type[FaultEffect]) -> None:
    fault = default_fault(name, FAULT_TARGETS)
    assert issubclass(kind, FaultEffect)
    assert fault.type == fault.id == name
    assert fault.target == FAULT_TARGETS.get(kind.acts_on, kind.default_target)
    assert fault.activation["at"] == 2.0
    assert fault.activation["by"] == "fault_injector"
    assert set(fault.activation) == set(Activation.model_fields)
    assert parse_fault(fault.plain()) == fault, "complete data is left as it is"
    assert Fault.of(fault.plain()) == fault
    check_place(fault, CHANNELS)


def a_target_of_another_kind_is_refused(name: str, kind: type[FaultEffect]) -> None:
    acts_on = {"any": "prompt", "number": "lidar", "command": "odometry.speed"}
    wrong = acts_on.get(kind.acts_on, "odometry.speed")
    fault = parse_fault({**default_fault(name, FAULT_TARGETS).plain(), "target": wrong})
    with pytest.raises(ConfigurationError) as caught:
        check_place(fault, CHANNELS)
    assert caught.value.key == "target"
    if kind.default_target in ("prompt", "model"):
        assert caught.value.expected == f"one of {kind.default_target}"


def every_parameter_has_a_meaning_and_every_number_a_span(
    name: str, kind: type[FaultEffect]
) -> None:
    for parameter, field in parameters_of(kind).model_fields.items():
        assert field.description, parameter
        numeric = field.annotation in (int, float) or field.annotation == float | None
        spanned = declared_span(field) is not None
        assert not numeric or spanned != ((name, parameter) in NO_MAGNITUDE), parameter


def the_ends_of_its_spans_make_faults(name: str, kind: type[FaultEffect]) -> None:
    ends: dict[str, dict[str, Any]] = {"low": {}, "high": {}}
    for path, span in spans_of(kind).items():
        parameter = path.rpartition(".")[2]
        values = span.values if isinstance(span, Choices) else (span.low, span.high, span.neutral)
        for value in values:
            effect: Any = fault_effect(planned(name, **{parameter: value}))
            assert getattr(effect.parameters, parameter) == value
        for end, together in ends.items():
            together[parameter] = (
                max(span.values, key=str) if isinstance(span, Choices) else getattr(span, end)
            )
    for together in ends.values():
        made = planned(name, **together).parameters
        assert made is not None
        assert {**made, **together} == made, "all parameters at one end"


def a_wrong_parameter_is_refused_at_its_key(name: str, kind: type[FaultEffect]) -> None:
    fields = parameters_of(kind).model_json_schema().get("properties", {})
    wrong = [(key, value) for key, schema in fields.items() for value in wrong_values(schema)]
    wrong += [(f"{key}q", 1.0) for key in fields] or [("power", 1.0)]
    for key, value in wrong:
        with pytest.raises(ConfigurationError) as caught:
            planned(name, **{key: value})
        assert str(caught.value.key).partition(".")[2].partition(".")[0] == key, (key, value)
        assert caught.value.expected or caught.value.remedy
        assert key[:-1] not in fields or f"did you mean '{key[:-1]}'?" in str(caught.value)


def what_is_not_a_value_of_its_kind_is_named(name: str, kind: type[FaultEffect]) -> None:
    wrong: dict[str, list[Any]] = {
        "number": ["12", None, True, [1.0], {"speed": 1.0}],
        "command": ["left", None, [1.0]],
        "image": [3.0, np.zeros((4, 6), np.uint8), np.zeros((4, 6, 3))],
    }
    wrong["image"] += [Lazy(lambda value=value: value) for value in wrong["image"]]
    place = "command" if kind.acts_on == "command" else CHANNEL
    noun = "picture" if kind.acts_on == "image" else "number"
    ask = commanded if kind.acts_on == "command" else corrupted
    own = parse_fault({**planned(name).plain(), "target": place})
    for value in [] if name == "stuck-command" else wrong.get(kind.acts_on, []):
        with pytest.raises(ConfigurationError, match=f"acts on a {noun}"):
            ask([value], own)


def numbers_of_any_kind_are_changed_one_by_one(name: str, kind: type[FaultEffect]) -> None:
    if kind.acts_on != "number":
        return
    given = {"bits": 20} if name == "bit-flip" else {}
    for number in (7, np.float32(7.0), np.int64(7)):
        (found,) = shown([{**worlds(kind)[0], CHANNEL: number}], planned(name, **given))
        assert type(found) is float or (name == "drift" and found is number), "nothing at first"
    rows = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    rows.flags.writeable = False
    plan = parse_fault({**planned(name, **given).plain(), "target": f"{CHANNEL}.1"})
    found = through([rows] * 2, plan)[1]
    assert np.array_equal(found[0], rows[0])
    assert (found[1] != rows[1]).all()
    assert not found.flags.writeable
    if name in ("noise", "bit-flip"):
        assert len(set((found[1] - rows[1]).tolist())) == 3, "each draws its own"


def neutral_values_change_nothing_and_far_ones_something(
    name: str, kind: type[FaultEffect]
) -> None:
    if name in NO_IDENTITY:
        return
    calm: dict[str, Any] = {}
    far: dict[str, Any] = {}
    for path, span in spans_of(kind).items():
        parameter = path.rpartition(".")[2]
        declared = declared_span(parameters_of(kind).model_fields[parameter])
        if declared is not None:
            nearest = span.values[0] if isinstance(span, Choices) else span.neutral
            number = type(nearest)
            calm[parameter] = nearest
            ends = number(declared.low), number(declared.high)
            far[parameter] = max(ends, key=lambda end: abs(end - nearest))
    assert calm, "a type with an identity has a magnitude"
    assert not changes(planned(name, **calm))
    assert changes(planned(name, **far))


def nothing_is_changed_before_it_begins_nor_written_into(
    name: str, kind: type[FaultEffect]
) -> None:
    own = planned(name, at=0.2)
    ticks, place = worlds(kind), Target.parse(own.target).channel
    before = [plain(channels[place]) for channels in ticks]
    around = [plain(channels["lidar"]) for channels in ticks]
    found = plain(shown(ticks, own))
    assert found == plain(shown(ticks, own)), "the same seed gives the same"
    assert [plain(channels[place]) for channels in ticks] == before, "nothing is written into"
    assert [plain(channels["lidar"]) for channels in ticks] == around
    assert found[:2] == before[:2], "nothing before the activation"
    assert found != before, "the type does something by default"
    if kind.acts_on in ("number", "any", "command", "image"):
        assert all(math.isfinite(value) for value in np.ravel(found))


def its_draws_do_not_depend_on_other_faults(name: str, kind: type[FaultEffect]) -> None:
    ticks, own = worlds(kind), planned(name)
    # Keeps a history, and never acts.
    other = planned("loss", ident="other", p=0.5, at=10.0)
    alone = plain(shown(ticks, own))
    assert plain(shown(ticks, own, other)) == alone
    assert plain(shown(ticks, own, other, first=False)) == alone


def between_its_turns_it_rests(name: str, kind: type[FaultEffect]) -> None:
    own = planned(name, turns={"on": 0.1, "off": 0.2})
    ticks, place = worlds(kind), Target.parse(own.target).channel
    for index, (channels, one) in enumerate(zip(ticks, shown(ticks, own), strict=True)):
        assert index % 3 == 0 or one is channels[place]


def the_reference_page_has_its_line_and_one_for_each_parameter(
    name: str, kind: type[FaultEffect]
) -> None:
    target = re.escape(str(FAULT_TARGETS.get(kind.acts_on, kind.default_target)))
    (line,) = re.findall(rf"^\| `{name}` \| [^|]+ \| `{target}` \|.*\|$", PAGE, re.MULTILINE)
    assert len(line.strip("| ").split(" | ")[-1]) > 20, "its effect"
    assert "``" not in line
    found = re.findall(rf"^\| `{name}` \| `(\w+)` \|", PAGE, re.MULTILINE)
    assert found == list(parameters_of(kind).model_fields)


SECONDS = st.floats(0.001, 40.0) | st.integers(1, 40)
ACTIVATIONS = st.fixed_dictionaries(
    {"at": SECONDS | st.just(0.1 + 0.2)}
) | st.fixed_dictionaries(
    {"probability": st.floats(0.0, 1.0, exclude_min=True)},
    optional={"not_before": SECONDS, "by": st.just("security_assessor")},
) | st.fixed_dictionaries(
    {"when": st.sampled_from(["odometry.speed > 3", "odometry.speed >= 0.30000000000000004"])}
)  # fmt: skip
DURATIONS = (
    SECONDS
    | st.none()
    | st.just("once")
    | st.tuples(SECONDS, SECONDS).map(lambda both: {"min": min(both), "max": max(both)})
    | st.fixed_dictionaries({"until": st.just("odometry.speed < 1"), "at_most": SECONDS})
    | st.fixed_dictionaries({"on": SECONDS, "off": SECONDS, "lasting": SECONDS})
)
NUMBERS = st.floats(-1e3, 1e3) | st.integers(-20, 20) | st.sampled_from([0.1 + 0.2, 1e-7, -0.0])


@st.composite
def varied(draw: st.DrawFn, name: str) -> dict[str, Any]:
    """A fault of the type as a file may have it, with other numbers and another time."""
    data = copy.deepcopy(default_fault(name, FAULT_TARGETS).plain())
    for key, parts in (("activation", ACTIVATIONS), ("duration", DURATIONS)):
        if draw(st.booleans()):
            data[key] = draw(parts)
    numbers = [key for key, value in data["parameters"].items() if type(value) in (int, float)]
    if numbers:
        for key in draw(st.sets(st.sampled_from(numbers))):
            data["parameters"][key] = draw(NUMBERS)
    for key in draw(st.sets(st.sampled_from(sorted({"parameters", "duration", "id"})))):
        data.pop(key)
    return data


def a_fault_that_was_read_is_read_again_as_it_is(name: str, kind: type[FaultEffect]) -> None:
    """Ask it also of the types of its numbers, and of the sign of a zero."""
    told = default_fault(name, FAULT_TARGETS)
    assert repr(parse_fault(told.plain()).plain()) == repr(told.plain())

    @settings(derandomize=True, deadline=None, max_examples=8, database=None)
    @given(st.data())
    def of_others(data: st.DataObject) -> None:
        try:
            fault = parse_fault(data.draw(varied(name)), FAULT_TARGETS)
        except ConfigurationError:
            return  # what is refused is never planned
        again = parse_fault(fault.plain())
        assert again == fault
        assert repr(again.plain()) == repr(fault.plain())
        assert again.by_chance == fault.by_chance
        assert fault_effect(again) == fault_effect(fault)
        assert isinstance(fault_effect(again), kind)

    of_others()


QUESTIONS = (
    the_default_is_complete_and_can_act_on_its_target,
    a_target_of_another_kind_is_refused,
    every_parameter_has_a_meaning_and_every_number_a_span,
    the_ends_of_its_spans_make_faults,
    a_wrong_parameter_is_refused_at_its_key,
    what_is_not_a_value_of_its_kind_is_named,
    numbers_of_any_kind_are_changed_one_by_one,
    neutral_values_change_nothing_and_far_ones_something,
    nothing_is_changed_before_it_begins_nor_written_into,
    its_draws_do_not_depend_on_other_faults,
    between_its_turns_it_rests,
    the_reference_page_has_its_line_and_one_for_each_parameter,
    a_fault_that_was_read_is_read_again_as_it_is,
)


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_a_type_of_fault_keeps_what_every_type_owes(name: str) -> None:
    for question in QUESTIONS:
        question(name, fault_class(name))


def test_a_span_is_of_a_range_or_of_choices() -> None:
    kinds = {type(span) for name in FAULT_TYPES for span in spans_of(fault_class(name)).values()}
    assert kinds == {Span, Choices}
