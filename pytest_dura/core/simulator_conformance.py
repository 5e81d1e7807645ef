"""Conformance of a simulator adapter to the contract of ``Simulator``, optional parts included.

A check of an optional part raises ``NotImplementedError`` where the adapter does not have it. Of a
simulator of which a process runs one, each instance is closed before the next is built. Episodes
of one that is not deterministic are compared by its signals, within its tolerances.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.conformance import (
    ConformanceReport,
    Findings,
    first_difference,
    leaves,
    mutable_parts,
    named_builder,
)
from pytest_dura.core.episode import check_scenario_keys
from pytest_dura.core.errors import ActionError, ConfigurationError, describe_error
from pytest_dura.core.percepts import Lazy, Percept
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.simulator import (
    Simulator,
    beyond_tolerance,
    checked_aliases,
    scene_problems,
    value_problems,
)
from pytest_dura.core.simulator_process import simulating
from pytest_dura.core.state import Tick

PURE = "make the adapter a pure function of scenario, seed and actions"
_TOLERANT = "declare the tolerance that its repetitions keep, or make it deterministic"


@dataclass
class CheckedEpisode:
    """One episode: its ticks, copies of them made at once, and its signals."""

    ticks: list[Tick]
    copies: list[dict[str, Any]]
    columns: dict[str, NDArray[np.float64]]
    signals: dict[str, Any]


@dataclass(frozen=True)
class EpisodeRuns:
    """Runner of episodes with the same actions.

    Args:
        findings: Collects the breaches.
        fresh: Builds a simulator.
        scenario: The scenario to reset it with.
        actions: One per tick.
        seeds: The seed that is checked, and another one.
        kind: The class of the simulator.
    """

    findings: Findings
    fresh: Callable[[], Simulator]
    scenario: Mapping[str, Any]
    actions: Sequence[Any]
    seeds: tuple[int, int]
    kind: type[Simulator]

    @property
    def singly(self) -> bool:
        """Whether one instance at a time is alive."""
        return self.kind.instances != "many"

    def episode(self, simulator: Simulator, seed: int, at: int | None = None) -> CheckedEpisode:
        """Run one episode; rendered at tick ``at``, if given."""
        ticks = [simulator.reset(self.scenario, seed)]
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if ticks[-1].index == at:
                simulator.render()
            if _is_over(ticks[-1]):
                break
            ticks.append(simulator.step(simulator.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return _checked(simulator, ticks, copies)

    def interleaved(self) -> CheckedEpisode:
        """Run one episode, in turn with one of the other seed in another instance."""
        simulator, other = self.fresh(), self.fresh()
        ticks = [simulator.reset(self.scenario, self.seeds[0])]
        shadow = other.reset(self.scenario, self.seeds[1])
        copies = [leaves(ticks[0])]
        for action in self.actions:
            if _is_over(ticks[-1]):
                break
            if not _is_over(shadow):
                shadow = other.step(other.check_action(action))
            ticks.append(simulator.step(simulator.check_action(action)))
            copies.append(leaves(ticks[-1]))
        return _checked(simulator, ticks, copies)

    def compare(self, episode: CheckedEpisode, other: CheckedEpisode, who: str) -> None:
        """Add a breach if two episodes that should be equal are not."""
        if not self.kind.deterministic:
            beyond = beyond_tolerance(self.kind.tolerances, episode.columns, other.columns)
            if beyond is not None:
                self.findings.breach(f"{who}: {beyond}", _TOLERANT)
            return
        for index, (left, right) in enumerate(zip(episode.copies, other.copies, strict=False)):
            if (path := first_difference(left, right)) is not None:
                self.findings.breach(f"{who} differs at tick {index} in {path}", PURE)
                return
        if len(episode.copies) != len(other.copies):
            ends = f"{len(episode.copies)} and {len(other.copies)}"
            self.findings.breach(f"{who} ends at another tick: {ends} ticks", PURE)
        elif (path := first_difference(episode.signals, other.signals)) is not None:
            self.findings.breach(f"{who} has another signal {path}", PURE)


def _checked(
    simulator: Simulator, ticks: list[Tick], copies: list[dict[str, Any]]
) -> CheckedEpisode:
    columns = simulator.signals(ticks)
    return CheckedEpisode(ticks, copies, dict(columns), leaves(columns))


def _is_over(tick: Tick) -> bool:
    """Whether an episode is not stepped further."""
    return tick.critical is not None or tick.goal or tick.truncated


@contextmanager
def _other_global_randomness() -> Iterator[None]:
    """Context with other global random states, which show in a simulator that draws from them."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the simulator's fault
    random.seed(987654321)
    np.random.seed(987654321)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


