"""Cases: sums over the episodes of a case, their faults and failure modes, and missing runs.

Those of all cases of a component together are sums of them.
"""

from __future__ import annotations

import math
import statistics
from array import array
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from operator import attrgetter
from typing import Any

from pytest_dura.core.seeding import derive_seed
from pytest_dura.evidence.case_model import (
    CaseEntry,
    CaseMetricsEntry,
    CasePlan,
    MeanFigure,
    MeasuredNumbers,
    OverallEntry,
    ShareEntry,
    SwitchingFigures,
    TimeToSafe,
)
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.conclusions.failure_modes import FailureModes, share
from pytest_dura.evidence.conclusions.faults import FaultMetrics
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import repeat_problems
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead

_SUMMED_METRICS = ("decisions", "recovered", "takeovers", "switches", "censored")


class CaseMetrics:
    """Sums up the planned episodes of a case with one component.

    It stores a few numbers of each episode.
    """

    def __init__(self) -> None:
        self._validity: Counter[str] = Counter()
        self._early = 0
        self._known: set[str] = set()
        self._in_run: Counter[str] = Counter()
        self._in_valid: Counter[str] = Counter()
        self._sums: Counter[str] = Counter()
        self._measures: dict[str, array[float]] = {}
        """Numbers of valid episodes; the counts of truth values stand among the others."""
        self._truths: set[str] = set()
        self._switching: Counter[str] = Counter()
        self._times_to_safe = array("d")
        self._reactions: Counter[str] = Counter()
        self._user: dict[str, array[float]] = {}
        self._faults = FaultMetrics()
        self._failure_modes = FailureModes()

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode.

        Args:
            episode: Of :func:`episode_record`.
        """
        outcome = episode.outcome
        truths = {key: value for key, value in outcome.measures.items() if isinstance(value, bool)}
        self._truths.update(truths)
        switching = outcome.switching
        rescued = switching.takeovers > 0 if switching.decisions else None
        known = {"flagged": outcome.flagged, "rescued": rescued}
        known |= {_OF_MEASURE + key: value for key, value in truths.items()}
        raised = [key for key, value in known.items() if value]
        self._validity[episode.validity] += 1
        self._early += episode.termination == "decided"
        self._known.update(key for key, value in known.items() if value is not None)
        self._in_run.update(raised)
        self._faults.add(episode)
        if episode.validity != "valid":
            return
        self._in_valid.update(raised)
        self._sums.update(recoveries=outcome.recoveries, alerts=outcome.alerts)
        self._reactions.update(episode.metrics.reactions)
        for name in outcome.measures.keys() - truths.keys():
            column = self._measures.setdefault(name, array("d"))
            number = outcome.measures[name]
            if number is not None:
                column.append(number)
        self._failure_modes.add(episode.metrics)
        if switching.decisions:
            self._switching["episodes"] += 1
            self._switching.update({key: getattr(switching, key) for key in _SUMMED_METRICS})
            self._times_to_safe.extend(time for time in switching.time_to_safe if time is not None)
        for name, value in episode.metrics.user.items():
            column = self._user.setdefault(name, array("d"))
            if value is not None:
                column.append(value)

    def join(self, other: CaseMetrics) -> None:
        """Add the sums of another case."""
        self._early += other._early
        self._known |= other._known
        self._truths |= other._truths
        for own, added in (
            (self._validity, other._validity),
            (self._in_run, other._in_run),
            (self._in_valid, other._in_valid),
            (self._sums, other._sums),
            (self._switching, other._switching),
            (self._reactions, other._reactions),
        ):
            own.update(added)
        for columns, added_columns in (
            (self._measures, other._measures),
            (self._user, other._user),
        ):
            for name, column in added_columns.items():
                columns.setdefault(name, array("d")).extend(column)
        self._times_to_safe.extend(other._times_to_safe)
        self._faults.join(other._faults)
        self._failure_modes.join(other._failure_modes)

    def entry(self, planned: int) -> CaseMetricsEntry:
        """Return the sums.

        Counts of ``flagged``, of measures that are true, and ``rescued`` are
        given over valid episodes and over all that were run, each with its share: of the valid
        ones, and of the planned ones. Of those that ended once all was decided (``ended_early``),
        they are what was observed until then.

        Args:
            planned: Episodes that were planned.
        """
        truths = {name: self._share(_OF_MEASURE + name, planned) for name in sorted(self._truths)}
        numbers = {
            name: MeasuredNumbers(
                runs=len(column),
                mean=_mean(column),
                sd=_finite(statistics.stdev(column)) if len(column) > 1 else None,
            )
            for name, column in sorted(self._measures.items())
        }
        return CaseMetricsEntry(
            planned=planned,
            run=self._validity.total(),
            valid=self._validity["valid"],
            invalid=self._validity["invalid"],
            missing=self._validity["missing"],
            ended_early=self._early,
            flagged=self._share("flagged", planned),
            measures={**{name: each for name, each in truths.items() if each}, **numbers},
            recoveries=self._sums["recoveries"],
            alerts=self._sums["alerts"],
            rescued=self._share("rescued", planned),
            reactions=dict(sorted(self._reactions.items())),
            switching=self._shared_control(),
            user={
                name: MeanFigure(mean=_mean(column), runs=len(column))
                for name, column in self._user.items()
            },
            faults=self._faults.entries(),
            failure_modes=self._failure_modes.entries(),
            answer_times=self._failure_modes.answer_times(),
            answer_ages=self._failure_modes.answer_ages(),
        )

    def _share(self, key: str, planned: int) -> ShareEntry | None:
        """Counts and shares; ``None`` where no episode has such a signal."""
        if key not in self._known:
            return None
        valid = self._validity["valid"]
        return ShareEntry(
            valid=self._in_valid[key],
            run=self._in_run[key],
            share_of_valid=share(self._in_valid[key], valid),
            share_of_planned=share(self._in_run[key], planned),
        )

    def _shared_control(self) -> SwitchingFigures | None:
        """Summarise how control was shared; see :class:`Switching` for the terms."""
        sums, times = self._switching, self._times_to_safe
        if not sums["episodes"]:
            return None
        return SwitchingFigures(
            share=sums["recovered"] / sums["decisions"],
            takeovers=sums["takeovers"],
            switches_per_episode=sums["switches"] / sums["episodes"],
            time_to_safe=TimeToSafe(
                median=statistics.median(times) if times else None,
                max=max(times) if times else None,
                censored=sums["censored"],
            ),
        )


_OF_MEASURE = "measures."


def _mean(numbers: array[float]) -> float | None:
    return _finite(statistics.fmean(numbers)) if numbers else None


def _finite(value: float) -> float | None:
    """Return a sum's quotient; ``None`` where the sum has left the range of numbers."""
    return value if math.isfinite(value) else None


