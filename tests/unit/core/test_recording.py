"""What an episode keeps for a viewer: what was said at each decision, and the scene."""

from __future__ import annotations

import numpy as np
import pytest
from loops import doing, run_loop
from thermostat import Thermostat

from pytest_dura import Assessed, Assessment, Proposal, Recovery, RecoveryPlanner, SafetyMonitor
from pytest_dura.core import Scene, Tracks


def heats(view):
    return Proposal(1.0, f"cold at {view.index}")


def doubts(view):
    """Safe, then a warning, then unsafe; a critical finding counts as unsafe, too."""
    words = [Assessed.SAFE, Assessed.WARNING, Assessed.UNSAFE, Assessed.SAFE]
    word = words[min(view.index, 3)]
    return Assessment(
        word, -1.0 if view.index == 2 else 1.0, (f"said at {view.index}",) if word else (),
        critical=view.index == 4,
    )  # fmt: skip


def run(*, recorded=True, simulator=None, **roles):
    return run_loop(heats, recorded=recorded, simulator=simulator, seconds=0.6, **roles)


def test_each_decision_has_its_explanation_reasons_flags_and_recovery():
    class Sometimes(SafetyMonitor):
        def trigger(self, view):
            return view.index % 2 == 0

        def run(self, view):
            return Assessment(Assessed.SAFE, 1.0)

    episode = run(
        safety_monitor=doing(SafetyMonitor, doubts),
        sometimes=Sometimes(),
        recovery_planner=doing(RecoveryPlanner, lambda _: Recovery(0.0, "off", "too warm")),
    )
    said = episode.recording
    decisions = len(episode.decisions["verdict"])
    assert decisions == episode.ticks - 1 == 6
    assert said.explanations == tuple(f"cold at {i}" for i in range(6))
    assert said.flags["safety_monitor"].tolist() == [0, 1, 2, 0, 2, 0]
    assert said.flags["sometimes"].tolist() == [0, -1, 0, -1, 0, -1]
    assert said.reasons[:3] == ("", "safety_monitor: said at 1", "safety_monitor: said at 2")
    assert said.recoveries == ("", "", "off: too warm", "", "off: too warm", "")
    assert (episode.decisions["source"] == "recovery").tolist() == [
        bool(r) for r in said.recoveries
    ]


def test_an_explanation_belongs_to_a_proposal_that_was_valid():
    episode = run_loop(
        lambda view: None if view.index == 1 else heats(view), recorded=True, seconds=0.3
    )
    assert episode.recording.explanations == ("cold at 0", "", "cold at 2")


def test_nothing_is_kept_unless_it_was_asked_for_and_the_digest_does_not_know():
    with_it, without = run(), run(recorded=False)
    assert without.recording is None
    assert with_it.recording is not None
    assert with_it.digest == without.digest


def test_a_simulator_without_a_scene_has_none():
    said = run().recording
    assert (said.scene, said.problem) == (None, None)


class Shown(Thermostat):
    def scene(self, ticks, percepts):
        assert len(ticks) == len(percepts)
        poses = np.zeros((len(ticks), 1, 6), np.float32)
        return Scene((), Tracks(("room",), poses), Tracks((), poses[:, :0]), "room")


class Blind(Thermostat):
    def scene(self, ticks, percepts):
        raise RuntimeError("no view from here")


def test_the_scene_is_that_of_all_ticks():
    episode = run(simulator=Shown())
    assert episode.recording.scene.truth.poses.shape == (episode.ticks, 1, 6)


def test_a_scene_that_fails_is_told_and_costs_no_episode():
    episode = run(simulator=Blind())
    assert episode.recording.scene is None
    assert "no view from here" in episode.recording.problem
    assert (episode.validity, episode.failure) == ("valid", None)


class Double(Thermostat):
    """Shows float64, NumPy's own default."""

    def scene(self, ticks, percepts):
        poses = np.zeros((len(ticks), 1, 6))
        return Scene((), Tracks(("room",), poses), Tracks(("room",), poses), "room")


def test_a_scene_that_no_trace_could_hold_is_told_and_not_kept():
    episode = run(simulator=Double())
    assert episode.recording.scene is None
    assert "truth.poses is float64 of shape" in episode.recording.problem
    assert (episode.validity, episode.failure) == ("valid", None)


@pytest.mark.parametrize("at", [0, 3])
def test_an_episode_that_fails_keeps_what_was_said_before(at):
    def breaks(view):
        if view.index == at:
            raise RuntimeError("boom")
        return Assessment(Assessed.SAFE, 1.0)

    episode = run(safety_monitor=doing(SafetyMonitor, breaks), simulator=Shown())
    assert episode.validity == "missing"
    said = episode.recording
    assert said.explanations == tuple(f"cold at {i}" for i in range(at))
    assert len(episode.decisions["verdict"]) == at
    assert all(len(column) == at for column in said.flags.values())


class Verbose(Thermostat):
    """Describes one action with a megabyte, whose last letter tells it from another."""

    def describe_action(self, action):
        return "x" * 2**20 + ("a" if action > 0.5 else "b")


def test_what_describes_an_action_is_bounded_since_its_column_has_room_for_it_at_every_tick():
    def both(view):
        return Proposal(float(view.index % 2))

    found = run_loop(both, simulator=Verbose(), seconds=0.6).decisions["executed"]
    assert found.dtype.itemsize <= 4 * 1000
    assert len(set(found.tolist())) == 2
    assert "(1048577 characters, #" in found[0]
