"""StlSafetyMonitor: a formula over the percept that judges the component while it runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.percepts import Percept
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.roles import Assessed, Assessment, RoleContext, SafetyMonitor
from pytest_dura.core.state import RoleView
from pytest_dura.requirements.drafts import DRAFTED, unsigned_reason
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.stl.formula import Formula, past_only_or_refuse
from pytest_dura.requirements.stl.online import OnlineFormula, Sample
from pytest_dura.requirements.stl.parser import parse
from pytest_dura.requirements.stl.validity import falsifiable_or_refuse

PREFIX = "percept."

Reader: TypeAlias = Callable[[Percept], Mapping[str, Any]]
"""Gives the values of a percept by the names that a formula has for them."""


def _percept_reader(names: Sequence[str], signals: str | None) -> Reader:
    """Reads the signals that a formula names; ``gap`` and ``percept.gap`` are both the percept's.

    Args:
        names: The signals of the formula.
        signals: Import path of a function that takes a percept and returns values by name. Without
            it a name is a channel that is a number, or a channel and a field: ``odometry.speed``.

    Raises:
        ConfigurationError: If there is no such function. The reader raises it for a name that the
            channels do not have, and for a function that returns no mapping.
    """
    if signals is None:
        return lambda percept: {name: _channel_value(percept, name) for name in names}
    function = _function(signals)
    prefixed = [name for name in names if name.startswith(PREFIX)]

    def read(percept: Percept) -> Mapping[str, Any]:
        values = function(percept)
        if not isinstance(values, Mapping):
            raise ConfigurationError(
                f"{signals} returned no signals",
                key="signals",
                found=values,
                expected="a mapping from names to numbers",
            )
        more = {name: values[bare] for name in prefixed if (bare := _bare(name)) in values}
        return {**values, **more} if more else values

    return read


def _bare(name: str) -> str:
    return name.removeprefix(PREFIX)


def _function(signals: str) -> Callable[[Percept], Any]:
    if not isinstance(signals, str):
        raise _no_function("the signals of a monitor are no import path", signals)
    try:
        return RoleSpec(signals).function()
    except ConfigurationError as error:
        raise _no_function(error.problem, signals) from error


def _no_function(problem: str, signals: object) -> ConfigurationError:
    return ConfigurationError(
        problem,
        key="signals",
        found=signals,
        expected="the import path package.module:name of a function that takes a percept and "
        "returns its signals by name",
        remedy="correct it, or leave it out to read channels such as odometry.speed",
    )


def _channel_value(percept: Percept, name: str) -> Any:
    channel, *fields = _bare(name).split(".")
    if channel not in percept:
        raise _unreadable(name, f"there is no channel {channel!r}", percept)
    value = percept[channel]
    for field in fields:
        known = _fields(value)
        if field not in known:
            raise _unreadable(name, f"there is no {field!r} in it", known)
        value = value[field] if isinstance(value, Mapping) else getattr(value, field)
    return value


def _fields(value: Any) -> Sequence[str]:
    if isinstance(value, Mapping):
        return [key for key in value if isinstance(key, str)]
    if dataclasses.is_dataclass(value):
        return [field.name for field in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return tuple(getattr(value, "_fields", ()))
    return [name for name in getattr(value, "__dict__", ()) if not name.startswith("_")]


def _unreadable(name: str, why: str, known: Sequence[str] | Percept) -> ConfigurationError:
    return ConfigurationError(
        f"the signal {name!r} cannot be read from the percept: {why}",
        found=name,
        expected="one of " + ", ".join(sorted(known)) if known else "nothing, it has no fields",
        remedy="name a channel and its field, as in odometry.speed, or give the import path of a "
        "function of the percept as `signals`",
    )


class StlSafetyMonitor(SafetyMonitor):
    """Calls a tick unsafe where a formula of signal temporal logic does not hold.

    The formula looks back: ``historically[0:0.5] (gap > 0.5)``. A monitor is no requirement. It
    sees the percept, as every role does, so that its ``gap`` is what the sensors report, faults
    included, and ``percept.gap`` is the same; the ``gap`` of a requirement is the ground truth.

    It is built from plain data, as in a scenario file, in place of the domain's monitor
    (``safety_monitor``) or beside it under a name of your own::

        roles:
          stl_monitor:
            path: pytest_dura:StlSafetyMonitor
            params:
              formula: historically[0:0.5] (gap > 0.5)
              warning: ttc > 2
              signals: my_project.signals:of_percept

    The score is the formula's robustness, in the unit of what it compares. It judges what has come
    about, and not the proposal: so it says the same of every proposal of a tick, is asked once, and
    has the component refine in vain. It runs without a valid proposal, too. Give ``historically``
    a window, unless one violation is to stand for the rest of the episode.

    Args:
        formula: Where it does not hold, the tick is unsafe.
        signals: Import path of a function from a percept to its signals by name. Without it a name
            is a channel that is a number, or a channel and its field, such as ``odometry.speed``.
        warning: Where this one does not hold, there is a warning.
        draft: The entry of a file of drafts that the formula is of, as a person has signed it.

    Raises:
        ConfigurationError: For anything but formulas that look back, a path that leads to no
            function, and a draft that is unsigned or of another formula. At ``reset`` for a window
            that is no multiple of the time step, and at the first tick for a signal that the
            percept does not have.
    """

    reassess = False

    def __init__(
        self,
        formula: str,
        signals: str | None = None,
        warning: str | None = None,
        draft: Mapping[str, Any] | None = None,
    ) -> None:
        self._unsafe = _past("formula", formula)
        if draft is not None:
            _signed_or_refuse(formula, draft)
        self._warning = None if warning is None else _past("warning", warning)
        names = {*self._unsafe.signals, *(self._warning.signals if self._warning else ())}
        self._read = _percept_reader(sorted(names), signals)

    @classmethod
    def check_params(cls, params: Mapping[str, Any], time_step: float) -> None:
        """Refuse formulas that cannot be read, look ahead or have windows between two ticks."""
        cls(**params).reset(RoleContext(0, time_step))

    def reset(self, context: RoleContext) -> None:
        """Forget the percepts seen."""
        self._monitors = [
            (OnlineFormula(formula, context.dt), verdict)
            for formula, verdict in (
                (self._unsafe, Assessed.UNSAFE),
                (self._warning, Assessed.WARNING),
            )
            if formula is not None
        ]
        self._samples: list[Sample] = []
        self._seen = 0

    def trigger(self, view: RoleView) -> bool:  # noqa: ARG002 - the base declares it
        """At every tick, with a proposal or without."""
        return True

    def run(self, view: RoleView) -> Assessment:
        """The verdict of this tick, from all percepts so far.

        Ticks at which it did not run are caught up on, and none is counted twice.
        """
        if len(view.percepts) != view.index + 1:
            raise ConfigurationError(
                "a monitor by a formula needs the percepts of all ticks",
                found=f"{len(view.percepts)} percepts at tick {view.index}",
                expected="one of each tick so far, as a StateManager gives",
            )
        for percept in view.percepts[self._seen :]:
            values = self._read(percept)
            self._samples = [monitor.update(values) for monitor, _ in self._monitors]
            self._seen += 1
        score = self._samples[0].robustness
        for (monitor, verdict), sample in zip(self._monitors, self._samples, strict=True):
            if not sample.holds:
                reason = (
                    f"`{monitor.formula.text}` does not hold at tick {view.index}: "
                    f"robustness {sample.robustness:.3g}"
                )
                return Assessment(verdict, score, (reason,))
        return Assessment(Assessed.SAFE, score)


def stated(formula: str) -> str:
    """Check of a requirement that a monitor by this formula never alarms."""
    return f"always ({formula})"


def _signed_or_refuse(formula: str, draft: Mapping[str, Any]) -> None:
    try:
        signed = Requirement(**{**draft, "applies_to": ()})
        of_file = signed.source.startswith(DRAFTED)
    except (TypeError, AttributeError):  # another key, or a source that is no text
        of_file = False
    if not of_file:
        reason = "it states a draft that is no entry of a file of drafts"
    elif signed.check != stated(formula):
        reason = f"it is a draft of `{signed.check}`"
    else:
        reason = unsigned_reason(signed)
    if reason:
        raise ConfigurationError(
            f"the monitor cannot be used: {reason}",
            key="draft",
            found=draft,
            expected=f"an entry that a person has signed, with the check `{stated(formula)}`",
            remedy="sign it by `python -m pytest_dura review FILE REVIEW`, and copy it as it is",
        )


def _past(key: str, text: str) -> Formula:
    if not isinstance(text, str):
        raise ConfigurationError(
            f"the {key} of a monitor is no text",
            key=key,
            found=text,
            expected="a formula, such as historically[0:0.5] (gap > 0.5)",
        )
    formula = parse(text)
    past_only_or_refuse(formula, "a monitor")
    falsifiable_or_refuse(formula)
    return formula
