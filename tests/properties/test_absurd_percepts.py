"""Percepts of any finite numbers: every built-in role answers, and answers what can be used."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import answering, said
from roads import Views, car_on, channels_of, walker

from pytest_dura.core import Generator, Percept, Proposal, RecoveryPlanner, RoleContext, RoleSpec
from pytest_dura.core.outputs import check_output, required_output
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import (
    BodyList,
    Command,
    HighwaySimulator,
    Maneuver,
    percept_at,
    percept_signals,
    route,
)

DRIVING = DOMAINS["driving"]
PATHS = {
    **{
        name: path
        for name, path in DRIVING.short_names["generator"].items()
        if name
        not in ("link", "device", "ros1", "ros2")  # other programs, which answer by themselves
    },
    **{name: path for name, path in DRIVING.default_roles.items() if name != "fault_injector"},
    **DRIVING.short_names["recovery_planner"],
    **DRIVING.short_names["residual_monitor"],
}
LARGEST = sys.float_info.max

numbers = st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(
    [0.0, -1.0, 1e300, -1e300, LARGEST, -LARGEST, 1e-308, -1e-308, 2.0, 60.0, 1e154]
)
SEEN = (
    car_on(0, "straight", 70.0, 5.0, "LEADS"),
    car_on(1, "straight", 80.0, 8.0, "COMES"),
    car_on(3, "left", 104.0, 4.0, "TURNS"),
    walker("WALKS", 6.0, 16.0, -1.3),
)
FIELDS = {"localisation": 3, "odometry": 1, "imu": 4}


@st.composite
def percepts(draw: Any) -> dict[str, Any]:
    """The channels of an ego among others, with any numbers in some places, or in all of a row."""
    s, turn = draw(st.sampled_from([(55.0, "left"), (91.0, "straight"), (105.0, "right")]))
    percept = channels_of(*SEEN[: draw(st.integers(0, 4))], s=s, turn=turn)
    arrays = {"lidar": percept["lidar"].data.copy(), "radar": percept["radar"].copy()}
    for channel in draw(st.lists(st.sampled_from([*arrays, *FIELDS]), min_size=1, max_size=4)):
        if channel in FIELDS:
            column = draw(st.integers(0, FIELDS[channel] - 1))
            name = percept[channel]._fields[column]
            percept[channel] = percept[channel]._replace(**{name: draw(numbers)})
        elif len(arrays[channel]):
            array = arrays[channel]
            row = draw(st.integers(0, len(array) - 1))
            column = draw(st.integers(0, array.shape[1]))  # the last means all
            array[row, column if column < array.shape[1] else slice(None)] = draw(numbers)
    return {
        **percept,
        "lidar": BodyList(percept["lidar"].ids, arrays["lidar"]),
        "radar": arrays["radar"],
    }


commands = st.builds(
    Command, st.sampled_from(list(Maneuver)), st.none() | st.sampled_from([-8.0, 0.0, 4.0])
)


def usable(role: Any, output: Any) -> None:
    """The loop accepts it, and its numbers are finite."""
    if isinstance(role, Generator):
        assert isinstance(output, Proposal)
        assert HighwaySimulator().check_action(output.action)
        return
    check_output(output, required_output(role))
    if isinstance(role, RecoveryPlanner):
        assert HighwaySimulator().check_action(output.action)
        return
    told = getattr(output, "values", None) or {"score": getattr(output, "score", 0.0)}
    assert all(math.isfinite(value) for value in told.values()), told


@pytest.mark.parametrize("name", PATHS)
@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    seen=st.lists(st.tuples(percepts(), st.none() | commands), min_size=1, max_size=4),
)
def test_every_role_answers_to_any_finite_numbers(name: str, seen: Any) -> None:
    role, views = RoleSpec(PATHS[name]).create(), Views()
    with answering(lambda *_: said("yield")):  # for the one that asks a language model
        role.reset(RoleContext(1, 0.1, {}, ()))
        for percept, action in seen:
            if isinstance(role, Generator):
                usable(role, role.propose(views.generator(percept)))
            else:
                usable(role, role.run(views.role(percept, action)))


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.lists(percepts(), min_size=1, max_size=4))
def test_signals_of_any_finite_numbers_are_finite_and_within_their_caps(seen: Any) -> None:
    way = route(0, "straight")
    seen = [Percept({**one, "map": one["map"]._replace(route=way)}) for one in seen]
    columns = percept_signals(seen)
    for name, column in columns.items():
        assert np.isfinite(column).all(), name
        at_once = [percept_at(percept)[name] for percept in seen]
        assert column.tolist() == pytest.approx(at_once, rel=1e-6, abs=1e-6)
