"""RecordBuilder: collects the reports of the items of a session, and makes the record of them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, Literal

from pytest_dura.core.episode import canonical
from pytest_dura.evidence.case_model import CasePlan, HazardEntry, RepeatEntry, RequirementEntry
from pytest_dura.evidence.conclude import measure_cases
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episodes import (
    EpisodeSpool,
    ItemReport,
    add_episode,
    case_situations,
    unpack_report,
)
from pytest_dura.evidence.gate import Gate, with_repeats, worse_repeat
from pytest_dura.evidence.metrics import CaseMetrics
from pytest_dura.evidence.model import COUNTED, RecordHead, SessionRecord
from pytest_dura.evidence.search_model import SearchRecords
from pytest_dura.evidence.session_model import MeasureEntry
from pytest_dura.evidence.sessions import ReuseRecord
from pytest_dura.evidence.verdict_model import (
    AssertionEntry,
    AttemptEntry,
    FailedAssertion,
    FalseCheck,
    MonitorEntry,
    VerdictEntry,
    WaiverEntry,
)
from pytest_dura.requirements.campaign_judge import judge_campaign
from pytest_dura.requirements.campaign_verdicts import (
    CampaignVerdict,
    Situation,
    Situations,
    doubted,
)
from pytest_dura.requirements.episode_verdicts import EpisodeVerdict
from pytest_dura.requirements.model import Requirement


class Components:
    """Descriptions of components by name, of which one may have several sets of parameters."""

    def __init__(self) -> None:
        self._known: dict[str, dict[bytes, JsonObject]] = {}
        self._sources: dict[str, Mapping[str, str]] = {}

    def add(self, component: JsonObject) -> None:
        """Add a description: ``name``, ``path``, ``params`` and others."""
        key = canonical([component.get("path"), component.get("params"), component])
        self._known.setdefault(component["name"], {}).setdefault(key, component)

    def add_sources(self, sources: Mapping[str, Mapping[str, str]]) -> None:
        """Add the files that digests of components are made of; see ItemReport."""
        self._sources.update(sources)

    @property
    def names(self) -> list[str]:
        """Names of all components."""
        return list(self._known)

    def problems(self) -> Iterator[str]:
        """Yield a problem for each name that several classes have, as verdicts go by the name."""
        for name, descriptions in self._known.items():
            paths = sorted({str(description.get("path")) for description in descriptions.values()})
            if len(paths) > 1:
                yield (
                    f"infrastructure: several components are called {name}, and verdicts go by "
                    f"that name: {', '.join(paths)}; rename all but one, or test them in sessions "
                    "of their own"
                )

    def to_json(self) -> dict[str, Any]:
        """Convert to the first one by name, with all ``others`` and the ``sources`` of all."""
        names = sorted(self._known)
        known = [entry for name in names for _, entry in sorted(self._known[name].items())]
        first: dict[str, Any] = dict(known[0]) if known else {"name": None, "version": None}
        if len(known) > 1:
            first["others"] = known[1:]
        if self._sources:
            first["sources"] = {key: self._sources[key] for key in sorted(self._sources)}
        return first


_COUNTS = ("asked", "repeated", "reused", "injected", "missed")
_TOKENS = ("asked_tokens", "reused_tokens")
_NAMES = ("component", "model", "fingerprint", "prompts", "base_url", "mode")


class LanguageModels:
    """Sums up the use of language models over the processes of a session."""

    def __init__(self) -> None:
        self._reports: dict[tuple[Any, ...], dict[str, JsonObject]] = {}

    def add(self, models: Iterable[Mapping[str, Any]]) -> None:
        """Add the counts of one process since it began, which include those it reported before.

        Args:
            models: Of :class:`pytest_dura.evidence.episodes.ItemReport`.
        """
        for model in models:
            known = self._reports.setdefault(tuple(model[name] for name in _NAMES), {})
            before = known.get(model["process"])
            if before is None or _total(model) >= _total(before):
                known[model["process"]] = dict(model)

    def to_json(self) -> list[JsonObject]:
        """Convert to the record's key ``models``, sorted, without the cassette."""
        models = []
        for key in sorted(self._reports, key=str):
            reports = self._reports[key]
            first = reports[min(reports)]
            counts = {
                name: sum(report.get(name, 0) for report in reports.values()) for name in _COUNTS
            }
            plain = {name: value for name, value in first.items() if name != "process"}
            causes: Counter[str] = sum(
                (Counter(report.get("unavailable", {})) for report in reports.values()), Counter()
            )
            unavailable = {cause: causes[cause] for cause in sorted(causes)}
            tokens = {name: _summed_tokens(reports.values(), name) for name in _TOKENS}
            summed = {**counts, **tokens, "unavailable": unavailable}
            models.append({**plain, **summed, "cassette": None})
        return models