def _check_lazy(runs: EpisodeRuns) -> None:
    """A lazy value that is read later is what it was at its tick, or refuses to be read."""
    early = runs.fresh().reset(runs.scenario, runs.seeds[0]).channels
    names = [name for name, value in early.items() if isinstance(value, Lazy)]
    if not names:
        raise NotImplementedError
    now = {name: leaves(early[name].get()) for name in names}
    if not runs.kind.deterministic:  # another run shows something else at any instant
        return
    later = runs.fresh()
    tick = later.reset(runs.scenario, runs.seeds[0])
    lazy = tick.channels
    for action in runs.actions[:3]:
        if _is_over(tick):
            break
        tick = later.step(later.check_action(action))
    for name in names:
        try:
            value = leaves(lazy[name].get())
        except ConfigurationError:
            continue
        if first_difference(now[name], value) is not None:
            runs.findings.breach(
                f"lazy channel {name!r} shows another instant if it is read after a step",
                "raise ConfigurationError when it is read too late, or keep what it needs",
            )


def check_time_step(runs: EpisodeRuns) -> None:
    """Check that another time step is kept or refused, and an impossible one refused."""
    for wrong in (0.0, -0.1, float("nan"), float("inf")):
        simulator = runs.fresh()
        try:
            simulator.set_time_step(wrong)
        except ConfigurationError:
            continue
        runs.findings.breach(
            f"set_time_step({wrong}) is accepted",
            "raise ConfigurationError for what is not a positive number",
        )
    simulator = runs.fresh()
    half = simulator.time_step / 2
    try:
        simulator.set_time_step(half)
    except ConfigurationError:
        runs.findings.not_supported.append(f"a time step of {half:g} s")
        return
    trace = runs.episode(simulator, runs.seeds[0])
    if len(trace.ticks) > 1 and abs(trace.ticks[1].time - half) > 1e-9:
        runs.findings.breach(
            f"after set_time_step({half:g}) the first tick is at {trace.ticks[1].time:g} s",
            "advance by self.time_step, or refuse a step that you cannot take",
        )


