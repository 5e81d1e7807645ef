"""The injector: when a fault is in the percept, and what it leaves alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from roads import car, channels_of

from pytest_dura.core import Percept, RoleContext, SecurityAssessment, StateManager, Tick, stream
from pytest_dura.driving import BodyList
from pytest_dura.faults import CampaignInjector, parse_fault

DT = 0.1


def fault(name: str = "ghost-obstacle", **fields: Any) -> dict[str, Any]:
    activation = {key: fields.pop(key) for key in ("at", "every", "by") if key in fields}
    return parse_fault({"type": name, "activation": activation, "duration": 0.3, **fields})


class Run:
    """An injector run tick by tick over the same channels."""

    def __init__(self, *faults: Mapping[str, Any], seed: int = 3) -> None:
        self.injector = CampaignInjector()
        self.injector.reset(RoleContext(seed, DT, {}, faults))
        self.state = StateManager(DT)
        self.tampered: list[tuple[str, ...]] = []
        self.lidar: list[BodyList] = []
        self.activated: list[tuple[int, str]] = []
        self.ended: list[tuple[int, str]] = []

    def tick(self, *directives: str, bodies: Any = ()) -> None:
        index = len(self.state.ticks)
        time = index * DT
        raw = channels_of(*bodies, s=50.0 + 0.5 * index)
        channels, tampered = self.injector.corrupt(raw, time)
        assert set(channels) == set(raw)
        for name, value in channels.items():
            assert (value is raw[name]) == (name not in tampered), "the rest is left alone"
        self.state.update(Tick(index, time, {}, raw), Percept(channels, tampered))
        self.tampered.append(tampered.get("lidar", ()))
        self.lidar.append(channels["lidar"])
        self.state.outputs["security_assessor"] = SecurityAssessment(directives=directives)
        output = self.injector.run(self.state.role_view())
        self.activated += [(index, name) for name in output.activated]
        self.ended += [(index, name) for name in output.deactivated]

    def ticks(self, count: int, bodies: Any = ()) -> Run:
        for _ in range(count):
            self.tick(bodies=bodies)
        return self

    def when(self, name: str) -> list[int]:
        return [index for index, names in enumerate(self.tampered) if name in names]


@pytest.mark.parametrize("at", [0.0, 0.1, 0.5, 2.0])
def test_at_is_the_first_tampered_tick_and_duration_is_exact(at: float) -> None:
    run = Run(fault(at=at)).ticks(40)
    first = round(at / DT)
    assert run.when("ghost-obstacle") == [first, first + 1, first + 2]
    assert run.activated == [(first, "ghost-obstacle")]
    assert run.ended == [(first + 3, "ghost-obstacle")], "the first tick without it"


def test_a_permanent_fault_stays() -> None:
    run = Run(fault(at=0.5, duration=None)).ticks(60)
    assert run.when("ghost-obstacle") == list(range(5, 60))
    assert run.ended == []


def test_a_periodic_fault_comes_again_and_begins_anew() -> None:
    run = Run(fault(at=0.5, every=1.0)).ticks(30)
    assert run.when("ghost-obstacle") == [5, 6, 7, 15, 16, 17, 25, 26, 27]
    assert [index for index, _ in run.activated] == [5, 15, 25]
    assert [index for index, _ in run.ended] == [8, 18, 28]
    places = [run.lidar[index][0].y for index in (5, 7, 15, 25)]
    assert places[0] == places[1], "it stands still while it lasts"
    assert places[0] - places[2] == pytest.approx(5.0), "and is ahead of the ego anew"
    assert places[2] - places[3] == pytest.approx(5.0)


def test_a_period_as_long_as_the_duration_leaves_no_gap_and_no_end() -> None:
    run = Run(fault(at=0.5, every=0.3)).ticks(20)
    assert run.when("ghost-obstacle") == list(range(5, 20))
    assert [index for index, _ in run.activated] == [5, 8, 11, 14, 17]
    assert run.ended == []


def test_an_activation_while_it_is_active_changes_nothing() -> None:
    run = Run(fault(at=0.5, every=0.2)).ticks(10)
    assert [index for index, _ in run.activated] == [5, 9]
    assert run.when("ghost-obstacle") == [5, 6, 7, 9]
    assert run.ended == [(8, "ghost-obstacle")]


def test_a_directed_fault_waits_for_the_directive_and_not_for_its_time() -> None:
    run = Run(fault(at=0.2, by="security_assessor"))
    run.ticks(10)
    assert run.activated == []
    run.tick("ghost-obstacle")
    run.ticks(6)
    assert run.activated == [(11, "ghost-obstacle")], "at the next percept"
    assert run.when("ghost-obstacle") == [11, 12, 13]


def test_an_unknown_directive_is_an_error_that_names_what_there_is() -> None:
    run = Run(fault(at=5.0))
    with pytest.raises(ValueError, match=r"directs 'nobody'.*there are: ghost-obstacle"):
        run.tick("ghost-obstacle", "nobody")


def test_where_nothing_is_planned_a_directive_has_no_effect() -> None:
    run = Run()  # the arm without faults of an assessor that does not know the plan
    run.tick("ghost-obstacle")
    assert run.ticks(5).activated == []


def test_without_faults_nothing_is_touched() -> None:
    injector = CampaignInjector()
    injector.reset(RoleContext(1, DT))
    raw = channels_of(car("V1", 0.0, 0.0))
    channels, tampered = injector.corrupt(raw, 0.0)
    assert channels is raw
    assert not tampered


def test_reset_forgets_the_episode_before() -> None:
    one = Run(fault(at=0.5, duration=None)).ticks(10)
    again = Run(fault(at=0.5, duration=None))
    again.injector = one.injector
    again.injector.reset(RoleContext(3, DT, {}, (fault(at=0.5, duration=None),)))
    assert again.ticks(10).tampered == one.tampered


def test_the_ghost_stands_on_the_route_ahead_of_the_front_bumper() -> None:
    run = Run(fault(at=0.5, parameters={"ahead": 10.0, "length": 4.0, "width": 1.5})).ticks(8)
    (ghost,) = run.lidar[5]
    front = 111.0 - (50.0 + 2.5) - 2.5
    assert (ghost.x, ghost.y) == pytest.approx((2.0, front - 10.0 - 2.0))
    assert (ghost.length, ghost.width, ghost.vx, ghost.vy) == (4.0, 1.5, 0.0, 0.0)
    assert ghost.id.startswith("V9"), "it looks like any other id"


def test_another_fault_does_not_change_the_first_one_s_draws() -> None:
    alone = Run(fault(at=0.5, id="a")).ticks(10)
    second = fault(at=0.2, id="b", duration=2.0, parameters={"ahead": 30.0})
    both = Run(second, fault(at=0.5, id="a")).ticks(10)
    drawn = int(stream(3, "fault:tick:5:a").integers(100))
    assert alone.lidar[5].ids[0] == f"V{900 + drawn}"
    assert alone.lidar[5].ids[0] in both.lidar[5].ids
    assert alone.lidar[5][0] == both.lidar[5].get(alone.lidar[5].ids[0])
    assert both.tampered[5] == ("b", "a"), "in declared order"
    assert Run(fault(at=0.5, id="a"), seed=4).ticks(10).lidar[5].ids != alone.lidar[5].ids


REAL = (car("V1", -30.0, 2.0, 0.0, 8.0), car("V2", 40.0, -2.0, np.pi, 8.0))


def spoofed(**parameters: Any) -> Run:
    data = fault("trajectory-spoof", at=0.5, duration=3.0, parameters=parameters)
    return Run(data).ticks(60, bodies=REAL)


def test_a_spoof_moves_the_nearest_car_and_nobody_else() -> None:
    run = spoofed()
    assert run.when("trajectory-spoof") == list(range(5, 35))
    for index in range(60):
        false, other = run.lidar[index].get("V1"), run.lidar[index].get("V2")
        assert other == REAL[1]
        assert (false == REAL[0]) == (index not in range(5, 35))


def test_a_spoofed_car_begins_where_it_is_and_ends_on_the_route_ahead_of_the_ego() -> None:
    run = spoofed(lead=2.0, duration=2.0)
    first = run.lidar[5].get("V1")
    assert first is not None
    assert (first.x, first.y) == (REAL[0].x, REAL[0].y)
    # Ego front at 55 m along the route and 8 m/s: 2 s ahead are 16 m.
    meet = 111.0 - (52.5 + 5.0 + 16.0)
    for index in (25, 30):
        arrived = run.lidar[index].get("V1")
        assert arrived is not None
        assert (arrived.x, arrived.y) == pytest.approx((2.0, meet))
        assert arrived.vx == arrived.vy == 0.0
    halfway = run.lidar[15].get("V1")
    assert halfway is not None
    assert halfway.x == pytest.approx((REAL[0].x + 2.0) / 2)
    assert np.arctan2(halfway.vy, halfway.vx) == pytest.approx(halfway.heading)


def test_a_spoof_of_magnitude_zero_is_the_identity() -> None:
    run = spoofed(magnitude=0.0)
    assert run.activated == [(5, "trajectory-spoof")]
    assert run.when("trajectory-spoof") == []
    assert all(found == BodyList.of(REAL) for found in run.lidar)


def test_a_spoof_of_half_the_magnitude_goes_half_the_way() -> None:
    full, half = spoofed().lidar[20].get("V1"), spoofed(magnitude=0.5).lidar[20].get("V1")
    assert full is not None
    assert half is not None
    for name in ("x", "y", "vx", "vy"):
        real = getattr(REAL[0], name)
        assert getattr(half, name) == pytest.approx((real + getattr(full, name)) / 2)


def test_a_heading_turns_the_shorter_way() -> None:
    # From 175 to about -153 degrees: halfway lies beyond 180, not at 11.
    heading = np.radians(175.0)
    body = car("V1", 40.0, 60.0, heading, 8.0)
    data = fault("trajectory-spoof", at=0.1, duration=3.0, parameters={"magnitude": 0.5})
    run = Run(data).ticks(3, bodies=(body,))
    found = run.lidar[1].get("V1")
    assert found is not None
    turned = abs(np.remainder(found.heading - heading + np.pi, 2 * np.pi) - np.pi)
    assert 0.0 < turned < np.pi / 4


def test_a_spoof_waits_until_there_is_a_car() -> None:
    data = fault("trajectory-spoof", at=0.2, duration=3.0)
    run = Run(data)
    run.ticks(10)
    assert run.when("trajectory-spoof") == []
    run.ticks(5, bodies=REAL)
    assert run.when("trajectory-spoof") == list(range(10, 15))


def test_a_spoof_whose_victim_is_out_of_sight_changes_nothing() -> None:
    data = fault("trajectory-spoof", at=0.2, duration=3.0)
    run = Run(data)
    run.ticks(5, bodies=REAL)
    run.ticks(3, bodies=REAL[1:])
    assert run.when("trajectory-spoof") == [2, 3, 4]
