"""Simulator: the port to the physical world, and the scene that it may give to viewers.

The paper calls the port Environment Interface. A recording holds what viewers show of an episode
beside its signals; the digest leaves it out.
"""

from __future__ import annotations

import cmath
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, Literal, cast

import numpy as np
from numpy.typing import NDArray

from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ActionError, ConfigurationError, shorten, type_name
from pytest_dura.core.measures import Measure
from pytest_dura.core.messages import MESSAGES
from pytest_dura.core.percepts import Percept
from pytest_dura.core.registry import Registry
from pytest_dura.core.state import ActionT, Tick, TruthT

CHANNELS = "channels."
"""How the names of sensor channels begin in :attr:`Simulator.lacks`."""
POSE = ("x", "y", "heading", "speed", "length", "width")
"""Columns of :attr:`Tracks.poses`: m, m, rad, m/s, m, m."""


@dataclass(frozen=True)
class Line:
    """A fixed line of the scene, such as the edge of a lane.

    Args:
        kind: Such as ``edge``, ``marking``, ``stop_line`` or ``route``.
        points: In metres, shape ``(k, 2)``.
    """

    kind: str
    points: NDArray[np.float32]

    __repr__ = short_repr


@dataclass(frozen=True)
class Tracks:
    """Poses of things, tick by tick.

    Args:
        ids: One id per thing, the same in the truth and in the percept.
        poses: Shape ``(ticks, things, 6)``, see :data:`POSE`; NaN where a thing is absent.
    """

    ids: tuple[str, ...]
    poses: NDArray[np.float32]

    __repr__ = short_repr


@dataclass(frozen=True)
class Scene:
    """The world from above, in metres and radians; x to the right, y downwards, angles clockwise.

    Args:
        lines: Fixed lines.
        truth: Things as the simulator knows them.
        percept: Things as the sensors report them after faults. One that the truth lacks is a
            ghost.
        ego: Id of the thing that the component steers.
    """

    lines: tuple[Line, ...]
    truth: Tracks
    percept: Tracks
    ego: str

    __repr__ = short_repr


@dataclass(frozen=True)
class Recording:
    """Texts of each decision, and the scene.

    Args:
        explanations: The component's explanation of its proposal, one per decision.
        reasons: Why the proposal was doubted or refused, one per decision; empty where it was not.
        recoveries: Name and explanation of the recovery action, one per decision; empty where
            there was none.
        flags: By monitor, its verdict at each decision: 0 safe, 1 warning, 2 unsafe, -1 where it
            did not run. Shape ``(decisions,)``.
        scene: The scene, if the simulator gives one.
        problem: Why there is no scene, if the simulator failed to give it.
        accounts: The component's account of each decision; empty if it gave none at all.
    """

    explanations: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    recoveries: tuple[str, ...] = ()
    flags: Mapping[str, NDArray[np.int8]] = field(default_factory=dict)
    scene: Scene | None = None
    problem: str | None = None
    accounts: tuple[Mapping[str, Any], ...] = ()

    __repr__ = short_repr


def scene_problems(scene: Any, ticks: int) -> Iterator[tuple[str, str]]:
    """Find what is wrong with the types and shapes of a scene: ``(problem, remedy)``.

    Args:
        scene: The result of a simulator's ``scene``, of any type.
        ticks: Number of ticks that it was given.
    """
    if not isinstance(scene, Scene):
        yield f"scene is a {type(scene).__name__}", "return a pytest_dura.Scene, or None"
        return
    lines = scene.lines
    if not isinstance(lines, tuple) or not all(isinstance(line, Line) for line in lines):
        yield "lines is no tuple of Line", "return a tuple of pytest_dura.Line"
    else:
        for number, line in enumerate(lines):
            yield from _line_problems(f"lines[{number}]", line)
    for name in ("truth", "percept"):
        yield from _tracks_problems(name, getattr(scene, name), ticks)
    if not isinstance(scene.ego, str):
        yield f"ego is a {type(scene.ego).__name__}", "give the id of what the component steers"


