"""Whose call was under way is read as it was written, whatever names there are."""

from __future__ import annotations

from pytest_dura.core.calls import COMPONENT, SIZE, Calls, read_call


def read(calls, name):
    with calls.calling(name):
        return read_call(bytes(calls.shared))


def test_names_are_read_as_they_were_written_as_far_as_there_is_room():
    calls = Calls()
    calls.at(7)
    assert read(calls, "safety_monitor") == ("safety_monitor", 7)
    assert read(calls, "check always\n  (gap > 0)") == ("check always (gap > 0)", 7)
    for number in range(1000):
        assert read(calls, f"check {number}")[0] in (f"check {number}", "")
    assert read(calls, "safety_monitor") == ("safety_monitor", 7)
    assert read(calls, COMPONENT) == (COMPONENT, 7)
    assert read_call(bytes(calls.shared)) == ("", 7)
    assert len(calls.shared) == SIZE