def _summed_tokens(reports: Iterable[Mapping[str, Any]], name: str) -> dict[str, int]:
    tokens: Counter[str] = Counter()
    for report in reports:
        tokens.update(report.get(name, {}))
    return dict(sorted(tokens.items()))


def _total(model: Mapping[str, Any]) -> int:
    return sum(model.get(name, 0) for name in _COUNTS)


def test_function(item: str) -> str:
    """Remove the parameters from a node id."""
    return item.partition("[")[0]


def question_key(item: str, verdict: AttemptEntry) -> tuple[str, ...]:
    """Identify what a verdict answers: the item, requirement, case, component and question."""
    paired = None if verdict.paired is None else verdict.paired.to_json()
    bound = verdict.bound
    question = [verdict.check, paired, verdict.method, bound.at_most, bound.confidence]
    about = verdict.requirement, verdict.case, verdict.component
    return item, *about, json.dumps(question, sort_keys=True)


_WORST_VERDICT_FIRST = ("violated", "undecided", "supported")


def _counting_attempt(attempts: Sequence[AttemptEntry]) -> AttemptEntry:
    """Select the attempt at an item that counts: the first violation, else the last attempt."""
    return next((entry for entry in attempts if entry.verdict == "violated"), attempts[-1])


def _final_outcomes(outcomes: Sequence[JsonObject]) -> list[JsonObject]:
    """Select one attempt of each item: a violation if there is one, else the last."""
    final: dict[str, JsonObject] = {}
    for outcome in outcomes:
        before = final.get(outcome["item"])
        if before is None or before["verdict"] != "violated":
            final[outcome["item"]] = outcome
    return list(final.values())


def _outcomes_by_attempt(outcomes: Sequence[JsonObject]) -> Iterator[list[JsonObject]]:
    """Yield what each attempt at a test came to, where there are several.

    An attempt has the outcome of each item by then: not every item is run again. Items that repeat
    a test make an attempt of their own.
    """
    repeated: dict[str, list[str]] = {}
    for outcome in sorted(outcomes, key=itemgetter("item")):
        items = repeated.setdefault(outcome["recorded_as"] or outcome["item"], [])
        if outcome["item"] not in items:
            items.append(outcome["item"])
    place = {item: number for items in repeated.values() for number, item in enumerate(items)}
    numbers = sorted({(place[outcome["item"]], outcome["attempt"]) for outcome in outcomes})
    if len(numbers) == 1:
        return
    for repetition, number in numbers:
        latest = {
            outcome["item"]: outcome
            for outcome in outcomes
            if place[outcome["item"]] == repetition and outcome["attempt"] <= number
        }
        yield list(latest.values())


_MAX_OBSERVED = 50
"""Greatest number of names that a test looked at."""
_MAX_FAILED = 10
"""Greatest number of episodes with the assertion that failed there."""
WORST_FIRST = ("violated", "missing", "open", "invalid", "satisfied")


def _worst_of_each_episode(final: list[JsonObject]) -> list[EpisodeVerdict]:
    """Select the worst verdict on each episode, which several parameters of a test may judge."""
    worst: dict[str, JsonObject] = {}
    for outcome in sorted(final, key=lambda outcome: WORST_FIRST.index(outcome["verdict"])):
        worst.setdefault(outcome["episode"], outcome)
    ordered = sorted(worst.values(), key=lambda outcome: _run_number(outcome["episode"]))
    return [EpisodeVerdict.from_json(outcome) for outcome in ordered]


