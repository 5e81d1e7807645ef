"""StlSafetyMonitor: a formula over the percept that judges the component while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.roles import Assessed, Assessment, RoleContext, SafetyMonitor
from pytest_dura.core.state import RoleView
from pytest_dura.requirements.monitoring.percepts import percept_reader
from pytest_dura.requirements.stl.language.checks import past_only_or_refuse
from pytest_dura.requirements.stl.language.formula import Formula
from pytest_dura.requirements.stl.language.parsing import parse
from pytest_dura.requirements.stl.online.monitoring import OnlineFormula, Sample


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
              signals: pytest_dura.driving.signals:percept_at

    The score is the formula's robustness, in the unit of what it compares. It judges what has come
    about, and not the proposal: so it says the same of every proposal of a tick, is asked once, and
    has the component refine in vain. It runs without a valid proposal, too. Give ``historically``
    a window, unless one violation is to stand for the rest of the episode.

    Args:
        formula: Where it does not hold, the tick is unsafe.
        signals: Import path of a function from a percept to its signals by name. Without it a name
            is a channel that is a number, or a channel and its field, such as ``odometry.speed``.
        warning: Where this one does not hold, there is a warning.

    Raises:
        ConfigurationError: For anything but formulas that look back, and a path that leads to no
            function. At ``reset`` for a window that is no multiple of the time step, and at the
            first tick for a signal that the percept does not have.
    """

    reassess = False

    def __init__(
        self, formula: str, signals: str | None = None, warning: str | None = None
    ) -> None:
        self._unsafe = _past("formula", formula)
        self._warning = None if warning is None else _past("warning", warning)
        names = {*self._unsafe.signals, *(self._warning.signals if self._warning else ())}
        self._read = percept_reader(sorted(names), signals)

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

        Ticks at which somebody did not ask are caught up on, and none is counted twice.
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
    return formula
