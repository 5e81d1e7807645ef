"""Judge the verdicts of a record again: on traces, and on the recorded episodes of their campaigns.

A verdict names the episodes that violated it. The statuses of all others follow from their
validity, or from their traces where there are any; the judge of campaigns decides on them again.
Taken as recorded are margins and vacuous episodes without a trace, and tables of pairs.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from pytest_dura.core.errors import ConfigurationError
from pytest_dura.evidence.case_model import CaseEntry, RepeatEntry, RequirementEntry
from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.episodes import case_situations
from pytest_dura.evidence.gate import with_repeats
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.evidence.verdict_model import MeasuredChange, MeasuredPairs, VerdictEntry
from pytest_dura.evidence.verify_record import differences
from pytest_dura.requirements.campaign_judge import CampaignJudge, RunSchedule
from pytest_dura.requirements.campaign_verdicts import (
    EVERY_EPISODE,
    TEST_FAILED,
    CampaignVerdict,
    Situations,
)
from pytest_dura.requirements.comparison import mcnemar
from pytest_dura.requirements.episode_verdicts import EARLY_ENDS, EpisodeStatus, EpisodeVerdict
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.pairs import Change, PairCounts
from pytest_dura.requirements.rate_tests import EXACT_METHOD, upper_bound

TraceVerdicts = Mapping[tuple[int, str], EpisodeVerdict]
"""Verdicts on traces, by the number of the verdict and the id of the episode."""
_NONDETERMINISTIC = "infrastructure: nondeterministic"
"""Beginning of the reason why a session does not trust a verdict."""


@dataclass(frozen=True, slots=True)
class _Run:
    """Properties of a planned run, or of a run and its twin, that a verdict rests on."""

    episode: str
    number: int
    validity: str
    termination: str
    proposals: int
    valid_proposals: int
    not_manifested: tuple[str, ...]
    recovered: bool
    trajectory: str
    drawn: bool

    @classmethod
    def of(cls, episode: EpisodeEntry) -> _Run:
        metrics = episode.metrics
        return cls(
            episode.id,
            episode.spec.run,
            episode.validity,
            episode.termination,
            metrics.proposals,
            metrics.valid_proposals,
            tuple(fault.id for fault in episode.faults if fault.manifested_at is None),
            metrics.recoveries > 0,
            episode.trajectory,
            episode.drawn,
        )

    def add_to(self, situations: Situations) -> None:
        """Add the run to those of which it is asked whether they are all equal."""
        case, valid = self.episode.rpartition("#")[0], self.validity == "valid"
        situations.add_run(case, self.number, self.trajectory, valid=valid, drawn=self.drawn)

    def with_twin(self, twin: _Run) -> _Run:
        """The pair of both, which is spoilt as soon as one of them is."""
        for spoilt in ("missing", "invalid"):
            for side in (self, twin):
                if side.validity == spoilt:
                    return replace(self, validity=spoilt, termination=side.termination)
        return self


@dataclass
class _CaseRuns:
    """The planned runs of a case with one component, by number."""

    runs: dict[int, _Run] = field(default_factory=dict)
    is_unambiguous: bool = True
    """Whether each number stands for a single run."""

    def add(self, run: _Run) -> None:
        self.is_unambiguous &= run.number not in self.runs
        self.runs[run.number] = run


def verdict_problems(record: SessionRecord, judged: TraceVerdicts) -> Iterator[str]:
    """Judge each verdict again, and yield the differences.

    Args:
        record: The record.
        judged: Verdicts on traces.
    """
    runs: dict[tuple[str, str], _CaseRuns] = defaultdict(_CaseRuns)
    for episode in record.episodes():
        if episode.planned:
            runs[episode.case, episode.component].add(_Run.of(episode))
    cases = {(case.id, case.component): case for case in record.head.cases}
    requirements = {requirement.id: requirement for requirement in record.head.requirements}
    verdicts_on: dict[tuple[str, str], list[VerdictEntry]] = defaultdict(list)
    for verdict in record.head.verdicts:
        verdicts_on[verdict.case, verdict.component].append(verdict)
    on_traces: dict[int, dict[str, EpisodeVerdict]] = defaultdict(dict)
    for (number, name), traced in judged.items():
        on_traces[number][name] = traced
    for number, verdict in enumerate(record.head.verdicts):
        place = verdict.case, verdict.component
        case, requirement = cases.get(place), requirements.get(verdict.requirement)
        if case is None or requirement is None:
            continue  # reported in verify_record
        pairs = verdict.pairs
        check = _VerdictCheck(
            verdict,
            requirement,
            case,
            runs[place],
            None if pairs is None else runs[pairs.case, verdict.component],
            on_traces[number],
            _violating_episodes(verdicts_on[place], verdict.run, case.requirements),
            any(
                requirements[name].paired is None
                for name in case.requirements
                if name in requirements
            ),
            [
                cases[name, verdict.component].repeat
                for name in (verdict.case, *([pairs.case] if pairs else []))
                if (name, verdict.component) in cases
            ],
        )
        about = f"{verdict.requirement} on {verdict.case}"
        for problem in check.problems():
            if problem.startswith("/"):
                yield f"/verdicts/{number}{problem} ({about})"
            else:
                yield f"verdict {about}: {problem}"


def _violating_episodes(
    verdicts: Sequence[VerdictEntry], runs: int, requirements: Collection[str]
) -> set[str] | None:
    """Ids of episodes that violate any requirement by themselves; ``None`` if not each was judged.

    Args:
        verdicts: Those on the case.
        runs: Number of its runs.
        requirements: Those of the case.
    """
    judged = {verdict.requirement for verdict in verdicts if verdict.run >= runs}
    if not judged.issuperset(requirements):
        return None
    alone = [verdict for verdict in verdicts if verdict.paired is None]
    return {counter.episode for verdict in alone for counter in verdict.counterexamples}


@dataclass(frozen=True)
class _VerdictCheck:
    """Check of a verdict against the runs that it rests on.

    Args:
        verdict: Of the record.
        requirement: Of the record.
        case: Of the record.
        own: Planned runs of the case.
        twins: Runs that these are compared with, of a verdict on pairs.
        on_traces: Verdicts on its episodes by their traces.
        violating_episodes: Ids of episodes that violate a requirement of the case by themselves;
            ``None`` if not all were judged.
        judges_alone: Whether a requirement of the case judges single episodes.
        repeats: Repetitions of its case, and of that of the second runs.
    """

    verdict: VerdictEntry
    requirement: RequirementEntry
    case: CaseEntry
    own: _CaseRuns
    twins: _CaseRuns | None
    on_traces: Mapping[str, EpisodeVerdict]
    violating_episodes: Collection[str] | None
    judges_alone: bool
    repeats: Sequence[RepeatEntry | None]

    def problems(self) -> Iterator[str]:
        """Yield differences as JSON pointers below the verdict, and contradictions in words."""
        verdict, spoilt = self.verdict, self.verdict.spoilt
        yield from _margin_problems(verdict, self.on_traces.values())
        if verdict.planned > self.case.planned:
            yield f"{verdict.planned} runs planned, and fewer of its case"
        if spoilt and all(run.episode != spoilt.episode for run in self.own.runs.values()):
            yield f"{spoilt.episode} says nothing of it, and is none of its runs"
        runs = self._runs()
        if runs is None:
            yield f"it rests on {verdict.run} runs, and not all are among the episodes"
            yield from _claim_problems(verdict)
            return
        if verdict.pairs is not None:
            recovered = sum(run.recovered for run in runs)
            yield from pair_problems(verdict, recovered if self.own.is_unambiguous else None)
        else:
            yield from self._run_problems(runs)
        yield from self._crash_problems(runs)
        again = list(self._judged_again(runs))
        yield from again[0] if again else _claim_problems(verdict)

    def _runs(self) -> list[_Run] | None:
        """List the runs, or pairs of runs, that it may rest on; ``None`` if not all are there."""
        own, number = self.own.runs, self.verdict.run
        if not self.verdict.check and self.twins is None:
            # A test on single episodes, of which a part may have been chosen.
            return [own[run] for run in sorted(own)] if number <= len(own) else None
        twins = own if self.twins is None else self.twins.runs
        if any(run not in own or run not in twins for run in range(number)):
            return None
        return [own[run].with_twin(twins[run]) for run in range(number)]

    def _run_problems(self, runs: Sequence[_Run]) -> Iterator[str]:
        """Compare violating, open and crashed runs with how they ended."""
        verdict, ends = self.verdict, {run.episode: run for run in runs}
        violated = {entry.episode for entry in verdict.counterexamples}
        # A violation that was seen before an infrastructure error counts.
        valid = sum(
            run.validity == "valid" or (run.validity == "missing" and run.episode in violated)
            for run in runs
        )
        if verdict.episodes > valid:
            yield f"{verdict.episodes} episodes are valid to it, and {valid} are"
        if unknown := violated - ends.keys():
            yield f"{min(unknown)} is its counterexample, and none of its runs"
        for episode in verdict.open:
            if episode in ends and ends[episode].termination not in EARLY_ENDS:
                yield f"{episode} is open, and it ended by {ends[episode].termination}"
        for episode in verdict.unseen_crashes:
            if episode in ends and ends[episode].termination != "critical":
                yield f"{episode} crashed unseen, and it ended by {ends[episode].termination}"
        for entry in verdict.counterexamples:
            run = ends.get(entry.episode)
            if run is not None and entry.valid == (run.validity == "invalid"):
                yield f"{run.episode} is {run.validity}, and its violation says otherwise"

    def _crash_problems(self, runs: Sequence[_Run]) -> Iterator[str]:
        """Yield crashes that violate nothing, and that a supported verdict passes over."""
        if self.violating_episodes is None or self.verdict.verdict != "supported":
            return
        explained = {*self.violating_episodes, *self.verdict.unseen_crashes}
        sides = [self.own.runs[run.number] for run in runs]
        if self.twins is not None and not self.judges_alone:
            # Otherwise it is not recorded which of the second runs violate what.
            sides += [self.twins.runs[run.number] for run in runs]
        for run in sides:
            if run.termination == "critical" and run.episode not in explained:
                yield f"supported, although {run.episode} crashed and violates nothing"

    def _judged_again(self, runs: Sequence[_Run]) -> Iterator[list[str]]:
        """Yield the differences from the verdict that its runs give; nothing if none is known."""
        verdict = self.verdict
        unambiguous = self.own.is_unambiguous and (self.twins is None or self.twins.is_unambiguous)
        if len(runs) != verdict.run or not unambiguous:
            return  # it is not known which runs it rests on
        statuses = self._statuses(runs)
        if statuses is None:
            counts = f"{verdict.episodes} episodes, {verdict.invalid} invalid"
            yield [f"its runs do not come to {counts}, {verdict.missing} missing"]
            return
        verdicts, is_only = statuses
        sequential = verdict.method not in (EVERY_EPISODE, "fixed")
        if not is_only and (sequential or any(run.not_manifested for run in verdicts)):
            return  # the order matters, and is not known
        try:
            decided = [self._decided(runs, verdicts, until) for until in (False, True)]
        except ConfigurationError as error:
            yield [f"it cannot be judged ({error.problem})"]
            return
        possible = [
            list(self._differences(known, verdicts, is_only=is_only)) for known in decided if known
        ]
        yield min(
            possible, key=len, default=["/run: its runs end the campaign earlier, or not yet"]
        )

    def _statuses(self, runs: Sequence[_Run]) -> tuple[list[EpisodeVerdict], bool] | None:
        """Assign a status to each run; the flag says whether this is the only assignment."""
        verdict = self.verdict
        violated = {entry.episode: entry for entry in verdict.counterexamples}
        remaining = Counter(
            satisfied=verdict.episodes - verdict.violations - len(verdict.open),
            open=len(verdict.open),
            invalid=verdict.invalid - verdict.without_effect,
            missing=verdict.missing,
            violated=verdict.violations + verdict.without_effect,
        )
        measured = verdict.paired is not None and verdict.paired.measure
        is_only, vacuous, verdicts = True, verdict.vacuous, []
        listed = {*violated, *verdict.open}
        rest = Counter(run.validity for run in runs if run.episode not in listed)
        exact = rest["valid"] == remaining["satisfied"] and rest["invalid"] == remaining["invalid"]
        for run in runs:
            traced, counterexample = self.on_traces.get(run.episode), violated.get(run.episode)
            status: EpisodeStatus = "satisfied"
            if counterexample is not None:
                status = "violated"
            elif run.episode in verdict.open:
                status = "open"
            elif traced is not None and traced.verdict != "violated":
                status = traced.verdict
            elif run.validity != "valid":
                # A failing function makes an invalid run missing.
                is_invalid = run.validity == "invalid" and remaining["invalid"]
                status = "invalid" if is_invalid else "missing"
            elif not remaining["satisfied"]:
                status = "invalid" if remaining["invalid"] else "missing"
            is_known = counterexample is not None or traced is not None or status == "open"
            is_only &= exact or is_known
            remaining[status] -= 1
            empty = vacuous > 0 and status == "satisfied" and (traced is None or traced.vacuous)
            vacuous -= empty
            margin = time = None
            if counterexample is not None:
                margin, time = counterexample.margin, counterexample.time
            elif traced is not None:
                margin, empty = traced.margin, traced.vacuous
            early = run.termination in EARLY_ENDS and not measured
            verdicts.append(
                EpisodeVerdict(
                    verdict.requirement,
                    run.episode,
                    verdict.component,
                    status,
                    margin,
                    time,
                    self._detail(run) if status == "missing" else "",
                    run.proposals,
                    run.valid_proposals,
                    empty,
                    run.not_manifested,
                    without_effect=counterexample is not None and not counterexample.valid,
                    ended=run.termination if early else "",
                    unseen_crash=self._unseen_crash(run),
                )
            )
        return None if any(remaining.values()) else (verdicts, is_only)

    def _detail(self, run: _Run) -> str:
        """Why a run is missing: it ended by an error, or a test did not judge it."""
        spoilt = self.verdict.spoilt
        if spoilt is not None and spoilt.episode == run.episode:
            return spoilt.detail
        return "" if self.verdict.check or run.validity == "missing" else TEST_FAILED

    def _unseen_crash(self, run: _Run) -> str:
        """Id of the run, or of its twin, whose crash the verdict names; empty without one."""
        sides = [run.episode]
        if self.twins is not None:
            sides.append(self.twins.runs[run.number].episode)
        return next((side for side in sides if side in self.verdict.unseen_crashes), "")

    def _decided(
        self, runs: Sequence[_Run], verdicts: Sequence[EpisodeVerdict], until: bool
    ) -> CampaignVerdict | None:
        """Decide again as a campaign does; ``None`` if that takes another number of runs."""
        recorded, bound = self.verdict, self.verdict.bound
        every = recorded.method == EVERY_EPISODE
        asked = Requirement.from_json(
            {
                "id": recorded.requirement,
                "at_most": bound.at_most,
                "confidence": bound.confidence,
                "method": None if every else recorded.method,
                "p0": self.requirement.p0 if recorded.method == "sprt" else None,
                "paired": None if recorded.paired is None else recorded.paired.to_json(),
            }
        )
        planned = recorded.planned
        judge = CampaignJudge(
            asked,
            recorded.case,
            planned=planned,
            component=recorded.component,
            until_decided=until,
        )
        situations = case_situations(self.case)
        if not recorded.check and self.twins is None:
            # Each test has decided on its own episode: they have no order and no end.
            for run in runs:
                run.add_to(situations)
            for verdict in verdicts:
                judge.add(verdict)
            judge.situation = situations.situation if len(runs) >= planned > 1 else None
            return judge.verdict()
        schedule = RunSchedule(planned, sequential=judge.sequential)
        for number, verdict in enumerate(verdicts):
            if judge.decided or number == schedule.end:
                return None
            run = self.own.runs[number]
            schedule.add(run.validity)
            judge.add(verdict)
            run.add_to(situations)
            if self.twins is not None:
                self.twins.runs[number].add_to(situations)
            judge.situation = situations.situation
        over = judge.decided or len(verdicts) == schedule.end or not verdicts
        return judge.verdict() if over else None

    def _differences(
        self, again: CampaignVerdict, verdicts: Sequence[EpisodeVerdict], *, is_only: bool
    ) -> Iterator[str]:
        """Compare with a verdict that was judged again, as far as that is known."""
        recorded, known = self.verdict, self.verdict.to_json()
        doubts = with_repeats(again.verdict, again.reason, self.repeats, recorded.component)
        computed = {
            key: value
            for key, value in plain_data(replace(again, **doubts).to_json()).items()
            if key in known
        }
        unknown = {"pairs"}  # a table that is checked on its own
        if not recorded.run:
            unknown.add("reason")  # a test that ended without a verdict says so itself
        distrusted = recorded.reason.startswith(_NONDETERMINISTIC)
        if recorded.verdict == "undecided" and again.verdict != "violated" and distrusted:
            unknown |= {"verdict", "reason"}
            computed["too_few"] = False
        by_tests = not recorded.check and self.twins is None
        violated = {entry.episode for entry in recorded.counterexamples}
        measured = {*violated, *self.on_traces}
        if not by_tests and any(
            _has_margin(run) and run.episode not in measured for run in verdicts
        ):
            unknown |= {"margin", "margins"}
        for key in computed.keys() - unknown:
            if key == "spoilt" and computed[key] and known[key]:
                names = ("episode", "verdict") if is_only else ("verdict",)
                for name in names:
                    yield from differences(f"/spoilt/{name}", known[key][name], computed[key][name])
            else:
                yield from differences(f"/{key}", known[key], computed[key])


def _has_margin(verdict: EpisodeVerdict) -> bool:
    """Whether an episode's margin is part of its campaign's distribution."""
    return verdict.valid and verdict.verdict != "open"


def _margin_problems(verdict: VerdictEntry, on_traces: Iterable[EpisodeVerdict]) -> Iterator[str]:
    """Check margins that are taken as recorded: those of all episodes are not known.

    Args:
        verdict: Of the record.
        on_traces: Verdicts on its episodes by their traces.
    """
    margins = verdict.margins
    if (margins is None) != (verdict.margin is None):
        yield f"the margin is {verdict.margin}, and its distribution {margins}"
    if margins is None:
        return
    quartiles = (margins.min, margins.q25, margins.median, margins.q75, margins.max)
    points = [point for point in quartiles if point is not None]
    if len(points) < len(quartiles) or points != sorted(points):
        yield "the quartiles of its margins are not in order"
        return
    if margins.min != verdict.margin:
        yield f"its least margin is {verdict.margin}, and its distribution has {margins.min}"
    listed = [entry.margin for entry in verdict.counterexamples if entry.valid]
    known = [margin for margin in listed if margin is not None]
    if not len(known) <= margins.n <= verdict.episodes:
        yield f"{margins.n} margins of {verdict.episodes} episodes"
    known += [
        traced.margin for traced in on_traces if _has_margin(traced) and traced.margin is not None
    ]
    for margin in known:
        if not points[0] <= margin <= points[-1]:
            yield f"its margins begin at {margins.min}, and one is {margin}"


_ROUNDING = 1e-6
_PAIR_COUNTS = ("only_with", "only_without", "both", "neither")


def pair_problems(verdict: VerdictEntry, recovered: int | None) -> Iterator[str]:
    """Check a table of pairs, which is taken as recorded, against its verdict and its runs.

    Args:
        verdict: Of the record, on pairs.
        recovered: Its runs in which recovery acted, if they are known.
    """
    pairs = verdict.pairs
    if isinstance(pairs, MeasuredPairs):
        yield from _change_problems(verdict, pairs.change)
        return
    if pairs is None:
        return
    counts, open_pairs = pairs.to_json(), pairs.incomplete
    complete = sum(counts[kind] for kind in _PAIR_COUNTS)
    if not pairs.pairs == complete + open_pairs == verdict.run:
        yield f"the table of its pairs does not add up to {verdict.run}"
    acted = sum(counts[f"acted_{kind}"] for kind in _PAIR_COUNTS)
    if any(counts[f"acted_{kind}"] > counts[kind] for kind in _PAIR_COUNTS):
        yield "recovery acted in more of its pairs than there are"
    if recovered is not None and not acted <= recovered <= acted + open_pairs:
        yield f"recovery acted in {acted} of its pairs, and in {recovered} of its runs"
    p_value = mcnemar(pairs.only_with, pairs.only_without)
    again = PairCounts.from_json(counts | {"p_value": p_value}).to_json()
    yield from differences("/pairs", counts, counts | again)
    for name in ("with", "without"):
        least, violated = pairs.both + counts[f"only_{name}"], counts[f"violated_{name}"]
        if not least <= violated <= least + open_pairs:
            yield f"{violated} runs {name} it violated it, and its table says {least}"


def _change_problems(verdict: VerdictEntry, change: MeasuredChange) -> Iterator[str]:
    """Check the changes of a measure against their summary and the verdict."""
    if len(change.pairs) != len(change.values):
        yield f"its change has {len(change.values)} values for {len(change.pairs)} pairs"
        return
    recorded = change.to_json()
    yield from differences("/pairs/change", recorded, Change.from_json(recorded).to_json())
    counted = change.n + len(change.lost) + len(change.gained)
    if not counted <= verdict.run:
        yield f"its change has {counted} pairs, of {verdict.run}"
    bound = None if verdict.paired is None else verdict.paired.change_at_most
    if bound is None:
        yield "the changes of a measure, and nothing says how much it may grow"
        return
    excesses = [value - bound for value in change.values if value is not None]
    # Values that equal the bound but for rounding violate nothing.
    slack = _ROUNDING * max(1.0, abs(bound))
    least, most = (sum(excess > shift for excess in excesses) for shift in (slack, -slack))
    lost = len(change.lost)
    if not least + lost <= verdict.violations <= most + lost:
        yield f"{verdict.violations} pairs violate it, and its changes give {least + lost}"


def _claim_problems(verdict: VerdictEntry) -> Iterator[str]:
    """Check a verdict of which it is not known what each of its runs came to."""
    bound, valid, run = verdict.bound, verdict.episodes, verdict.run
    counterexamples, open_ = verdict.counterexamples, len(verdict.open)
    violations, missing = verdict.violations, verdict.missing
    without_effect = verdict.without_effect
    if valid + verdict.invalid + missing != run:
        yield f"valid, invalid and missing episodes do not add up to {run}"
    listed = sum(entry.valid for entry in counterexamples)
    if (violations, without_effect) != (listed, len(counterexamples) - listed):
        counts = f"{violations} violations, {without_effect} without effect"
        yield f"{counts}, and {len(counterexamples)} counterexamples, {listed} of them valid"
    if violations + open_ > valid or without_effect > verdict.invalid:
        yield f"more violations and open episodes than the {valid} valid and the invalid ones"
    if verdict.situation is not None:
        expected = None
    elif bound.method != EXACT_METHOD or not valid:
        expected = bound.upper  # of a sequential method: the order matters, and is not known
    else:
        expected = upper_bound(min(violations + open_, valid), valid, bound.confidence)
    yield from differences("/bound/upper", bound.upper, expected)
    if verdict.verdict == "violated" and not counterexamples:
        yield "violated without a violation"
    exact = bound.method == EXACT_METHOD and bound.at_most is not None
    against = (
        (missing or not valid, f"{valid} episodes valid and {missing} missing"),
        (run + verdict.saved < verdict.planned, f"{run} of {verdict.planned} runs"),
        (bound.at_most is None and (violations or open_), "violations or open episodes"),
        (without_effect, "violations in invalid runs"),
        (verdict.unseen_crashes, "a crash that violates nothing"),
        (exact and (bound.upper or 1.0) > (bound.at_most or 0.0), "a bound above its rate"),
    )
    if verdict.verdict == "supported":
        yield from (f"supported with {what}" for holds, what in against if holds)