def _judge_test(
    requirement: Requirement,
    case: str,
    component: str,
    outcomes: Sequence[JsonObject],
    situation: Situation | None = None,
) -> CampaignVerdict:
    """Judge a test that looks at one episode at a time.

    Args:
        requirement: The requirement; its rate and confidence come from the test.
        case: Id of the case.
        component: Name of the component under test.
        outcomes: Outcomes of all episodes that it looked at, with ``item``, ``planned``,
            ``at_most``, ``confidence``.
        situation: The single situation of the case's runs, if all of them are equal.
    """
    # Tests are a fixed number, and run in no fixed order: no sequential method applies.
    judged_by = replace(
        requirement,
        at_most=outcomes[0]["at_most"],
        confidence=outcomes[0]["confidence"],
        method=None,
        p0=None,
    )
    planned = max(outcome["planned"] for outcome in outcomes)
    final = _worst_of_each_episode(_final_outcomes(outcomes))
    # Each run is a test of its own: none is saved where all runs are equal.
    whole = len(final) >= planned > 1
    return judge_campaign(
        judged_by,
        case,
        final,
        planned=planned,
        component=component,
        situation=situation if whole else None,
    )


def _assertion_summary(final: Sequence[JsonObject]) -> AssertionEntry:
    """Summarise the assertions of a test over all episodes that it looked at.

    Args:
        final: Of :func:`_final_outcomes`.
    """
    assertions = [(outcome["episode"], outcome["assertion"]) for outcome in final]
    false = Counter(check for _, assertion in assertions for check in assertion["false"])
    observed = {name for _, assertion in assertions for name in assertion["observed"]}
    failed = sorted((name, entry["failed"]) for name, entry in assertions if entry["failed"])
    return AssertionEntry(
        alone=all(assertion["alone"] for _, assertion in assertions),
        by_check=sum(assertion["by_check"] for _, assertion in assertions),
        observed=sorted(observed)[:_MAX_OBSERVED],
        false=[
            FalseCheck(check=name, episodes=false[name]) for name in sorted(false)[:_MAX_OBSERVED]
        ],
        failed=[FailedAssertion(episode=name, message=why) for name, why in failed[:_MAX_FAILED]],
    )


def _run_number(episode: str) -> tuple[str, int]:
    case, _, run = episode.rpartition("#")
    return case, int(run)


SCHEMA_VERSION = "3"
_REPEAT_KEYS = set(RepeatEntry.model_fields)
UNKNOWN_COMPONENT = "unknown"
"""Name of a component that a conftest defines, until the first episode reports it."""

_UNCONCLUDED: JsonObject = {
    "overall": [],
    "effectiveness": [],
    "baseline": None,
    "finished": None,
    "gate": Gate.running(warn_undecided=False).to_json(),
    "inputs": [],
    "coverage": {"cells": [], "left_out": 0, "parameters": []},
    "timings": {"wall_seconds": 0, "evidence_seconds": 0, "simulated_seconds": 0,
                "processing_seconds": {}},
    "redacted": {},
    "totals": {"gate": "incomplete", **dict.fromkeys(COUNTED, 0)},
}  # fmt: skip
"""What follows from the rest of the record, until :func:`conclude_record` computes it."""
_NO_EPISODES: JsonObject = {"taken_over": 0, "sessions": [], "outdated": []}


def _unmeasured(case: CasePlan) -> JsonObject:
    """Return what :func:`measure_cases` computes of a case, before it does."""
    metrics = CaseMetrics().to_json(case.planned)
    return {"metrics": metrics, "missing_runs": [], "missing_runs_total": 0}


def _verdict(
    attempt: AttemptEntry,
    item: str,
    *,
    waiver: WaiverEntry | None = None,
    attempts: Sequence[AttemptEntry] = (),
    assertion: AssertionEntry | None = None,
) -> VerdictEntry:
    return VerdictEntry(
        **vars(attempt),
        item=item,
        waiver=waiver,
        attempts=list(attempts),
        assertion=assertion,
        also_without=None,
    )


