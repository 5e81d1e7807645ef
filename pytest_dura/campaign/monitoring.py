"""How good the monitors of a case are, on the twins in which nobody acted on their word."""

from __future__ import annotations

from collections.abc import Sequence

from pytest_dura.core.episode import Episode
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.alarms import watch
from pytest_dura.requirements.monitoring.judging import judge_alerts, judge_monitor
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.verdicts.episodes import judge_episode


def monitor_qualities(
    episodes: Sequence[Episode], requirements: Sequence[Requirement]
) -> list[MonitorQuality]:
    """The quality of every monitor against each safety requirement, and of alerts against faults.

    Args:
        episodes: Episodes of one case without recovery.
        requirements: Of any kind; those on safety that a single episode can violate are used.

    Returns:
        Nothing if something was done on a monitor's word in any of the episodes (under ``halt`` and
        ``refine``): a violation that was averted would make its true alarm a false one.
    """
    watched = [(episode, watch(episode)) for episode in episodes]
    if any(seen.intervention is not None for _, seen in watched):
        return []
    monitors = sorted({name for _, seen in watched for name in seen.alarms})
    found = []
    for requirement in requirements:
        if requirement.kind != "safety" or requirement.paired or not requirement.check:
            continue
        verdicts = [(judge_episode(requirement, episode), seen) for episode, seen in watched]
        found += [judge_monitor(monitor, verdicts) for monitor in monitors if verdicts]
    seen = [one for _, one in watched]
    if any(one.manifested_at is not None and one.alerts is not None for one in seen):
        found.append(judge_alerts(seen))
    return found
