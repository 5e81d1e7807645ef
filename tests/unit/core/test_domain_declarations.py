"""What a domain declares, and what of it is refused."""

from __future__ import annotations

import pytest

from pytest_dura import (
    DOMAINS,
    Action,
    Channel,
    ConfigurationError,
    Domain,
    Signal,
    Simulator,
)
from pytest_dura.library.domain_reference import declared

LEVEL = Signal("level", "m", "above the bottom")


@pytest.mark.parametrize("kind", [Signal, Action])
@pytest.mark.parametrize("unit", ["", " ", None, 3])
def test_what_has_no_unit_is_refused_by_name(kind, unit) -> None:
    with pytest.raises(ConfigurationError, match="'level' has no unit") as caught:
        kind("level", unit)
    assert caught.value.key == "unit"
    assert f"{kind.__name__}('level', unit=..., meaning=...)" in str(caught.value.remedy)


@pytest.mark.parametrize("name", ["", "two words", "a.b", 3])
def test_a_name_that_no_formula_could_read_is_refused(name) -> None:
    with pytest.raises(ConfigurationError, match="a name that nothing can read"):
        Signal(name, "m")


@pytest.mark.parametrize("key", ["signals", "percept_signals", "proposal_signals"])
def test_a_signal_that_is_a_name_alone_is_refused(key) -> None:
    with pytest.raises(ConfigurationError, match="signal 'level' of the domain 'w' has no unit"):
        Domain("w", **{key: ("level",)})


def test_two_signals_of_one_name_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="the domain 'w' declares 'level' twice"):
        Domain("w", signals=(LEVEL, Signal("level", "mm")))


def test_units_of_a_channel_are_as_many_as_its_numbers() -> None:
    with pytest.raises(ConfigurationError, match="a channel of 2 numbers has 1 units"):
        Channel("numbers", ("a", "b"), units=("m",))
    assert Channel("array", columns=2, units=("m", "rad")).units == ("m", "rad")


def test_actions_are_the_fields_of_the_command() -> None:
    domain = Domain("w", actions=(Action("flow", "m3/s"),), channels={})
    assert domain.channels is not None
    assert domain.channels["command"].fields == ("flow",)
    own = {"command": Channel("other")}
    assert Domain("w", actions=(Action("flow", "m3/s"),), channels=own).channels == own


@pytest.mark.of_guest
def test_every_signal_of_a_built_in_episode_is_declared() -> None:
    from pytest_dura.driving.signals import NAMES, PERCEPT_NAMES

    driving = DOMAINS["driving"]
    assert tuple(signal.name for signal in driving.signals or ()) == NAMES
    assert tuple(signal.name for signal in driving.percept_signals or ()) == PERCEPT_NAMES
    assert all(signal.meaning for signal in driving.signals or ())


def test_a_domain_without_a_simulator_of_its_name_has_no_measures() -> None:
    tables = declared(Domain("w", signals=(LEVEL,)))
    assert [table.title for table in tables] == ["signals"]
    assert tables[0].rows == [("level", "[m]", "above the bottom")]


BAD_ALIASES = {
    "a channel itself": {"radar": "lidar"},
    "of no channel": {"objects": "lidr"},
    "of another alias": {"objects": "lidar", "things": "objects"},
    "of the command": {"steering": "command"},
    "what faults call something else": {"prompt": "lidar"},
    "no name": {"two.words": "lidar"},
}


def simulator_with(aliases):
    class Aliased(Simulator):
        channel_aliases = aliases

    return Aliased


@pytest.mark.parametrize("aliases", BAD_ALIASES.values(), ids=BAD_ALIASES)
def test_an_alias_that_cannot_be_meant_is_refused_with_what_is_free(aliases) -> None:
    channels = {"lidar": Channel("objects"), "radar": Channel("array", columns=3)}
    domain = Domain("w", channels=channels, actions=(Action("flow", "m3/s"),))
    with pytest.raises(ConfigurationError, match=r"channel alias '.*' cannot be used") as caught:
        domain.aliases_of(simulator_with(aliases))
    assert caught.value.key == "channel_aliases"
    assert str(caught.value.expected).endswith("for one of lidar, radar")
    assert domain.aliases_of(simulator_with({"objects": "lidar"})) == {"objects": "lidar"}


def test_an_alias_of_a_channel_that_this_simulator_lacks_is_let_be() -> None:
    simulator = simulator_with({"objects": "lidar"})
    simulator.lacks = {"channels.lidar": "it has radar alone"}
    domain = Domain("w", channels={"radar": Channel("array")})
    assert domain.aliases_of(simulator) == {"objects": "lidar"}


@pytest.mark.of_guest
def test_driving_names_its_alias_in_its_tables() -> None:
    (channels,) = [each for each in declared(DOMAINS["driving"]) if each.title == "channels"]
    rows = {name: meaning for name, *_, meaning in channels.rows}
    assert rows["lidar"].endswith("; alias: objects")
    assert "objects" not in rows
