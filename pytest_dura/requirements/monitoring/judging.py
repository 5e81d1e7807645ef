"""Judges monitors: their alarms against the violations of a requirement, alerts against faults."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.requirements.monitoring.alarms import Stretch, Watch
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.verdicts.episodes import EpisodeVerdict

HORIZON = 5.0
"""Seconds before a violation within which an alarm counts as a warning of it, by default."""
ALERTS = "alerts"
"""The name of all alerts together, where they are judged as one monitor."""
FAULTS = "faults"
"""What alerts are judged against: that a fault has manifested."""
_TOLERANCE = 1e-6
"""Seconds; times are sums of float steps."""


def judge_monitor(
    monitor: str, judged: Iterable[tuple[EpisodeVerdict, Watch]], horizon: float = HORIZON
) -> MonitorQuality:
    """How well a monitor's alarms foretold the violations of a requirement.

    Args:
        monitor: The monitor's role name.
        judged: The verdict on each episode, and what the monitors said in it.
        horizon: Seconds before a violation within which an alarm counts as a warning of it.

    Raises:
        ConfigurationError: If a monitor's word changed what was carried out in an episode, if the
            verdicts are of several requirements or components or not those of the episodes, if the
            monitor was asked in none of them, or for a horizon that is no positive number.
    """
    if not 0.0 < horizon < math.inf:
        raise ConfigurationError(
            "a horizon is a positive, finite number of seconds",
            key="horizon",
            found=horizon,
            expected="a number above 0, such as 5.0",
        )
    pairs = list(judged)
    _check_uninvolved(seen for _, seen in pairs)
    _check_asked(monitor, [seen for _, seen in pairs])
    tally = _Tally()
    claims = set()
    for verdict, seen in pairs:
        if (verdict.episode, verdict.component) != (seen.episode, seen.component):
            raise ConfigurationError(
                "a verdict and what the monitors said are about one episode",
                found=f"{verdict.episode} and {seen.episode}",
                remedy="give each episode's verdict with its own watch",
            )
        claims.add((verdict.requirement, verdict.component))
        alarms = seen.alarms.get(monitor, ())
        if verdict.verdict == "missing":
            tally.counts["missing"] += 1
        elif not verdict.valid or verdict.verdict == "open":  # an open one may yet be violated
            tally.counts["invalid"] += 1
        elif verdict.verdict == "satisfied":
            tally.negative(alarms, seen.duration)
        elif verdict.time is None:
            tally.counts["untimed"] += 1
        else:
            tally.violated(alarms, verdict.time, horizon)
    requirement, component = _one_claim(claims)
    return tally.quality(monitor, requirement, component, horizon)


def judge_alerts(watches: Iterable[Watch]) -> MonitorQuality:
    """How well the alerts told episodes with a manifested fault from those without one.

    Args:
        watches: What the monitors said in each episode; it takes episodes with and without faults
            to tell both kinds of error.

    Raises:
        ConfigurationError: If a monitor's word changed what was carried out in an episode, if no
            assessor was asked in a valid one, or the episodes are of several components.
    """
    found = list(watches)
    _check_uninvolved(found)
    tally = _Tally()
    for seen in found:
        if seen.validity != "valid":
            tally.counts[seen.validity] += 1
        elif seen.alerts is None:
            raise ConfigurationError(
                "alerts are judged where there is somebody to raise them",
                found=f"no assessor was asked in {seen.episode}",
                expected="a loop with a SecurityAssessor in it",
            )
        elif seen.manifested_at is None:
            tally.negative(seen.alerts, seen.duration)
        else:
            began = seen.manifested_at if seen.began_at is None else seen.began_at
            tally.attacked(seen.alerts, began, seen.detected_at)
    target, component = _one_claim({(FAULTS, seen.component) for seen in found})
    return tally.quality(ALERTS, target, component, None)


@dataclass
class _Tally:
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
        names = (
            "true_positives", "false_negatives", "false_positives", "true_negatives",
            "late", "early", "untimed", "invalid", "missing", "false_alarms",
        )  # fmt: skip
        return MonitorQuality(
            monitor=monitor,
            target=target,
            component=component,
            horizon=horizon,
            lead_times=tuple(self.lead_times),
            delays=tuple(self.delays),
            hours=math.fsum(self.seconds) / 3600.0,
            **{name: self.counts[name] for name in names},
        )


def _check_uninvolved(watches: Iterable[Watch]) -> None:
    for seen in watches:
        if seen.intervention is not None:
            raise ConfigurationError(
                "a monitor is judged where nobody acts on its word: a violation that was averted"
                " would make its true alarm a false one",
                found=f"{seen.intervention} in {seen.episode}",
                expected="episodes of the policy log_only",
                remedy="run the case with the policy log_only, or without the recovery planner",
            )


def _check_asked(monitor: str, watches: list[Watch]) -> None:
    known = sorted({name for seen in watches for name in seen.alarms})
    if watches and monitor not in known:
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
            found=" and ".join(f"{one} of {who}" for one, who in sorted(claims)) or "no episodes",
            remedy="judge it apart for each",
        )
    return claims.pop()
