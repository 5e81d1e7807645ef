"""Laws of frames on a wire: round trip, damage, and what is found after garbage."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import example, given, settings
from hypothesis import strategies as st

from pytest_dura.adapters.link.frames import LONGEST, MARK, START, Decoder, Frame, Kind

FRAMES = st.builds(
    Frame,
    kind=st.sampled_from(Kind),
    number=st.integers(0, 2**32 - 1),
    answers=st.integers(0, 2**32 - 1),
    stamp=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=64) | st.just(MARK * 20),
    failed=st.booleans(),
)


@settings(derandomize=True, deadline=None)
@given(st.lists(FRAMES, max_size=4), st.lists(st.integers(1, 40), max_size=20))
def test_what_is_sent_arrives_in_whatever_pieces(frames, sizes) -> None:
    data, decoder = b"".join(frame.encode() for frame in frames), Decoder()
    arrived = []
    for size in sizes:
        arrived += decoder.feed(data[:size])
        data = data[size:]
    assert arrived + decoder.feed(data) == frames
    assert (decoder.damaged, decoder.garbage) == (0, 0)


@settings(derandomize=True, deadline=None)
@given(st.data(), FRAMES, FRAMES)
def test_each_wrong_bit_is_found_and_the_next_frame_is_read(data, frame, following) -> None:
    sent = bytearray(frame.encode())
    bit = data.draw(st.integers(0, 8 * len(sent) - 1))
    sent[bit // 8] ^= 1 << bit % 8
    decoder = Decoder()
    assert decoder.feed(bytes(sent) + following.encode()) == [following]
    assert decoder.garbage == len(sent)


@settings(derandomize=True, deadline=None)
@given(st.binary(max_size=200), FRAMES)
@example(MARK * 30, Frame(Kind.TICK, 1))
@example(MARK[:1], Frame(Kind.TICK, 1))
def test_a_frame_is_found_after_garbage(garbage, frame) -> None:
    decoder = Decoder()
    assert decoder.feed(garbage) == []
    assert decoder.feed(frame.encode()) == [frame]
    assert decoder.garbage == len(garbage)


@settings(derandomize=True, deadline=None)
@given(FRAMES, st.integers(1, 100))
def test_frames_after_one_that_was_cut_off_are_found_once_its_length_has_come(frame, left) -> None:
    frame = replace(frame, payload=b"x" * 200)
    cut, whole = frame.encode()[: START + left], Frame(Kind.COMMAND, 7, payload=b"y" * 100)
    decoder = Decoder()
    arrived = [found for _ in range(4) for found in decoder.feed(cut if _ == 0 else whole.encode())]
    assert arrived == [whole] * 3
    assert decoder.damaged == 1


def test_no_frame_makes_the_receiver_wait_for_more_than_the_longest() -> None:
    longest = Frame(Kind.RESET, 1, payload=b"z" * LONGEST)
    cut = longest.encode()[:START]
    decoder, whole = Decoder(), Frame(Kind.COMMAND, 2).encode()
    arrived = []
    for _ in range(LONGEST // len(whole) + 2):
        arrived += decoder.feed(whole)
    assert arrived
    decoder.feed(cut)
    assert decoder.feed(whole * (LONGEST // len(whole) + 2))
