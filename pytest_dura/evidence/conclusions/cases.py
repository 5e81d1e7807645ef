"""Cases: sums over the episodes of a case, their faults and failure modes, and missing runs.

Those of all cases of a component together are sums of them.
"""

from __future__ import annotations

import math
import statistics
from array import array
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from typing import Any

from pytest_dura.core.codec import encode
from pytest_dura.core.loop_signals import Switching
from pytest_dura.core.metrics import DISCOMFORT, EpisodeMetrics, TracedFault
from pytest_dura.core.seeding import derive_seed
from pytest_dura.evidence.case_model import (
    CaseEntry,
    CaseMetricsEntry,
    CasePlan,
    CaseUsage,
    FailureModeEntry,
    FaultMetricsEntry,
    FaultRates,
    LatencyEntry,
    MeanFigure,
    MeasuredNumbers,
    OverallEntry,
    Percentiles,
    ShareEntry,
    SwitchingFigures,
    TimeToSafe,
)
from pytest_dura.evidence.conclusions.conclusion import Conclusion
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.gate import repeat_problems
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.model import RecordHead
from pytest_dura.requirements.rate_tests import upper_bound

CONFIDENCE = 0.95
"""Confidence of the bound on the rate of episodes in which a failure mode shows."""
_FAILURE_MODE_COUNTS = ("hits", "of", "null_hits", "null_of")


class FailureModes:
    """Sums up the failure modes in the valid episodes of a case with one component.

    It stores a few numbers for each failure mode, and two for each decision.
    """

    def __init__(self) -> None:
        self._kinds: dict[str, Any] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._seconds = array("d")
        self._ages = array("d")

    def add(self, metrics: EpisodeMetrics) -> None:
        """Add the metrics of an episode's entry."""
        for name, tally in metrics.tallies.items():
            self._kinds.setdefault(name, tally.kind)
            counts = self._counts.setdefault(name, Counter())
            counts.update({key: getattr(tally, key) for key in _FAILURE_MODE_COUNTS})
            counts["episodes"] += tally.hits > 0
            counts["of_episodes"] += tally.of > 0
        self._seconds.extend(metrics.answer_seconds)
        self._ages.extend(metrics.answer_ages)

    def join(self, other: FailureModes) -> None:
        """Add the sums of another case."""
        self._kinds = {**other._kinds, **self._kinds}
        for name, counts in other._counts.items():
            self._counts.setdefault(name, Counter()).update(counts)
        self._seconds.extend(other._seconds)
        self._ages.extend(other._ages)

    def entries(self) -> list[FailureModeEntry]:
        """Return an entry for each failure mode, in the order of appearance.

        The decisions of an episode depend on each other, so that no bound is given on their
        share. Episodes of a case are drawn independently: ``upper`` is the exact bound on the rate
        of those in which the failure ever shows, of those in which it could.
        """
        return [self._of(name, counts) for name, counts in self._counts.items()]

    def _of(self, name: str, counts: Counter[str]) -> FailureModeEntry:
        episodes, of = counts["episodes"], counts["of_episodes"]
        return FailureModeEntry(
            name=name,
            kind=self._kinds[name],
            hits=counts["hits"],
            of=counts["of"],
            share=share(counts["hits"], counts["of"]),
            null_hits=counts["null_hits"],
            null_of=counts["null_of"],
            null_share=share(counts["null_hits"], counts["null_of"]),
            episodes=episodes,
            of_episodes=of,
            upper=upper_bound(episodes, of, CONFIDENCE) if of else None,
        )

    def answer_times(self) -> Percentiles | None:
        """Summarise how long decisions took by the component's account, in s of wall-clock time."""
        return percentile_summary(self._seconds)

    def answer_ages(self) -> Percentiles | None:
        """Summarise the ages of decisions when they took effect, in simulated s."""
        return percentile_summary(self._ages)


def share(part: int, whole: int) -> float | None:
    """Quotient of two counts; ``None`` if the whole is 0."""
    return part / whole if whole else None


def percentile_summary(values: Iterable[float]) -> Percentiles | None:
    """Summarise times of decisions; ``None`` without any."""
    ordered = sorted(values)
    if not ordered:
        return None
    return Percentiles(
        decisions=len(ordered),
        p50=_percentile(ordered, 0.50),
        p95=_percentile(ordered, 0.95),
        max=ordered[-1],
    )


