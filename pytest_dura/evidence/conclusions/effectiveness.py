"""Effectiveness: what the runs show of recovery and monitors by themselves."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pytest_dura.core.text import counted
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead
from pytest_dura.requirements.monitoring.quality import MonitorQuality
from pytest_dura.requirements.pairs import PairTable
from pytest_dura.requirements.rate_tests import lower_bound, upper_bound

Key = tuple[str, str, int]
"""Case, component and run."""

RECOVERY_ROLE = "recovery_planner"
_SUMS = ("only_with", "only_without", "both", "neither", "acted_only_with", "acted_only_without",
         "acted_both", "acted_neither", "reference_without", "reference_both")  # fmt: skip


class Effectiveness(Conclusion):
    """Concludes the key ``effectiveness``: recovery first, then each monitor, by name.

    Of recovery it compares the runs in which it acted with their twins without it. Runs are equal
    if their performance values have the same least, greatest and last value, and they took the same
    time. Decisions are left out: they differ wherever recovery acts.
    """

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._acted: dict[Key, int] = {}
        """Courses of the runs in which recovery acted."""
        self._calm: dict[Key, int] = {}
        """Those of the others."""

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        if episode.planned and episode.validity == "valid" and episode.metrics.performance:
            courses = self._acted if episode.outcome.switching.takeovers else self._calm
            courses[episode.case, episode.component, episode.spec.run] = _course(episode)

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude it from the verdicts on pairs, and the quality of monitors."""
        return {"effectiveness": self.of(head.verdicts, head.monitors)}

    def of(
        self, verdicts: Sequence[ItemVerdict], monitors: Sequence[MonitorQuality]
    ) -> list[dict[str, Any]]:
        """Conclude it as plain data."""
        return [*self._recovery(verdicts), *_monitor_effects(monitors)]

    def _recovery(self, verdicts: Iterable[ItemVerdict]) -> Iterator[dict[str, Any]]:
        sums: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
        references: dict[tuple[str, str], str] = {}
        twins: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
        for verdict in verdicts:
            pairs = verdict.pairs
            if isinstance(pairs, PairTable) and pairs.without == RECOVERY_ROLE:
                key = verdict.component, verdict.requirement
                references[key] = pairs.reference
                if verdict.case not in twins[key]:  # several tests may ask the same of a case
                    twins[key][verdict.case] = pairs.case
                    sums[key].update({name: getattr(pairs, name) for name in _SUMS})
        for (component, requirement), counts in sorted(sums.items()):
            # The runs in which recovery acted and that have a twin, and those equal to it.
            compared = equal = 0
            of_case, reference = twins[component, requirement], references[component, requirement]
            for (case, name, run), course in self._acted.items():
                if name == component and case in of_case:
                    other = of_case[case], name, run
                    twin = self._calm.get(other, self._acted.get(other))
                    compared += twin is not None
                    equal += twin == course
            courses = compared, equal
            finding, detail = _recovery_finding(requirement, counts, courses, reference)
            yield _entry(RECOVERY_ROLE, component, requirement, finding, detail)


def _course(episode: EpisodeEntry) -> int:
    """Hash the course of a run."""
    values = {
        name: (spread.last, spread.min, spread.max)
        for name, spread in episode.metrics.performance.items()
        if name != "response_time"
    }
    return hash((episode.timings.simulated_seconds, tuple(sorted(values.items()))))


