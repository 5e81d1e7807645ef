"""Requirements on the assessor that learned, run by run."""

from __future__ import annotations

import pytest

from pytest_dura import JudgedEpisode

ATTACKS = ["ghost-obstacle", "trajectory-spoof", "gnss-drag-off"]


@pytest.mark.dura(scenario="intersection/congested", faults=ATTACKS, runs=3)
@pytest.mark.requirement("DET-1", text="Alerts within 5 s of an attack", kind="security")
def test_alerts_in_time(episode: JudgedEpisode) -> None:
    (attack,) = episode.faults
    assert attack.detection_latency is not None
    assert attack.detection_latency <= 5.0


@pytest.mark.dura(scenario="intersection/congested", faults=["none"], runs=3)
@pytest.mark.requirement("DET-2", text="Raises no alert without an attack", kind="security")
def test_raises_no_false_alarm(episode: JudgedEpisode) -> None:
    assert not any(event.kind == "alert" for event in episode.events)
