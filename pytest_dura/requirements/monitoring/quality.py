"""Quality of monitors: their alarms against violations, their alerts against faults."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

from pytest_dura.core.codec import Amount, Count, Number, Share
from pytest_dura.core.episode import Episode, Validity
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict

Stretch = tuple[float, float]
"""The first and the last tick of an alarm, in seconds."""


@dataclass(frozen=True, slots=True)
class MonitorTimeline:
    """Alarms and alerts of one episode; plain data that crosses processes.

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
        intervention: How an assessment changed the action that was carried out, if one did.
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


def monitor_timeline(episode: Episode) -> MonitorTimeline:
    """Alarms and alerts of an episode, from its metrics, decisions and fault records.

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
    return MonitorTimeline(
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
    stretches: list[Stretch] = []
    standing = False
    for time in times:
        stood, standing = standing, time in flagged or (standing and time not in asked)
        if standing:
            stretches.append((stretches.pop()[0] if stood else time, time))
    return tuple(stretches)


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


@dataclass(frozen=True, slots=True)
class Spread:
    """Times, in seconds."""

    min: Number
    """Least, in s."""
    median: Number
    """Median, in s."""
    max: Number
    """Greatest, in s."""


@dataclass(frozen=True, slots=True)
class MonitorQuality:
    """Quality of a monitor on episodes in which nothing acted on it; one count per episode.

    For a requirement, an episode is positive if it violated the requirement, at its time t. It is
    a true positive if an alarm stood at some time in ``[t - horizon, t)``: one that begins at t
    comes too late, and one that was withdrawn before t - horizon is not about it. The lead time is
    t less the beginning of the first such alarm, ``horizon`` at most. For faults, an episode is
    positive if a fault manifested, and a true positive if one was detected (``FaultRecord``): from
    its activation on, since a monitor may read a fake before the component does. The delay is from
    the first activation of one that manifested to the first detection.
    """

    case: str
    """Id of the case: the scenario, then `+` and its faults where they differ from the scenario's
    own, then `~` and a role that is switched off; empty for episodes of several cases."""
    monitor: str
    """Role name of the monitor, or `alerts`."""
    target: str
    """Id of the requirement, or `faults`."""
    component: str
    """Name of the component under test."""
    horizon: Number | None
    """How long before a violation an alarm counts, in s; null for faults."""
    true_positives: Count
    """Positive episodes that it warned of or detected."""
    false_negatives: Count
    """The other positive episodes."""
    false_positives: Count
    """Other episodes in which it raised an alarm at any time."""
    true_negatives: Count
    """Other episodes in which it raised none."""
    late: Count
    """False negatives with an alarm from t on; for faults, with an alert that came after the window
    in which it would have detected the fault."""
    early: Count
    """The other false negatives with an alarm: all of them withdrawn before t - horizon; for
    faults, before the first activation."""
    untimed: Count
    """Violated episodes whose check gives no time; in none of the counts."""
    invalid: Count
    """Invalid episodes; in none of the counts."""
    missing: Count
    """Missing episodes; in none of the counts."""
    lead_times: tuple[Number, ...]
    """Of each true positive of a requirement, in s."""
    delays: tuple[Number, ...]
    """Of each true positive for faults, from the activation to the alert, in s."""
    false_alarms: Count
    """Alarms in episodes that are not positive; one episode may have several."""
    hours: Amount
    """Simulated hours of the episodes that are not positive."""
    episodes: Count = 0
    """Episodes that were counted."""
    precision: Share | None = None
    """Share of its alarmed episodes, true or false positive, that are true."""
    recall: Share | None = None
    """Share of the positive episodes that it warned of or detected."""
    false_positive_rate: Share | None = None
    """Share of the other episodes in which it raised an alarm."""
    false_alarms_per_hour: Amount | None = None
    """False alarms per simulated hour of the episodes that are not positive."""
    lead_time: Spread | None = None
    """Of the lead times, in s."""
    delay: Spread | None = None
    """Of the delays, in s."""

    def with_rates(self) -> MonitorQuality:
        """Copy with all that follows from its counts and times."""
        positives = self.true_positives + self.false_negatives
        negatives = self.false_positives + self.true_negatives
        return replace(
            self,
            episodes=positives + negatives,
            precision=_share(self.true_positives, self.true_positives + self.false_positives),
            recall=_share(self.true_positives, positives),
            false_positive_rate=_share(self.false_positives, negatives),
            false_alarms_per_hour=self.false_alarms / self.hours if self.hours > 0 else None,
            lead_time=_spread(self.lead_times),
            delay=_spread(self.delays),
        )

    def contradictions(self) -> Iterator[str]:
        """Yield what its counts cannot say together, apart from what follows from others."""
        times = self.delays if self.horizon is None else self.lead_times
        if len(times) != self.true_positives or (self.delays and self.lead_times):
            yield f"{self.true_positives} true positives, and {len(times)} times of them"
        if self.late + self.early > self.false_negatives:
            yield "more late and early alarms than false negatives"
        if self.false_positives > self.false_alarms:
            yield "fewer false alarms than episodes with one"


def _share(some: int, of: int) -> float | None:
    return some / of if of else None


def _spread(times: tuple[float, ...]) -> Spread | None:
    return Spread(min(times), statistics.median(times), max(times)) if times else None


_HORIZON = 5.0
"""Seconds before a violation within which an alarm counts as a warning of it, by default."""
_ALERTS = "alerts"
"""The name of all alerts together, where they are judged as one monitor."""
FAULTS = "faults"
"""Target of alerts in place of a requirement: that a fault has manifested."""
_TOLERANCE = 1e-6
"""Seconds; times are sums of float steps."""


def judge_monitor(
    monitor: str,
    judged: Iterable[tuple[EpisodeVerdict, MonitorTimeline]],
    horizon: float = _HORIZON,
) -> MonitorQuality:
    """Judge a monitor's alarms as predictions of a requirement's violations.

    Args:
        monitor: The monitor's role name.
        judged: The verdict on each episode, and its timeline.
        horizon: Seconds before a violation within which an alarm counts as a warning of it.

    Raises:
        ConfigurationError: If an assessment changed the action that was carried out in an episode,
            if the verdicts are of several requirements or components or not those of the episodes,
            if the monitor was asked in none of them, or for a horizon that is no positive number.
    """
    if not 0.0 < horizon < math.inf:
        raise ConfigurationError(
            "a horizon is a positive, finite number of seconds",
            key="horizon",
            found=horizon,
            expected="a number above 0, such as 5.0",
        )
    pairs = list(judged)
    _check_uninvolved(timeline for _, timeline in pairs)
    _check_asked(monitor, [timeline for _, timeline in pairs])
    tally = _Tally(_common_case(timeline for _, timeline in pairs))
    claims = set()
    for verdict, timeline in pairs:
        if (verdict.episode, verdict.component) != (timeline.episode, timeline.component):
            raise ConfigurationError(
                "a verdict and the reports of the monitors are about one episode",
                found=f"{verdict.episode} and {timeline.episode}",
                remedy="give each episode's verdict with its own watch",
            )
        claims.add((verdict.requirement, verdict.component))
        alarms = timeline.alarms.get(monitor, ())
        if verdict.verdict == "missing":
            tally.counts["missing"] += 1
        elif not verdict.valid or verdict.verdict == "open":  # an open one may yet be violated
            tally.counts["invalid"] += 1
        elif verdict.verdict == "satisfied":
            tally.negative(alarms, timeline.duration)
        elif verdict.time is None:
            tally.counts["untimed"] += 1
        else:
            tally.violated(alarms, verdict.time, horizon)
    requirement, component = _one_claim(claims)
    return tally.quality(monitor, requirement, component, horizon)


def judge_alerts(timelines: Iterable[MonitorTimeline]) -> MonitorQuality:
    """Judge alerts as a detector of episodes with a manifested fault.

    Args:
        timelines: Of each episode; both kinds of error show only where there are episodes with and
            without faults.

    Raises:
        ConfigurationError: If an assessment changed the action that was carried out in an episode,
            if no assessor was asked in a valid one, or the episodes are of several components.
    """
    timelines = list(timelines)
    _check_uninvolved(timelines)
    tally = _Tally(_common_case(timelines))
    for timeline in timelines:
        if timeline.validity != "valid":
            tally.counts[timeline.validity] += 1
        elif timeline.alerts is None:
            raise ConfigurationError(
                "alerts are judged where a role raises them",
                found=f"no assessor was asked in {timeline.episode}",
                expected="a loop with a SecurityAssessor in it",
            )
        elif timeline.manifested_at is None:
            tally.negative(timeline.alerts, timeline.duration)
        else:
            began = timeline.manifested_at if timeline.began_at is None else timeline.began_at
            tally.attacked(timeline.alerts, began, timeline.detected_at)
    target, component = _one_claim({(FAULTS, timeline.component) for timeline in timelines})
    return tally.quality(_ALERTS, target, component, None)


@dataclass
class _Tally:
    case: str
    counts: Counter[str] = field(default_factory=Counter)
    lead_times: list[float] = field(default_factory=list)
    delays: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def negative(self, alarms: tuple[Stretch, ...], duration: float) -> None:
        self.counts["false_positives" if alarms else "true_negatives"] += 1
        self.counts["false_alarms"] += len(alarms)
        self.seconds.append(duration)

    def violated(self, alarms: tuple[Stretch, ...], time: float, horizon: float) -> None:
        in_time = [alarm for alarm in alarms if alarm[0] < time - _TOLERANCE]
        warning = [first for first, last in in_time if last >= time - horizon - _TOLERANCE]
        if warning:
            self.counts["true_positives"] += 1
            self.lead_times.append(min(time - min(warning), horizon))
        else:
            self._missed(alarms, late=len(in_time) < len(alarms))

    def attacked(
        self, alerts: tuple[Stretch, ...], began_at: float, detected_at: float | None
    ) -> None:
        if detected_at is None:
            self._missed(alerts, late=any(last >= began_at for _, last in alerts))
        else:
            self.counts["true_positives"] += 1
            self.delays.append(detected_at - began_at)

    def _missed(self, alarms: tuple[Stretch, ...], *, late: bool) -> None:
        self.counts["false_negatives"] += 1
        if alarms:
            self.counts["late" if late else "early"] += 1

    def quality(
        self, monitor: str, target: str, component: str, horizon: float | None
    ) -> MonitorQuality:
        counts = self.counts
        return MonitorQuality(
            case=self.case,
            monitor=monitor,
            target=target,
            component=component,
            horizon=horizon,
            lead_times=tuple(self.lead_times),
            delays=tuple(self.delays),
            hours=math.fsum(self.seconds) / 3600.0,
            true_positives=counts["true_positives"],
            false_negatives=counts["false_negatives"],
            false_positives=counts["false_positives"],
            true_negatives=counts["true_negatives"],
            late=counts["late"],
            early=counts["early"],
            untimed=counts["untimed"],
            invalid=counts["invalid"],
            missing=counts["missing"],
            false_alarms=counts["false_alarms"],
        ).with_rates()


def _common_case(timelines: Iterable[MonitorTimeline]) -> str:
    """Id of the case of all episodes; empty where they are of several."""
    cases = {timeline.episode.rpartition("#")[0] for timeline in timelines}
    return cases.pop() if len(cases) == 1 else ""


def _check_uninvolved(timelines: Iterable[MonitorTimeline]) -> None:
    for timeline in timelines:
        if timeline.intervention is not None:
            raise ConfigurationError(
                "a monitor is judged where recovery does not act: a violation that was averted"
                " would make its true alarm a false one",
                found=f"{timeline.intervention} in {timeline.episode}",
                expected="episodes of the policy log_only",
                remedy="run the case with the policy log_only, or without the recovery planner",
            )


def _check_asked(monitor: str, timelines: list[MonitorTimeline]) -> None:
    known = sorted({name for timeline in timelines for name in timeline.alarms})
    if timelines and monitor not in known:
        raise ConfigurationError(
            f"no monitor {monitor!r} was asked in any of these episodes",
            key="monitor",
            found=monitor,
            expected="one of " + ", ".join(known) if known else "a loop with a monitor in it",
        )


def _one_claim(claims: set[tuple[str, str]]) -> tuple[str, str]:
    if len(claims) != 1:
        raise ConfigurationError(
            "a monitor is judged on episodes of one component, against one requirement",
            found=" and ".join(f"{target} of {component}" for target, component in sorted(claims))
            or "no episodes",
            remedy="judge it apart for each",
        )
    return claims.pop()
