"""Laws of recovery planners for driving: what is asked of them is what decides."""

from __future__ import annotations

import math

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from roads import Views, car, channels_of

from pytest_dura import Recovery, RoleContext, RoleSpec
from pytest_dura.domains import DOMAINS

laws = settings(derandomize=True, deadline=None, max_examples=60)

SAFE_STOP = RoleSpec(DOMAINS["driving"].short_names["recovery_planner"]["safe_stop"])
RADIUS = math.hypot(5.0 / 6, 2.0 / 2)
"""m; three discs of this radius stand for a car of 5 m by 2 m in predictions."""
EGO_X, JUNCTION_Y = 2.0, 111.0
"""The ego comes from the south on x = 2, and has y = 111 - s."""
COMFORTABLE = -3.0
"""m/s2"""
sides = st.sampled_from([-1.0, 1.0])
widths = st.floats(3.3, 7.0)
separations = st.floats(0.0, 5.0)


def beside_a_parked_car(
    separation: float, aside: float, *, ego: float, parked: float, speed: float
) -> Recovery:
    """What a SafeStop does that is to keep so far from a car that stands beside the way."""
    other = car("V1", EGO_X + aside, JUNCTION_Y - parked, -math.pi / 2)
    planner = SAFE_STOP.with_params({"separation": separation}).create()
    planner.reset(RoleContext(1, 0.1))
    return planner.run(Views().role(channels_of(other, s=ego, speed=speed), "proceed"))


@laws
@given(separations, widths, sides)
def test_a_safe_stop_takes_a_way_out_that_is_as_wide_as_asked_and_no_other(
    separation: float, width: float, side: float
) -> None:
    free = width - 2 * RADIUS
    assume(abs(free - separation) > 0.2)  # the prediction looks at some instants only
    found = beside_a_parked_car(separation, side * width, ego=108.0, parked=113.0, speed=4.0)
    assert found.name == ("clear_zone" if free > separation else "safe_stop")


@laws
@given(separations, widths, sides)
def test_a_safe_stop_is_gentle_where_it_passes_as_far_away_as_asked_and_harder_elsewhere(
    separation: float, width: float, side: float
) -> None:
    """It would come to stand beside the car, after 10.7 m."""
    free = width - 2 * RADIUS
    assume(abs(free - separation) > 0.2)
    found = beside_a_parked_car(separation, side * width, ego=50.0, parked=60.0, speed=8.0)
    assert found.name == "safe_stop"
    assert (found.action.acceleration == COMFORTABLE) == (free > separation)
    assert found.action.acceleration <= COMFORTABLE
