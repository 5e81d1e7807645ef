"""Messages: what happened, where, and how to mend it; the same text in every process."""

from __future__ import annotations

import json

import pytest

from pytest_dura import ConfigurationError, InfrastructureError
from pytest_dura.core import ConformanceError, describe_error, shorten


def test_a_configuration_error_names_place_key_value_and_remedy() -> None:
    error = ConfigurationError(
        "a duration is positive",
        file="a.yaml",
        line=3,
        key="duration",
        found=-1,
        expected="a number above 0",
        remedy="write a positive number",
    )
    assert str(error).splitlines() == [
        "a.yaml:3: a duration is positive",
        "  key:      duration",
        "  found:    -1",
        "  expected: a number above 0",
        "  remedy:   write a positive number",
    ]
    assert str(ConfigurationError("only this")) == "only this"


def test_an_infrastructure_error_names_role_and_tick() -> None:
    error = InfrastructureError("safety_monitor", 7, 0.7, "it broke")
    assert str(error) == "infrastructure: safety_monitor at tick 7 (t = 0.7 s): it broke"


def test_a_conformance_error_counts_and_numbers_its_breaches() -> None:
    assert str(ConformanceError("role X", [("bad", "mend it")])).splitlines() == [
        "role X: 1 breach of the contract",
        "  1. bad",
        "     remedy: mend it",
    ]
    assert "2 breaches" in str(ConformanceError("role X", [("a", "b"), ("c", "d")]))


def test_an_error_is_described_without_memory_addresses() -> None:
    assert describe_error(ValueError(f"bad {object()}")) == "ValueError: bad <object object at 0x…>"
    assert describe_error(KeyError()) == "KeyError"


def test_what_a_library_raises_is_placed_where_the_users_own_file_called_it() -> None:
    def propose() -> object:
        return json.loads("no plan")

    with pytest.raises(ValueError, match="Expecting value") as caught:
        propose()
    line = propose.__code__.co_firstlineno + 1
    place = f"(test_errors_tell.py:{line} in propose)"
    assert describe_error(caught.value).endswith(f": line 1 column 1 (char 0) {place}")


def test_long_values_are_shortened_to_one_line() -> None:
    text = shorten("x\n" * 500, limit=40)
    assert len(text) == 40
    assert "\n" not in text
