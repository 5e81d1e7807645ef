"""Recorded logs: none is judged in part, whatever its times are."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura import BlackBox

TICK = 0.1

changes = st.one_of(
    st.just(("none", 0)),
    st.tuples(st.just("shift"), st.sampled_from([1, -1, 30, -30, 17_000_000_000])),
    st.tuples(st.just("unit"), st.sampled_from([1e3, 1e6, 1e9])),
    st.tuples(st.just("run"), st.sampled_from([-9, -1, 1, 9])),
    st.tuples(st.just("lost"), st.integers(1, 6)),
)


def test_a_log_that_a_run_would_judge_in_part_is_refused() -> None:
    """Each line lies at a tick, one is too fast, and one thing at most is amiss with the times."""
    ways: Counter[str] = Counter()

    @settings(max_examples=300, derandomize=True, deadline=None)
    @given(changes, st.integers(20, 40), st.integers(1, 4), st.data())
    def law(change, lines, every, data) -> None:
        kind, size = change
        ticks = (lines - 1) * every
        at = np.arange(lines) * every
        if kind == "lost":
            first = data.draw(st.integers(1, lines - 1 - size))
            at = np.delete(at, slice(first, first + size))
        shift, unit = size if kind == "shift" else 0, size if kind == "unit" else 1.0
        speed = np.where(at == data.draw(st.sampled_from(at.tolist())), 12.0, 1.0)
        returned = {"time": (at + shift) * TICK * unit, "speed": speed}
        log = BlackBox(lambda _at, _inputs: returned, [], ["speed"])
        run = np.arange(ticks + (size if kind == "run" else 0) + 1) * TICK
        try:
            seen = log.columns({}, run)["speed"].max()
        except ValueError as refusal:
            seen, text = None, str(refusal)
            assert text.startswith("the log has gaps" if kind == "lost" else "simulate returned")
        # One line of a log at each tick may be lost: a single sample rests on no line then.
        is_whole = kind == "none" or (kind == "lost" and size * every == 1)
        assert (seen == 12.0) if is_whole else (seen is None)
        ways[f"{kind} {is_whole}"] += 1

    law()
    assert len(ways) == 6
    assert min(ways.values()) > 4, ways
