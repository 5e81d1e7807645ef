"""Gap and time to collision of a whole episode against one pair at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pytest_dura.driving import GAP_CAP, TTC_CAP, Body, BodyList, box_gap, box_time_to_collision
from pytest_dura.driving.bodies import proximity

places = st.floats(-70.0, 70.0)
speeds = st.floats(-12.0, 12.0)
sizes = st.sampled_from([(5.0, 2.0), (0.6, 0.6), (12.0, 2.5), (1.0, 1.0)])
bodies = st.tuples(places, places, st.floats(-4.0, 4.0), speeds, speeds, sizes)
egos = st.tuples(places, places, st.floats(-4.0, 4.0), speeds, speeds)
ticks = st.lists(st.tuples(egos, st.lists(bodies, max_size=5)), min_size=1, max_size=4)


def one_by_one(ego: Any, others: Any) -> tuple[float, float]:
    gap, ttc = GAP_CAP, TTC_CAP
    mine = np.array([[*ego[:3], 5.0, 2.0]])
    for x, y, heading, vx, vy, size in others:
        box = np.array([[x, y, heading, *size]])
        gap = min(gap, float(box_gap(mine, box)[0]))
        velocities = np.array([ego[3:]]), np.array([[vx, vy]])
        times = box_time_to_collision(mine, velocities[0], box, velocities[1], TTC_CAP)
        ttc = min(ttc, float(times[0]))
    return gap, ttc


@settings(derandomize=True, deadline=None, max_examples=60)
@given(ticks)
def test_leaving_out_far_pairs_changes_nothing(episode: Any) -> None:
    shown = [
        BodyList.of([Body(f"V{i}", *one[:5], *one[5]) for i, one in enumerate(others)])
        for _, others in episode
    ]
    gap, ttc = proximity(np.array([ego for ego, _ in episode], dtype=float), shown)
    for tick, (ego, others) in enumerate(episode):
        expected = one_by_one(ego, others)
        assert (gap[tick], ttc[tick]) == pytest.approx(expected, abs=1e-9)
