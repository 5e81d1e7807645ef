"""Laws of the faults on the way to a language model."""

from __future__ import annotations

from typing import get_args

from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.faults import default_fault, fault_effect, parse_fault
from pytest_dura.llm import Delivery, ServerFault

WAYS = [one for one in get_args(ServerFault) if one]
SECONDS = st.floats(0.0, 60.0, allow_nan=False)
DELIVERIES = st.builds(Delivery, st.sampled_from(["", *WAYS]), SECONDS)
few = settings(derandomize=True, deadline=None, max_examples=60)


def applied(kind, delivery, **parameters):
    fault = parse_fault({**default_fault(kind).plain(), "parameters": parameters})
    return fault_effect(fault).apply(True, delivery, None)


@few
@given(delivery=DELIVERIES, how=st.sampled_from(WAYS))
def test_model_failure_makes_any_delivery_fail_and_delays_none(delivery, how):
    after = applied("model-failure", delivery, how=how)
    assert after.fault
    assert after.delay == delivery.delay
    if delivery.fault:
        assert after is delivery  # what fails already fails as it does
    else:
        assert after.fault == how


@few
@given(delivery=DELIVERIES, first=SECONDS, second=SECONDS)
def test_model_delay_adds_up_in_any_order_and_breaks_nothing(delivery, first, second):
    one = applied("model-delay", applied("model-delay", delivery, seconds=first), seconds=second)
    two = applied("model-delay", applied("model-delay", delivery, seconds=second), seconds=first)
    assert abs(one.delay - two.delay) < 1e-9
    assert abs(one.delay - (delivery.delay + first + second)) < 1e-9
    assert one.fault == delivery.fault


@few
@given(delivery=DELIVERIES)
def test_model_delay_of_no_time_changes_nothing(delivery):
    assert applied("model-delay", delivery, seconds=0.0) is delivery
