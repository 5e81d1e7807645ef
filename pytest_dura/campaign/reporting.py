"""Reports of a campaign: what is judged, and why its verdict is not "supported"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pytest_dura.requirements.campaign_verdicts import violation_text

if TYPE_CHECKING:
    from pytest_dura.core.episode import Episode
    from pytest_dura.requirements.campaign_verdicts import CampaignVerdict
    from pytest_dura.requirements.model import Requirement


@dataclass
class ComponentFailures:
    """The first failure of the component itself, and in how many episodes there was one."""

    first: str = ""
    count: int = 0
    episodes: int = 0

    def add(self, episode: Episode) -> None:
        """Take in an episode."""
        self.episodes += 1
        failed = [event for event in episode.events if event.kind == "component_failure"]
        if failed:
            text = f"{failed[0].subject} {failed[0].detail} (t = {failed[0].time:.2f} s)"
            self.first = self.first or text
            self.count += 1

    def __str__(self) -> str:
        return f"{self.first}; in {self.count} of {self.episodes} episodes"


def explain_verdict(
    verdict: CampaignVerdict, requirement: Requirement, failures: ComponentFailures
) -> list[str]:
    """Lines that say why a verdict is not "supported": in which run, when and by how much."""
    what = f"{verdict.verdict}: {verdict.requirement} on {verdict.case} ({verdict.component})"
    lines = [f"{what}: {verdict.reason}"]
    spoilt = verdict.spoilt if verdict.verdict == "undecided" else None
    if spoilt is not None and spoilt.verdict == "missing":
        lines.insert(0, f"{spoilt.detail} (in {spoilt.episode})")
    if requirement.text:
        lines.append(f"required: {requirement.text}")
    if requirement.check and requirement.check != verdict.requirement:
        lines.append(f"check:    {requirement.check}")
    paired = requirement.paired
    if paired is not None and paired.measure:
        lines.append(f"measure:  {paired.measure}, which may grow by {paired.change_at_most:g}")
    if paired is not None:
        lines.append(f"pairs:    with {paired.without}, and without")
    lines += _violations(verdict)
    if spoilt is not None and spoilt.verdict != "missing":
        lines.append(f"{spoilt.verdict + ':':<9} {spoilt.episode}: {spoilt.detail}")
    if failures.first:
        lines.append(f"component: {failures}")
    # Lines of a component's own message must not look like lines of this report.
    return [line.replace("\n", "\n    ") for line in lines]


def _violations(verdict: CampaignVerdict) -> list[str]:
    if not verdict.counterexamples:
        return []
    worst = verdict.counterexamples[0]
    lines = [f"worst:    {worst.episode}{violation_text(worst.time, worst.margin)}"]
    others = [
        counterexample.episode.rpartition("#")[2] for counterexample in verdict.counterexamples[1:]
    ]
    if others:
        lines.append(f"also in:  {_runs(others)}")
    if verdict.without_effect:
        lines.append(f"invalid:  in {verdict.without_effect} of them no fault had an effect")
    return lines


def _runs(numbers: Sequence[str]) -> str:
    shown = ", ".join(f"#{number}" for number in numbers[:8])
    return shown + (f" and {len(numbers) - 8} more" if len(numbers) > 8 else "")


def describe_check(requirement: Requirement) -> list[str]:
    """Lines that say what is judged and how."""
    lines = [requirement.check or "decided by test code"]
    paired = requirement.paired
    if paired is not None and paired.measure:
        lines = [f"{paired.measure} grows by at most {paired.change_at_most:g}"]
    if paired is not None:
        lines.append(f"on pairs of runs: with {paired.without}, and without")
    if requirement.at_most is not None:
        method = f" by {requirement.method}" if requirement.method else ""
        lines.append(
            f"violated in at most {requirement.at_most:g} of the episodes, "
            f"at {requirement.confidence:g} confidence{method}"
        )
    if requirement.applies_to:
        lines.append(f"applies to {', '.join(requirement.applies_to)}")
    return lines