Status = Literal["running", "complete", "interrupted"]


@dataclass
class RecordBuilder:
    """Builds the record of a session from reports. The same report may come twice.

    Args:
        header: ``created``, ``tool``, ``command``, ``base_seed``, ``environment``.
        directory: The bundle's, where episodes are kept on disk. Without one they are in a
            temporary file of the system.

    Raises:
        ConfigurationError: If the directory cannot be made or written.
    """

    header: JsonObject
    directory: Path | None = None
    searches: SearchRecords = field(default_factory=SearchRecords, init=False)
    objections: dict[str, None] = field(default_factory=dict, init=False)
    """Reasons of items why the session does not pass, in order."""
    _components: Components = field(default_factory=Components)
    _measures: dict[str, MeasureEntry] = field(default_factory=dict)
    _hazards: dict[str, HazardEntry] = field(default_factory=dict)
    _requirements: dict[str, RequirementEntry] = field(default_factory=dict)
    _cases: dict[tuple[str, str], CasePlan] = field(default_factory=dict)
    _components_of: dict[str, list[str]] = field(default_factory=dict)
    """Names of components by the id of a case."""
    _spool: EpisodeSpool = field(init=False)
    _verdicts: dict[tuple[str, ...], VerdictEntry] = field(default_factory=dict)
    """Those of other sessions."""
    _attempts: dict[tuple[str, ...], dict[str, list[tuple[int, AttemptEntry]]]] = field(
        default_factory=dict
    )
    """Numbered attempts at each question, by the item that made them."""
    _outcomes: dict[tuple[str, ...], dict[str, JsonObject]] = field(default_factory=dict)
    _monitors: dict[tuple[str, ...], MonitorEntry] = field(default_factory=dict)
    _expected: dict[tuple[str, str, str], CasePlan] = field(default_factory=dict)
    _waivers: dict[str, WaiverEntry] = field(default_factory=dict)
    _failed: set[str] = field(default_factory=set)
    """Items that failed in the end."""
    _first_waived: dict[str, str] = field(default_factory=dict)
    """First waived item of each test."""
    _clashes: dict[tuple[str, str], str] = field(default_factory=dict)
    _models: LanguageModels = field(default_factory=LanguageModels)
    _problems: set[str] = field(default_factory=set)
    _reuse: ReuseRecord = field(default_factory=ReuseRecord)
    _ran: set[str] = field(default_factory=set)
    """Cases with any episode."""
    _repeats: dict[tuple[str, str], RepeatEntry] = field(default_factory=dict)
    _situations: dict[tuple[str, str], Situations] = field(default_factory=dict)
    """Situations of the planned episodes, by case and component."""

    def __post_init__(self) -> None:
        """Open the spool for the episodes."""
        self._spool = EpisodeSpool(self.directory)

    def close(self) -> None:
        """Delete the episodes; records that were made of them can no longer be read."""
        self._spool.close()

    def expect(self, item: str, requirement: JsonObject, case: JsonObject) -> None:
        """Announce an item of a campaign; if it never reports, its verdict is undecided."""
        plan, known = CasePlan.model_validate(case), RequirementEntry.model_validate(requirement)
        self._expected[item, known.id, plan.id] = plan
        self._add_requirement(known)

    def add_hazards(self, hazards: Iterable[HazardEntry]) -> None:
        """Add hazards that the session has to answer for; the first of an id holds."""
        for hazard in hazards:
            self._hazards.setdefault(hazard.id, hazard)

    def _add_requirement(self, requirement: RequirementEntry) -> None:
        self._requirements.setdefault(requirement.id, requirement)

    def add(self, report: ItemReport) -> None:
        """Add the report of an item.

        Raises:
            ConfigurationError: If its episodes cannot be written.
        """
        for part in report.parts:
            self.add(unpack_report(part))
        item = report.item
        for claim in report.claims:
            decides = test_function(item) if claim.each_run else report.recorded_as or item
            self._expected.setdefault((decides, claim.requirement, claim.case.id), claim.case)
        for component in report.components:
            self._components.add(component)
        self._components.add_sources(report.sources)
        self.add_hazards(report.hazards)
        for requirement in report.requirements:
            self._add_requirement(requirement)
        for case in report.cases:
            self._add_case(case)
        self._add_measures(report.measures)
        self._add_episodes(report)
        for repeat in report.repeats:
            about = repeat.case, repeat.component
            result = RepeatEntry.model_validate(repeat.to_json(include=_REPEAT_KEYS))
            self._repeats[about] = worse_repeat(self._repeats.get(about), result) or result
        self._models.add(report.models)
        self._problems.update(report.problems)
        self.objections.update(dict.fromkeys(report.objections))
        self._reuse.add(report.notes, report.searched)
        for verdict in report.verdicts:
            self._add_verdict(report, verdict)
        self.searches.add(report.recorded_as or item, report.searches)
        for monitor in report.monitors:
            key = monitor.case, monitor.component, monitor.target, monitor.monitor
            self._monitors[key] = monitor
        self._add_outcomes(report)
        if report.retried:
            self.waive(item, "rerun", "the item was run again")

    def add_traces(self, traces: Iterable[JsonObject]) -> None:
        """Add the files of traces: ``{id, component, digest, trace}``, in any order.

        Raises:
            ConfigurationError: If they cannot be written.
        """
        for trace in traces:
            self._spool.add_trace(trace)

    def adopt(self, verdict: VerdictEntry) -> None:
        """Take over a verdict of another session, with its item, its waiver and its attempts."""
        self._verdicts[question_key(verdict.item, verdict)] = verdict

    def waive(self, item: str, kind: str, reason: str) -> None:
        """Record that an item's failure is excused: ``xfail``, ``rerun`` or ``skip``.

        That an item was run again excuses nothing if it failed all the same; see :meth:`fail`.
        """
        if kind == "rerun" and item in self._failed:
            return
        self._waivers[item] = WaiverEntry.model_validate({"kind": kind, "reason": reason})
        self._first_waived.setdefault(test_function(item), item)

    def fail(self, item: str) -> None:
        """Record that an item failed in the end, however often it was run."""
        self._failed.add(item)
        if item in self._waivers and self._waivers[item].kind == "rerun":
            del self._waivers[item]

    @property
    def problems(self) -> list[str]:
        """Doubts about the whole session; each begins with ``infrastructure:``."""
        return sorted({*self._clashes.values(), *self._problems, *self._components.problems()})

    def add_models(self, models: Iterable[Mapping[str, Any]]) -> None:
        """Add what was asked of language models beside the items' reports.

        Args:
            models: As in :class:`pytest_dura.evidence.episodes.ItemReport`.
        """
        self._models.add(models)

    def record(self, status: Status) -> SessionRecord:
        """Make the record; its episodes can be read until the builder is closed.

        Raises:
            ConfigurationError: If the episodes cannot be read.
        """
        self._add_unreported_cases()
        head = RecordHead.model_validate(
            {
                **_UNCONCLUDED,
                **self.header,
                "schema_version": SCHEMA_VERSION,
                "status": status,
                "reuse": {**_NO_EPISODES, **self._reuse.to_json(self.header["reuse"])},
                "component_under_test": self._components.to_json(),
                "models": self._models.to_json(),
                "measures": sorted(self._measures.values(), key=attrgetter("place", "name")),
                **self._hazards_json(),
                "requirements": [self._requirements[name] for name in sorted(self._requirements)],
                "cases": [
                    {**case.to_json(), **_unmeasured(case), "repeat": self._repeats.get(key)}
                    for key, case in self._cases.items()
                ],
                "verdicts": self.verdicts(),
                "searches": self.searches.entries(self._waivers),
                "monitors": [self._monitors[key] for key in sorted(self._monitors)],
            }
        )
        record = SessionRecord(head, self.directory or Path(), self._spool.__iter__)
        return measure_cases(record)

    def _hazards_json(self) -> JsonObject:
        """The record's key ``hazards``, if there are any."""
        hazards = [self._hazards[name] for name in sorted(self._hazards)]
        return {"hazards": hazards} if hazards else {}

    def verdicts(self) -> list[VerdictEntry]:
        """List all verdicts, also on what never reported, sorted by case and requirement."""
        verdicts = list(self._verdicts.values())
        verdicts += [self._of_attempts(key[0], asked) for key, asked in self._attempts.items()]
        for key, outcomes in self._outcomes.items():
            verdicts.append(self._of_outcomes(key, list(outcomes.values())))
        reported = {(entry.item, entry.requirement, entry.case) for entry in verdicts}
        for claim, case in self._unsearched():
            if claim not in reported:
                verdicts.append(self._not_run(*claim[:2], case))
        return sorted(map(self._qualified, verdicts), key=attrgetter("case", "requirement", "item"))

    def _add_measures(self, measures: Iterable[MeasureEntry]) -> None:
        for measure in measures:
            known = self._measures.setdefault(measure.name, measure)
            if known != measure:
                self._problems.add(
                    f"infrastructure: two simulators declare the measure {measure.name!r} "
                    f"differently: {known.function} and {measure.function}"
                )

    def _add_case(self, case: CasePlan) -> None:
        key = case.id, case.component
        known = self._cases.get(key)
        if known is None:
            self._components_of.setdefault(case.id, []).append(case.component)
        if known is None or known.planned < case.planned:
            self._cases[key] = case if known is None else known.replace(planned=case.planned)

    def _add_episodes(self, report: ItemReport) -> None:
        for episode in report.episodes:
            self._ran.add(episode["case"])
            self._add_situation(episode)
            first = self._spool.add(episode)
            if first != episode["digest"]:
                self._clashes[episode["case"], episode["component"]] = (
                    f"infrastructure: nondeterministic: the episode {episode['id']} was run twice, "
                    f"with the digests {first[:12]} and {episode['digest'][:12]}"
                )
        for chain in report.chains:
            self._spool.add_chain(chain)
        self.add_traces(report.traces)

    def _add_situation(self, episode: JsonObject) -> None:
        key = episode["case"], episode["component"]
        if not episode["planned"] or key not in self._cases:
            return
        if key not in self._situations:
            self._situations[key] = case_situations(self._cases[key])
        add_episode(self._situations[key], episode)

    def _add_outcomes(self, report: ItemReport) -> None:
        asked = {
            "item": report.item,
            "attempt": report.attempt,
            "recorded_as": report.recorded_as,
        }
        for outcome in report.outcomes:
            # Two tests on one episode give two verdicts, not two attempts at one.
            about = outcome["requirement"], outcome["case"], outcome["component"]
            entry = outcome | asked
            known = self._outcomes.setdefault((test_function(report.item), *about), {})
            known[json.dumps(entry, sort_keys=True)] = entry

    def _add_verdict(self, report: ItemReport, verdict: AttemptEntry) -> None:
        # An item may ask several questions; the same question again is another attempt.
        key = question_key(report.recorded_as or report.item, verdict)
        attempts = self._attempts.setdefault(key, {}).setdefault(report.item, [])
        numbered = report.attempt, verdict
        if not attempts or attempts[-1] != numbered:
            attempts.append(numbered)

    def _of_attempts(
        self, item: str, asked: Mapping[str, Sequence[tuple[int, AttemptEntry]]]
    ) -> VerdictEntry:
        """Verdict of one or several attempts, by one or several items that repeat a test.

        Of several attempts at an item a violation counts before anything else, and of several items
        the worst verdict; all of them are kept.
        """
        attempts = {name: [entry for _, entry in asked[name]] for name in sorted(asked)}
        counting = {name: _counting_attempt(entries) for name, entries in attempts.items()}
        verdict = min(counting.values(), key=lambda one: _WORST_VERDICT_FIRST.index(one.verdict))
        waivers = [self._waivers[name] for name in attempts if name in self._waivers]
        bad = {name for name, entry in counting.items() if entry.verdict != "supported"}
        return _verdict(
            verdict,
            item,
            waiver=waivers[0] if waivers and bad <= self._waivers.keys() else None,
            attempts=[
                entry for entries in attempts.values() for entry in entries if entry is not verdict
            ],
        )

    def _of_outcomes(self, key: tuple[str, ...], outcomes: list[JsonObject]) -> VerdictEntry:
        """Verdict of a test that looks at one episode at a time."""
        test, requirement, case, component = key
        final = _final_outcomes(outcomes)
        known = self._situations.get((case, component))
        situation = None if known is None else known.situation

        def judged(seen: Sequence[JsonObject]) -> AttemptEntry:
            known = self._requirement(requirement)
            return AttemptEntry.of(_judge_test(known, case, component, seen, situation))

        verdict = judged(outcomes)
        attempts = list(map(judged, _outcomes_by_attempt(outcomes)))
        if verdict in attempts:
            attempts.remove(verdict)
        return _verdict(
            verdict,
            test,
            waiver=self._waiver_of(final, verdict),
            attempts=attempts,
            assertion=_assertion_summary(final),
        )

    def _waiver_of(self, final: list[JsonObject], verdict: AttemptEntry) -> WaiverEntry | None:
        """Waiver of a verdict, if all that is bad about it comes from waived items."""
        waivers = [
            self._waivers[outcome["item"]] for outcome in final if outcome["item"] in self._waivers
        ]
        bad = {outcome["item"] for outcome in final if outcome["verdict"] != "satisfied"}
        excused = bad <= self._waivers.keys() and verdict.run >= verdict.planned
        return waivers[0] if waivers and excused else None

    def _add_unreported_cases(self) -> None:
        """Add the cases that are expected, and of which nothing was reported."""
        reported = set(self._components_of)
        for _, case in self._unsearched():
            if case.id not in reported:
                self._add_case(self._with_component(case))

    def _unsearched(self) -> list[tuple[tuple[str, str, str], CasePlan]]:
        """Expected claims, apart from those that items searched instead of deciding them."""
        answered = self.searches.answered
        return [claim for claim in self._expected.items() if claim[0] not in answered]

    def _with_component(self, case: CasePlan) -> CasePlan:
        """Put the component's name into an expected case, if it is known by now."""
        if case.component != UNKNOWN_COMPONENT:
            return case
        names = self._components_of.get(case.id) or self._components.names
        return case.replace(component=names[0]) if len(names) == 1 else case

    def _not_run(self, item: str, requirement: str, case: CasePlan) -> VerdictEntry:
        case = self._with_component(case)
        verdict = AttemptEntry.of(
            judge_campaign(
                self._requirement(requirement),
                case.id,
                [],
                planned=case.planned,
                component=case.component,
            )
        )
        if item != f"{case.id}::{requirement}":
            # Its episodes may have run: what was not made is the verdict.
            verdict = verdict.replace(reason="the test ended without a verdict on it")
        elif case.id in self._ran:
            reason = "episodes of the case ran, and no verdict was made on them"
            verdict = verdict.replace(reason=reason)
        waived = item if item in self._waivers else self._first_waived.get(item, "")
        return _verdict(verdict, item, waiver=self._waivers.get(waived))

    def _requirement(self, name: str) -> Requirement:
        known = self._requirements.get(name)
        return Requirement.from_json({"id": name} if known is None else known.to_json())

    def _qualified(self, verdict: VerdictEntry) -> VerdictEntry:
        """Apply doubts about the case's episodes."""
        clash = self._clashes.get((verdict.case, verdict.component))
        if clash is not None:
            verdict = verdict.replace(**doubted(verdict.verdict, verdict.reason, clash))
        cases = [verdict.case, *([verdict.pairs.case] if verdict.pairs else [])]
        repeats = [self._repeats.get((case, verdict.component)) for case in cases]
        changed = with_repeats(verdict.verdict, verdict.reason, repeats, verdict.component)
        return verdict.replace(**changed)
