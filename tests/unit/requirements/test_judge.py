"""An episode ends at a violation only when every requirement is decided."""

from __future__ import annotations

import pytest
from loops import run_loop
from thermostat import Overheater

from pytest_dura import ConfigurationError, Episode, Termination
from pytest_dura.requirements import Requirement, RequirementJudge, judge_episode

HOT = "always (temperature < 18)"


def run(*checks: str) -> Episode:
    requirements = [Requirement(f"R{i}", check=check) for i, check in enumerate(checks)]
    return run_loop(
        Overheater(),
        judge=RequirementJudge(requirements),
        policy="log_only",
        spec={"termination": Termination(4.0, violation=True)},
    )


def test_it_ends_at_the_first_violation() -> None:
    found = run(HOT)
    assert found.termination == "violation"
    temperature = found.signal("temperature")
    assert temperature[-1] >= 18 > temperature[-2]
    assert judge_episode(Requirement("R", check=HOT), found).verdict == "violated"


@pytest.mark.parametrize(
    "open_check",
    [
        "always (temperature < 1000)",
        "eventually (temperature > 1000)",
        "always[0:3.5] (temperature < 1000)",
        "always (percept.temperature < 18)",
        "always (loop.recovering < 1)",
        "always (proposal.fallback < 1)",
        "",
    ],
)
def test_it_goes_on_while_another_requirement_is_open(open_check: str) -> None:
    found = run(HOT, open_check)
    if open_check.startswith("always["):
        assert (found.termination, found.time[-1]) == ("violation", pytest.approx(3.5))
    else:
        assert (found.termination, found.time[-1]) == ("time", pytest.approx(4.0))


def test_a_satisfied_requirement_is_decided() -> None:
    assert run(HOT, "eventually (temperature > 16)").termination == "violation"


def test_without_a_violation_or_a_requirement_nothing_ends() -> None:
    assert run("eventually (temperature > 15)").termination == "time"
    assert run().termination == "time"


def test_a_check_that_cannot_be_read() -> None:
    with pytest.raises(ConfigurationError, match="cannot read the formula"):
        RequirementJudge([Requirement("R", check="never (x > 0)")])
