"""What a script does without pytest: run, judge, the margin over time, plot."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from thermostat import Controller, Thermostat

from pytest_dura import ConfigurationError, Requirement, Runner, plot_episode
from pytest_dura.search import falsify_case

BIAS = {"type": "bias", "target": "thermometer", "activation": {"at": 0.0}}
SCENARIO = """
name: room/warm
simulator: thermostat:Thermostat
duration: 1.0
world: {start: 15.0}
roles: {generator: "thermostat:Controller"}
requirements: [WARM-1]
"""
REQUIREMENT = """
requirements:
  - {id: WARM-1, text: It is warm., kind: safety, check: always (temperature > 15.1)}
  - {id: TEST-1, text: A test decides it., kind: safety}
"""


@pytest.fixture
def runner(tmp_path: Path) -> Runner:
    (tmp_path / "room.yaml").write_text(SCENARIO)
    (tmp_path / "requirements.yaml").write_text(REQUIREMENT)
    return Runner.of(tmp_path, generator=Controller)


def test_a_requirement_is_named_by_its_id_by_itself_or_by_its_formula(runner) -> None:
    episode = runner.run("room/warm")
    by_id = runner.judge(episode, "WARM-1")
    assert (by_id.verdict, by_id.requirement, by_id.time) == ("violated", "WARM-1", 0.0)
    assert runner.judge(episode, runner.requirement("WARM-1")) == by_id
    by_formula = runner.judge(episode, "always (temperature > 15.1)")
    assert (by_formula.verdict, by_formula.margin) == ("violated", by_id.margin)


def test_what_is_unknown_is_refused_with_what_there_is(runner) -> None:
    episode = runner.run("room/warm")
    with pytest.raises(ConfigurationError, match="did you mean 'WARM-1'"):
        runner.judge(episode, "WARN-1")
    with pytest.raises(ConfigurationError, match="temperature"):
        episode.margins("always (temprature > 15)")
    with pytest.raises(ConfigurationError, match="'TEST-1' has no check"):
        plot_episode(episode, runner.requirement("TEST-1"))


def test_the_least_margin_over_time_is_the_margin(runner) -> None:
    episode = runner.run("room/warm")
    margins = episode.margins("always (temperature > 15.1)")
    assert margins == pytest.approx(episode.signal("temperature") - 15.1)
    assert margins.min() == runner.judge(episode, "WARM-1").margin
    # What is within is not left out: each tick has the margin from there on.
    later = episode.margins("eventually (temperature > 15.1)")
    assert later[0] == pytest.approx(margins.max())
    assert np.all(np.diff(later) <= 0)


def test_the_plot_shows_the_margin_above_the_signals_and_where_it_is_violated(
    runner, tmp_path
) -> None:
    episode, file = runner.run("room/warm"), tmp_path / "warm.svg"
    picture = plot_episode(episode, runner.requirement("WARM-1"), file)
    assert file.read_text("utf-8") == picture == picture._repr_svg_()
    texts = [element.text for element in ET.fromstring(picture).iter() if element.text]
    assert "room/warm#0 WARM-1 violated" in texts
    assert "margin of temperature > 15.1" in texts
    assert any(text.startswith("temperature") for text in texts)
    assert "WARM-1 violated at 0.00 s" in texts
    assert plot_episode(episode, "always (temperature > 15.1)") != picture  # it has no id


def test_parts_are_given_as_classes_or_paths(tmp_path) -> None:
    (tmp_path / "room.yaml").write_text(SCENARIO.replace("[WARM-1]", "[]"))
    by_class = Runner.of(tmp_path, generator=Controller, simulator=Thermostat).run("room/warm")
    by_path = Runner.of(tmp_path, generator="thermostat:Controller").run("room/warm")
    assert by_class.digest == by_path.digest
    off = Runner.of(tmp_path, roles={"safety_monitor": None})
    assert off.roles == {"safety_monitor": None}
    with pytest.raises(ConfigurationError, match="not a Generator"):
        Runner.of(tmp_path, generator=Thermostat)
    with pytest.raises(TypeError, match="base_sed"):
        Runner.of(tmp_path, base_sed=1)


@pytest.mark.of_guest
def test_a_part_is_given_by_a_short_name_of_a_domain() -> None:
    assert Runner.of(generator="aggressive").roles["generator"].label == "Aggressive"


def test_a_script_searches_where_it_says_by_what(runner, tmp_path) -> None:
    check = "always (temperature > 14)"
    with pytest.raises(ConfigurationError, match="made without a search") as refused:
        runner.campaign("room/warm").falsify(check)
    assert "Runner.of(..., falsifier=" in str(refused.value)
    searching = Runner.of(tmp_path, falsifier=falsify_case)
    found = searching.campaign("room/warm").falsify(check, faults=[BIAS], budget=3)
    assert (found.simulations, found.outcomes[0].status) == (3, "nothing found")


def test_a_requirement_of_a_script_needs_no_file(runner) -> None:
    own = Requirement("OWN-1", check="always (temperature < 15.2)")
    assert runner.judge(runner.run("room/warm"), own).requirement == "OWN-1"


@pytest.mark.parametrize("run", [-1, 1.5, True, "1"])
def test_runs_are_counted_from_0(runner, run) -> None:
    with pytest.raises(ConfigurationError, match="runs are counted from 0"):
        runner.run("room/warm", run=run)


@pytest.mark.parametrize("name", ["warm.png", "none/warm.svg", "warm", ""])
def test_a_picture_that_cannot_be_written_is_refused(runner, name, tmp_path) -> None:
    episode = runner.run("room/warm")
    with pytest.raises(ConfigurationError, match="the picture cannot be written"):
        plot_episode(episode, "always (temperature > 15)", tmp_path / name)
    assert not (tmp_path / "warm.png").exists()