def _percentile(ordered: list[float], rank: float) -> float:
    """Percentile by the nearest rank, which is the value of an actual decision."""
    return ordered[max(math.ceil(rank * len(ordered)) - 1, 0)]


TRACED = ("propagation", "propagated_at", "unknown", "outcome", "violated", "violated_without")
"""What is known of a fault only once its episode was followed."""


RATES: Mapping[str, tuple[str, str]] = {
    "activation": ("activated", "run"),
    "manifestation": ("manifested", "run"),
    "propagation": ("propagated", "followed"),
    "detection": ("detected", "manifested"),
    "recovery": ("recovered", "recovery"),
}
"""Numerator and denominator of each rate."""

_CHAIN_STEPS = (
    "run", "activated", "manifested", "followed", "propagated",
    "detected", "recovery", "recovered", "judged", "violated", "violated_without",
)  # fmt: skip
_LATENCIES = ("detection_latency", "recovery_latency", "time_to_recover")


def with_chains(episode: JsonObject, chains: Mapping[str, Mapping[str, Any]]) -> JsonObject:
    """Add what is known of each fault, by its id, to an episode's entry."""
    faults = []
    for fault in episode["faults"]:
        chain = chains.get(fault["id"])
        faults.append(fault if chain is None else fault | {key: chain[key] for key in TRACED})
    return {**episode, "faults": faults}


def untraced(fault: TracedFault) -> TracedFault:
    """Copy a fault without what is known only once its episode was followed."""
    return replace(
        fault,
        propagation=None,
        propagated_at=None,
        unknown="",
        outcome=None,
        violated=(),
        violated_without=None,
    )


