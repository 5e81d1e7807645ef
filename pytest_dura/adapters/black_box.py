"""BlackBox: a function from inputs over time to signals, as a system that scenarios run.

It has neither ticks nor roles: a vendor's executable, an adaptive integrator, a co-simulation. The
whole run is simulated when an episode begins; the loop then goes over its samples, so that
requirements, campaigns, searches and evidence see what they see of any other system.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pytest_dura.adapters.black_box_batches import Batches
from pytest_dura.adapters.black_box_run import BlackBoxRun, Floats, Playback
from pytest_dura.core.display import short_repr
from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.core.percepts import NOTHING, sealed
from pytest_dura.core.roles import Generator
from pytest_dura.core.simulator import Simulator
from pytest_dura.core.trust import factory

_NAME = re.compile(r"[A-Za-z_]\w*")
_TOLERANCE = 1e-9
"""Share of a piece by which a time may miss the piece's beginning, as sums of time steps do."""
_UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_MISSING_LINE = 1.5
"""Times the usual step of a log, from which on a line is missing; below it, lines jitter."""
_UNSEEN_SAMPLES = 2.5
"""Time steps without a line from which on more than one judged sample rests on no line."""
_MOST_GAPS = 3
"""Gaps of a log that a message names."""


@dataclass(frozen=True)
class Input:
    """An input over time, given by one number for each piece of the run.

    Args:
        name: Its name: the key of ``world`` in scenarios, and a signal that requirements read.
        low: Least value.
        high: Greatest value.
        pieces: Numbers that it is given by. A scenario gives a list of so many, or a single number
            where this is 1.
        interpolation: ``constant``: each number holds for an equal part of the run; ``linear``:
            the numbers are values at equally spaced times from beginning to end, at least two.
        unit: Its unit, for messages.
        nominal: Its value where a scenario says nothing; by default the number of the range that
            is nearest to 0.

    Raises:
        ConfigurationError: For a name, range or number of pieces that cannot be.
    """

    name: str
    low: float
    high: float
    pieces: int = 1
    interpolation: Literal["constant", "linear"] = "constant"
    unit: str = ""
    nominal: float | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        nominal = self.value_by_default
        finite = all(isinstance(v, (int, float)) for v in (self.low, self.high, nominal))
        if not (finite and -math.inf < self.low <= nominal <= self.high < math.inf):
            raise ConfigurationError(
                f"the range of the input {self.name!r} cannot be used",
                key=self.name,
                found=(self.low, self.nominal, self.high),
                expected="finite numbers, low <= nominal <= high",
            )
        if not _NAME.fullmatch(self.name):
            raise ConfigurationError(
                "formulas could not name this input",
                key="Input.name",
                found=self.name,
                expected="letters, digits and underscores, no digit first",
            )
        if self.interpolation not in ("constant", "linear"):
            raise ConfigurationError(
                f"the input {self.name!r} cannot be interpolated so",
                key="interpolation",
                found=self.interpolation,
                expected="constant or linear",
            )
        least = 2 if self.interpolation == "linear" else 1
        if isinstance(self.pieces, bool) or not isinstance(self.pieces, int) or self.pieces < least:
            raise ConfigurationError(
                f"the input {self.name!r} has too few pieces",
                key="pieces",
                found=self.pieces,
                expected=f"a whole number of at least {least} where it is {self.interpolation}",
            )

    @property
    def value_by_default(self) -> float:
        """Value of each piece where a scenario says nothing."""
        return min(max(0.0, self.low), self.high) if self.nominal is None else self.nominal

    @property
    def expected(self) -> str:
        """What a scenario may give, in words."""
        unit = f" {self.unit}" if self.unit else ""
        range_ = f"from {self.low:g} to {self.high:g}{unit}"
        if self.pieces == 1:
            return f"a number {range_}"
        return f"a list of {self.pieces} numbers {range_}"

    def read(self, value: Any) -> list[float] | float:
        """Check a value of a scenario, and fill in the default for ``None``.

        Raises:
            ConfigurationError: If it is not what the input takes.
        """
        if value is None:
            value = [self.value_by_default] * self.pieces
            return value if self.pieces > 1 else self.value_by_default
        values = value if isinstance(value, (list, tuple)) else [value]
        listed = isinstance(value, (list, tuple)) == (self.pieces > 1)
        if not (listed and len(values) == self.pieces and all(map(self._holds, values))):
            raise ConfigurationError(
                f"the input {self.name!r} does not take this",
                key=f"world.{self.name}",
                found=value,
                expected=self.expected,
                remedy="correct it, and the range and the pieces under `variation`",
            )
        numbers = [float(number) for number in values]
        return numbers if self.pieces > 1 else numbers[0]

    def _holds(self, value: Any) -> bool:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return number and self.low <= value <= self.high


