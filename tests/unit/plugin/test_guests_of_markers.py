"""What guests make of a marker's arguments: one names scenarios, and at least one of them."""

from __future__ import annotations

from typing import ClassVar

import pytest

from pytest_dura import ConfigurationError
from pytest_dura.guests import Guest
from pytest_dura.plugin import guests as session_guests
from pytest_dura.plugin.guests import SessionGuests
from pytest_dura.plugin.items import markers


class Rides(Guest):
    marker_arguments: ClassVar = {"floor": None}

    def marked(self, given):
        return None if given["floor"] is None else given["floor"]


class Drives(Guest):
    marker_arguments: ClassVar = {"drives": None}

    def marked(self, given):
        return None if given["drives"] is None else given["drives"]


@pytest.fixture
def marked(monkeypatch):
    known = {"lift": Rides, "road": Drives}
    monkeypatch.setattr(session_guests, "guests", lambda: known)
    options = {name: guest.options for name, guest in known.items()}
    return SessionGuests(None, lambda: options, dict).marked


def test_the_scenarios_of_one_guest_are_taken(marked) -> None:
    assert marked({"floor": None, "drives": None}) is None
    assert marked({"floor": ["up"], "drives": None}) == ["up"]


@pytest.mark.parametrize(
    "given, problem",
    [
        ({"floor": [], "drives": None}, "the guest lift has no scenario for {'floor': []}"),
        ({"floor": ["up"], "drives": ["a"]}, "the guests lift and road both name scenarios"),
    ],
)
def test_no_scenario_and_those_of_two_guests_are_refused(marked, given, problem) -> None:
    with pytest.raises(ConfigurationError, match=problem.replace("[", r"\[")):
        marked(given)


@pytest.mark.parametrize("argument", ["runs", "floor"])
def test_an_argument_that_the_marker_has_already_is_refused(monkeypatch, argument) -> None:
    class Second(Guest):
        marker_arguments: ClassVar = {argument: None}

    monkeypatch.setattr(markers, "guests", lambda: {"lift": Rides, "second": Second})
    markers._signature.cache_clear()
    try:
        with pytest.raises(ConfigurationError, match=f"second adds the argument '{argument}'"):
            markers._signature(markers._dura_marker)
    finally:
        markers._signature.cache_clear()
