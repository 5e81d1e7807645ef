"""An episode ends early only where nothing that follows could change what it says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from columns import Columns, Idle
from loops import run_loop
from thermostat import Bias, Overheater, Thermostat

from pytest_dura import Episode, EpisodeSpec, Fault, Proposal, RoleSpec, Termination, Tick
from pytest_dura.core import ConfigurationError, Divergence
from pytest_dura.requirements import (
    CheckResult,
    Paired,
    Requirement,
    RequirementJudge,
    judge_episode,
)

WARM = "eventually (temperature > 15.5)"
HOT = "always (temperature < 15.5)"
NEVER = Fault("bias", "late", "thermometer", {"at": 99.0}, 1.0)


def run(*checks: str | Requirement, seconds: float = 4.0, **given: Any) -> Episode:
    requirements = [
        Requirement(f"R{i}", check=one) if isinstance(one, str) else one
        for i, one in enumerate(checks)
    ]
    end = given.pop("end", Termination(seconds, decided=True))
    given.setdefault("judge", RequirementJudge(requirements))
    faults = tuple(given.pop("faults", ()))
    return run_loop(
        given.pop("generator", Overheater()),
        policy="log_only",
        spec={"termination": end, "faults": faults},
        **given,
    )


def ended(episode: Episode) -> tuple[str, float]:
    return episode.termination, round(float(episode.time[-1]), 9)


@pytest.mark.parametrize(
    "check, time",
    [
        (WARM, 2.0),
        (HOT, 2.0),
        ("always[0:1.5] (temperature < 1000)", 1.5),
        ("always[0:0.3] (temperature < 1000)", 0.3),
        ("always[0:1.5] (temperature > 1000 implies power > 2)", 1.5),
        ("eventually[0:2.1] (temperature > 1000 implies power > 2)", 2.1),
        ("always[0:0] (temperature > 1)", 0.0),
        ("always[0:0] (next (temperature > 1))", 0.1),
    ],
)
def test_it_ends_at_the_look_at_which_all_is_decided(check: str, time: float) -> None:
    found, whole = run(check), run(check, end=Termination(4.0))
    assert ended(found) == ("decided", time)
    assert ended(whole) == ("time", 4.0)
    requirement = Requirement("R", check=check)
    own, other = judge_episode(requirement, found), judge_episode(requirement, whole)
    assert (own.verdict, own.vacuous, own.time) == (other.verdict, other.vacuous, other.time)


@pytest.mark.parametrize(
    "left",
    [
        "always (temperature < 1000)",
        "always[0:3.9] (temperature < 1000)",
        "always (percept.temperature < 18)",
        "always (loop.recovering < 1)",
        "always (proposal.fallback < 1)",
        "eventually (temperature > 1000 implies power > 2)",
        "builtins:bool",
        "",
        Requirement("P", check=WARM, paired=Paired("faults")),
        "eventually (no_such_signal > 1)",
        "eventually[0:0.25] (temperature > 1)",
        "eventually (1 / (power - power) > 0)",
    ],
)
def test_it_goes_on_while_a_requirement_is_not_decided(left: Any) -> None:
    found = run(WARM, left)
    expected = ("decided", 3.9) if left == "always[0:3.9] (temperature < 1000)" else ("time", 4.0)
    assert ended(found) == expected
    assert run(left, WARM).termination == found.termination


def test_without_a_requirement_nothing_ends() -> None:
    assert run().termination == "time"
    assert run(WARM, judge=None).termination == "time"


def test_a_pass_that_may_still_turn_out_not_to_be_vacuous_is_not_decided() -> None:
    check = "eventually (temperature > 17 implies power > 2)"
    found = run(check)
    assert found.termination == "decided"
    assert found.signal("temperature").max() > 17
    assert not judge_episode(Requirement("R", check=check), found).vacuous


def planned(at: float, **more: Any) -> dict[str, Any]:
    return replace(NEVER, activation={"at": at}, **more)


def test_it_waits_for_the_planned_faults_to_manifest() -> None:
    faults = [planned(0.5), planned(2.3, id="later")]
    found = run(WARM, faults=faults, fault_injector=Bias(), seconds=6.0)
    assert found.termination == "decided"
    assert found.validity == "valid"
    assert found.time[-1] > 2.3
    whole = run(WARM, faults=faults, fault_injector=Bias(), end=Termination(4.0))
    assert whole.validity == "valid"


def test_a_fault_that_never_manifests_leaves_the_episode_as_invalid_as_it_was() -> None:
    found = run(WARM, faults=[NEVER], fault_injector=Bias())
    assert (found.termination, found.validity) == ("time", "invalid")
    drawn = [replace(NEVER, by_chance=True)]
    by_chance = run(WARM, faults=drawn, fault_injector=Bias())
    assert (by_chance.termination, by_chance.validity) == ("time", "valid")
    # Its only hit might come after a violation, and a rate is judged under faults that hit.
    for faults in (drawn, [*drawn, planned(98.0, id="sure")]):
        assert run(HOT, faults=faults, fault_injector=Bias()).termination == "time"
    hit = [planned(3.0, by_chance=True)]
    late = run(HOT, faults=hit, fault_injector=Bias())
    assert ended(late)[0] == "decided"
    assert late.not_manifested == ()


def test_what_is_violated_waits_for_no_fault() -> None:
    found = run(HOT, faults=[NEVER], fault_injector=Bias())
    assert ended(found) == ("decided", 2.0)
    assert judge_episode(Requirement("R", check=HOT), found).verdict == "violated"
    # Of two, the one that is satisfied would be invalid in a whole episode.
    for checks in ((HOT, WARM), (WARM, HOT)):
        assert run(*checks, faults=[NEVER], fault_injector=Bias()).termination == "time"


def test_a_whole_episode_is_never_said_to_have_ended_early() -> None:
    check = "always[0:1.5] (temperature < 1000)"
    assert run(check, seconds=1.5).termination == "time"
    assert run(check, end=Termination(4.0, iterations=15, decided=True)).termination == "iterations"


class Room(Thermostat):
    """A room that knows afterwards how warm it was going to be."""

    def signals(self, ticks: Sequence[Tick]) -> dict[str, Any]:
        """With the greatest temperature, which later ticks may raise."""
        known = super().signals(ticks)
        return known | {"peak": np.full(len(ticks), known["temperature"].max())}


class Foreseeing(Room):
    """It says so."""

    hindsight = frozenset({"peak"})


@pytest.mark.parametrize("room", [Room, Foreseeing])
@pytest.mark.parametrize("check", ["peak < 15.5", "always[0:2] (peak < 15.5 implies power > 2)"])
def test_what_is_known_with_hindsight_is_not_decided_early(room: Any, check: str) -> None:
    # One that does not say so is found out once a sample has changed from one look to the next.
    late = "always[0:3] (temperature < 1000)"
    assert run(late, check, simulator=room()).termination == "time"


@pytest.mark.parametrize("window, decided", [("always[0:2]", False), ("always[0:0]", True)])
def test_the_only_look_at_signals_is_held_against_one_at_less(window: str, decided: bool) -> None:
    # At the first tick nothing can be known yet of what later ones change.
    found = run(f"{window} (peak < 25)", simulator=Room())
    assert (found.termination == "decided") == decided


def test_the_violation_rule_knows_hindsight_too() -> None:
    found = run("peak < 15.1", simulator=Foreseeing(), end=Termination(4.0, violation=True))
    assert found.termination == "time"


def test_an_episode_that_ended_early_has_no_signals_that_hindsight_gives() -> None:
    found = run(WARM, simulator=Foreseeing())
    assert found.termination == "decided"
    assert "peak" not in found.signals
    with pytest.raises(ConfigurationError, match="run it with --dura-end=complete if that"):
        judge_episode(Requirement("R", check="always (peak < 25)"), found)
    whole = run(WARM, simulator=Foreseeing(), end=Termination(4.0))
    assert "peak" in whole.signals


def test_nothing_else_is_read_from_an_episode_that_ended_early() -> None:
    found = run(WARM)
    own = judge_episode(Requirement("R", check="always (temperature < 1000)"), found)
    assert own.verdict == "open"
    assert "does not decide" in own.detail
    function = judge_episode(Requirement("R"), found, lambda _: CheckResult(True))
    assert function.verdict == "open"
    assert "once the requirements of its case were decided" in function.detail
    violated = judge_episode(Requirement("R"), found, lambda _: False)
    assert violated.verdict == "violated"


def test_its_margin_is_the_least_that_was_still_possible() -> None:
    columns = {"a": [1.0] * 60, "b": [9.0] * 30 + [-9.0] * 30}
    check = "always (b > 0) or eventually (a > 0.5)"
    found, whole = (
        run(check, generator=Idle(), simulator=Columns(columns), end=end)
        for end in (Termination(4.0, decided=True), Termination(4.0))
    )
    assert (found.termination, whole.termination) == ("decided", "time")
    for episode in (found, whole):
        assert judge_episode(Requirement("R", check=check), episode).margin == 0.5


def test_the_margin_of_a_violation_is_what_it_was_by_then() -> None:
    check = "always (temperature < 15.5)"
    found, whole = run(check), run(check, end=Termination(4.0))
    own, other = (judge_episode(Requirement("R", check=check), one) for one in (found, whole))
    assert own.verdict == other.verdict == "violated"
    assert own.margin == 15.5 - found.signal("temperature").max()
    assert own.margin > other.margin


def test_the_next_episode_of_a_judge_begins_anew() -> None:
    judge = RequirementJudge([Requirement("R", check=HOT)])
    assert ended(run(judge=judge)) == ("decided", 2.0)
    cold = run(judge=judge, generator=lambda _: Proposal(0.0))
    assert cold.termination == "time"
    assert ended(run(judge=judge)) == ("decided", 2.0)


def test_twins_of_unlike_length_say_nothing_of_what_only_one_of_them_proposed() -> None:
    short, whole = run(WARM), run(WARM, end=Termination(4.0))
    for pair in ((short, whole), (whole, short), (short, short)):
        assert "ended at 2.00 s, once all was decided" in Divergence.of(*pair).doubt
    assert Divergence.of(whole, whole).doubt == ""


def test_specs_without_it_are_as_they_were() -> None:
    roles = {"generator": RoleSpec("thermostat:Overheater")}
    spec = EpisodeSpec("c", 0, 1, RoleSpec("thermostat:Thermostat"), roles)
    told = spec.to_json()
    assert told["termination"] == {
        "time_limit": 30.0, "goal": True, "violation": False, "iterations": None,
    }  # fmt: skip
    early = replace(spec, termination=Termination(decided=True))
    assert early.to_json()["termination"]["decided"] is True
    assert early.key != spec.key
    for one in (spec, early):
        assert EpisodeSpec.from_json(one.to_json()) == one