@dataclass(frozen=True)
class InputCurve:
    """An input during one run: call it with times in seconds, a number or an array.

    Args:
        values: A number for each piece.
        duration: Seconds of the run.
        interpolation: ``constant`` or ``linear``.
    """

    values: tuple[float, ...]
    duration: float
    interpolation: str

    __repr__ = short_repr

    def __call__(self, time: ArrayLike) -> Any:
        """Return the values at these times; a new piece counts from its beginning on."""
        at = np.asarray(time, dtype=np.float64)
        if self.interpolation == "linear":
            result = np.interp(at, self.times, self.values)
        else:
            pieces = len(self.values)
            index = np.floor(at * (pieces / self.duration) + _TOLERANCE).astype(int)
            result = np.asarray(self.values)[np.clip(index, 0, pieces - 1)]
        return result if np.ndim(time) else float(result)

    @property
    def times(self) -> Floats:
        """Where pieces begin; of a linear one, the times of its values."""
        pieces = len(self.values)
        if self.interpolation == "linear":
            return np.linspace(0.0, self.duration, pieces, dtype=np.float64)
        return np.asarray(np.arange(pieces) * (self.duration / pieces), dtype=np.float64)


Curves: TypeAlias = Mapping[str, InputCurve]
Simulate: TypeAlias = Callable[[Floats, Curves], Mapping[str, ArrayLike]]
SimulateMany: TypeAlias = Callable[[Floats, Sequence[Curves]], Sequence[Mapping[str, ArrayLike]]]
_Run: TypeAlias = tuple[int, tuple[tuple[str, InputCurve], ...]]
"""Number of samples, and the inputs."""


