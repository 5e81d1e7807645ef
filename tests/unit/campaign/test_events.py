"""The stream on which a runner emits its events."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import pytest

from pytest_dura.campaign import EventStream, MonitorsMeasured, Progress, RunningCampaign

PROGRESS = Progress("room/warm", "T-1", 2, 9)


def test_subscribers_are_called_in_the_order_of_their_subscriptions():
    events, called = EventStream(), []
    for name in "cab":
        events.subscribe(Progress, lambda event, name=name: called.append((name, event)))
    events.emit(PROGRESS)
    assert called == [("c", PROGRESS), ("a", PROGRESS), ("b", PROGRESS)]


def test_an_event_reaches_subscribers_of_its_type_alone():
    events, called = EventStream(), []
    events.subscribe(MonitorsMeasured, called.append)
    events.emit(PROGRESS)
    assert called == []


def test_what_a_subscriber_raises_is_raised_where_the_event_is_emitted():
    events, called = EventStream(), []

    def refuse(_):
        raise ValueError("no")

    events.subscribe(Progress, refuse)
    events.subscribe(Progress, called.append)
    with pytest.raises(ValueError, match="no"):
        events.emit(PROGRESS)
    assert called == []


def test_events_are_frozen():
    with pytest.raises(FrozenInstanceError):
        PROGRESS.done = 3


def test_an_event_keeps_what_was_reached_when_it_was_emitted():
    running = RunningCampaign("room/warm", "T-1", 9)
    first, second = running.reach(1, 9, 1), running.reach(2, 11, 2)
    assert (first.done, first.budget, first.ended) == (1, 9, False)
    assert (second.done, second.budget, second.ended) == (2, 11, False)
    assert (running.end().done, running.end().ended) == (2, True)
