"""Monitors that a language model drafts: formulas over the percept, by what they would warn of."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from pytest_dura.campaign.pairs import monitor_qualities
from pytest_dura.core.errors import ConfigurationError
from pytest_dura.core.role_spec import RoleSpec
from pytest_dura.core.text import counted, one_line
from pytest_dura.domains import Domain
from pytest_dura.drafts.asking import Draft
from pytest_dura.drafts.checks import plain_error, refusal_of_text
from pytest_dura.drafts.files import Passed
from pytest_dura.drafts.rounds import Drafting
from pytest_dura.requirements.judgements import RECOVERY_ROLE
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.monitoring.stl_monitor import StlSafetyMonitor, stated

_ROLE, _PATH = "stl_monitor", "pytest_dura:StlSafetyMonitor"
ABOUT_MONITORS = (
    "Monitors that a language model drafted, each stated as: it never alarms. No session takes one",
    "until a person has signed it, python -m pytest_dura review FILE REVIEW.yaml, and a scenario",
    "names it: path stl, with what stands within `always (...)` as formula, and the entry as draft",
)
_ASKED = """
In place of requirements, write safety monitors. Each is to warn, while the system runs, of
violations of {id}: {text} [{check}]
The check of a monitor looks back: `historically (...)`, `once (...)` and `a since b`, each with
a window of seconds, and no always, eventually or until. Where it does not hold, there is an
alarm: `historically[0:0.5] (x > 1)` raises one if x was 1 or less in the last 0.5 s.
"""


def warnings_of(qualities: Sequence[MonitorQuality]) -> tuple[str, str]:
    """What a monitor would warn of: why that is nothing, empty if it is not, and a summary.

    Args:
        qualities: Of runs without recovery, against one requirement.
    """

    def count(*names: str) -> int:
        return sum(getattr(each, name) for each in qualities for name in names)

    found, quiet, alarmed = map(count, ("true_positives", "true_negatives", "false_positives"))
    violated, runs = found + count("false_negatives"), counted(count("episodes"), "run")
    if not violated:
        return f"none of {runs} without recovery is violated, to be warned of", ""
    if not found + alarmed + count("late", "early"):
        return f"constant: it alarms in none of {runs} without recovery", ""
    if not quiet:
        return f"none of {runs} without recovery is both satisfied and without an alarm", ""
    if not found:
        return f"it warns of none of {violated} violations in time, and late of {count('late')}", ""
    ahead = statistics.median(time for each in qualities for time in each.lead_times)
    return "", (
        f"without recovery it warns of {found} of {violated} violated runs, {ahead:.3g} s ahead in "
        f"the median, and alarms in {alarmed} of {alarmed + quiet} satisfied ones"
    )


@dataclass
class MonitorDrafting(Drafting):
    """Rounds of a conversation on monitors.

    Args:
        requirement: Whose violations they are to warn of.
    """

    requirement: Requirement = field(kw_only=True)

    def __post_init__(self) -> None:
        """Find the cases in which there may be something to warn of.

        Raises:
            ConfigurationError: If there is none.
        """
        own = self.requirement
        single = own.kind == "safety" and own.check and not own.paired
        self._cases = [each for each in self.suite.cases if own.id in each.requirements]
        if not (single and self._cases and self.conversation.domain.percept_signals):
            raise ConfigurationError(
                f"no monitor can be judged by {own.id}",
                key="--warns-of",
                found=f"{own.id} of {own.kind}, in {counted(len(self._cases), 'chosen scenario')}",
                expected="a safety requirement with a check on single runs, of a scenario whose "
                "domain declares percept signals",
                remedy="name another one, or its scenarios by --scenario",
            )

    @staticmethod
    def asked_of(requirement: Requirement) -> str:
        """Say to a model what a monitor is, and of what it is to warn."""
        return _ASKED.format(id=requirement.id, text=requirement.text, check=requirement.check)

    @staticmethod
    def percept_of(domain: Domain) -> Domain:
        """Return a domain with the signals that a monitor reads, and no others."""
        return replace(domain, signals=(), proposal_signals=())

    def _round(
        self, entries: Sequence[Mapping[str, Any]], digest: str
    ) -> Iterator[tuple[str, bool, str]]:
        """Yield the id of each draft, whether it was kept, and why."""
        taken = self.suite.taken | {each.requirement.id: "a draft" for each in self.passed}
        for draft in map(Draft.of, entries):
            formula = draft.requirement.check
            never = replace(draft.requirement, check=stated(formula))
            try:
                StlSafetyMonitor(formula)
                reason = refusal_of_text(
                    replace(draft, requirement=never), self.conversation.domain, taken
                )
                reason, text = (reason, "") if reason else warnings_of(self.judged(formula))
            except ConfigurationError as error:
                reason, text = plain_error(error), ""
            taken[never.id] = "another draft"
            if not reason:
                text = f"as a monitor of {self.requirement.id}, {text}"
                self.passed.append(Passed(never, (), text, digest))
            yield never.id, not reason, reason or f"{formula}; {text}"

    def judged(self, formula: str) -> list[MonitorQuality]:
        """Run a monitor on each case that the requirement judges, without recovery.

        Raises:
            ConfigurationError: For one that cannot run there.
        """
        params = {"formula": formula, **self.suite.domain.parameters.get("stl", {})}
        qualities: list[MonitorQuality] = []
        for driver in self.suite.drivers().values():
            runner = replace(driver, roles={**driver.roles, _ROLE: RoleSpec(_PATH, params)})
            for case in self._cases:
                episode = runner.fetch(case.switched_off(RECOVERY_ROLE))
                if episode.failure is not None:
                    raise ConfigurationError(f"{episode.id}: {one_line(episode.failure, 300)}")
                found = monitor_qualities(partial(iter, (episode,)), [self.requirement])
                qualities += [each for each in found if each.monitor == _ROLE]
        return qualities
