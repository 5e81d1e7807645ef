"""Requirements of the balancer as tests, and whether the suite's own parts keep their contracts."""

from __future__ import annotations

from dataclasses import replace

import cartpole_parts as parts
import numpy as np
import pytest

from pytest_dura import (
    Fault,
    GeneratorView,
    Orchestrator,
    RoleContext,
    RoleSpec,
    check_role,
    check_simulator,
)

GLITCH = Fault("bias", "stuck", "pole", {"at": 1.0}, 0.06)
OUTAGE = replace(GLITCH, duration=0.5)
STUBBORN = {"generator": RoleSpec("cartpole_parts:Stubborn")}


@pytest.mark.parametrize("seed", range(5))
def test_the_pole_stays_up(run, seed):
    episode = run(seed)
    assert episode.validity == "valid"
    assert episode.termination == "time"
    assert episode.ticks == 251
    assert episode.signal("upright").min() > 0.05
    assert episode.signal("room").min() > 1.0


@pytest.mark.parametrize("seed", range(3))
def test_it_survives_a_short_glitch_of_the_angle_sensor(run, seed):
    episode = run(seed, faults=(GLITCH,))
    assert episode.validity == "valid"
    assert episode.faults[0].manifest_ticks == 3
    assert episode.termination == "time"


def test_it_does_not_survive_an_outage_of_half_a_second(run):
    episode = run(faults=(OUTAGE,))
    assert episode.validity == "valid"
    assert episode.termination == "critical"
    assert 1.0 < episode.time[-1] < 1.5


def test_a_stubborn_component_falls_without_recovery_and_is_caught_with_it(run):
    alone = run(roles=STUBBORN, policy="log_only")
    assert alone.termination == "critical"
    assert alone.events[-1].detail == "the environment has terminated"
    assert alone.flagged
    helped = run(roles=STUBBORN)
    assert helped.time[-1] > 2.0 * alone.time[-1]
    assert helped.metrics.recoveries
    assert helped.metrics.violations["safety_monitor"] > 0


def test_our_own_role_runs_at_its_own_trigger_after_the_monitor(spec):
    loop = Orchestrator.build(spec)
    names = [name for name, *_ in loop.assessors]
    assert names.index("drift_watch") > names.index("safety_monitor")
    seen = []
    watch = loop.roles["drift_watch"]
    work = watch.run
    watch.run = lambda view: seen.append((view.index, work(view))) or seen[-1][1]
    loop.run(spec)
    assert [index for index, _ in seen] == [0, 50, 100, 150, 200]
    assert all(set(output) == {"drift", "margin"} for _, output in seen)


def test_the_component_sees_sensors_and_no_truth(run):
    assert not hasattr(GeneratorView, "truth")
    episode = run()
    assert set(episode.signals) == {
        "position", "angle", "upright", "room", "percept.position", "percept.speed",
    }  # fmt: skip


def test_the_same_seed_is_the_same_episode(run):
    assert run(3).digest == run(3).digest
    assert run(3).digest != run(4).digest


def test_another_time_step_is_simulated_as_such(run):
    fine, coarse = run(time_step=0.01), run()
    assert (fine.ticks, coarse.ticks) == (501, 251)
    assert fine.time[-1] == pytest.approx(coarse.time[-1])


def test_the_player_shows_the_pole_as_it_is_and_as_it_is_perceived(spec):
    spec = replace(spec, faults=(GLITCH,))
    episode = Orchestrator.build(spec, recorded=True).run(spec)
    shown = episode.recording.scene
    differ = (shown.truth.poses[:, 1] != shown.percept.poses[:, 1]).any(axis=1)
    assert np.flatnonzero(differ).tolist() == [50, 51, 52]


def test_the_adapter_keeps_the_contract_of_a_simulator(spec):
    report = check_simulator(spec.simulator, spec.scenario, [0, 1, 1, 0, 1, 0, 0, 1] * 2)
    assert report.not_supported == ("lazy channels", "render")


@pytest.mark.parametrize(
    "role",
    [parts.Balancer, parts.Stubborn, parts.AngleMonitor, parts.StuckSensor, parts.CatchThePole],
)
def test_the_roles_keep_their_contracts(role, spec):
    context = RoleContext(0, 0.02, spec.scenario, (replace(GLITCH, activation={"at": 0.1}),))
    check_role(role, simulator=spec.simulator, scenario=spec.scenario, context=context)
