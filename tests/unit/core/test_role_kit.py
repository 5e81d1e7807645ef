"""check_role: passes good roles and names every breach of bad ones."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest
from thermostat import (
    Bias,
    Controller,
    HeatMonitor,
    JumpWatch,
    Meter,
    NightWatch,
    Overheater,
    SwitchOff,
    Thermostat,
)

from pytest_dura import (
    Assessed,
    Assessment,
    ConfigurationError,
    Fault,
    FaultInjector,
    Generator,
    GeneratorView,
    Injection,
    Percept,
    PerformanceAssessment,
    PerformanceOracle,
    Proposal,
    Recovery,
    RecoveryPlanner,
    Role,
    RoleContext,
    RoleSpec,
    SafetyMonitor,
    SecurityAssessor,
    StateManager,
    Tick,
    check_role,
    stream,
)
from pytest_dura.core import ConformanceError

BIAS = Fault("bias", "bias", "thermometer", {"at": 0.3}, 0.5)
CONTEXT = RoleContext(0, 0.1, {}, (BIAS,))


def breaches(kind: Any) -> str:
    with pytest.raises(ConformanceError) as caught:
        check_role(kind, simulator=Thermostat, context=CONTEXT)
    text = str(caught.value)
    assert text.count("remedy:") == text.count("\n") / 2
    return text


@pytest.mark.parametrize(
    "kind",
    [Controller, Overheater, HeatMonitor, JumpWatch, Bias, Meter, SwitchOff, NightWatch,
     RoleSpec("thermostat:HeatMonitor", {"limit": 16.0})],
)  # fmt: skip
def test_good_roles_pass_in_a_closed_loop(kind: Any) -> None:
    report = check_role(kind, simulator=Thermostat, context=CONTEXT)
    assert len(report.checked) == 2
    assert report.not_supported == ()


def test_a_random_role_passes_if_it_draws_from_its_stream() -> None:
    class Random(Generator):
        def reset(self, context: RoleContext) -> None:
            self._draws = stream(context.seed, "generator")

        def propose(self, view: GeneratorView) -> Proposal:
            return Proposal(float(self._draws.random()))

    check_role(Random, simulator=RoleSpec("thermostat:Thermostat"))


def views_for(generator: bool, *temperatures: Any) -> list[Any]:
    state, views = StateManager(0.1), []
    for index, temperature in enumerate(temperatures):
        state.update(Tick(index, index * 0.1, {}, {}), Percept({"thermometer": temperature}))
        state.proposal = Proposal(1.0)
        views.append(state.generator_view() if generator else state.role_view())
    return views


def test_good_roles_pass_on_given_views() -> None:
    check_role(Controller, views_for(True, 15.0, 25.0))
    check_role(HeatMonitor, views_for(False, 15.0, 35.0))


def test_views_or_a_simulator_are_needed_and_of_the_right_kind() -> None:
    with pytest.raises(ConfigurationError, match="on views or in a simulator"):
        check_role(Controller)
    with pytest.raises(ConformanceError, match="another kind of view"):
        check_role(Controller, views_for(False, 15.0))


def test_a_shared_instance_is_reported() -> None:
    watch = JumpWatch()
    report = check_role(lambda: watch, simulator=Thermostat)
    assert report.not_supported == ("fresh instances: each call gives the same object",)
    assert check_role(RoleSpec.of(watch), simulator=Thermostat).not_supported


class Keeps(Generator):
    """Remembers over a reset."""

    def __init__(self) -> None:
        self.total = 0.0

    def propose(self, view: GeneratorView) -> Proposal:
        self.total += 0.001
        return Proposal(min(self.total, 1.0))


class KeepsItsStream(Generator):
    """Draws on where it was, unless the seed is another one."""

    seed: int | None = None

    def reset(self, context: RoleContext) -> None:
        if context.seed != self.seed:
            self.seed, self.draws = context.seed, stream(context.seed, "generator")

    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(float(self.draws.random()))


class KeepsTheWorst(Generator):
    """Remembers the largest seed."""

    worst = 0

    def reset(self, context: RoleContext) -> None:
        self.worst = max(self.worst, context.seed)

    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(float(self.worst))


numbers = count()


class Counts(Generator):
    """Depends on how often anybody has asked."""

    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal((next(numbers) % 97) / 97)


class TooStrong(Generator):
    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(2.0)


class SaysFloat(Generator):
    def propose(self, view: GeneratorView) -> Any:
        return 1.0


class Raises(Generator):
    def propose(self, view: GeneratorView) -> Proposal:
        return Proposal(view.percept["sonar"])


class SaysNothing(SafetyMonitor):
    def run(self, view: Any) -> Any:
        return None


class NaNScore(SafetyMonitor):
    def run(self, view: Any) -> Assessment:
        return Assessment(Assessed.SAFE, float("nan"))


class PlainAssessment(SecurityAssessor):
    def run(self, view: Any) -> Any:
        return Assessment()


class NoInjection(FaultInjector):
    def run(self, view: Any) -> Any:
        return ("bias",)


class InPlace(FaultInjector):
    def run(self, view: Any) -> Injection:
        return Injection()

    def corrupt(self, channels: Any, time: float) -> Any:
        channels["thermometer"] = 0.0
        return channels, {}


class NoPair(FaultInjector):
    def run(self, view: Any) -> Injection:
        return Injection()

    def corrupt_command(self, action: Any, time: float) -> Any:
        return action, "bias"


class NaNValue(PerformanceOracle):
    def run(self, view: Any) -> PerformanceAssessment:
        return PerformanceAssessment({"speed": float("nan")})


class BadRecovery(RecoveryPlanner):
    def run(self, view: Any) -> Recovery:
        return Recovery("off", "switch_off")


class NoName(Role):
    def run(self, view: Any) -> int:
        return 1


class AfterText(NightWatch):
    after = "safety_monitor"  # type: ignore[assignment]


class AfterItself(NightWatch):
    after = ("night_watch",)


class TriggerSaysNone(NightWatch):
    def trigger(self, view: Any) -> Any:
        return None


@pytest.mark.parametrize(
    "kind, breach",
    [
        (Keeps, "the same instance, reset again gives another output at view 0: .action"),
        (KeepsItsStream, "the same instance, reset again gives another output at view 0"),
        (KeepsTheWorst, "the same instance, after another seed gives another output at view 0"),
        (Counts, "another instance gives another output at view 0: .action"),
        (TooStrong, "its action is none of this simulator's: 2.0 is not a heating power"),
        (SaysFloat, "propose returned float, not a Proposal"),
        (Raises, "raised KeyError"),
        (SaysNothing, "run: returned NoneType, not an Assessment"),
        (NaNScore, "run: its score is not a number (NaN)"),
        (PlainAssessment, "run: returned Assessment, not a SecurityAssessment"),
        (NoInjection, "run: returned tuple, not an Injection"),
        (InPlace, "corrupt changed the channels in place"),
        (NoPair, "corrupt_command returned 'bias' as ids"),
        (NaNValue, "run: its values['speed'] is not a number (NaN)"),
        (BadRecovery, "its action is none of this simulator's: 'off' is not a heating power"),
        (NoName, "its name is ''"),
        (AfterText, "after is 'safety_monitor', not a tuple"),
        (AfterItself, "after names 'night_watch'"),
        (TriggerSaysNone, "trigger returned None"),
        (dict, "the factory gives a dict, not a role"),
    ],
)
def test_a_breach_is_named_with_its_remedy(kind: Any, breach: str) -> None:
    assert breach in breaches(kind)


def test_a_role_that_writes_into_the_percept_is_found_out() -> None:
    class Writes(SafetyMonitor):
        def run(self, view: Any) -> Assessment:
            view.percept["thermometer"].degrees = 0.0
            return Assessment()

    with pytest.raises(ConformanceError, match="it changed the percept at"):
        check_role(Writes, views_for(False, SimpleNamespace(degrees=1.0)))


def test_wall_clock_values_may_differ() -> None:
    class Timer(PerformanceOracle):
        def run(self, view: Any) -> PerformanceAssessment:
            number = next(numbers)
            return PerformanceAssessment({}, {"s": float(number)}, ("s",) if number % 3 else ())

    check_role(Timer, simulator=Thermostat)