def case_order(case: CasePlan) -> tuple[float, str, str]:
    """Sort key of cases: the place that the scenario gives, then their names."""
    place = math.inf if case.order is None else case.order
    return place, case.id, case.component


_MAX_LISTED_RUNS = 100
"""Greatest number of runs that are listed of a case."""


def verdicts_on_cases(
    verdicts: Iterable[ItemVerdict],
) -> Mapping[tuple[str, str], list[ItemVerdict]]:
    """Group verdicts by case and component; a comparison of pairs rests on two cases."""
    by_case: dict[tuple[str, str], list[ItemVerdict]] = defaultdict(list)
    for verdict in verdicts:
        for case in {verdict.case, verdict.pairs.case if verdict.pairs else verdict.case}:
            by_case[case, verdict.component].append(verdict)
    return by_case


def missing_runs(
    case: CasePlan, verdicts: Iterable[ItemVerdict], reported: Collection[int]
) -> dict[str, Any]:
    """Count the planned runs of a case that never reported, and list the first of them.

    A run that a campaign did not need for its decision is not missing.

    Args:
        case: Its entry in the record.
        verdicts: Those that rest on it, of :func:`verdicts_on_cases`.
        reported: Numbers of the planned runs that reported, whatever their validity.
    """
    needed = planned = 0
    for verdict in verdicts:
        needed = max(needed, verdict.planned - verdict.saved)
        planned = max(planned, verdict.planned)
    if case.planned > planned:
        needed = case.planned  # more than any verdict needs
    missing = [run for run in range(needed) if run not in reported]
    return {"missing_runs": missing[:_MAX_LISTED_RUNS], "missing_runs_total": len(missing)}