def _check_snapshot(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """A snapshot leads twice to the same rest of the episode."""
    simulator = runs.fresh()
    simulator.reset(runs.scenario, runs.seeds[0])
    middle = (len(reference.ticks) - 1) // 2
    for action in runs.actions[:middle]:
        simulator.step(simulator.check_action(action))
    with suppress(NotImplementedError):
        simulator.render()  # a renderer must not stand in the way
    snapshot = simulator.snapshot()
    if not runs.kind.deterministic:
        simulator.restore(snapshot)
        return
    rest = runs.actions[middle : len(reference.ticks) - 1]
    for attempt in ("the run on from", "the first return to", "the second return to"):
        expected = reference.copies[middle + 1 :]
        for action, copy in zip(rest, expected, strict=True):
            tick = simulator.step(simulator.check_action(action))
            if (path := first_difference(copy, leaves(tick))) is not None:
                runs.findings.breach(
                    f"{attempt} a snapshot differs at tick {tick.index} in {path}",
                    "snapshot all state, random generators included, and restore copies of it",
                )
                return
        simulator.restore(snapshot)


def _check_render(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """It gives a picture, and moves nothing on."""
    simulator = runs.fresh()
    simulator.reset(runs.scenario, runs.seeds[0])
    picture = simulator.render()
    if not (
        isinstance(picture, np.ndarray)
        and picture.dtype == np.uint8
        and picture.ndim == 3
        and picture.shape[2] == 3
    ):
        text = f"{getattr(picture, 'dtype', type(picture).__name__)} {np.shape(picture)}"
        runs.findings.breach(
            f"render gives {text}", "return a uint8 array of shape (height, width, 3)"
        )
    elif not picture.any():
        runs.findings.breach(
            "the rendered picture is all black", "render without SDL_VIDEODRIVER=dummy"
        )
    runs.compare(reference, runs.episode(runs.fresh(), runs.seeds[0], at=0), "with rendering")


def _check_scene(runs: EpisodeRuns, reference: CheckedEpisode) -> None:
    """The scene of an episode is valid, also of one that ended at once, and changes nothing."""
    scenes = []
    for number in range(2):
        simulator = runs.fresh()
        ticks = runs.episode(simulator, runs.seeds[0]).ticks
        before = leaves(ticks)
        scene = simulator.scene(ticks, [_percept(simulator, tick) for tick in ticks])
        scenes.append(leaves(scene))
        if scene is None:
            continue
        if (path := first_difference(before, leaves(ticks))) is not None:
            runs.findings.breach(f"scene changed ticks{path}", "read the ticks, and copy them")
        problems = list(scene_problems(scene, len(ticks))) or value_problems(scene)
        for problem in problems:
            runs.findings.breach(*problem)
        if number == 0:
            again = runs.episode(simulator, runs.seeds[0])
            runs.compare(reference, again, "an instance, after scene")
    if scenes[0] == scenes[1] == leaves(None):
        raise NotImplementedError
    if runs.kind.deterministic and (path := first_difference(*scenes)) is not None:
        runs.findings.breach(f"another instance has another scene, in {path}", PURE)
    tick = simulator.reset(runs.scenario, runs.seeds[0])
    scene = simulator.scene([tick], [_percept(simulator, tick)])
    for problem in scene_problems(scene, 1) if scene is not None else ():
        runs.findings.breach(*problem)


def _percept(simulator: Simulator, tick: Tick) -> Percept:
    return Percept(tick.channels, aliases=simulator.channel_aliases)


def check_simulator(
    factory: RoleSpec | Callable[[], Simulator[Any, Any]],
    scenario: Mapping[str, Any],
    actions: Sequence[Any],
    seeds: tuple[int, int] = (0, 1),
    time_step: float | None = None,
) -> ConformanceReport:
    """Check that a simulator adapter keeps its contract.

    Args:
        factory: Builds a fresh simulator at each call.
        scenario: The scenario to reset it with.
        actions: Actions as a component proposes them, one per tick; use ten or more. An episode
            that turns critical, is truncated or reaches its goal is not stepped further.
        seeds: The seed that is checked, and another one for the episode in between.
        time_step: Simulated seconds per tick; the simulator's own if not given.

    Raises:
        ConformanceError: With every breach and how to mend it.
        ConfigurationError: For an unknown key of the scenario.
    """
    check_scenario_keys(scenario, ("seeds", "time_step"))
    name, build = named_builder(factory)
    findings = Findings(f"simulator {name}")
    kind = factory.factory() if isinstance(factory, RoleSpec) else factory
    with findings.checking("open_process"), simulating(kind):
        _check_built(findings, build, scenario, list(actions), seeds, time_step)
    return findings.report()


def _check_built(  # noqa: PLR0917 - a private function with a single call
    findings: Findings,
    build: Callable[[], Any],
    scenario: Mapping[str, Any],
    actions: list[Any],
    seeds: tuple[int, int],
    time_step: float | None,
) -> None:
    built: list[Simulator] = []

    def fresh() -> Simulator:
        if built and built[-1].instances != "many":
            built.pop().close()
        simulator = build()
        if not isinstance(simulator, Simulator):
            raise TypeError(f"the factory gave a {type(simulator).__name__}, not a Simulator")
        built.append(simulator)
        if time_step is not None:
            simulator.set_time_step(time_step)
        return simulator

    kind: type[Simulator] | None = None
    with findings.checking("it can be built"):
        kind = type(fresh())
    if kind is not None:
        _SimulatorKit(EpisodeRuns(findings, fresh, scenario, actions, seeds, kind)).run()
    for simulator in built:
        with findings.checking("close"):
            simulator.close()


class _SimulatorKit:
    def __init__(self, runs: EpisodeRuns) -> None:
        self.runs, self.findings = runs, runs.findings

    def run(self) -> None:
        check = self.findings.checking
        before = leaves(self.runs.scenario)
        with check("declarations: instances, deterministic, tolerances, lacks"):
            self._check_declarations()
        with check("check_scenario: the scenario's world, and its own result"):
            self._check_world()
        reference: CheckedEpisode | None = None
        with check("an episode can be run"):
            reference = self.runs.episode(self.runs.fresh(), self.runs.seeds[0])
        if reference is None:
            return
        with check("ticks: index, time and types"):
            self._check_ticks(reference.ticks, self.runs.fresh().time_step)
        with check("channel_aliases: free names, each of a channel"):
            checked_aliases(self.runs.kind, reference.ticks[0].channels)
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
            _check_lazy(self.runs)
        with check("time step"):
            check_time_step(self.runs)
        with check("snapshot and restore"):
            _check_snapshot(self.runs, reference)
        with check("render"):
            _check_render(self.runs, reference)
        with check("scene"):
            _check_scene(self.runs, reference)
        if not self.runs.singly:
            with check("close leaves other instances alone"):
                self._check_close(reference)
        if (path := first_difference(before, leaves(self.runs.scenario))) is not None:
            self.findings.breach(
                f"the scenario was changed at {path}", "read the scenario, and copy what you change"
            )

    def _check_declarations(self) -> None:
        kind, breach = self.runs.kind, self.findings.breach
        if kind.instances not in ("many", "one per process", "one"):
            remedy = 'say "many", "one per process" or "one"'
            breach(f"instances is {kind.instances!r}", remedy)
        if not kind.deterministic and not kind.tolerances:
            breach("it is not deterministic, and declares no tolerances", _TOLERANT)
        for name, tolerance in kind.tolerances.items():
            if not 0.0 <= tolerance < float("inf"):
                breach(f"the tolerance of {name} is {tolerance!r}", "give a number of at least 0")
        for key, reason in kind.lacks.items():
            if not (isinstance(key, str) and isinstance(reason, str) and key and reason):
                breach(f"lacks has {key!r}: {reason!r}", "map what is lacking to the reason")

    def _check_world(self) -> None:
        world = self.runs.scenario.get("world", {})
        checked = self.runs.kind.check_scenario(world)
        again = self.runs.kind.check_scenario(checked)
        if (path := first_difference(leaves(checked), leaves(again))) is not None:
            self.findings.breach(
                f"check_scenario changes its own result at {path}",
                "fill in defaults once, so that a checked world stays as it is",
            )
        for key, _, reason in self.runs.kind.lacking(checked):
            self.findings.breach(
                f"the scenario needs {key}, which it lacks: {reason}",
                "check it with a scenario that it can simulate",
            )

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

    def _check_frozen(self, trace: CheckedEpisode) -> None:
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
        simulator = self.runs.fresh()
        again = self.runs.episode(simulator, self.runs.seeds[0])
        percepts = [_percept(simulator, tick) for tick in again.ticks]
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
        self._check_hindsight(simulator, again.ticks, tables["signals"])

    def _check_hindsight(
        self, simulator: Simulator, ticks: list[Tick], whole: Mapping[str, NDArray[np.float64]]
    ) -> None:
        """Samples do not change with later ticks: verdicts may be decided before the end."""
        if any(
            np.shape(column) != (len(ticks),) or not np.isfinite(column).all()
            for column in whole.values()
        ):
            return  # a breach already
        changed: dict[str, int] = {}
        for size in sorted({1, len(ticks) // 2, len(ticks) - 1} - {0}):
            for name, column in simulator.signals(ticks[:size]).items():
                sure = name in whole and name not in simulator.hindsight
                if sure and not np.allclose(column, whole[name][:size]):
                    changed.setdefault(name, size)
        for name, size in changed.items():
            self.findings.breach(
                f"signals[{name!r}] of the first {size} ticks changes once more have followed",
                "let a value rest on earlier ticks alone, or name the signal in `hindsight`",
            )

    def _check_determinism(self, reference: CheckedEpisode) -> None:
        seed, other = self.runs.seeds
        early = self.runs.fresh()
        late = early if self.runs.singly else self.runs.fresh()
        with _other_global_randomness():
            self.runs.compare(reference, self.runs.episode(late, seed), "another instance")
        self.runs.episode(early, other)
        self.runs.compare(
            reference, self.runs.episode(early, seed), "an instance after another episode"
        )
        self.runs.compare(
            reference, self.runs.episode(early, seed), "the same instance, reset again"
        )
        if self.runs.singly:
            return
        self.runs.compare(
            reference, self.runs.episode(late, seed), "an older instance, after others ran"
        )
        self.runs.compare(
            reference, self.runs.interleaved(), "an instance stepped in turn with another"
        )

    def _check_actions(self) -> None:
        simulator = self.runs.fresh()
        simulator.reset(self.runs.scenario, self.runs.seeds[0])
        for wrong in (None, float("nan")):
            try:
                simulator.check_action(wrong)
            except ActionError:
                continue
            except Exception as error:
                outcome = f"raises {describe_error(error)}"
            else:
                outcome = "accepts it"
            self.findings.breach(
                f"check_action({wrong}) {outcome}", "raise ActionError and say what is expected"
            )
        for action in self.runs.actions:
            text = simulator.describe_action(simulator.check_action(action))
            if not isinstance(text, str) or re.search(r"\b0x[0-9a-fA-F]{6,}", text):
                self.findings.breach(
                    f"describe_action gives {text!r}",
                    "describe an action by a text that is the same in every process",
                )
                return

    def _check_fallback(self) -> None:
        simulator = self.runs.fresh()
        first = simulator.reset(self.runs.scenario, self.runs.seeds[0])
        action = simulator.fallback_action()
        if not _is_over(first) and (tick := simulator.step(action)).index != 1:
            self.findings.breach(
                f"a step with the fallback action leads to tick {tick.index}",
                "return from fallback_action what step takes",
            )
        simulator.describe_action(action)

    def _check_close(self, reference: CheckedEpisode) -> None:
        other, simulator = self.runs.fresh(), self.runs.fresh()
        self.runs.episode(other, self.runs.seeds[0])
        other.close()
        trace = self.runs.episode(simulator, self.runs.seeds[0])
        self.runs.compare(reference, trace, "an instance, after another was closed")
