"""What fails within a component's call and is not the component's: nobody blames it for that."""

from __future__ import annotations

import pytest
from loops import Says, run_loop

from pytest_dura import Proposal
from pytest_dura.core import ComponentEnvironmentError, environment_errors, report_environment_error


def fails(view):
    if view.index == 3:
        raise report_environment_error(ComponentEnvironmentError("cassette", "it has no answer"))
    return Proposal(1.0)


def fails_and_goes_on(view):
    try:
        return fails(view)
    except ComponentEnvironmentError:
        return Proposal(0.0)


@pytest.mark.parametrize("component", [fails, fails_and_goes_on])
def test_it_ends_the_episode_as_missing_whatever_the_component_makes_of_it(component):
    episode = run_loop(Says(component))
    assert episode.validity == "missing"
    assert episode.failure == "infrastructure: cassette at tick 3 (t = 0.3 s): it has no answer"
    assert not [one for one in episode.events if one.kind == "component_failure"]


def test_an_error_that_nobody_was_told_of_is_the_components():
    def raises(view):
        raise ComponentEnvironmentError("cassette", "made up")

    episode = run_loop(Says(raises))
    assert episode.validity == "valid"
    assert "made up" in episode.events[0].detail


def test_it_may_come_up_in_the_reset():
    class Begins(Says):
        def reset(self, context):
            raise report_environment_error(ComponentEnvironmentError("cassette", "gone"))

    episode = run_loop(Begins(fails))
    assert episode.failure == "infrastructure: cassette at tick 0 (t = 0.0 s): gone"


def test_a_loop_within_a_component_hears_of_its_own_failures_only():
    with environment_errors() as outer:
        with environment_errors() as inner:
            report_environment_error(ComponentEnvironmentError("cassette", "inner"))
        report_environment_error(ComponentEnvironmentError("cassette", "outer"))
    assert [str(one) for one in inner] == ["inner"]
    assert [str(one) for one in outer] == ["outer"]


def test_without_a_loop_nobody_listens():
    error = ComponentEnvironmentError("cassette", "alone")
    assert report_environment_error(error) is error
    with environment_errors() as heard:
        pass
    assert heard == []
