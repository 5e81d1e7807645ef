"""What determines a role and is found elsewhere stands in the specs of its episodes."""

from __future__ import annotations

import pytest
from thermostat import Controller

from pytest_dura import ConfigurationError, Generator, Proposal, RoleSpec, SafetyMonitor
from pytest_dura.library import LocalRole, ParameterResolver, expand_cases, load_library

ASKED: list[dict] = []


class Asking(Generator):
    """Its model is named elsewhere, and is another one each time somebody asks."""

    def __init__(self, power=1.0, model=None):
        self.power, self.model = power, model

    @classmethod
    def resolve_parameters(cls, params):
        ASKED.append(dict(params))
        return {**params, "model": f"model-{len(ASKED)}"}

    def propose(self, view):
        return Proposal(self.power)


class Unsettled(Asking):
    @classmethod
    def resolve_parameters(cls, params):
        ASKED.append(dict(params))
        raise ConfigurationError("the server is not there")


class Broken(Asking):
    @classmethod
    def resolve_parameters(cls, params):
        return {}["model"]


class NotPlain(Asking):
    @classmethod
    def resolve_parameters(cls, params):
        return {"model": object()}


class NoMapping(Asking):
    @classmethod
    def resolve_parameters(cls, params):
        return ["model"]


def make(power=1.0):
    return Asking(power)


@pytest.fixture(autouse=True)
def nothing_asked():
    ASKED.clear()


@pytest.fixture
def settled():
    return ParameterResolver().resolve


def spec_of(kind, **params):
    return RoleSpec(f"{__name__}:{kind.__name__}", params)


def test_a_class_is_asked_once_for_the_same_parameters(settled):
    first = settled(spec_of(Asking, power=2.0))
    assert first.params == {"power": 2.0, "model": "model-1"}
    assert settled(spec_of(Asking, power=2.0)) is first
    assert settled(spec_of(Asking, power=3.0)).params["model"] == "model-2"
    assert ASKED == [{"power": 2.0}, {"power": 3.0}]


def test_settling_again_changes_nothing(settled):
    first = settled(spec_of(Asking))
    assert settled(first) is first
    assert len(ASKED) == 1


def test_a_session_that_begins_in_the_same_process_asks_again(settled):
    assert settled(spec_of(Asking)).params["model"] == "model-1"
    again = ParameterResolver().resolve
    assert again(spec_of(Asking)).params["model"] == "model-2"


def test_a_failure_is_not_repeated_and_stays_the_same_error(settled):
    for _ in range(2):
        with pytest.raises(ConfigurationError, match="the server is not there"):
            settled(spec_of(Unsettled))
    assert len(ASKED) == 1


@pytest.mark.parametrize(
    "kind, words",
    [
        (Broken, "Broken cannot resolve its parameters: KeyError"),
        (NotPlain, "NotPlain cannot resolve its parameters: TypeError"),
        (NoMapping, "NoMapping resolves its parameters to something else"),
    ],
)
def test_what_a_class_cannot_settle_is_one_error(settled, kind, words):
    with pytest.raises(ConfigurationError, match=words):
        settled(spec_of(kind))


def test_a_local_class_keeps_its_target_and_is_built_with_what_was_settled(settled):
    class Local(Asking):
        pass

    found = settled(LocalRole("tests/conftest.py:Local", Local))
    assert isinstance(found, LocalRole)
    assert found.label == "Local (tests)"
    assert isinstance(found.create(), Local)
    assert found.create().model == "model-1"


def test_two_local_classes_of_one_path_are_told_apart(settled):
    path = "conftest.py:Local"
    found = [settled(LocalRole(path, type("Local", (Asking,), {}))) for _ in range(2)]
    assert [one.params["model"] for one in found] == ["model-1", "model-2"]


@pytest.mark.parametrize(
    "spec",
    [
        RoleSpec.of(Asking(model="mine")),
        RoleSpec.of(make, {"power": 2.0}),
        RoleSpec.of(Controller),
        RoleSpec("nowhere:Planner"),
        LocalRole("conftest.py:make", make),
    ],
    ids=["instance", "factory", "class that settles nothing", "no such module", "local factory"],
)
def test_everything_else_stays_as_it_is(settled, spec):
    assert settled(spec) is spec
    assert settled(spec) is spec
    assert ASKED == []


class Watching(SafetyMonitor):
    def __init__(self, model=None):
        self.model = model

    @classmethod
    def resolve_parameters(cls, params):
        return {**params, "model": "a judge"}

    def run(self, view):
        raise AssertionError


@pytest.mark.of_guest
def test_the_spec_of_an_episode_states_what_was_settled_of_every_role():
    library = load_library(())
    (case,) = expand_cases([library.scenarios["intersection/nominal"]])
    roles = {"generator": spec_of(Asking), "safety_monitor": spec_of(Watching)}
    resolver = ParameterResolver()
    specs = [case.spec(run, 0, roles, resolver=resolver) for run in range(3)]
    for spec in specs:
        assert spec.to_json()["roles"]["generator"]["params"] == {"model": "model-1"}
        assert spec.to_json()["roles"]["safety_monitor"]["params"] == {"model": "a judge"}
        assert type(spec).from_json(spec.to_json()) == spec
    assert len(ASKED) == 1
