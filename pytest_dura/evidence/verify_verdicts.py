"""Verify that verdicts are what the recorded episodes of their campaigns come to.

A verdict names the episodes that violated it. The statuses of all others follow from their
validity, or from their traces where there are any; from all of them it is decided again.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from pytest_dura.evidence.entry import plain_data
from pytest_dura.evidence.episodes import case_situations
from pytest_dura.evidence.model import SessionRecord
from pytest_dura.requirements.campaign_judge import CampaignJudge
from pytest_dura.requirements.campaign_verdicts import (
    EQUAL_RUNS,
    EVERY_EPISODE,
    REPEATED,
    CampaignVerdict,
    Margins,
    Situation,
    Situations,
)
from pytest_dura.requirements.episode_verdicts import EARLY_ENDS, EpisodeStatus, EpisodeVerdict
from pytest_dura.requirements.model import Requirement

Data = Mapping[str, Any]


def _has_margin(verdict: EpisodeVerdict) -> bool:
    """Whether an episode's margin is part of its campaign's distribution."""
    return verdict.valid and verdict.verdict != "open"


def _margin_distribution(margins: Iterable[float | None]) -> dict[str, Any] | None:
    """Summarise the margins that are not ``None``, as in the record."""
    distribution = Margins.of([margin for margin in margins if margin is not None])
    return None if distribution is None else asdict(distribution)


def _margin_problems(verdict: Data, on_traces: Iterable[EpisodeVerdict]) -> Iterator[str]:
    """Yield the contradictions between the margins of a verdict.

    Args:
        verdict: Of the record.
        on_traces: Verdicts on its episodes by their traces.
    """
    margins = verdict["margins"]
    counterexamples = verdict["counterexamples"]
    listed = [entry["margin"] for entry in counterexamples if entry["valid"]]
    order = [
        (not entry["valid"], entry["margin"] or 0.0, entry["episode"]) for entry in counterexamples
    ]
    if order != sorted(order):
        yield "its counterexamples are not in the order of their margins"
    if (margins is None) != (verdict["margin"] is None):
        yield f"the margin is {verdict['margin']}, and its distribution {margins}"
    elif margins is not None:
        yield from _distribution_problems(
            verdict, [margin for margin in listed if margin is not None], on_traces
        )


def _distribution_problems(
    verdict: Data, listed: list[float], on_traces: Iterable[EpisodeVerdict]
) -> Iterator[str]:
    margins = verdict["margins"]
    points = [margins[name] for name in ("min", "q25", "median", "q75", "max")]
    if None in points or points != sorted(points):
        yield "the quartiles of its margins are not in order"
        return
    if margins["min"] != verdict["margin"]:
        yield f"its least margin is {verdict['margin']}, and its distribution has {margins['min']}"
    if not len(listed) <= margins["n"] <= verdict["episodes"]:
        yield f"{margins['n']} margins of {verdict['episodes']} episodes"
    traced = [
        on_trace.margin
        for on_trace in on_traces
        if _has_margin(on_trace) and on_trace.margin is not None
    ]
    for margin in (*listed, *traced):
        if not margins["min"] <= margin <= margins["max"]:
            yield f"its margins begin at {margins['min']}, and one is {margin}"
    # A test on single episodes reports the margins of violations alone.
    measured = verdict["paired"] is not None and verdict["paired"]["measure"]
    by_tests = not verdict["check"] and not measured
    whole = verdict["violations"] == verdict["episodes"] == len(listed) or by_tests
    if whole and margins != plain_data(_margin_distribution(listed)):
        yield "the distribution of its margins is not that of its counterexamples"


_ROUNDING = 1e-6
_PAIR_COUNTS = ("only_with", "only_without", "both", "neither")


def pair_problems(verdict: Data, recovered: int | None) -> Iterator[str]:
    """Yield the contradictions between a table of pairs, its verdict and its runs.

    Args:
        verdict: Of the record, on pairs.
        recovered: Its runs in which recovery acted, if they are known.
    """
    pairs = verdict["pairs"]
    if "change" in pairs:
        yield from _change_problems(verdict)
        return
    from pytest_dura.requirements.comparison import mcnemar

    open_pairs = pairs["incomplete"]
    complete = sum(pairs[kind] for kind in _PAIR_COUNTS)
    if not pairs["pairs"] == complete + open_pairs == verdict["run"]:
        yield f"the table of its pairs does not add up to {verdict['run']}"
    acted = sum(pairs[f"acted_{kind}"] for kind in _PAIR_COUNTS)
    if any(pairs[f"acted_{kind}"] > pairs[kind] for kind in _PAIR_COUNTS):
        yield "recovery acted in more of its pairs than there are"
    if recovered is not None and not acted <= recovered <= acted + open_pairs:
        yield f"recovery acted in {acted} of its pairs, and in {recovered} of its runs"
    p_value = mcnemar(pairs["only_with"], pairs["only_without"])
    if pairs["p_value"] != p_value:
        yield f"p is {pairs['p_value']}, and its table gives {p_value}"
    tried = pairs["acted_only_without"] + pairs["acted_both"]
    rate = pairs["acted_only_without"] / tried if tried else None
    if pairs["success_rate"] != rate:
        yield f"the rate of success is {pairs['success_rate']}, and its table gives {rate}"
    for name in ("with", "without"):
        least, violated = pairs["both"] + pairs[f"only_{name}"], pairs[f"violated_{name}"]
        if not least <= violated <= least + open_pairs:
            yield f"{violated} runs {name} it violated it, and its table says {least}"


def _change_problems(verdict: Data) -> Iterator[str]:
    """Yield the contradictions between the changes of a measure, their summary and the verdict."""
    from pytest_dura.requirements.pairs import Change

    change = verdict["pairs"]["change"]
    if len(change["pairs"]) != len(change["values"]):
        yield f"its change has {len(change['values'])} values for {len(change['pairs'])} pairs"
        return
    if Change.from_json(change).to_json() != change:
        yield "the summary of its change is not that of its values"
    counted = change["n"] + sum(len(change[key]) for key in ("lost", "gained"))
    if not counted <= verdict["run"]:
        yield f"its change has {counted} pairs, of {verdict['run']}"
    bound = verdict["paired"]["change_at_most"]
    excesses = [value - bound for value in change["values"] if value is not None]
    # Values that equal the bound but for rounding violate nothing.
    slack = _ROUNDING * max(1.0, abs(bound))
    least, most = (sum(excess > shift for excess in excesses) for shift in (slack, -slack))
    lost = len(change["lost"])
    if not least + lost <= verdict["violations"] <= most + lost:
        yield f"{verdict['violations']} pairs violate it, and its changes give {least + lost}"


TraceVerdicts = Mapping[tuple[int, str], EpisodeVerdict]
"""Verdicts on traces, by the number of the verdict and the id of the episode."""
_EXTRA_SHARE = 0.2
"""Further runs that may follow invalid ones, as a share of the planned ones."""
_UNLISTED: Data = {"planned": math.inf, "variation": {}, "faults": []}
"""Substitute for a case that the record does not have."""


@dataclass(frozen=True)
class _Run:
    """Properties of a planned run that a verdict rests on."""

    episode: str
    validity: str
    termination: str
    proposals: int
    valid_proposals: int
    not_manifested: tuple[str, ...]
    recovered: bool
    trajectory: str
    drawn: bool


@dataclass
class _Case:
    """The planned runs of a case with one component."""

    runs: dict[int, _Run] = field(default_factory=dict)
    is_unambiguous: bool = True
    """Whether each number stands for a single run."""

    def add(self, episode: Data) -> None:
        number, metrics = episode["spec"]["run"], episode["metrics"]
        self.is_unambiguous &= number not in self.runs
        self.runs[number] = _Run(
            episode["id"],
            episode["validity"],
            episode["termination"],
            metrics["proposals"],
            metrics["valid_proposals"],
            tuple(fault["id"] for fault in episode["faults"] if fault["manifested_at"] is None),
            metrics["recoveries"] > 0,
            episode["trajectory"],
            episode["drawn"],
        )

    def add_to(self, situations: Situations, numbers: Iterable[int]) -> None:
        """Add the runs of these numbers to the situations."""
        for number in numbers:
            run = self.runs[number]
            situations.add_run(
                run.episode.rpartition("#")[0],
                number,
                run.trajectory,
                valid=run.validity == "valid",
                drawn=run.drawn,
            )


def _situation_text(situation: str | None) -> str:
    return "no single situation" if situation is None else f"one situation, {situation}"


def verdict_problems(record: SessionRecord, judged: TraceVerdicts) -> Iterator[str]:
    """Yield the contradictions between verdicts and their episodes.

    Args:
        record: The record.
        judged: Verdicts on traces.
    """
    cases: dict[tuple[str, str], _Case] = defaultdict(_Case)
    for episode in record.episodes():
        if episode["planned"]:
            cases[episode["case"], episode["component"]].add(episode)
    listed = {(case["id"], case["component"]): case for case in record["cases"]}
    requirements = {requirement["id"]: requirement for requirement in record["requirements"]}
    of_cases = {(case["id"], case["component"]): case["requirements"] for case in record["cases"]}
    verdicts_on: dict[tuple[str, str], list[Data]] = defaultdict(list)
    for verdict in record["verdicts"]:
        verdicts_on[verdict["case"], verdict["component"]].append(verdict)
    for number, verdict in enumerate(record["verdicts"]):
        name = f"verdict {verdict['requirement']} on {verdict['case']}"
        case_runs, twin_runs = cases[verdict["case"], verdict["component"]], None
        case = listed.get((verdict["case"], verdict["component"]), _UNLISTED)
        if verdict["planned"] > case["planned"]:
            yield f"{name}: {verdict['planned']} runs planned, and fewer of its case"
        if verdict["pairs"] is not None:
            twin_runs = cases[verdict["pairs"]["case"], verdict["component"]]
        on_traces = {episode: traced for (at, episode), traced in judged.items() if at == number}
        place = verdict["case"], verdict["component"]
        violating = _violating_episodes(verdicts_on[place], verdict["run"], of_cases.get(place, ()))
        requirement = requirements.get(verdict["requirement"], {})
        check = _VerdictCheck(
            verdict, requirement, case_runs, twin_runs, on_traces, violating, case_situations(case)
        )
        for problem in check.problems():
            yield f"{name}: {problem}"


def _violating_episodes(
    verdicts: Sequence[Data], runs: int, requirements: Collection[str]
) -> set[str] | None:
    """Ids of episodes that violate any requirement; ``None`` if not each requirement was judged.

    Args:
        verdicts: Those on the case.
        runs: Number of its runs.
        requirements: Those of the case.
    """
    judged = {verdict["requirement"] for verdict in verdicts if verdict["run"] >= runs}
    if not judged.issuperset(requirements):
        return None
    return {counter["episode"] for verdict in verdicts for counter in verdict["counterexamples"]}


@dataclass(frozen=True)
class _VerdictCheck:
    """Check of a verdict against the runs that it rests on."""

    verdict: Data
    requirement: Data
    case: _Case
    twin: _Case | None
    on_traces: Mapping[str, EpisodeVerdict]
    violating_episodes: Collection[str] | None
    """Ids of episodes that violate a requirement of the case; ``None`` if not all are judged."""
    situations: Situations
    """Situations of its case, without any run yet."""

    def problems(self) -> Iterator[str]:
        yield from _margin_problems(self.verdict, self.on_traces.values())
        verdict, unrecorded = self.verdict, self._unrecorded_run()
        if verdict["spoilt"] is not None:
            spoilt = verdict["spoilt"]["episode"]
            if all(run.episode != spoilt for run in self.case.runs.values()):
                yield f"{spoilt} says nothing of it, and is none of its runs"
        if unrecorded is not None:
            yield f"it rests on {verdict['run']} runs, and {unrecorded} is not among the episodes"
            return
        is_unambiguous = self.case.is_unambiguous
        if is_unambiguous and verdict["situation"] != (situation := self._situation()):
            recorded, computed = map(_situation_text, (verdict["situation"], situation))
            yield f"its runs are {recorded}, and their trajectories say {computed}"
        if verdict["pairs"] is not None:
            recovered = sum(self.case.runs[number].recovered for number in range(verdict["run"]))
            yield from pair_problems(verdict, recovered if is_unambiguous else None)
            return
        runs = self._runs_of_verdict()
        violated = {counterexample["episode"] for counterexample in verdict["counterexamples"]}
        # A violation that was seen before an infrastructure error counts.
        valid = sum(
            run.validity == "valid" or (run.validity == "missing" and run.episode in violated)
            for run in runs
        )
        if verdict["episodes"] > valid:
            yield f"{verdict['episodes']} episodes are valid to it, and {valid} are"
        if violated - {run.episode for run in runs}:
            yield f"{min(violated)} is its counterexample, and none of its runs"
        yield from self._early_ends(runs)
        if len(runs) == verdict["run"] and is_unambiguous:
            yield from self._decided_again(runs)

    def _early_ends(self, runs: Sequence[_Run]) -> Iterator[str]:
        """Compare runs that are open, crashed or without effect with how they ended."""
        verdict = self.verdict
        ends = {run.episode: run for run in runs}
        for episode in verdict["open"]:
            if episode in ends and ends[episode].termination not in EARLY_ENDS:
                yield f"{episode} is open, and it ended by {ends[episode].termination}"
        for episode in verdict["unseen_crashes"]:
            if episode in ends and ends[episode].termination != "critical":
                yield f"{episode} crashed unseen, and it ended by {ends[episode].termination}"
        for violated in verdict["counterexamples"]:
            run = ends.get(violated["episode"])
            if run is not None and violated["valid"] == (run.validity == "invalid"):
                yield f"{run.episode} is {run.validity}, and its violation says otherwise"
        if self.violating_episodes is None or verdict["verdict"] != "supported":
            return
        explained = {*self.violating_episodes, *verdict["unseen_crashes"]}
        for run in runs:
            if run.termination == "critical" and run.episode not in explained:
                yield f"supported, although {run.episode} crashed and violates nothing"

    def _situation(self) -> Situation | None:
        """Situation of its runs, by their trajectories."""
        verdict = self.verdict
        if not verdict["check"]:
            self.case.add_to(self.situations, self.case.runs)
            return self.situations.situation if verdict["run"] >= verdict["planned"] > 1 else None
        for case in (self.case, self.twin):
            if case is not None:
                case.add_to(self.situations, range(verdict["run"]))
        return self.situations.situation

    def _unrecorded_run(self) -> str | None:
        """Name a run that it rests on and that is not recorded."""
        verdict = self.verdict
        if not verdict["check"]:
            # A test on single episodes, of which a part may have been chosen.
            return None if verdict["run"] <= len(self.case.runs) else "one of them"
        for case in (self.case, self.twin):
            for number in range(verdict["run"]):
                if case is not None and number not in case.runs:
                    return f"number {number}"
        return None

    def _runs_of_verdict(self) -> list[_Run]:
        """List the runs that it may rest on, in their order."""
        chosen = self.case.runs
        numbers = range(self.verdict["run"]) if self.verdict["check"] else sorted(chosen)
        return [chosen[number] for number in numbers]

    def _decided_again(self, runs: Sequence[_Run]) -> Iterator[str]:
        statuses = self._statuses(runs)
        if statuses is None:
            names = ("episodes", "invalid", "missing")
            counts = ", ".join(f"{self.verdict[name]} {name}" for name in names)
            yield f"its runs do not come to {counts}"
            return
        verdicts, is_only = statuses
        if not is_only and (self._sequential or any(run.not_manifested for run in verdicts)):
            return  # the order matters, and is not known
        decided = [self._judged(verdicts, until) for until in (False, True)]
        possible = [verdict for verdict in decided if verdict is not None]
        if not any(self._agrees(verdict) for verdict in possible):
            gives = "another number of runs"
            if possible:
                gives = f"{possible[0].verdict}: {possible[0].reason}"
            yield f"{self.verdict['verdict']}: {self.verdict['reason']}; its runs give {gives}"
        if is_only and all(run.episode in self.on_traces for run in runs):
            margins = [run.margin for run in verdicts if _has_margin(run)]
            if self.verdict["margins"] != plain_data(_margin_distribution(margins)):
                yield "the distribution of its margins is not that of its traces"
            if self.verdict["vacuous"] != sum(run.vacuous for run in verdicts):
                yield f"{self.verdict['vacuous']} vacuous, and its traces say otherwise"

    @property
    def _sequential(self) -> bool:
        return self.verdict["method"] not in (EVERY_EPISODE, "fixed")

    def _statuses(self, runs: Sequence[_Run]) -> tuple[list[EpisodeVerdict], bool] | None:
        """Assign a status to each run; the flag says whether this is the only assignment."""
        verdict = self.verdict
        violated = {entry["episode"]: entry for entry in verdict["counterexamples"]}
        remaining = Counter(
            satisfied=verdict["episodes"] - verdict["violations"] - len(verdict["open"]),
            open=len(verdict["open"]),
            invalid=verdict["invalid"] - verdict["without_effect"],
            missing=verdict["missing"],
            violated=verdict["violations"] + verdict["without_effect"],
        )
        is_only, vacuous, verdicts = True, verdict["vacuous"], []
        listed = {*violated, *verdict["open"]}
        rest = Counter(run.validity for run in runs if run.episode not in listed)
        exact = rest["valid"] == remaining["satisfied"] and rest["invalid"] == remaining["invalid"]
        for run in runs:
            traced, counterexample = self.on_traces.get(run.episode), violated.get(run.episode)
            status: EpisodeStatus = "satisfied"
            if counterexample is not None:
                status = "violated"
            elif run.episode in verdict["open"]:
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
                margin, time = counterexample["margin"], counterexample["time"]
            elif traced is not None:
                margin, empty = traced.margin, traced.vacuous
            verdicts.append(
                EpisodeVerdict(
                    verdict["requirement"],
                    run.episode,
                    verdict["component"],
                    status,
                    margin,
                    time,
                    "",
                    run.proposals,
                    run.valid_proposals,
                    empty,
                    run.not_manifested,
                    without_effect=status == "violated" and run.validity == "invalid",
                    ended=run.termination if run.termination in EARLY_ENDS else "",
                    unseen_crash=run.episode in verdict["unseen_crashes"],
                )
            )
        return None if any(remaining.values()) else (verdicts, is_only)

    def _judged(self, verdicts: Sequence[EpisodeVerdict], until: bool) -> CampaignVerdict | None:
        """Decide again; ``None`` if that takes another number of runs."""
        recorded, bound = self.verdict, self.verdict["bound"]
        judge = CampaignJudge(
            Requirement(
                id=recorded["requirement"],
                at_most=bound["at_most"],
                confidence=bound["confidence"],
                method=None if recorded["method"] == EVERY_EPISODE else recorded["method"],
                p0=self.requirement.get("p0") if recorded["method"] == "sprt" else None,
            ),
            recorded["case"],
            planned=recorded["planned"],
            component=recorded["component"],
            until_decided=until,
        )
        for verdict in verdicts:
            over = judge.decided or len(judge.verdicts) == recorded["planned"]
            if recorded["check"] and judge.sequential and over:
                return None
            judge.add(verdict)
        judge.situation = recorded["situation"]
        if recorded["check"] and judge.situation == REPEATED:
            return judge.verdict() if len(verdicts) == EQUAL_RUNS else None
        if recorded["check"]:
            enough = judge.decided or len(verdicts) == recorded["planned"]
            if not (enough if judge.sequential else len(verdicts) == self._plan()):
                return None
        return judge.verdict()

    def _plan(self) -> int:
        """Count the runs of a fixed plan, further ones after invalid runs included."""
        planned = end = self.verdict["planned"]
        budget, number = math.ceil(_EXTRA_SHARE * planned), 0
        while number < end and number in self.case.runs:
            if self.case.runs[number].validity == "invalid" and end < planned + budget:
                end += 1
            number += 1
        return int(end)

    def _agrees(self, decided: CampaignVerdict) -> bool:
        verdict = self.verdict
        if verdict["run"] == 0 and verdict["verdict"] == "undecided":
            return True
        bound = plain_data(asdict(decided.bound))
        if (decided.method, decided.saved, bound) != (
            verdict["method"],
            verdict["saved"],
            verdict["bound"],
        ):
            return False
        if verdict["verdict"] == "undecided" and decided.verdict == "supported":
            return bool(verdict["reason"].startswith("infrastructure: nondeterministic"))
        spoilt = None if decided.spoilt is None else decided.spoilt.verdict
        recorded_spoilt = None if verdict["spoilt"] is None else verdict["spoilt"]["verdict"]
        return (decided.verdict, decided.reason, spoilt) == (
            verdict["verdict"],
            verdict["reason"],
            recorded_spoilt,
        )