def _recovery_finding(
    requirement: str, counts: Mapping[str, int], courses: tuple[int, int], reference: str
) -> tuple[str, str]:
    acted_runs, unchanged = courses
    prevented, introduced = counts["only_without"], counts["only_with"]
    violated = counts["only_without"] + counts["both"]
    pairs = violated + introduced + counts["neither"]
    if acted_runs and unchanged == acted_runs:
        also = "" if violated else f"; nothing violated {requirement} without it either"
        text = f"changed nothing: the runs in which it acted ({acted_runs}) went as their twins"
        return "changed nothing", text + also
    if not pairs:
        return "cannot be told", f"no pair with and without it is complete for {requirement}"
    if not violated:
        # Whatever the reference, there is nothing that it could have as well.
        detail = (
            f"nothing to prevent: 0 violations of {requirement} without it, so prevented 0, futile "
            f"0, unavoidable 0; of {pairs} pairs, introduced {_share_text(introduced, pairs)}"
        )
        return "introduced" if introduced else "cannot be told", detail
    what = f"{counted(violated, 'violation')} of {requirement} without it"
    if not prevented and not introduced and not counts["acted_both"]:
        return "never acted", f"acted in none of {what} in {pairs} pairs"
    detail = (
        f"of {what}, prevented {_share_text(prevented, violated)}, futile "
        f"{_share_text(counts['acted_both'], violated)}"
    )
    if reference:
        detail += _of_avoidable(counts, reference)
    if others := pairs - violated:
        detail += f"; of the pairs without one ({others}), introduced "
        detail += _share_text(introduced, others)
    if prevented:
        return "prevented", detail
    return "introduced" if introduced else "prevented none", detail


def _of_avoidable(counts: Mapping[str, int], reference: str) -> str:
    """What a reference has as well of the violations without recovery, and what it avoids."""
    unavoidable, both = counts["reference_without"], counts["reference_both"]
    violated = counts["only_without"] + counts["both"]
    avoidable = violated - unavoidable
    prevented = avoidable - (counts["both"] - both)
    text = f", unavoidable for {reference} {_share_text(unavoidable, violated)}"
    if not avoidable:
        return text
    return f"{text}; of the {avoidable} avoidable, prevented {_share_text(prevented, avoidable)}"


def _share_text(count: int, of: int) -> str:
    """A count of pairs, and the exact two-sided 95 % interval of its share."""
    low, high = lower_bound(count, of, 0.975), upper_bound(count, of, 0.975)
    return f"{count} ({100 * low:.0f} to {100 * high:.0f} %)"


def _monitor_effects(monitors: Sequence[MonitorQuality]) -> Iterator[dict[str, Any]]:
    by_target: dict[tuple[str, str], dict[str, Counter[str]]] = defaultdict(dict)
    for quality in monitors:
        targets = by_target[quality.component, quality.monitor]
        sums = targets.setdefault(quality.target, Counter())
        names = ("true_positives", "false_negatives", "false_positives", "true_negatives")
        sums.update({name: getattr(quality, name) for name in names})
    for (component, monitor), targets in sorted(by_target.items()):
        finding, detail = _monitor_finding(targets)
        # An assessor speaks by alerts, which are judged as a monitor of their own.
        if monitor == "security_assessor" and finding in ("silent", "cannot be told"):
            continue
        yield _entry(monitor, component, None, finding, detail)


def _monitor_finding(targets: Mapping[str, Counter[str]]) -> tuple[str, str]:
    warnings = {
        name: (counted["true_positives"], counted["true_positives"] + counted["false_negatives"])
        for name, counted in sorted(targets.items())
    }
    happened = {name: counts for name, counts in warnings.items() if counts[1]}
    if not happened:
        detail = (
            "cannot be told here: nothing that it is to warn of happened in runs without recovery "
            f"({', '.join(warnings)})"
        )
        return "cannot be told", detail
    in_words = ", ".join(f"{name} {hits} of {of}" for name, (hits, of) in happened.items())
    if any(hits for hits, _ in happened.values()):
        return "warned", f"warned in time of {in_words}"
    if any(target["false_positives"] for target in targets.values()):
        return "warned of none", f"flagged other runs, and warned of none: {in_words}"
    return "silent", f"warned in time of no violation: {in_words}"


def _entry(
    role: str, component: str, requirement: str | None, finding: str, detail: str
) -> dict[str, Any]:
    return {
        "role": role, "component": component, "requirement": requirement, "finding": finding,
        "detail": detail,
    }  # fmt: skip
