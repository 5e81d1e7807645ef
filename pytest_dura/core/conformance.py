"""Conformance of roles to the contract of their base class, and helpers of both kits."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from pytest_dura.core.component import check_proposal
from pytest_dura.core.episode import check_scenario_keys
from pytest_dura.core.errors import (
    ActionError,
    ConfigurationError,
    ConformanceError,
    describe_error,
)
from pytest_dura.core.outputs import check_output, required_output
from pytest_dura.core.percepts import NOTHING, Lazy, Percept
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import (
    FaultInjector,
    Generator,
    PerformanceAssessment,
    Recovery,
    Role,
    RoleContext,
)
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import GeneratorView, Proposal, RoleView, StateManager


@dataclass(frozen=True)
class ConformanceReport:
    """Outcome of a conformance kit without a breach.

    Args:
        subject: Name of the checked simulator or role.
        checked: Descriptions of the properties that hold.
        not_supported: Optional parts of the contract that the subject does not have.
    """

    subject: str
    checked: tuple[str, ...]
    not_supported: tuple[str, ...]


class Findings:
    """Collection of breaches, so that one run of a kit reports all of them."""

    def __init__(self, subject: str) -> None:
        self.subject = subject
        self.breaches: list[tuple[str, str]] = []
        self.checked: list[str] = []
        self.not_supported: list[str] = []

    def breach(self, problem: str, remedy: str) -> None:
        """Add a breach; equal ones count once."""
        if (problem, remedy) not in self.breaches:
            self.breaches.append((problem, remedy))

    @contextmanager
    def checking(self, what: str) -> Iterator[None]:
        """Context of the check of one property; an error in it is a breach.

        ``NotImplementedError`` means that an optional part is not supported.
        """
        try:
            yield
        except NotImplementedError:
            self.not_supported.append(what)
        except Exception as error:
            self.breach(f"{what}: raised {describe_error(error)}", "make this call succeed")
        else:
            if what not in self.checked:
                self.checked.append(what)

    def report(self) -> ConformanceReport:
        """Make the report.

        Raises:
            ConformanceError: If there are breaches.
        """
        if self.breaches:
            raise ConformanceError(self.subject, self.breaches)
        return ConformanceReport(self.subject, tuple(self.checked), tuple(self.not_supported))


def named_builder(factory: RoleSpec | Callable[[], Any]) -> tuple[str, Callable[[], Any]]:
    """Name of a factory, and a function that builds a fresh object with it."""
    if isinstance(factory, RoleSpec):
        return factory.path, factory.create
    return getattr(factory, "__qualname__", type(factory).__qualname__), factory


_HIDDEN = ("__dict__", "__weakref__")
_PLAIN = (str, bytes, int, float, complex, type(None))
_bytes_of = struct.Struct("d").pack


def leaves(value: Any) -> dict[str, Any]:
    """Map the path of every leaf of a value to the leaf; leaves are immutable copies.

    Floats and arrays are kept as bytes: NaN equals NaN, and 0.0 differs from -0.0. Lazy values
    are not made. A value without items and attributes counts by its type alone.
    """
    gathered: dict[str, Any] = {}
    _gather_leaves(value, "", (), gathered)
    return gathered


def first_difference(left: Mapping[str, Any], right: Mapping[str, Any]) -> str | None:
    """First path at which two results of :func:`leaves` differ, or ``None``."""
    if left == right:
        return None
    for path in [*left, *(path for path in right if path not in left)]:
        if path not in left or path not in right or left[path] != right[path]:
            return path or "the value"
    return None


def mutable_parts(value: Any) -> list[str]:
    """List the parts of a value that can be changed in place, as ``path (kind)``."""
    return [f"{path or 'the value'} ({kind})" for path, kind in _mutable(value, "", ())]


def _gather_leaves(value: Any, path: str, above: tuple[int, ...], gathered: dict[str, Any]) -> None:
    # Most leaves are plain; the order of the other cases matters.
    kind = type(value)
    if kind is float or (isinstance(value, float) and not isinstance(value, Enum)):
        gathered[path] = _bytes_of(value)
    elif kind is bool:
        gathered[path] = (kind.__name__, value)  # False would equal 0
    elif kind in _PLAIN:
        gathered[path] = value
    elif isinstance(value, Enum):
        gathered[path] = (kind.__name__, value.name)
    elif isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
        gathered[path] = (value.dtype.str, value.shape, value.tobytes())
    elif isinstance(value, _PLAIN):
        gathered[path] = value
    elif isinstance(value, Lazy) or id(value) in above:
        gathered[path] = kind.__name__
    else:
        gathered[f"{path}<type>"] = kind.__qualname__
        above = (*above, id(value))
        for name, part in _parts(value):
            _gather_leaves(part, path + name, above, gathered)


def _mutable(value: Any, path: str, above: tuple[int, ...]) -> Iterator[tuple[str, str]]:
    if isinstance(value, (Enum, *_PLAIN, np.generic, Lazy)) or id(value) in above:
        return
    if isinstance(value, np.ndarray):
        if value.flags.writeable:
            yield path, "a writeable array"
        return
    if isinstance(value, (list, dict, set, bytearray)):
        yield path, f"a {type(value).__name__}"
        return
    if not getattr(getattr(value, "__dataclass_params__", None), "frozen", True):
        yield path, "a dataclass that is not frozen"
        return
    for name, part in _parts(value):
        yield from _mutable(part, path + name, (*above, id(value)))


def _parts(value: Any) -> Iterator[tuple[str, Any]]:
    """Named parts of a container or object."""
    if isinstance(value, Mapping):
        # Reading a lazy channel through a percept would make it.
        channels = getattr(value, "_channels", value)
        return ((f"[{key!r}]", channels[key]) for key in sorted(value, key=repr))
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return ((f".{name}", getattr(value, name)) for name in value._fields)
    if isinstance(value, (list, tuple)):
        return ((f"[{index}]", part) for index, part in enumerate(value))
    if isinstance(value, np.ndarray):
        return ((f"[{index}]", number) for index, number in enumerate(value.ravel().tolist()))
    if isinstance(value, (set, frozenset)):
        return ((f"{{{index}}}", part) for index, part in enumerate(sorted(value, key=repr)))
    names = [] if callable(value) else _attributes(value)
    return ((f".{name}", getattr(value, name)) for name in names)


def _is_hidden(name: str) -> bool:
    """Whether an attribute is no part of a value, such as a memo of what was derived from it."""
    return name in _HIDDEN or name.startswith("_made")


def _attributes(value: Any) -> list[str]:
    names: list[str] = []
    for base in reversed(type(value).__mro__):
        slots = vars(base).get("__slots__", ())
        names += (slots,) if isinstance(slots, str) else slots
    names += getattr(value, "__dict__", ())
    return [name for name in names if not _is_hidden(name) and hasattr(value, name)]


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
    """Check that a role keeps its contract, on given views or in a closed loop with a simulator.

    Args:
        factory: Builds a fresh role at each call.
        views: The views that the role gets, in order: ``GeneratorView`` for a Generator,
            ``RoleView`` for any other role.
        simulator: The simulator of the closed loop, if no views are given. A Generator and a
            RecoveryPlanner drive it, other roles see its fallback action as the proposal.
        scenario: The scenario to reset the simulator with.
        context: Context for the role's ``reset``; default: seed 0 and the simulator's time step.
        ticks: Length of the closed loop.

    Raises:
        ConformanceError: With every breach and how to mend it.
        ConfigurationError: If there are neither views nor a simulator, and for an unknown key of
            the scenario.
    """
    if not views and simulator is None:
        raise ConfigurationError(
            "a role is checked on views or in a simulator",
            key="views",
            expected="some views, or a simulator",
            remedy="pass views=[...] or simulator=MySimulator",
        )
    check_scenario_keys(scenario, ("ticks", "context"))
    name, build = named_builder(factory)
    world = named_builder(simulator)[1]() if simulator is not None and not views else None
    context = context or RoleContext(0, world.time_step if world else views[0].dt, scenario)
    kit = _RoleKit(
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
class _RoleKit:
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
                f"its name is {role.name!r}", "give the class a name such as 'door_watch'"
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
        """Outputs of the role at each view, after a reset."""
        role.reset(context)
        if self.world is not None:
            return self._closed_loop(role, self.world)
        return [self._output(role, view) for view in self.views]

    def _closed_loop(self, role: Role, world: Simulator) -> list[Any]:
        outputs = []
        # The world keeps its seed: the second context differs for the role alone.
        tick = world.reset(self.scenario, self.context.seed)
        state = StateManager(self.context.dt)
        for _ in range(self.ticks):
            if tick.critical is not None or tick.truncated:
                break
            state.update(tick, Percept(tick.channels, aliases=world.channel_aliases))
            action = world.fallback_action()
            if isinstance(role, Generator):
                output = self._output(role, state.generator_view())
                proposed = output.action if isinstance(output, Proposal) else None
            else:
                state.proposal = Proposal(action)
                output = self._output(role, state.role_view(("checked for conformance",)))
                proposed = output.action if isinstance(output, Recovery) else action
                state.put(role.name, output)
            outputs.append(output)
            if isinstance(role, FaultInjector):
                self._check_injector(role, tick.channels, action, tick.time)
            if proposed is not None:
                action = self._checked_action(world, proposed, action)
            tick = world.step(action)
        return outputs

    def _output(self, role: Role, view: View) -> Any:
        """Checked output at one view; the text of the error where the role raises one."""
        before = leaves(view.percept)
        required = GeneratorView if isinstance(role, Generator) else RoleView
        if not isinstance(view, required):
            raise ConfigurationError(
                f"{type(role).__name__} takes another kind of view",
                key="views",
                found=type(view).__name__,
                expected=required.__name__,
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
            check_output(output, required_output(role))
        except (TypeError, ValueError) as error:
            self.findings.breach(
                f"run: {error}", f"return a complete {required_output(role).__name__} from run"
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

    def _compare(self, first: list[Any], other: list[Any], who: str, remedy: str) -> None:
        for index, (left, right) in enumerate(zip(first, other, strict=False)):
            path = first_difference(leaves(_deterministic(left)), leaves(_deterministic(right)))
            if path is not None:
                self.findings.breach(f"{who} gives another output at view {index}: {path}", remedy)
                return
        if len(first) != len(other):
            self.findings.breach(f"{who} drives the world to another end", remedy)


def _deterministic(output: Any) -> Any:
    """Copy of an output without the values that depend on the machine's speed."""
    if not isinstance(output, PerformanceAssessment):
        return output
    fails = tuple(name for name in output.performance_fail if name not in output.wall_clock)
    return PerformanceAssessment(output.values, NOTHING, fails)