def value_problems(scene: Scene) -> Iterator[tuple[str, str]]:
    """Find what is wrong with the values of a scene without faults: ``(problem, remedy)``."""
    for number, line in enumerate(scene.lines):
        if not np.isfinite(line.points).all():
            yield f"lines[{number}].points is not finite", "give x and y in metres"
    for name in ("truth", "percept"):
        poses = getattr(scene, name).poses
        absent = np.isnan(poses).any(axis=2)
        if np.isinf(poses).any() or not np.isnan(poses[absent]).all():
            yield (
                f"{name}.poses is not finite where something is present",
                "give all of a pose, or NaN for all of it where the thing is absent",
            )
    if scene.ego not in scene.truth.ids:
        yield (
            f"ego is {scene.ego!r}, which is not in truth.ids",
            "name the thing that the component steers",
        )


def _line_problems(name: str, line: Line) -> Iterator[tuple[str, str]]:
    if not isinstance(line.kind, str):
        yield f"{name}.kind is a {type(line.kind).__name__}", "name the kind of the line"
    shape = np.shape(line.points)
    if not _is_float32(line.points) or len(shape) != 2 or shape[1] != 2:
        yield (
            f"{name}.points is {_described(line.points)}, expected float32 of shape (k, 2)",
            "give x and y in metres as float32",
        )


def _tracks_problems(name: str, tracks: Any, ticks: int) -> Iterator[tuple[str, str]]:
    if not isinstance(tracks, Tracks):
        yield f"{name} is a {type(tracks).__name__}", "return pytest_dura.Tracks"
        return
    ids = tracks.ids
    if not isinstance(ids, tuple) or not all(isinstance(name, str) for name in ids):
        yield f"{name}.ids is no tuple of texts", "name each thing by a text"
        return
    if len(set(ids)) < len(ids):
        twice = next(name for name in ids if ids.count(name) > 1)
        yield f"{name}.ids has {twice!r} more than once", "give each thing an id of its own"
    expected = (ticks, len(ids), len(POSE))
    if not _is_float32(tracks.poses) or np.shape(tracks.poses) != expected:
        yield (
            f"{name}.poses is {_described(tracks.poses)}, expected float32 of shape {expected}",
            "give a pose for each tick and each thing as float32, NaN where it is absent",
        )


def _is_float32(array: Any) -> bool:
    return isinstance(array, np.ndarray) and array.dtype == np.float32


def _described(array: Any) -> str:
    return f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"


