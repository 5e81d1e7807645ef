"""Laws of episodes that were cut: what is judged on a prefix is what the whole episode shows."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest
from formulas import can_fail, formulas, traces
from handmade import SPEC, handmade
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from pytest_dura import DependabilityMetrics, Episode, JudgedEpisode, Requirement
from pytest_dura.requirements import judge_episode

NAMES = ("a", "b")
STEP = 0.1
WHOLE = ("time", "goal", "critical", "halt")
CUT = ("violation", "decided")
ALWAYS_OR_ONCE = ["(always (a > 0))", "(eventually (b > 0))"]
"""Satisfied by one side, while what follows may still lessen the margin of the other."""


def episode(trace: dict[str, list[float]], **keys: Any) -> Episode:
    """An episode of these samples, in which the component always answered."""
    size = len(trace["a"])
    made = handmade(
        size,
        dt=STEP,
        spec=replace(SPEC, time_step=STEP),
        metrics=DependabilityMetrics(proposals=size, valid_proposals=size),
        **trace,
    )
    return replace(made, **keys)


def test_a_prefix_shows_a_violation_or_a_satisfaction_only_if_the_whole_episode_does() -> None:
    ends: Counter[str] = Counter()

    windows = st.sampled_from(["always", "eventually", "always[0:0.2]", "eventually[0.1:0.3]"])
    small = formulas(NAMES, time_step=STEP, max_leaves=2, max_window=3)
    ranged = st.builds(lambda window, formula: f"({window} ({formula}))", windows, small)

    @settings(max_examples=120, derandomize=True, deadline=None)
    @given(st.lists(ranged, min_size=1, max_size=2), traces(NAMES, min_size=2), st.integers(1, 9))
    @example(ALWAYS_OR_ONCE, {"a": [3.0, 3.0, -1.0], "b": [1.0, 1.0, 1.0]}, 2)
    def law(sides: list[str], trace: dict[str, list[float]], size: int) -> None:
        assume(can_fail(" or ".join(sides)))
        rule = Requirement("R", check=" or ".join(sides))
        whole = judge_episode(rule, episode(trace))
        prefix = {name: column[:size] for name, column in trace.items()}
        for end in (*CUT, "infrastructure"):
            failure = "infrastructure: it broke" if end == "infrastructure" else None
            cut = judge_episode(rule, episode(prefix, termination=end, failure=failure))
            ends[f"{cut.verdict} {end}"] += 1
            if failure:
                assert cut.verdict in ("violated", "missing")
            if cut.verdict in ("satisfied", "violated") and whole.verdict != "invalid":
                assert (cut.verdict, cut.time) == (whole.verdict, whole.time)
            if cut.verdict == whole.verdict == "satisfied" and end == "decided":
                margin = math.inf if whole.margin is None else whole.margin
                assert cut.margin is None or cut.margin <= margin

    law()
    kinds = [f"{verdict} {end}" for verdict in ("violated", "satisfied", "open") for end in CUT]
    assert min(ends[kind] for kind in (*kinds, "missing infrastructure")) >= 3, ends


@pytest.mark.parametrize("end", [*WHOLE, *CUT, "infrastructure"])
def test_a_function_says_nothing_of_a_prefix_but_that_it_is_violated(end: Any) -> None:
    failure = "infrastructure: it broke" if end == "infrastructure" else None
    looked_at = episode({"a": [1.0] * 5, "b": [1.0] * 5}, termination=end, failure=failure)

    def verdict(holds: bool) -> str:
        def check(_: JudgedEpisode) -> bool:
            return holds

        return judge_episode(Requirement("R"), looked_at, check).verdict

    expected = "missing" if failure else "satisfied" if end in WHOLE else "open"
    assert verdict(True) == expected
    assert verdict(False) == ("missing" if failure else "violated")
