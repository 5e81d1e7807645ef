"""Which signals of an episode are known as it goes on, and which with hindsight alone."""

from __future__ import annotations

from pytest_dura import Orchestrator, RoleSpec
from pytest_dura.domains import DOMAINS
from pytest_dura.driving.signals import HINDSIGHT, NAMES
from pytest_dura.library import expand_cases, load_library


def test_the_signals_that_later_ticks_change_are_those_that_say_so() -> None:
    (case,) = expand_cases(load_library([]).scenarios, select=["intersection/congested"])
    # One that enters where others have priority, so that they have to brake.
    reckless = RoleSpec(DOMAINS["driving"].short_names["generator"]["aggressive"])
    changed = set()
    for run in (0, 1):
        spec = case.spec(run, 0, {"generator": reckless, "recovery_planner": None})
        loop = Orchestrator.build(spec)
        loop.run(spec)
        ticks = loop.state.ticks
        whole = loop.simulator.signals(ticks)
        for size in range(1, len(ticks), 4):
            early = loop.simulator.signals(ticks[:size])
            changed |= {name for name in NAMES if (early[name] != whole[name][:size]).any()}
    assert changed == HINDSIGHT == loop.simulator.hindsight