class Simulator(ABC, Generic[TruthT, ActionT]):
    """World that is reset with a scenario and advanced one tick at a time.

    ``Simulator[Truth, Action]`` tells a type checker what :attr:`Tick.truth` holds, a ``TypedDict``
    for example, and what the plant takes; without them they are a mapping of anything and anything.

    An adapter must be a pure function of scenario, seed and actions, or say by
    :attr:`deterministic` that it is none. ``check_simulator`` of
    ``pytest_dura.core.simulator_conformance`` tests that, and the rest of this contract.
    """

    instances: ClassVar[Literal["many", "one per process", "one"]] = "many"
    """Whether several may live in one process. Of ``one per process`` the loop runs one episode at
    a time, from building to closing; many processes simulate as many at a time. Of ``one``, such as
    a test rig, one process simulates: pytest's own."""

    imports: ClassVar[tuple[str, ...]] = ()
    """Modules that its first episode imports; the process from which others are forked imports them
    before, once for all."""

    deterministic: ClassVar[bool] = True
    """Whether equal scenarios, seeds and actions give equal ticks to the last bit. If not, a replay
    and the repetition within a session compare signals within :attr:`tolerances`."""

    tolerances: ClassVar[Mapping[str, float]] = {}
    """Greatest difference of a signal between two runs of one episode that counts as the same, in
    the signal's unit, of a simulator that is not deterministic. Signals that it does not name are
    not compared, and at least one has to be named."""

    repeatable: ClassVar[bool] = True
    """Whether a repeated episode is the same, within :attr:`tolerances` if there are any. If not,
    the runs of a case count as draws: a repetition that differs leaves no verdict undecided, and
    reports say so."""

    lacks: ClassVar[Mapping[str, str]] = {}
    """What this simulator cannot do, with the reason in a few words: a dotted key of the world
    (``doors``, ``controls.signals``), or ``channels.`` with the name of a sensor channel.

    A scenario that gives such a key a value, or plans a fault of such a channel, is refused when it
    is loaded."""

    channel_aliases: ClassVar[Mapping[str, str]] = {}
    """Second names of sensor channels, to their own: percepts, the targets of faults and conditions
    take either; records, messages and the percept's iteration have the channel's own."""

    time_step: float = 0.1
    """Simulated seconds per tick."""

    hindsight: ClassVar[frozenset[str]] = frozenset()
    """Signals whose value at a tick depends on later ticks, such as the time until the road is free
    again. No requirement on one of them is decided before an episode's end."""

    measures: ClassVar[Sequence[Measure]] = ()
    """Figures of its episodes, in the order in which tables show them. A factory of simulators that
    is a function has none, unless it is given the attribute."""

    def set_time_step(self, seconds: float) -> None:
        """Set the simulated seconds per tick; takes effect at the next reset."""
        if not 0.0 < seconds < float("inf"):
            raise ConfigurationError(
                "the time step of a simulator is a positive number of seconds",
                key="time_step",
                found=seconds,
                expected="a number above 0",
            )
        self.time_step = seconds

    @classmethod
    def open_process(cls) -> None:
        """Start what outlives episodes, such as a server, once in each process that simulates.

        It is called before the first episode there. An error refuses the episode.
        """

    @classmethod
    def close_process(cls) -> None:
        """Stop what :meth:`open_process` started; called at the end of the process.

        A process that is killed does not get there: what it starts should end with it.
        """

    @classmethod
    def check_scenario(cls, world: Mapping[str, Any]) -> dict[str, Any]:
        """Check a scenario's world and fill in its defaults; the base takes any, as it is.

        It is called when a scenario is loaded, and again for each episode with what was drawn.

        Raises:
            ConfigurationError: If the world cannot be simulated; its ``key`` begins with ``world``.
        """
        return dict(world)

    @classmethod
    def lacking(cls, world: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
        """Yield what a world needs and :attr:`lacks` names: dotted key, value and reason.

        Args:
            world: As :meth:`check_scenario` returns it.
        """
        for key, reason in cls.lacks.items():
            if key.startswith(CHANNELS):
                continue
            value: Any = world
            for part in key.split("."):
                value = value.get(part) if isinstance(value, Mapping) else None
            if value not in (None, False) and not (isinstance(value, Sized) and not len(value)):
                yield key, value, reason

    @classmethod
    def world_of_run(
        cls,
        world: Mapping[str, Any],
        run: int,  # noqa: ARG003 - for those who override it
    ) -> dict[str, Any]:
        """Return the world of a run; the base takes the same for all runs.

        Args:
            world: As :meth:`check_scenario` returns it, with what was drawn.
            run: Number of the run, from 0.
        """
        return dict(world)

    @classmethod
    def tells_runs_apart(cls) -> bool:
        """Whether runs have worlds of their own, so that equal runs say nothing of further ones."""
        own = getattr(cls.world_of_run, "__func__", cls.world_of_run)
        return own is not Simulator.world_of_run.__func__  # type: ignore[attr-defined]

    def recorded_episode(
        self,
        spec: Any,  # noqa: ARG002 - for those who override it
    ) -> Any:
        """Return the whole episode, where it was recorded and is not run; ``None`` to run it.

        Args:
            spec: The :class:`~pytest_dura.EpisodeSpec` that determines it.

        Returns:
            An :class:`~pytest_dura.Episode`, or ``None``.
        """
        return None

    @abstractmethod
    def reset(self, scenario: Mapping[str, Any], seed: int) -> Tick[TruthT]:
        """Begin an episode; the tick has index 0 and time 0."""

    @abstractmethod
    def step(self, action: ActionT) -> Tick[TruthT]:
        """Apply a checked action for one time step."""

    @abstractmethod
    def signals(self, ticks: Sequence[Tick[TruthT]]) -> dict[str, NDArray[np.float64]]:
        """Compute the ground-truth signals by name, one value per tick, shape ``(len(ticks),)``.

        It is called once per episode, so that it may be vectorised over time, and on the ticks so
        far if episodes end once all is decided. A value may depend on earlier ticks, but on later
        ones only if :attr:`hindsight` names the signal.
        """

    def percept_signals(
        self,
        percepts: Sequence[Percept],  # noqa: ARG002 - for those who override it
    ) -> dict[str, NDArray[np.float64]]:
        """Compute the signals that follow from percepts alone, one value per percept.

        The episode stores them with the prefix ``percept.``.
        """
        return {}

    def account_measures(
        self,
        ticks: Sequence[Tick[TruthT]],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
        accounts: Sequence[Mapping[str, Any]],  # noqa: ARG002 - see above
    ) -> dict[str, NDArray[np.float64]]:
        """Measure the component's failure modes from its accounts, one value per decision.

        It is called once per episode, and only if the component gave an account of any proposal.
        A value is 1 where the decision in force at a tick shows the failure, 0 where it does not,
        NaN where it could not show it. The episode stores them as signals with the prefix
        ``proposal.``, 0 for NaN, and counts them over the ticks with a new decision.

        Args:
            ticks: The true states.
            percepts: The percepts of these ticks.
            accounts: :attr:`Proposal.account` of each decision; empty where there was none.

        Returns:
            Columns of shape ``(len(accounts),)``.
        """
        return {}

    measure_kinds: ClassVar[Mapping[str, str]] = {}
    """Kind of the measures of :meth:`account_measures` that are no plain failure mode: ``control``
    or ``comparison``; see :class:`~pytest_dura.core.metrics.Tally`."""

    def account_signals(
        self,
        ticks: Sequence[Tick[TruthT]],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
        accounts: Sequence[Mapping[str, Any]],  # noqa: ARG002 - see above
    ) -> dict[str, NDArray[np.float64]]:
        """Compute signals from accounts beside failure modes, such as the age of a decision.

        As :meth:`account_measures`, whose names it shares, but of any numbers, and not counted.
        """
        return {}

    def found_events(
        self,
        ticks: Sequence[Tick[TruthT]],  # noqa: ARG002 - for those who override it
    ) -> Sequence[tuple[int, str, str, str]]:
        """Return events that only an episode as a whole shows: tick, kind, subject and detail.

        It is called once, after the episode. No verdict depends on it.
        """
        return ()

    def scene(
        self,
        ticks: Sequence[Tick[TruthT]],  # noqa: ARG002 - for those who override it
        percepts: Sequence[Percept],  # noqa: ARG002 - see above
    ) -> Scene | None:
        """Return the episode as seen from above, for the report's player; ``None`` without one.

        It is called at most once per episode, after its end. No verdict depends on it.
        """
        return None

    def check_action(self, action: Any) -> ActionT:
        """Check an action, and return it in the form that ``step`` takes.

        Of a component's action, numbers, texts, lists, tuples, dictionaries and arrays of numbers
        arrive as copies of exactly these types, objects of other classes, a dataclass for example,
        as they are. The base takes finite numbers, texts, and containers of them. A simulator with
        actions of a class of its own overrides this, and takes no other class; one with a closed
        set of actions refuses more.

        Raises:
            ActionError: If it is not an action of this simulator.
        """
        if action is None:
            raise ActionError("the proposal holds no action (None)")
        if type(action) is not float or not math.isfinite(action):  # the usual case
            wrong = _wrong_action(action)
            if wrong is not None:
                raise ActionError(wrong)
        return cast("ActionT", action)

    @abstractmethod
    def fallback_action(self) -> ActionT:
        """Return the action of the plant without any command."""

    def actuation(self, action: ActionT) -> Any:
        """Return a checked action as the actuators get it, which command faults change.

        The base returns the action itself. A simulator whose actions leave something open, such as
        the acceleration of a maneuver, fills that in here; ``step`` does the same with either.
        """
        return action

    def describe_action(self, action: ActionT) -> str:
        """Describe an action by a short, stable text for decisions and reports."""
        return str(action)

    def render(self) -> NDArray[np.uint8]:
        """Return an RGB picture of the current state, shape ``(height, width, 3)``."""
        raise NotImplementedError(f"{type(self).__name__} does not render")

    def snapshot(self) -> object:
        """Return the whole state, to branch from; opaque to the caller."""
        raise NotImplementedError(f"{type(self).__name__} has no snapshots")

    def restore(self, snapshot: object) -> None:
        """Return to a snapshot of this simulator; it may be restored more than once."""
        raise NotImplementedError(f"{type(self).__name__} has no snapshots")

    def close(self) -> None:
        """Release what the simulator holds; it is not used afterwards."""


def beyond_tolerance(
    tolerances: Mapping[str, float],
    signals: Mapping[str, NDArray[np.float64]],
    others: Mapping[str, NDArray[np.float64]],
) -> str | None:
    """Describe the first signal in which two runs of one episode differ by more than declared.

    Ticks that only one of the runs has are not compared: an end at the goal may come a tick later.

    Args:
        tolerances: See :attr:`Simulator.tolerances`.
        signals: Of the first run, by name, each of shape ``(ticks,)``.
        others: Of the second run.

    Returns:
        The difference in words, or ``None`` if there is none.
    """
    for name, tolerance in tolerances.items():
        if name not in signals or name not in others:
            return f"{name} is no signal of both runs"
        left, right = signals[name], others[name]
        ticks = min(len(left), len(right))
        apart = np.abs(left[:ticks] - right[:ticks])
        outside = np.flatnonzero(~(apart <= tolerance))
        if len(outside):
            tick = int(outside[0])
            return f"{name} differs by {apart[tick]:.4g} at tick {tick}, tolerance {tolerance:g}"
    return None


def describe_tolerances(tolerances: Mapping[str, float]) -> str:
    """List tolerances in one line."""
    return ", ".join(f"{name} within {tolerance:g}" for name, tolerance in tolerances.items())


def _wrong_action(action: Any) -> str | None:
    """Problem of an action for any simulator; ``None`` if it may be one."""
    kind = type(action)
    if kind in (str, bytes, bool, type(None)):
        return None
    if kind in (int, float, complex):
        return None if _is_finite(action) else f"the action {shorten(action)} is no finite number"
    if kind is dict or kind is list or kind is tuple:
        parts = [*action, *action.values()] if kind is dict else action
        return next((wrong for wrong in map(_wrong_action, parts) if wrong is not None), None)
    if isinstance(action, (np.ndarray, np.generic)) and not action.dtype.hasobject:
        finite = action.dtype.kind not in "fc" or bool(np.isfinite(action).all())
        return None if finite else f"the action {shorten(action)} holds what is no finite number"
    return (
        f"the action holds an object of type {type_name(action)}; a simulator that takes such "
        "actions overrides check_action"
    )


def _is_finite(number: complex) -> bool:
    try:
        return cmath.isfinite(number)
    except OverflowError:  # an int of hundreds of digits
        return False


_OTHER_TARGETS = ("command", "proposal")
"""What faults and conditions name beside sensor channels and messages."""


def checked_aliases(simulator: Any, channels: Collection[str]) -> Mapping[str, str]:
    """Return the second names of channels that a simulator, or its class, declares.

    Args:
        simulator: The simulator, its class, or a function that makes it.
        channels: Names of its sensor channels.

    Raises:
        ConfigurationError: For one that is a channel itself, and for one of no channel.
    """
    aliases: Mapping[str, str] = getattr(simulator, "channel_aliases", {})
    lacking = [key.removeprefix(CHANNELS) for key in getattr(simulator, "lacks", ())]
    taken = {*channels, *_OTHER_TARGETS, *MESSAGES.known()} if aliases else ()
    for alias, channel in aliases.items():
        is_free = alias not in taken and alias.isidentifier()
        if is_free and channel in (*channels, *lacking):
            continue
        why = f"there is no channel {channel!r}" if is_free else "it is no name, or one in use"
        raise ConfigurationError(
            f"the channel alias {alias!r} cannot be used: {why}",
            key="channel_aliases",
            found=f"{alias}: {channel}",
            expected="a name that nothing else has, for one of " + ", ".join(sorted(channels)),
            remedy="correct `channel_aliases` of the simulator's class",
        )
    return aliases


SIMULATORS: Registry[type[Simulator]] = Registry(
    "pytest_dura.simulators",
    "simulator",
    callable,  # whether it may be built is checked where it is: see `core.trust`
    "a subclass of pytest_dura.Simulator",
    names=r"[A-Za-z][\w-]*(\.[A-Za-z][\w-]*)?",
)
"""Simulators; ``lift`` is the domain's own, and ``lift.fast`` would be another of it."""
