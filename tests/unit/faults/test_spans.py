"""Spans: what a search may give the parameters of the catalogue's faults."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from fault_runs import CHANNEL, commanded, through
from pydantic import create_model
from roads import channels_of

from pytest_dura.core import ConfigurationError, stream
from pytest_dura.driving import Body
from pytest_dura.faults import (
    FAULT_TYPES,
    Choices,
    Fault,
    FaultPart,
    Moment,
    NumberFault,
    Span,
    default_fault,
    fault_class,
    load_fault,
    spans_of,
)
from pytest_dura.faults.parts import declared_span, parameters_of
from pytest_dura.faults.types.base import NoParameters
from pytest_dura.llm import Delivery

NO_IDENTITY = {
    "stuck-at", "out-of-range", "freeze", "denial", "replay", "masquerade", "stuck-command",
    "inversion", "perturbation", "ghost-obstacle", "id-switch", "gnss-jam", "prompt-text",
    "prompt-drop", "prompt-reorder", "prompt-paraphrase", "model-failure",
}  # fmt: skip
"""Types that change something whatever their parameters are, or whose magnitude is no number."""

NO_MAGNITUDE = {
    # The valid range of the field, which is as it is.
    ("out-of-range", "low"),
    ("out-of-range", "high"),
}
"""Numbers that say what is there, and not how wrong it is."""


def numeric(annotation: Any) -> bool:
    return annotation in (int, float) or annotation == float | None


def fault(name: str, **parameters: Any) -> Fault:
    link = dict.fromkeys(("number", "any", "image"), CHANNEL)
    data = default_fault(name, {**link, "command": "command"})
    given = {**data["parameters"], **parameters}
    return load_fault({**data, "activation": {"at": 0.0}, "duration": None, "parameters": given})


def neutral(name: str) -> dict[str, Any]:
    found = {}
    for path, span in spans_of(fault_class(name)).items():
        parameter = path.rpartition(".")[2]
        if declared_span(parameters_of(fault_class(name)).model_fields[parameter]) is not None:
            found[parameter] = span.values[0] if isinstance(span, Choices) else span.neutral
    return found


def test_every_number_of_the_catalogue_has_a_span() -> None:
    without = {
        (name, parameter)
        for name in FAULT_TYPES
        for parameter, field in parameters_of(fault_class(name)).model_fields.items()
        if numeric(field.annotation) and declared_span(field) is None
    }
    assert without == NO_MAGNITUDE


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_every_value_of_a_span_that_is_an_end_or_the_neutral_makes_a_fault(name: str) -> None:
    for path, span in spans_of(fault_class(name)).items():
        parameter = path.rpartition(".")[2]
        if isinstance(span, Choices):
            values, simplest = span.values, span.values[0]
        else:
            values, simplest = (span.low, span.high), span.neutral
        for value in (*values, simplest):
            made = fault(name, **{parameter: value})
            assert getattr(made.parameters, parameter) == value


@pytest.mark.parametrize("name", sorted(FAULT_TYPES))
def test_all_parameters_at_either_end_make_a_fault(name: str) -> None:
    spans = spans_of(fault_class(name))
    for end in ("low", "high"):
        given = {
            path.rpartition(".")[2]: max(span.values, key=str)
            if isinstance(span, Choices)
            else getattr(span, end)
            for path, span in spans.items()
        }
        assert fault(name, **given).parameters.model_dump() | given == (
            fault(name, **given).parameters.model_dump()
        )


@pytest.mark.parametrize("name", sorted(set(FAULT_TYPES) - NO_IDENTITY))
def test_at_the_neutral_values_nothing_is_changed(name: str) -> None:
    assert neutral(name), "a type with an identity has a magnitude"
    assert not changes(fault(name, **neutral(name)))


@pytest.mark.parametrize("name", sorted(set(FAULT_TYPES) - NO_IDENTITY))
def test_at_the_far_end_of_its_spans_something_is_changed(name: str) -> None:
    far: dict[str, Any] = {}
    for parameter, calm in neutral(name).items():
        span = declared_span(parameters_of(fault_class(name)).model_fields[parameter])
        assert span is not None
        kind = type(calm)
        far[parameter] = max(kind(span.low), kind(span.high), key=lambda one: abs(one - calm))
    assert changes(fault(name, **far))


def changes(one: Fault) -> bool:
    """Whether a fault changes anything of a stream of values that it can act on."""
    if one.acts_on == "command":
        values = [math.sin(index) for index in range(30)]
        return commanded(values, one.model_dump(mode="json")) != values
    if one.target != CHANNEL:
        return _changes_percept(one)
    values = [math.sin(index) + 0.01 * index for index in range(30)]
    if one.acts_on == "image":
        values = [np.random.default_rng(n).integers(0, 256, (6, 8, 3), np.uint8) for n in range(4)]
    found = through(values, one.model_dump(mode="json"))
    return any(now is not was for now, was in zip(found, values, strict=True))


def _changes_percept(one: Fault) -> bool:
    around = [
        Body("V1", 10.0, 4.0, 0.1, 3.0, 0.0, 5.0, 2.0),
        Body("V2", -20.0, 30.0, 1.0, -3.0, 1.0, 5.0, 2.0),
        Body("P1", 5.0, -9.0, 2.0, 0.0, 1.0, 0.6, 0.6),
    ]
    channels = {**channels_of(*around), "model": Delivery()}
    before = channels[one.target]

    def moment(elapsed: float) -> Moment:
        return Moment(elapsed, 0.1, elapsed, channels, [], lambda: stream(1, "spans"))

    memory = one.begin(before, moment(0.0))
    return any(one.apply(memory, before, moment(at)) is not before for at in (0.0, 0.5, 2.0))


def test_a_whole_number_has_whole_values_the_neutral_first() -> None:
    assert spans_of(fault_class("duplicate"))["parameters.n"] == Choices(tuple(range(10)))
    given = spans_of(_with(int, Span(-1, 2, neutral=1)))
    assert given == {"parameters.number": Choices((1, 0, 2, -1))}
    with pytest.raises(ConfigurationError, match="whole number"):
        spans_of(_with(int, Span(0.5, 2.0, neutral=1.0)))


def test_a_type_of_ones_own_declares_its_spans_in_the_same_way() -> None:
    assert spans_of(_with(float, Span(1.0, 2.0, neutral=1.5))) == {
        "parameters.number": Span(1.0, 2.0, 1.5)
    }
    assert spans_of(_with(float)) == {}, "what nothing is said of stays as it is"
    assert spans_of(Bare) == {}


class Bare(NumberFault):
    type: Literal["bare"]
    parameters: NoParameters = NoParameters()

    def changed(self, value: Any, moment: Moment) -> Any:
        return value


def _with(kind: Any, *metadata: Any) -> type[Fault]:
    annotation = Annotated[(kind, *metadata)] if metadata else kind
    model = create_model("P", __base__=FaultPart, number=(annotation, kind(1)))
    return create_model("F", __base__=Bare, parameters=(model, model()))


@pytest.mark.parametrize("low, high, neutral", [(1.0, 0.0, 0.5), (0, 1, 2), (1, 1, 1)])
def test_a_span_that_is_not_in_order_is_refused(low, high, neutral) -> None:
    with pytest.raises(ConfigurationError, match="not in order"):
        Span(low, high, neutral)