class BlackBox:
    """A function from inputs over time to signals: the component under test and its plant in one.

    An object of it at the top level of a module is what a scenario names, ``simulator: plant:BOX``.
    The scenario's ``world`` gives the inputs by name, ``variation`` what is searched.

    Args:
        simulate: Called with the times of the samples, in seconds from 0, shape ``(n,)``, and an
            :class:`InputCurve` for each input by its name. It returns an array for each signal:
            values at these times, shape ``(n,)``; or, with an array ``time`` of its own beside
            them, values at those, which are interpolated linearly. Equal calls return equal values.
        inputs: The inputs.
        signals: Names of the signals. The inputs are signals, too.
        files: What it depends on beside its Python code, such as an executable: another content
            makes other episodes.
        simulate_many: Simulates many runs at once where that is quicker, such as with arrays of
            shape ``(runs, n)``: called with the times and the inputs of each run, it returns for
            each what ``simulate`` returns. Searches use it; what it returns for a run must not
            depend on the others, and what a search finds is replayed by ``simulate``.
        tolerances: For a tool whose equal runs differ a little: within what signals count as the
            same, see :attr:`pytest_dura.Simulator.tolerances`. By default equal runs are equal.

    One without inputs that returns a ``time`` of its own is a recorded log, which is judged as a
    whole or not at all: a log that reaches beyond the run, or has gaps, is refused.

    Raises:
        ConfigurationError: For names that are used twice or that formulas cannot name.
    """

    def __init__(
        self,
        simulate: Simulate,
        inputs: Sequence[Input],
        signals: Sequence[str],
        *,
        files: Sequence[str | Path] = (),
        tolerances: Mapping[str, float] = NOTHING,
        simulate_many: SimulateMany | None = None,
    ) -> None:
        self.tolerances = {name: float(value) for name, value in tolerances.items()}
        self.deterministic = not tolerances
        self.simulate, self.inputs, self.signals = simulate, tuple(inputs), tuple(signals)
        self.files = tuple(map(Path, files))
        self.simulate_many = simulate_many
        self._batches: Batches[_Run] = Batches()
        self._next: Sequence[Mapping[str, Any]] = ()
        names = [*(given.name for given in self.inputs), *self.signals]
        wrong = [name for name in names if names.count(name) > 1 or not _is_signal_name(name)]
        if wrong or not self.signals:
            raise ConfigurationError(
                "the names of a black box's inputs and signals cannot be used",
                key="signals",
                found=wrong[0] if wrong else "no signal",
                expected="at least one signal, each name once, of letters, digits, underscores "
                "and dots, and not `time`",
            )
        unknown = sorted(set(tolerances) - set(self.signals))
        if unknown or not all(0.0 < value < math.inf for value in self.tolerances.values()):
            raise ConfigurationError(
                "the tolerances of a black box cannot be used",
                key="tolerances",
                found=unknown[0] if unknown else self.tolerances,
                expected=f"numbers above 0 for {', '.join(self.signals)}",
            )
        factory(self)  # a file may name it, as it may name a subclass of Simulator

    def __call__(
        self, *, component: bool = False, files: Mapping[str, str] = NOTHING
    ) -> Simulator | Generator:
        """Build the simulator of an episode; or its component, which does nothing by itself.

        Args:
            component: Whether to build the component.
            files: SHA-256 of each of the files, which have to be the same now.

        Raises:
            ConfigurationError: If a file has changed.
        """
        if not component:
            return BlackBoxRun(self)
        for name, digest in self._digests().items():
            if files.get(name, digest) != digest:
                raise ConfigurationError(
                    "this is another file than the episode was recorded with",
                    file=name,
                    found=f"SHA-256 {digest}",
                    expected=f"SHA-256 {files[name]}",
                    remedy="put the recorded file back to replay the episode",
                )
        return Playback()

    component_parameters: Mapping[str, Any] = MappingProxyType({"component": True})
    """Parameters with which a call builds the component of scenarios that name no generator."""

    def resolve_parameters(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters with the digests of the files, which episodes are known by."""
        digests = self._digests()
        return {**({"files": digests} if digests else {}), **params}

    def check_scenario(self, world: Mapping[str, Any]) -> dict[str, Any]:
        """Return the inputs that a scenario gives, defaults filled in.

        Raises:
            ConfigurationError: For an unknown input, and for values that it does not take.
        """
        known = [given.name for given in self.inputs]
        for name in world:
            if name not in known:
                raise ConfigurationError(
                    f"the black box has no input {name!r}",
                    key=f"world.{name}",
                    expected=", ".join(known) or "no inputs",
                    remedy=did_you_mean(name, known),
                )
        return {given.name: given.read(world.get(given.name)) for given in self.inputs}

    def columns(self, world: Mapping[str, Any], time: Floats) -> dict[str, Floats]:
        """Simulate one run.

        Args:
            world: The inputs, see :meth:`check_scenario`.
            time: Times of the samples, in seconds from 0, shape ``(n,)``.

        Returns:
            Each input and signal by name, shape ``(n,)``.

        Raises:
            ValueError: If ``simulate`` returns something else than finite signals for the run, or
                a log that would be judged in part.
        """
        curves = self._curves(world, float(time[-1]))
        columns = {name: curve(time) for name, curve in curves.items()}
        times = sealed(time.copy())
        returned = self._from_batch(times, curves)
        if returned is None:
            returned = self.simulate(times, MappingProxyType(curves))
        return columns | _sampled(returned, self.signals, time, is_log=self.is_log)

    @property
    def simulates_batches(self) -> bool:
        """Whether runs may be simulated together, which :meth:`announce` names before."""
        return self.simulate_many is not None

    def announce(self, worlds: Sequence[Mapping[str, Any]]) -> None:
        """Note the worlds of the runs that come next; the first of them may simulate all."""
        self._next = worlds

    def _from_batch(self, time: Floats, curves: Curves) -> Mapping[str, ArrayLike] | None:
        """Return what a batch came to for a run; ``None`` where it is simulated by itself."""
        many = self.simulate_many
        if many is None:
            return None
        worlds, self._next = self._next, ()
        if len(worlds) < 2:
            self._batches.forget()
            return None

        def batch() -> list[_Run]:
            runs = []
            for world in worlds:
                with suppress(ConfigurationError):  # which its own run reports
                    runs.append(_run(time, self._curves(world, float(time[-1]))))
            return runs

        def check(batched: Mapping[str, ArrayLike]) -> None:
            alone = self.simulate(time, MappingProxyType(curves))
            self._check_same(batched, alone, time)

        return self._batches.take(
            _run(time, curves),
            batch,
            lambda runs: many(time, [MappingProxyType(dict(inputs)) for _, inputs in runs]),
            check,
        )

    def _check_same(
        self, batched: Mapping[str, ArrayLike], alone: Mapping[str, ArrayLike], time: Floats
    ) -> None:
        """Hold a run of a batch against the same run by itself.

        Raises:
            ValueError: If they differ by more than the tolerances.
        """
        first, second = (
            _sampled(each, self.signals, time, is_log=False) for each in (batched, alone)
        )
        for name in self.signals:
            apart = np.abs(first[name] - second[name])
            if (apart > self.tolerances.get(name, 0.0)).any():
                where = int(np.argmax(apart))
                value, expected = first[name][where], second[name][where]
                raise ValueError(
                    f"simulate_many returns {name} = {value:.6g} at {time[where]:g} s, where "
                    f"simulate returns {expected:.6g} for the same run"
                )

    def _curves(self, world: Mapping[str, Any], end: float) -> dict[str, InputCurve]:
        values = self.check_scenario(world)
        return {
            given.name: InputCurve(
                tuple(np.atleast_1d(values[given.name]).tolist()), end, given.interpolation
            )
            for given in self.inputs
        }

    @property
    def is_log(self) -> bool:
        """Whether a time of its own is that of a recorded log."""
        return not self.inputs

    def _digests(self) -> dict[str, str]:
        return {file.name: _digest(file) for file in self.files}


def _run(time: Floats, curves: Curves) -> _Run:
    return len(time), tuple(curves.items())


def _digest(file: Path) -> str:
    try:
        stat = file.stat()
        return _digest_of(file, stat.st_size, stat.st_mtime_ns)
    except OSError as error:
        raise ConfigurationError(
            f"a file of a black box cannot be read: {error.strerror or error}",
            file=str(file),
            remedy="name it relative to the module: Path(__file__).parent / ...",
        ) from None


# Each episode builds a component, and an FMU may have many megabytes.
@lru_cache(maxsize=32)
def _digest_of(file: Path, _size: int, _changed: int) -> str:
    """SHA-256 of a file, read once as long as it stays as it is."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _is_signal_name(name: str) -> bool:
    return name != "time" and all(_NAME.fullmatch(part) for part in name.split("."))


def _sampled(
    returned: Any, names: Sequence[str], time: Floats, *, is_log: bool
) -> dict[str, Floats]:
    """Check what ``simulate`` returned, and take the values at the times of the samples."""
    if not isinstance(returned, Mapping):
        raise TypeError(f"simulate returned {type(returned).__name__}, not a mapping of signals")
    missing = [name for name in names if name not in returned]
    if missing:
        raise ValueError(f"simulate returned no signal {missing[0]!r}")
    own = returned.get("time")
    at = time if own is None else _column("time", own, None)
    if (np.diff(at) < 0.0).any():
        raise ValueError("simulate returned times that go back")
    if own is not None:
        _check_cover(at, time, is_log=is_log)
    columns = {name: _column(name, returned[name], at) for name in names}
    return {
        name: column if own is None else np.interp(time, at, column)
        for name, column in columns.items()
    }


def _check_cover(at: Floats, time: Floats, *, is_log: bool) -> None:
    """Refuse values that do not cover the run, and values that the run does not cover.

    What lies beyond the run by a time step or more is not judged, and might hold a violation. The
    last step of a tool that simulates may be longer, since nothing was to happen there.

    Raises:
        ValueError: With the times, the share that would be judged, and a remedy.
    """
    end = float(time[-1])
    step, slack = end / max(len(time) - 1, 1), 1e-6 * max(end, 1.0)
    if not len(at):
        raise ValueError(f"simulate returned no time of a run from 0 to {end:g} s")
    outside = (at < -slack) | (at > end + slack)
    is_short = at[0] > slack or at[-1] < end - slack
    is_beyond = at[0] <= -0.999 * step or at[-1] - end >= 0.999 * step
    if is_short or (is_beyond and (is_log or at[:2].max() < -slack or at[-2:].min() > end + slack)):
        share = f"{int((~outside).sum())} of {len(at)} lines lie within it"
        remedy = _log_remedy(at, end, step, slack) if is_log else "return all of it, and no more"
        raise ValueError(
            f"simulate returned {_seconds(at[0])} to {_seconds(at[-1])} s of a run from 0 to "
            f"{end:g} s: {share}; {remedy}"
        )
    if is_log:
        _check_gaps(at, step)


def _log_remedy(at: Floats, end: float, step: float, slack: float) -> str:
    """Say what to do with a log whose times are not those of the run."""
    span, advice = float(at[-1] - at[0]), []
    if at[0] > slack or at[0] <= -0.999 * step:
        advice.append("subtract the first stamp: time - time[0]")
    for unit, factor in _UNITS.items():
        if end / 3.0 <= span * factor <= end * 3.0:
            advice.append(f"if its times are in {unit}, multiply them by {factor:g}")
            span *= factor
    whole = math.floor(span / step + 1e-3) * step  # a part of a step is not judged
    if 0.0 < whole < end - slack:
        advice.append(f"let the scenario run for {whole:g} s: `duration`")
    elif whole > end + slack:
        advice.append(f"let the scenario run for {whole:g} s (`duration`), or cut the log")
    return "; ".join(advice) or "return all of the run"


def _check_gaps(at: Floats, step: float) -> None:
    """Refuse a log in which lines are missing for more than one judged sample.

    Raises:
        ValueError: With the gaps, and the share of the time that lies in them.
    """
    steps = np.diff(at)
    usual = float(np.percentile(steps[steps > 0.0], 50, method="lower"))
    wide = np.flatnonzero((steps > _MISSING_LINE * usual) & (steps > _UNSEEN_SAMPLES * step))
    if not len(wide):
        return
    gaps = [f"from {at[index]:g} to {at[index + 1]:g} s" for index in wide[:_MOST_GAPS]]
    more = f" and {len(wide) - _MOST_GAPS} more" if len(wide) > _MOST_GAPS else ""
    whole = float(at[-1] - at[0])
    raise ValueError(
        f"the log has gaps: no line {', '.join(gaps)}{more}; only {whole - steps[wide].sum():g} of "
        f"{whole:g} s have lines, one every {usual:g} s; judge the parts between the gaps in "
        "scenarios of their own, or, where it is known what happened there, return values at the "
        "times that simulate is given"
    )


def _seconds(value: float) -> str:
    """Format seconds, also of an epoch, so that two of them differ."""
    return f"{value:.0f}" if abs(value) >= 1e5 else f"{value:g}"


def _column(name: str, values: Any, time: Floats | None) -> Floats:
    column = np.array(values, dtype=np.float64)
    if column.ndim != 1 or (time is not None and column.shape != time.shape):
        expected = "(n,)" if time is None else f"({len(time)},)"
        raise ValueError(f"simulate returned {name!r} of shape {column.shape}, expected {expected}")
    bad = np.flatnonzero(~np.isfinite(column))
    if len(bad):
        when = "" if time is None else f" at {time[bad[0]]:g} s"
        raise ValueError(f"simulate returned {column[bad[0]]} for {name!r}{when}")
    return column
