"""check_simulator: whether a simulator adapter keeps the contract of ``Simulator``."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from pytest_dura.core.comparing import first_difference, leaves, mutable_parts
from pytest_dura.core.errors import ActionError, ConfigurationError, describe_error
from pytest_dura.core.findings import ConformanceReport, Findings, builder
from pytest_dura.core.roles import RoleSpec
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.state import Lazy, Percept, Tick

PURE = "make the adapter a pure function of scenario, seed and actions"


def check_simulator(
    factory: RoleSpec | Callable[[], Simulator],
    scenario: Mapping[str, Any],
    actions: Sequence[Any],
    seeds: tuple[int, int] = (0, 1),
    time_step: float | None = None,
) -> ConformanceReport:
    """Put a simulator adapter through its contract.

    Args:
        factory: Builds a fresh simulator at each call.
        scenario: The scenario to reset it with.
        actions: What a component would propose, one per tick; ten or more tell the most. An
            episode that turns critical or reaches its goal is not stepped further.
        seeds: The seed that is checked, and another one for the episode in between.
        time_step: Simulated seconds per tick; the simulator's own if not given.

    Raises:
        ConformanceError: With every breach that was found and how to mend it.
    """
    name, build = builder(factory)
    findings = Findings(f"simulator {name}")
    built: list[Simulator] = []

    def fresh() -> Simulator:
        simulator = build()
        if not isinstance(simulator, Simulator):
            raise TypeError(f"the factory gave a {type(simulator).__name__}, not a Simulator")
        built.append(simulator)
        if time_step is not None:
            simulator.set_time_step(time_step)
        return simulator

    _Kit(findings, fresh, scenario, list(actions), seeds).run()
    for simulator in built:
        with findings.checking("close"):
            simulator.close()
    return findings.report()


@dataclass
class _Trace:
    """One episode: its ticks, what they were when they were new, and its signals."""

    ticks: list[Tick]
    copies: list[dict[str, Any]]
    signals: dict[str, Any]


class _Kit:
    def __init__(
        self,
        findings: Findings,
        fresh: Callable[[], Simulator],
        scenario: Mapping[str, Any],
        actions: list[Any],
        seeds: tuple[int, int],
    ) -> None:
        self.findings, self._fresh, self.scenario = findings, fresh, scenario
        self.actions, self.seeds = actions, seeds

    def run(self) -> None:
        check = self.findings.checking
        before = leaves(self.scenario)
        reference: _Trace | None = None
        with check("an episode can be run"):
            reference = self._episode(self._fresh(), self.seeds[0])
        if reference is None:
            return
        with check("ticks: index, time and types"):
            self._check_ticks(reference.ticks, self._fresh().time_step)
        with check("ticks: read-only, and unchanged by later steps"):
            self._check_frozen(reference)
        with check("signals: finite float64, one value per tick"):
            self._check_signals()
        with check("determinism: instances, orders, episodes before"):
            self._check_determinism(reference)
        with check("actions: None and NaN are refused, descriptions are stable"):
            self._check_actions()
        with check("fallback action"):
            self._check_fallback()
        with check("lazy channels"):
            self._check_lazy()
        with check("time step"):
            self._check_time_step()
        with check("snapshot and restore"):
            self._check_snapshot(reference)
        with check("render"):
            self._check_render(reference)
        with check("close leaves other instances alone"):
            self._check_close(reference)
        if (path := first_difference(before, leaves(self.scenario))) is not None:
            self.findings.breach(
                f"the scenario was changed at {path}", "read the scenario, and copy what you change"
            )

    def _episode(self, simulator: Simulator, seed: int, at: int | None = None) -> _Trace:
        """One episode; rendered at tick ``at``, if given."""
        ticks = [simulator.reset(self.scenario, seed)]
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if ticks[-1].index == at:
                simulator.render()
            if _over(ticks[-1]):
                break
            ticks.append(simulator.step(simulator.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return _Trace(ticks, copies, leaves(simulator.signals(ticks)))

    def _check_ticks(self, ticks: list[Tick], dt: float) -> None:
        for index, tick in enumerate(ticks):
            if not isinstance(tick, Tick):
                kind = type(tick).__name__
                self.findings.breach(f"reset or step returned a {kind}", "return a Tick")
                return
            if tick.index != index or type(tick.index) is not int:
                self.findings.breach(
                    f"tick number {index} has the index {tick.index!r}",
                    "count from 0 at reset, in int, one per step",
                )
                return
            if not abs(tick.time - index * dt) <= 1e-9 * max(1.0, index * dt):
                self.findings.breach(
                    f"tick {index} has the time {tick.time!r} s, expected {index * dt:g} s",
                    "set time to index * self.time_step",
                )
                return
            if not (tick.critical is None or isinstance(tick.critical, str)):
                self.findings.breach(
                    f"critical is {tick.critical!r} at tick {index}", "give the reason, or None"
                )
            for event in tick.events:
                if len(event) != 3 or not all(isinstance(part, str) for part in event):
                    self.findings.breach(
                        f"tick {index} has the event {event!r}",
                        "an event is three texts: kind, subject, detail",
                    )

    def _check_frozen(self, trace: _Trace) -> None:
        for tick, copy in zip(trace.ticks, trace.copies, strict=True):
            if (path := first_difference(copy, leaves(tick))) is not None:
                self.findings.breach(
                    f"{path} of tick {tick.index} was changed by a later step",
                    "copy the simulator's state into each tick",
                )
                break
        for name, values in (
            ("truth", trace.ticks[-1].truth),
            ("channels", trace.ticks[-1].channels),
        ):
            for key, value in values.items():
                for part in mutable_parts(value):
                    self.findings.breach(
                        f"{name}[{key!r}] is not read-only: {part}",
                        "use tuples, MappingProxyType, frozen dataclasses, and arrays with"
                        " flags.writeable = False",
                    )

    def _check_signals(self) -> None:
        simulator = self._fresh()
        again = self._episode(simulator, self.seeds[0])
        percepts = [Percept(tick.channels) for tick in again.ticks]
        tables = {
            "signals": simulator.signals(again.ticks),
            "percept_signals": simulator.percept_signals(percepts),
        }
        if not tables["signals"]:
            self.findings.breach("there are no signals", "return at least one signal")
        for table, columns in tables.items():
            for name, column in columns.items():
                shape, dtype = np.shape(column), getattr(column, "dtype", type(column).__name__)
                if shape != (len(again.ticks),) or dtype != np.float64:
                    self.findings.breach(
                        f"{table}[{name!r}] is {dtype} of shape {shape},"
                        f" expected float64 of shape ({len(again.ticks)},)",
                        "return one float64 per tick",
                    )
                elif table == "signals" and not np.isfinite(column).all():
                    self.findings.breach(
                        f"signals[{name!r}] is not finite at tick"
                        f" {np.flatnonzero(~np.isfinite(column))[0]}",
                        "saturate a signal that has no value at a declared cap",
                    )

    def _check_determinism(self, reference: _Trace) -> None:
        seed, other = self.seeds
        early, late = self._fresh(), self._fresh()
        with _other_global_randomness():
            self._compare(reference, self._episode(late, seed), "another instance")
        self._episode(early, other)
        self._compare(reference, self._episode(early, seed), "an instance after another episode")
        self._compare(reference, self._episode(early, seed), "the same instance, reset again")
        self._compare(reference, self._episode(late, seed), "an older instance, after others ran")
        self._compare(reference, self._interleaved(), "an instance stepped in turn with another")

    def _interleaved(self) -> _Trace:
        one, two = self._fresh(), self._fresh()
        ticks = [one.reset(self.scenario, self.seeds[0])]
        shadow = two.reset(self.scenario, self.seeds[1])
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if _over(ticks[-1]):
                break
            if not _over(shadow):
                shadow = two.step(two.check_action(action))
            ticks.append(one.step(one.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return _Trace(ticks, copies, leaves(one.signals(ticks)))

    def _compare(self, one: _Trace, other: _Trace, who: str) -> None:
        """A breach if two episodes that should be equal are not."""
        for index, (left, right) in enumerate(zip(one.copies, other.copies, strict=False)):
            if (path := first_difference(left, right)) is not None:
                self.findings.breach(f"{who} differs at tick {index} in {path}", PURE)
                return
        if len(one.copies) != len(other.copies):
            ends = f"{len(one.copies)} and {len(other.copies)}"
            self.findings.breach(f"{who} ends at another tick: {ends} ticks", PURE)
        elif (path := first_difference(one.signals, other.signals)) is not None:
            self.findings.breach(f"{who} has another signal {path}", PURE)

    def _check_actions(self) -> None:
        simulator = self._fresh()
        simulator.reset(self.scenario, self.seeds[0])
        for wrong in (None, float("nan")):
            try:
                simulator.check_action(wrong)
            except ActionError:
                continue
            except Exception as error:
                found = f"raises {describe_error(error)}"
            else:
                found = "accepts it"
            self.findings.breach(
                f"check_action({wrong}) {found}", "raise ActionError and say what is expected"
            )
        for action in self.actions:
            text = simulator.describe_action(simulator.check_action(action))
            if not isinstance(text, str) or re.search(r"\b0x[0-9a-fA-F]{6,}", text):
                self.findings.breach(
                    f"describe_action gives {text!r}",
                    "describe an action by a text that is the same in every process",
                )
                return

    def _check_fallback(self) -> None:
        simulator = self._fresh()
        simulator.reset(self.scenario, self.seeds[0])
        action = simulator.fallback_action()
        tick = simulator.step(action)
        if tick.index != 1:
            self.findings.breach(
                f"a step with the fallback action leads to tick {tick.index}",
                "return from fallback_action what step takes",
            )
        simulator.describe_action(action)

    def _check_lazy(self) -> None:
        """A lazy value read later must be what it would have been, or refuse to be read."""
        at_once, later = self._fresh(), self._fresh()
        prompt = at_once.reset(self.scenario, self.seeds[0]).channels
        lazy = later.reset(self.scenario, self.seeds[0]).channels
        names = [name for name, value in prompt.items() if isinstance(value, Lazy)]
        if not names:
            raise NotImplementedError
        now = {name: leaves(prompt[name].get()) for name in names}
        for action in self.actions[:3]:
            if _over(later.step(later.check_action(action))):
                break
        for name in names:
            try:
                value = leaves(lazy[name].get())
            except ConfigurationError:
                continue
            if first_difference(now[name], value) is not None:
                self.findings.breach(
                    f"lazy channel {name!r} shows another instant if it is read after a step",
                    "raise ConfigurationError when it is read too late, or keep what it needs",
                )

    def _check_time_step(self) -> None:
        for wrong in (0.0, -0.1, float("nan"), float("inf")):
            simulator = self._fresh()
            try:
                simulator.set_time_step(wrong)
            except ConfigurationError:
                continue
            self.findings.breach(
                f"set_time_step({wrong}) is accepted",
                "raise ConfigurationError for what is not a positive number",
            )
        simulator = self._fresh()
        half = simulator.time_step / 2
        try:
            simulator.set_time_step(half)
        except ConfigurationError:
            self.findings.not_supported.append(f"a time step of {half:g} s")
            return
        trace = self._episode(simulator, self.seeds[0])
        if len(trace.ticks) > 1 and abs(trace.ticks[1].time - half) > 1e-9:
            self.findings.breach(
                f"after set_time_step({half:g}) the first tick is at {trace.ticks[1].time:g} s",
                "advance by self.time_step, or refuse a step that you cannot take",
            )

    def _check_snapshot(self, reference: _Trace) -> None:
        simulator = self._fresh()
        simulator.reset(self.scenario, self.seeds[0])
        middle = (len(reference.ticks) - 1) // 2
        for action in self.actions[:middle]:
            simulator.step(simulator.check_action(action))
        with suppress(NotImplementedError):
            simulator.render()  # a renderer must not stand in the way
        snapshot = simulator.snapshot()
        rest = self.actions[middle : len(reference.ticks) - 1]
        for attempt in ("the run on from", "the first return to", "the second return to"):
            expected = reference.copies[middle + 1 :]
            for action, copy in zip(rest, expected, strict=True):
                tick = simulator.step(simulator.check_action(action))
                if (path := first_difference(copy, leaves(tick))) is not None:
                    self.findings.breach(
                        f"{attempt} a snapshot differs at tick {tick.index} in {path}",
                        "snapshot all state, random generators included, and restore copies of it",
                    )
                    return
            simulator.restore(snapshot)

    def _check_render(self, reference: _Trace) -> None:
        simulator = self._fresh()
        simulator.reset(self.scenario, self.seeds[0])
        picture = simulator.render()
        if not (
            isinstance(picture, np.ndarray)
            and picture.dtype == np.uint8
            and picture.ndim == 3
            and picture.shape[2] == 3
        ):
            found = f"{getattr(picture, 'dtype', type(picture).__name__)} {np.shape(picture)}"
            self.findings.breach(
                f"render gives {found}", "return a uint8 array of shape (height, width, 3)"
            )
        elif not picture.any():
            self.findings.breach(
                "the rendered picture is all black", "render without SDL_VIDEODRIVER=dummy"
            )
        self._compare(
            reference, self._episode(self._fresh(), self.seeds[0], at=0), "with rendering"
        )

    def _check_close(self, reference: _Trace) -> None:
        other, simulator = self._fresh(), self._fresh()
        self._episode(other, self.seeds[0])
        other.close()
        trace = self._episode(simulator, self.seeds[0])
        self._compare(reference, trace, "an instance, after another was closed")


def _over(tick: Tick) -> bool:
    return tick.critical is not None or tick.goal


@contextmanager
def _other_global_randomness() -> Iterator[None]:
    """Other global random states for a while: what draws from them gives itself away."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the subject's sin
    random.seed(987654321)
    np.random.seed(987654321)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
