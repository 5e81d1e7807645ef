"""Spans: what a search may give the parameters of the catalogue's faults."""

from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import create_model

from pytest_dura.core import ConfigurationError
from pytest_dura.faults import (
    Choices,
    FaultEffect,
    FaultPart,
    Moment,
    NumberFault,
    Span,
    fault_class,
    spans_of,
)
from pytest_dura.faults.types.base import NoParameters


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
    parameters: NoParameters = NoParameters()

    def changed(self, value: Any, moment: Moment) -> Any:
        return value


def _with(kind: Any, *metadata: Any) -> type[FaultEffect]:
    annotation = Annotated[(kind, *metadata)] if metadata else kind
    model = create_model("P", __base__=FaultPart, number=(annotation, kind(1)))
    return create_model("F", __base__=Bare, parameters=(model, model()))


@pytest.mark.parametrize("low, high, neutral", [(1.0, 0.0, 0.5), (0, 1, 2), (1, 1, 1)])
def test_a_span_that_is_not_in_order_is_refused(low, high, neutral) -> None:
    with pytest.raises(ConfigurationError, match="not in order"):
        Span(low, high, neutral)
