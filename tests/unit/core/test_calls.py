"""Whose call was under way is read as it was written, whatever names there are."""

from __future__ import annotations

from pytest_dura.core.calls import COMPONENT, SIZE, Calls, CallUnderWay, read_call


def read(calls, name):
    with calls.calling(name):
        return place(calls)


def place(calls):
    call = read_call(bytes(calls.shared))
    return call.name, call.tick


def test_names_are_read_as_they_were_written_as_far_as_there_is_room():
    calls = Calls()
    calls.at(7)
    assert read(calls, "safety_monitor") == ("safety_monitor", 7)
    assert read(calls, "check always\n  (gap > 0)") == ("check always (gap > 0)", 7)
    for number in range(1000):
        assert read(calls, f"check {number}")[0] in (f"check {number}", "")
    assert read(calls, "safety_monitor") == ("safety_monitor", 7)
    assert read(calls, COMPONENT) == (COMPONENT, 7)
    assert place(calls) == ("", 7)
    assert len(calls.shared) == SIZE


def test_the_call_in_which_a_process_copied_itself_stays_whatever_follows():
    calls = Calls()
    calls.at(2)
    with calls.calling("safety_monitor"):
        calls.note_copy(calls.numbers["safety_monitor"])
    calls.at(3)
    with calls.calling(COMPONENT):
        assert read_call(bytes(calls.shared)) == CallUnderWay("safety_monitor", 2, copied=True)
