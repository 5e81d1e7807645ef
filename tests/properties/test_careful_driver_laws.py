"""Laws of the careful driver, the reference of UN R157."""

from __future__ import annotations

from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st
from roads import Views, begin, car

from pytest_dura import RoleContext, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.driving import BodyList
from pytest_dura.driving.sensors import radar_returns

laws = settings(derandomize=True, deadline=None, max_examples=12)

CAREFUL = RoleSpec(DOMAINS["driving"].short_names["generator"]["careful_driver"])
G = 9.81
FRONT_TO_CENTRE = 2.5
TICK, BUILD_UP = 0.1, 0.2
"""s until a tick is over, and until the brake is built up."""


def least_gap(speed: float, room: float) -> tuple[float, list[float]]:
    """Drive on a straight road towards a car that stands and comes into view at ``room`` metres.

    Returns the room that is left in the end, and the accelerations asked for, the first of them the
    last one before it is in view.
    """
    simulator, ticks = begin({"ego": {"distance": 95.0, "speed": speed}})
    driver, views = CAREFUL.create(), Views()
    driver.reset(RoleContext(1, 0.1))
    start = ticks[0].truth["ego"].s
    at = start + 20.0 + FRONT_TO_CENTRE + room
    wall = car("WALL", *simulator._route.point(at + FRONT_TO_CENTRE)[:2], -1.5707963267948966)
    left, asked, before = room, list[float](), 0.0
    for _ in range(80):
        ego = ticks[-1].truth["ego"]
        left = at - ego.s - FRONT_TO_CENTRE
        seen = BodyList.of([wall] if left <= room else [])
        percept: dict[str, Any] = {
            **ticks[-1].channels, "lidar": seen, "radar": radar_returns(ego, seen)
        }  # fmt: skip
        command = driver.propose(views.generator(percept)).action
        if left <= room:
            asked.append(command.acceleration)
        else:
            before = command.acceleration
            command = "proceed"
            views.state.proposal = None
        if left <= 0.0 or (asked and ego.speed < 0.05):
            break
        held = {"maneuver": "proceed", "acceleration": 0.0} if command == "proceed" else command
        ticks.append(simulator.step(simulator.check_action(held)))
    return left, [before, *asked]


@laws
@given(st.floats(4.0, 10.0), st.floats(0.0, 20.0))
@example(10.0, 0.0)  # where 0.1 g less shows most
def test_who_needs_less_than_0_774_g_after_0_75_s_is_never_hit(speed: float, more: float) -> None:
    needed = speed * (0.75 + TICK + BUILD_UP) + speed**2 / (2 * 0.774 * G)
    left, _ = least_gap(speed, needed + 0.1 + more)
    assert left > 0.0


@laws
@given(st.floats(6.0, 10.0), st.floats(0.3, 0.95))
def test_nobody_brakes_before_the_reaction_is_over_nor_harder_than_0_774_g(
    speed: float, part: float
) -> None:
    """So near that comfortable braking does not do."""
    room = part * (speed * 0.75 + speed**2 / (2 * 0.774 * G))
    left, asked = least_gap(speed, room)
    assert left <= 0.0
    assert min(asked[1:9]) >= min(asked[0], 0.0)
    assert min(asked) >= -0.774 * G - 1e-9
