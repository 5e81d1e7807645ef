"""Watch: what the monitors of one episode said, and when, as plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from pytest_dura.core.episode import Episode, Validity

Stretch = tuple[float, float]
"""The first and the last tick of an alarm, in seconds."""


@dataclass(frozen=True, slots=True)
class Watch:
    """What the monitors of one episode said; plain data that crosses processes.

    Args:
        episode: Id of the episode.
        component: Name of the component under test.
        validity: ``valid``, ``invalid`` or ``missing``.
        duration: Simulated seconds.
        alarms: By name of each monitor that was asked, its alarms in order. One stands from the
            first tick at which the monitor found the proposal unsafe to the last tick before the
            monitor, when it was asked again, did not: a monitor that is not asked, as where there
            is no valid proposal, has not taken its alarm back.
        alerts: Stretches of neighbouring ticks with alerts of any assessor, whatever they were
            about; ``None`` where no assessor was asked.
        manifested_at: Seconds at which a fault manifested first, if one did.
        detected_at: Seconds at which a manifested fault was detected first, if one was.
        intervention: How a monitor's word changed what was carried out, if it did.
        began_at: Seconds from which on an alert could detect a fault that manifested, by then or
            later: its activation. By default its manifestation.
    """

    episode: str
    component: str
    validity: Validity
    duration: float
    alarms: Mapping[str, tuple[Stretch, ...]]
    alerts: tuple[Stretch, ...] | None = None
    manifested_at: float | None = None
    detected_at: float | None = None
    intervention: str | None = None
    began_at: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        alarms = {name: _lists(stretches) for name, stretches in sorted(self.alarms.items())}
        alerts = None if self.alerts is None else _lists(self.alerts)
        return {**asdict(self), "alarms": alarms, "alerts": alerts}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Watch:
        """The inverse of :meth:`to_json`."""
        alarms = {name: _tuples(stretches) for name, stretches in data["alarms"].items()}
        alerts = None if data["alerts"] is None else _tuples(data["alerts"])
        return cls(**{**data, "alarms": alarms, "alerts": alerts})


def watch(episode: Episode) -> Watch:
    """What the monitors of an episode said, from its metrics, decisions and fault records.

    The ``unsafe`` events do not suffice for that: between ``unsafe`` and ``unsafe_ended`` there may
    be ticks at which the monitor was not asked, and a simulator may have events of that kind, too.
    """
    metrics = episode.metrics
    asked = {name: set(map(float, times)) for name, (times, _) in metrics.robustness.items()}
    flagged = {
        name: {float(episode.time[tick]) for tick in ticks} for name, ticks in metrics.flags.items()
    }
    alerted = {float(episode.time[i]) for ticks in metrics.alert_ticks.values() for i in ticks}
    faults, time = episode.faults, episode.time.tolist()
    return Watch(
        episode=episode.id,
        component=episode.spec.component,
        validity=episode.validity,
        duration=float(episode.time[-1] - episode.time[0]) if episode.ticks else 0.0,
        alarms={
            name: _stretches(time, asked[name], flagged.get(name, set())) for name in sorted(asked)
        },
        alerts=_stretches(time, set(time), alerted) if metrics.alert_ticks else None,
        manifested_at=_first(fault.manifested_at for fault in faults),
        detected_at=_first(fault.detected_at for fault in faults),
        intervention=_intervention(episode),
        began_at=_first(fault.began_at for fault in faults if fault.success),
    )


def _stretches(times: list[float], asked: set[float], flagged: set[float]) -> tuple[Stretch, ...]:
    """Runs of times from a flagged one to the last before one that was asked and not flagged."""
    found: list[Stretch] = []
    standing = False
    for time in times:
        stood, standing = standing, time in flagged or (standing and time not in asked)
        if standing:
            found.append((found.pop()[0] if stood else time, time))
    return tuple(found)


def _first(times: Iterable[float | None]) -> float | None:
    return min((time for time in times if time is not None), default=None)


def _intervention(episode: Episode) -> str | None:
    if (episode.decisions["source"] == "recovery").any():
        return "recovery acted"
    if episode.termination == "halt":
        return "the episode was halted"
    if (episode.decisions["attempts"] > 0).any():
        return "a proposal was refined"
    return None


def _lists(stretches: Iterable[Stretch]) -> list[list[float]]:
    return [list(stretch) for stretch in stretches]


def _tuples(stretches: Iterable[Iterable[float]]) -> tuple[Stretch, ...]:
    return tuple((first, last) for first, last in stretches)
