"""check_role: whether a role keeps the contract of its base class."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pytest_dura.core.comparing import first_difference, leaves
from pytest_dura.core.component import check_proposal
from pytest_dura.core.errors import ActionError, ConfigurationError, describe_error
from pytest_dura.core.findings import ConformanceReport, Findings, builder
from pytest_dura.core.outputs import check_output, owed_output
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import (
    FaultInjector,
    Generator,
    PerformanceAssessment,
    Proposal,
    Recovery,
    Role,
    RoleContext,
)
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import NOTHING, GeneratorView, Percept, RoleView, StateManager

View = GeneratorView | RoleView

PURE = "let the output follow from the context given to reset and from the views alone"


def check_role(
    factory: RoleSpec | Callable[[], Role],
    views: Sequence[View] = (),
    *,
    simulator: RoleSpec | Callable[[], Simulator] | None = None,
    scenario: Mapping[str, Any] = NOTHING,
    context: RoleContext | None = None,
    ticks: int = 20,
) -> ConformanceReport:
    """Put a role through its contract, on given views or in a closed loop with a simulator.

    Args:
        factory: Builds a fresh role at each call.
        views: What the role is shown, in order: ``GeneratorView`` for a Generator, ``RoleView``
            for any other role.
        simulator: Where no views are given: the world in which they arise. A Generator and a
            RecoveryPlanner drive it, other roles see its fallback action as the proposal.
        scenario: The scenario to reset the simulator with.
        context: What the role's ``reset`` gets; seed 0 and the simulator's time step by default.
        ticks: Length of the closed loop.

    Raises:
        ConformanceError: With every breach that was found and how to mend it.
        ConfigurationError: If there are neither views nor a simulator.
    """
    if not views and simulator is None:
        raise ConfigurationError(
            "a role is checked on views or in a simulator",
            key="views",
            expected="some views, or a simulator",
            remedy="pass views=[...] or simulator=MySimulator",
        )
    name, build = builder(factory)
    world = builder(simulator)[1]() if simulator is not None and not views else None
    context = context or RoleContext(0, world.time_step if world else views[0].dt, scenario)
    kit = _Kit(
        findings=Findings(f"role {name}"),
        build=build,
        views=views,
        world=world,
        scenario=scenario,
        context=context,
        ticks=ticks,
    )
    kit.run()
    return kit.findings.report()


@dataclass
class _Kit:
    findings: Findings
    build: Callable[[], Role]
    views: Sequence[View]
    world: Simulator | None
    scenario: Mapping[str, Any]
    context: RoleContext
    ticks: int

    def run(self) -> None:
        findings = self.findings
        role, other = self.build(), self.build()
        if not isinstance(role, Role):
            findings.breach(
                f"the factory gives a {type(role).__name__}, not a role",
                "derive it from pytest_dura.Role or one of the six bases",
            )
            return
        if role is other:
            findings.not_supported.append("fresh instances: each call gives the same object")
        with findings.checking("name and after"):
            self._check_declarations(role)
        with findings.checking("outputs: type and numbers"):
            first = self._outputs(role, self.context)
            again = self._outputs(other, self.context)
            self._compare(first, again, "another instance", PURE)
            forget = "forget everything in reset"
            again = self._outputs(role, self.context)
            self._compare(first, again, "the same instance, reset again", forget)
            self._outputs(role, replace(self.context, seed=self.context.seed + 1))
            again = self._outputs(role, self.context)
            self._compare(first, again, "the same instance, after another seed", forget)
        if self.world is not None:
            self.world.close()

    def _check_declarations(self, role: Role) -> None:
        if not isinstance(role.name, str) or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]*", role.name):
            self.findings.breach(
                f"its name is {role.name!r}", "give the class a name such as 'pedestrian_watch'"
            )
        if not isinstance(role.after, (tuple, list)):
            self.findings.breach(
                f"after is {role.after!r}, not a tuple", f"write after = ({role.after!r},)"
            )
            return
        for name in role.after:
            if not isinstance(name, str) or not name or name == role.name:
                self.findings.breach(
                    f"after names {name!r}", "name other roles that run earlier in the tick"
                )

    def _outputs(self, role: Role, context: RoleContext) -> list[Any]:
        """What the role says at each view, after a reset."""
        role.reset(context)
        if self.world is not None:
            return self._closed_loop(role, self.world)
        return [self._ask(role, view) for view in self.views]

    def _closed_loop(self, role: Role, world: Simulator) -> list[Any]:
        outputs = []
        # The world keeps its seed: the second context differs for the role alone.
        tick = world.reset(self.scenario, self.context.seed)
        state = StateManager(self.context.dt)
        for _ in range(self.ticks):
            if tick.critical is not None:
                break
            state.update(tick, Percept(tick.channels))
            action = world.fallback_action()
            if isinstance(role, Generator):
                output = self._ask(role, state.generator_view())
                proposed = output.action if isinstance(output, Proposal) else None
            else:
                state.proposal = Proposal(action)
                output = self._ask(role, state.role_view(("checked for conformance",)))
                proposed = output.action if isinstance(output, Recovery) else action
                state.put(role.name, output)
            outputs.append(output)
            if isinstance(role, FaultInjector):
                self._check_injector(role, tick.channels, action, tick.time)
            if proposed is not None:
                action = self._checked_action(world, proposed, action)
            tick = world.step(action)
        return outputs

    def _ask(self, role: Role, view: View) -> Any:
        """One output, checked; an error stands in for an output that there is not."""
        before = leaves(view.percept)
        owed = GeneratorView if isinstance(role, Generator) else RoleView
        if not isinstance(view, owed):
            raise ConfigurationError(
                f"{type(role).__name__} takes another kind of view",
                key="views",
                found=type(view).__name__,
                expected=owed.__name__,
            )
        output: Any
        try:
            if isinstance(role, Generator) and isinstance(view, GeneratorView):
                output = role.propose(view)
                if (problem := check_proposal(output)) is not None:
                    self.findings.breach(f"propose {problem}", "return a Proposal(action, ...)")
            else:
                output = self._run(role, view)
        except Exception as error:
            text = describe_error(error)
            self.findings.breach(f"raised {text}", "handle every view that can arise")
            output = text
        if (path := first_difference(before, leaves(view.percept))) is not None:
            self.findings.breach(f"it changed the percept at {path}", "copy what you change")
        return output

    def _run(self, role: Role, view: Any) -> Any:
        triggered = role.trigger(view)
        if not isinstance(triggered, bool):
            self.findings.breach(
                f"trigger returned {triggered!r}", "return True or False from trigger"
            )
        if not triggered:
            return None
        output = role.run(view)
        try:
            check_output(output, owed_output(role))
        except (TypeError, ValueError) as error:
            self.findings.breach(
                f"run: {error}", f"return a complete {owed_output(role).__name__} from run"
            )
        return output

    def _check_injector(
        self, role: FaultInjector, channels: Mapping[str, Any], action: Any, time: float
    ) -> None:
        before = leaves(channels)
        changed, tampered = role.corrupt(channels, time)
        if not isinstance(changed, Mapping) or not isinstance(tampered, Mapping):
            self.findings.breach(
                "corrupt returned something else than two mappings",
                "return the channels, and by channel the ids of the faults that changed it",
            )
        if first_difference(before, leaves(channels)) is not None:
            self.findings.breach("corrupt changed the channels in place", "change a copy")
        _, ids = role.corrupt_command(action, time)
        if not isinstance(ids, tuple):
            self.findings.breach(
                f"corrupt_command returned {ids!r} as ids", "return a tuple of fault ids"
            )

    def _checked_action(self, world: Simulator, proposed: Any, otherwise: Any) -> Any:
        if proposed is otherwise:
            return otherwise
        try:
            return world.check_action(proposed)
        except ActionError as error:
            self.findings.breach(
                f"its action is none of this simulator's: {error}", "return an action it accepts"
            )
            return otherwise

    def _compare(self, one: list[Any], other: list[Any], who: str, remedy: str) -> None:
        for index, (left, right) in enumerate(zip(one, other, strict=False)):
            path = first_difference(leaves(_deterministic(left)), leaves(_deterministic(right)))
            if path is not None:
                self.findings.breach(f"{who} gives another output at view {index}: {path}", remedy)
                return
        if len(one) != len(other):
            self.findings.breach(f"{who} drives the world to another end", remedy)


def _deterministic(output: Any) -> Any:
    """An output without what depends on the machine's speed."""
    if not isinstance(output, PerformanceAssessment):
        return output
    fails = tuple(name for name in output.performance_fail if name not in output.wall_clock)
    return PerformanceAssessment(output.values, NOTHING, fails)
