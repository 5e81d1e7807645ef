"""A run in which recovery was not asked is its own twin without recovery, and no other run is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from campaign_rooms import BIAS, CountedRoom, rooms
from hypothesis import given, settings
from hypothesis import strategies as st
from thermostat import Controller

from pytest_dura import JudgedEpisode, RoleSpec, Runner
from pytest_dura.execution import EpisodeStore
from pytest_dura.library import Case

laws = settings(derandomize=True, deadline=None, max_examples=40)
ROLE = "recovery_planner"


class Moody(Controller):
    """Declares that it may act otherwise the next time."""

    repeatable = False


def heated(
    folder: Path, policy: str = "recover", limit: float = 99.0, **options: Any
) -> tuple[Runner, Case]:
    """A room whose heater stays on, and a monitor that refuses this above a limit in °C."""
    monitor = RoleSpec("thermostat:HeatMonitor", {"limit": limit})
    options["roles"] = {"safety_monitor": monitor, **options.get("roles", {})}
    options = {"generator": "thermostat:Overheater", "duration": 0.5} | options
    runner = rooms(folder, more=f"policy: {policy}", **options)
    return runner, runner.case("room/it")


def pair(runner: Runner, case: Case) -> tuple[JudgedEpisode, JudgedEpisode, int]:
    """A run, its twin without recovery, and how often their seed was simulated."""
    first, twin = runner.fetch(case), runner.fetch(case.switched_off(ROLE))
    return first, twin, CountedRoom.seeds.count(first.spec.seed)


@laws
@given(
    st.floats(10.0, 26.0),
    st.sampled_from(["recover", "refine(2)", "log_only", "halt"]),
    st.sampled_from(["[]", BIAS]),
)
def test_a_twin_that_was_not_simulated_is_what_a_simulation_gives(
    tmp_path_factory: pytest.TempPathFactory, limit: float, policy: str, faults: str
) -> None:
    runner, case = heated(tmp_path_factory.mktemp("room"), policy, limit, faults=faults)
    first, twin, simulations = pair(runner, case)
    assert simulations == (2 if first.flagged else 1)
    assert twin.digest == runner.task(case.switched_off(ROLE)).run().digest
    assert twin.digest != first.digest


@pytest.mark.parametrize("limit, simulations", [(99.0, 1), (5.0, 2)])
def test_a_refused_proposal_makes_a_simulation(
    tmp_path: Path, limit: float, simulations: int
) -> None:
    first, twin, count = pair(*heated(tmp_path, limit=limit))
    assert count == simulations
    assert first.flagged == (first.trajectory != twin.trajectory) == (simulations == 2)


@pytest.mark.parametrize(
    "options",
    [
        {"store": EpisodeStore(repeatable=False)},
        {"roles": {"generator": RoleSpec.of(Moody)}},
        {"roles": {"generator": RoleSpec.of(Controller())}},
        {"metrics": {"roles": lambda episode: float(len(episode.spec.roles))}},
        {"clock": "wall"},
    ],
    ids=["session", "component", "instance", "metric", "clock"],
)
def test_what_may_differ_between_equal_runs_is_simulated(
    tmp_path: Path, options: dict[str, Any]
) -> None:
    *_, simulations = pair(*heated(tmp_path, **options))
    assert simulations == 2


def test_a_run_without_recovery_is_simulated_where_the_other_is_not_known(tmp_path: Path) -> None:
    runner, case = heated(tmp_path)
    twin = runner.fetch(case.switched_off(ROLE))
    assert CountedRoom.seeds == [twin.spec.seed]