class FaultMetrics:
    """Counts how far each fault got, over the episodes in which it was planned.

    It stores a few numbers of each episode.
    """

    def __init__(self) -> None:
        self._targets: dict[str, Any] = {}
        self._readers: dict[str, set[str]] = {}
        self._counts: dict[str, Counter[str]] = {}
        self._times: dict[tuple[str, str], array[float]] = {}

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode of :func:`with_chains`."""
        for fault in episode.faults:
            name = fault.id
            self._targets.setdefault(name, fault.target)
            self._readers.setdefault(name, set()).update(fault.read_by)
            self._counts.setdefault(name, Counter()).update(_passed_steps(fault))
            if fault.manifested_at is not None:
                for latency in _LATENCIES:
                    seconds = getattr(fault, latency)
                    if seconds is not None:
                        self._times.setdefault((name, latency), array("d")).append(seconds)

    def join(self, other: FaultMetrics) -> None:
        """Add the sums of another case."""
        self._targets = {**other._targets, **self._targets}
        for name, counts in other._counts.items():
            self._readers.setdefault(name, set()).update(other._readers[name])
            self._counts.setdefault(name, Counter()).update(counts)
        for key, times in other._times.items():
            self._times.setdefault(key, array("d")).extend(times)

    def entries(self) -> list[FaultMetricsEntry]:
        """Return what came of them, fault by fault.

        ``activated`` and ``manifested`` are counted over all episodes that were run, what follows
        over those in which the fault manifested: ``propagated`` of ``followed``, in which that is
        known, ``detected``, ``recovery`` (recovery acted) and ``recovered`` (control was handed
        back). ``violated`` is counted of ``judged``, the episodes whose outcome is known from a
        verdict on a campaign. A violation that the run of the same seed without the fault has as
        well is not attributed to it: episodes with no others count as ``violated_without``.
        Rates: activation and manifestation are shares of all runs, propagation of those followed,
        detection of those manifested, recovery of those in which it acted; ``None`` where there
        are none. Latencies are seconds: from the activation to the alert, from the
        manifestation to the first recovery action, and from there until the proposal was acceptable
        again.
        """
        return [self._of_fault(name, counts) for name, counts in self._counts.items()]

    def _of_fault(self, name: str, counts: Counter[str]) -> FaultMetricsEntry:
        figures: dict[str, Any] = {step: counts[step] for step in _CHAIN_STEPS}
        for latency in _LATENCIES:
            figures[latency] = _latency_summary(self._times.get((name, latency)))
        return FaultMetricsEntry(
            id=name,
            target=self._targets[name],
            read_by=sorted(self._readers[name]),
            rates=FaultRates(
                **{
                    rate: share(counts[part], counts[whole])
                    for rate, (part, whole) in RATES.items()
                }
            ),
            **figures,
        )


def _passed_steps(fault: TracedFault) -> list[str]:
    """List the steps that a fault passed in one episode."""
    reached = fault.manifested_at is not None
    passed = {
        "run": True,
        "activated": fault.activated_at is not None,
        "manifested": reached,
        "followed": reached and fault.propagation in ("propagated", "contained"),
        "propagated": reached and fault.propagation == "propagated",
        "detected": reached and fault.detected_at is not None,
        "recovery": reached and fault.recovery_at is not None,
        "recovered": reached and fault.recovered_at is not None,
        "judged": fault.outcome not in (None, "missing"),
        "violated": fault.outcome == "violated",
        "violated_without": fault.outcome == "violated also without it",
    }
    return [step for step in _CHAIN_STEPS if passed[step]]


def _latency_summary(times: array[float] | None) -> LatencyEntry | None:
    """Median and maximum of a latency in s, where it is known."""
    return LatencyEntry(median=statistics.median(times), max=max(times)) if times else None


_DERIVED_OUTCOMES = ("comfort_failed", "rescued")
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
        self._usage: Counter[str] = Counter()

    def add(self, episode: EpisodeEntry) -> None:
        """Add an episode.

        Args:
            episode: Of :func:`episode_record`.
        """
        outcome = episode.outcome
        truths = {key: value for key, value in outcome.measures.items() if isinstance(value, bool)}
        self._truths.update(truths)
        known = {"flagged": outcome.flagged, **_derived(episode)}
        known |= {_OF_MEASURE + key: value for key, value in truths.items()}
        raised = [key for key, value in known.items() if value]
        self._validity[episode.validity] += 1
        self._early += episode.termination == "decided"
        self._known.update(key for key, value in known.items() if value is not None)
        self._in_run.update(raised)
        self._faults.add(episode)
        usage = episode.metrics.answer_usage
        if usage is not None:
            decisions = len(episode.metrics.answer_seconds)
            self._usage.update({"episodes": 1, "decisions": decisions, **encode(usage)})
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
        if outcome.switching.decisions:
            self._add_switching(outcome.switching)
        for name, value in episode.metrics.user.items():
            column = self._user.setdefault(name, array("d"))
            if value is not None:
                column.append(value)

    def _add_switching(self, switching: Switching) -> None:
        self._switching["episodes"] += 1
        self._switching.update({key: getattr(switching, key) for key in _SUMMED_METRICS})
        self._times_to_safe.extend(time for time in switching.time_to_safe if time is not None)

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
            (self._usage, other._usage),
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

        Counts of ``flagged``, of measures that are true, ``comfort_failed`` and ``rescued`` are
        given over valid episodes and over all that were run, each with its share: of the valid
        ones, and of the planned ones. Of those that ended once all was decided (``ended_early``),
        they are what was observed until then.

        Args:
            planned: Episodes that were planned.
        """
        truths = {name: self._share(_OF_MEASURE + name, planned) for name in sorted(self._truths)}
        numbers = {name: _spread(self._measures[name]) for name in sorted(self._measures)}
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
            comfort_failed=self._share("comfort_failed", planned),
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
            usage=CaseUsage(**self._usage) if self._usage else None,
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


def _spread(numbers: array[float]) -> MeasuredNumbers:
    return MeasuredNumbers(
        runs=len(numbers),
        mean=_mean(numbers),
        sd=_finite(statistics.stdev(numbers)) if len(numbers) > 1 else None,
    )


def _mean(numbers: array[float]) -> float | None:
    return _finite(statistics.fmean(numbers)) if numbers else None


def _finite(value: float) -> float | None:
    """Return a sum's quotient; ``None`` where the sum has left the range of numbers."""
    return value if math.isfinite(value) else None


def case_order(case: CasePlan) -> tuple[float, str, str]:
    """Sort key of cases: the place that the scenario gives, then their names."""
    place = math.inf if case.order is None else case.order
    return place, case.id, case.component


def _derived(episode: EpisodeEntry) -> dict[str, bool | None]:
    """Derive outcomes from an episode's measures; ``None`` where they are not measured."""
    discomfort = episode.metrics.performance.get(DISCOMFORT)
    switching = episode.outcome.switching
    return {
        "comfort_failed": None if discomfort is None else (discomfort.max or 0.0) > 1.0,
        "rescued": switching.takeovers > 0 if switching.decisions else None,
    }


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
            for problem in repeat_problems(case, digests, asked_models=bool(self.head.models)):
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
