"""AttackPlan: what a SecurityAssessor goes by when it directs attacks."""

from __future__ import annotations

from typing import Any

import pytest
from injecting import fault

from pytest_dura.core import ConfigurationError, Injection, Percept, StateManager, Tick
from pytest_dura.faults import AttackPlan


class Ticks:
    """A plan that is asked tick by tick, each of 0.1 s."""

    def __init__(self, *faults: Any, gauge: float = 0.0) -> None:
        self.plan, self.state = AttackPlan(faults, "security_assessor"), StateManager(0.1)
        self.channels = {"gauge": {"level": gauge}}

    def ask(self, injection: Injection | None = None) -> tuple[str, ...]:
        """What is directed at the next tick, after which the injector reports, if it runs."""
        index = len(self.state.ticks)
        self.state.update(Tick(index, index * 0.1, {}, self.channels), Percept(self.channels))
        directives = self.plan.due(self.state.role_view(), dict)
        if injection is not None:
            self.state.put("fault_injector", injection)
        return directives


def directed(**activation: Any) -> dict[str, Any]:
    return fault("f", by="security_assessor", **activation)


@pytest.mark.parametrize("delay, tick", [(0.0, 1), (0.3, 2), (0.5, 4)])
def test_an_event_is_answered_once_also_where_the_injector_falls_silent(
    delay: float, tick: int
) -> None:
    ticks = Ticks(directed(after={"fault": "a", "delay": delay}))
    answers = [ticks.ask(Injection(("a",))), *(ticks.ask() for _ in range(9))]
    assert [index for index, names in enumerate(answers) if names] == [tick]


def test_the_end_of_a_fault_is_no_beginning() -> None:
    ticks = Ticks(directed(after={"fault": "a", "event": "deactivated"}))
    answers = [ticks.ask(Injection(("a",))), ticks.ask(Injection((), ("a",))), ticks.ask()]
    assert answers == [(), (), ("f",)]


@pytest.mark.parametrize("not_before", [0.0, 5.0])
def test_a_condition_on_what_is_not_there_is_refused_at_the_first_tick(not_before: float) -> None:
    ticks = Ticks(directed(when="gauge.depth > 1", not_before=not_before))
    with pytest.raises(ConfigurationError, match="the fault 'f' cannot be used"):
        ticks.ask()
