"""Faults of the way to a language model: what becomes of the delivery, and what comes of that."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from pytest_dura.core import RoleContext, stream
from pytest_dura.faults import (
    CampaignInjector,
    Moment,
    fault_effect,
    parse_fault,
)
from pytest_dura.llm import Delivery, Endpoint, Message, OpenAiClient, Request, ServerFault
from pytest_dura.llm.faults import How

REQUEST = Request("m", (Message("user", "Where?"),))


def fault(kind: str, at: float = 0.0, **given: Any) -> dict[str, Any]:
    head = {key: given.pop(key) for key in ("id", "duration") if key in given}
    return parse_fault({"type": kind, "activation": {"at": at}, **head, "parameters": given})


def delivered(
    *faults: dict[str, Any], sent: Delivery | None = None, ticks: int = 1
) -> list[tuple[Delivery, tuple[str, ...]]]:
    """The delivery at each tick of 0.1 s, and the faults that changed it."""
    injector = CampaignInjector()
    injector.reset(RoleContext(1, 0.1, {}, faults))
    found = []
    for index in range(ticks):
        injector.corrupt({"odometry": 0.0}, index * 0.1)
        found.append(injector.corrupt_message("model", sent or Delivery(), index * 0.1))
    return found


def test_every_way_to_fail_of_the_port_can_be_injected() -> None:
    assert ("", *get_args(How)) == get_args(ServerFault)


@pytest.mark.parametrize("how", get_args(How))
def test_a_failing_model_fails_in_the_declared_way_and_the_client_reads_it_so(how) -> None:
    ((found, tampered),) = delivered(fault("model-failure", how=how))
    assert (found, tampered) == (Delivery(fault=how), ("model-failure",))
    client = OpenAiClient(Endpoint("http://host.invalid/v1", "m"))
    failure = client.ask(REQUEST, 5.0, found.fault).failure
    expected = {"cut": "truncated", "garbage": "malformed"}.get(how, "unavailable")
    assert failure == expected


def test_delays_add_up_and_none_changes_nothing() -> None:
    late = fault("model-delay", seconds=1.5), fault("model-delay", id="more", seconds=0.25)
    ((found, tampered),) = delivered(*late)
    assert (found, tampered) == (Delivery(delay=1.75), ("model-delay", "more"))
    sent = Delivery(delay=0.5)
    none = fault("model-delay", seconds=0.0)
    moment = Moment(0.0, 0.1, 0.0, {}, (), lambda: stream(0, "law"))
    assert fault_effect(none).apply(True, sent, moment) is sent
    ((found, tampered),) = delivered(none, sent=sent)
    assert found is sent
    assert tampered == ()


def test_what_failed_stays_as_it_failed() -> None:
    sent = Delivery(fault="cut", delay=0.5)
    ((found, tampered),) = delivered(fault("model-failure", how="garbage"), sent=sent)
    assert found is sent
    assert tampered == ()
    first, second = (
        fault("model-failure", how="http_429"),
        fault("model-failure", id="b", how="cut"),
    )
    ((found, tampered),) = delivered(first, second, fault("model-delay", seconds=2.0))
    assert found == Delivery("http_429", 2.0)
    assert tampered == ("model-failure", "model-delay")


def test_it_acts_within_its_time_and_on_no_other_message() -> None:
    one = fault("model-failure", at=0.2, duration=0.3)
    found = delivered(one, ticks=8)
    assert [delivery.fault for delivery, _ in found] == ["", "", *["http_500"] * 3, "", "", ""]
    injector = CampaignInjector()
    injector.reset(RoleContext(1, 0.1, {}, (fault("model-failure"),)))
    injector.corrupt({"odometry": 0.0}, 0.0)
    prompt = object()
    assert injector.corrupt_message("prompt", prompt, 0.0) == (prompt, ())