class Cases(Conclusion):
    """Concludes metrics and missing runs of the cases, and the key ``overall``.

    ``overall`` sums up the cases of each component, without the twins of pairs.

    Args:
        head: With its cases, in any order.
    """

    def __init__(self, head: RecordHead) -> None:
        super().__init__(head)
        self._cases: Sequence[CaseEntry] = sorted(head.cases, key=case_order)
        self._metrics = {(case.id, case.component): CaseMetrics() for case in self._cases}
        self._reported: dict[tuple[str, str], set[int]] = {key: set() for key in self._metrics}

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode."""
        metrics = self._metrics.get((episode.case, episode.component))
        if metrics is not None and episode.planned:
            metrics.add(episode)
            self._reported[episode.case, episode.component].add(episode.spec.run)

    def check(self, episode: EpisodeEntry) -> Iterator[str]:
        """Yield what an episode cannot say beside its case."""
        place, spec = f"episode {episode.id}", episode.spec
        self._digests[episode.id, episode.component].add(episode.digest)
        case = self._listed.get((episode.case, episode.component))
        if case is None:
            yield f"{place}: its case is not listed"
            return
        base = self.head.base_seed if case.seed is None else case.seed
        seed = derive_seed(base, spec.scenario_name, spec.run)
        seed = seed if case.seed is None or spec.run else case.seed
        if episode.planned and episode.seed != seed:
            yield f"{place}: planned, and its seed is {episode.seed}, not {seed} as that of its run"
        faults = [[(each.id, each.type, each.target) for each in of.faults] for of in (case, spec)]
        if spec.scenario_name != case.scenario or faults[0] != faults[1]:
            stated = f"{spec.scenario_name} with {faults[1]}"
            yield f"{place}: its spec has {stated}, and its case {faults[0]}"
        for name in episode.verdicts:
            if name not in case.requirements:
                yield f"{place}: a verdict on {name}, which its case does not declare"

    def check_head(self) -> Iterator[str]:
        """Yield what plan and repetition of a case cannot say."""
        for case in self.head.cases:
            override = case.runs_override
            if override is not None and case.planned not in (0, override):
                planned = f"{case.planned} runs planned"
                yield f"case {case.id}: {planned}, and --dura-runs={override} replaces them"
            repeated = case.repeat.episode if case.repeat else "", case.component
            digests = self._digests.get(repeated, ())
            for problem in repeat_problems(case, digests):
                yield f"case {case.id}: {problem}"

    @cached_property
    def _listed(self) -> Mapping[tuple[str, str], CaseEntry]:
        return {(case.id, case.component): case for case in self.head.cases}

    @cached_property
    def _digests(self) -> dict[tuple[str, str], set[str]]:
        """Digests of the episodes that were checked, by id and component."""
        return defaultdict(set)

    def concluded(self, head: RecordHead) -> Mapping[str, Any]:
        """Conclude them with the verdicts, which say how many runs were needed."""
        judged = verdicts_on_cases(head.verdicts)
        cases = [
            case.replace(
                metrics=metrics.entry(case.planned),
                **missing_runs(case, judged.get(key, []), self._reported[key]),
            )
            for (key, metrics), case in zip(self._metrics.items(), self._cases, strict=True)
        ]
        return {"cases": cases, "overall": list(self._overall(head.verdicts))}

    def _overall(self, verdicts: Iterable[ItemVerdict]) -> Iterator[OverallEntry]:
        """Yield the sums of each component, by name."""
        judged, twins = set(), set()
        for verdict in verdicts:
            judged.add(verdict.case)
            if verdict.pairs:
                twins.add(verdict.pairs.case)
        # A case without faults may be a twin, or be judged for its own sake.
        counted = [
            case for case in self._cases if not case.without and case.id not in twins - judged
        ]
        for component in sorted({case.component for case in counted}):
            cases = [case for case in counted if case.component == component]
            pooled = CaseMetrics()
            for case in sorted(cases, key=attrgetter("id")):
                pooled.join(self._metrics[case.id, component])
            planned = sum(case.planned for case in cases)
            yield OverallEntry(component=component, cases=len(cases), metrics=pooled.entry(planned))
