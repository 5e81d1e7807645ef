"""RecordBuilder: collects the reports of the items of a session, and makes the record of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from pytest_dura.core.codec import decode
from pytest_dura.core.episode import canonical
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.evidence.case_model import CasePlan, RepeatEntry
from pytest_dura.evidence.conclude import conclude
from pytest_dura.evidence.conclusions.cases import CaseMetrics
from pytest_dura.evidence.conclusions.verdicts import UNKNOWN_COMPONENT, test_function
from pytest_dura.evidence.entry import JsonObject
from pytest_dura.evidence.episodes import (
    EpisodeSpool,
    ItemReport,
    unpack_report,
)
from pytest_dura.evidence.gate import Gate, worse_repeat
from pytest_dura.evidence.item_verdicts import Waiver, WaiverKind
from pytest_dura.evidence.model import COUNTED, RecordHead, SessionRecord
from pytest_dura.evidence.searches import SearchRecords
from pytest_dura.evidence.sessions import ResumeRecord
from pytest_dura.requirements.hazards import Hazard
from pytest_dura.requirements.judgements import Doubt, Judgement
from pytest_dura.requirements.model import Requirement
from pytest_dura.requirements.monitoring.quality import MonitorQuality


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


SCHEMA_VERSION = "4"
_REPEAT_KEYS = set(RepeatEntry.model_fields)
_UNCONCLUDED: JsonObject = {
    "overall": [],
    "effectiveness": [],
    "baseline": None,
    "finished": None,
    "gate": Gate.running(warn_undecided=False),
    "inputs": [],
    "coverage": {"cells": [], "left_out": 0, "parameters": []},
    "conclusions": {},
    "timings": {"wall_seconds": 0, "evidence_seconds": 0, "simulated_seconds": 0,
                "processing_seconds": {}},
    "redacted": {},
    "totals": {"gate": "incomplete", **dict.fromkeys(COUNTED, 0)},
}  # fmt: skip
"""What follows from the rest of the record, until it is concluded and completed."""
_NO_EPISODES: JsonObject = {"taken_over": 0, "sessions": [], "outdated": []}


def _unmeasured(case: CasePlan) -> JsonObject:
    """Return what :func:`conclude` computes of a case, before it does."""
    metrics = CaseMetrics().to_json(case.planned)
    return {"metrics": metrics, "missing_runs": [], "missing_runs_total": 0}


def claim(item: str, requirement: str, case: CasePlan) -> Judgement:
    """Make the judgement of what an item is to decide, before it does.

    Args:
        item: Node id of the item; of a test on single episodes without its parameters.
        requirement: Id of the requirement.
        case: The case.
    """
    return Judgement(
        "claim", requirement, case.id, case.component, case.planned, item=item, decides=item
    )


def _asked_by(report: ItemReport, judgement: Judgement) -> Judgement:
    """Put the item of a report into a judgement, unless it is a claim, which has its own."""
    if judgement.item:
        return judgement
    item, first = report.item, report.recorded_as
    decides = test_function(item) if judgement.kind == "test" else first or item
    return replace(judgement, item=item, decides=decides, recorded_as=first, attempt=report.attempt)


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
    _measures: dict[str, MeasureInfo] = field(default_factory=dict)
    _hazards: dict[str, Hazard] = field(default_factory=dict)
    _requirements: dict[str, Requirement] = field(default_factory=dict)
    _cases: dict[tuple[str, str], CasePlan] = field(default_factory=dict)
    _components_of: dict[str, list[str]] = field(default_factory=dict)
    """Names of components by the id of a case."""
    _spool: EpisodeSpool = field(init=False)
    _judgements: dict[Judgement, None] = field(default_factory=dict)
    """Each once, as the same report may come twice."""
    _monitors: dict[tuple[str, ...], MonitorQuality] = field(default_factory=dict)
    _claimed: dict[str, CasePlan] = field(default_factory=dict)
    """Cases of what is to be decided, by id."""
    _waivers: dict[str, Waiver] = field(default_factory=dict)
    _failed: set[str] = field(default_factory=set)
    """Items that failed in the end."""
    _clashes: dict[tuple[str, str], str] = field(default_factory=dict)
    _models: LanguageModels = field(default_factory=LanguageModels)
    _problems: set[str] = field(default_factory=set)
    _resume: ResumeRecord = field(default_factory=ResumeRecord)
    _repeats: dict[tuple[str, str], RepeatEntry] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Open the spool for the episodes."""
        self._spool = EpisodeSpool(self.directory)

    def close(self) -> None:
        """Delete the episodes; records that were made of them can no longer be read."""
        self._spool.close()

    def expect(self, item: str, requirement: JsonObject, case: JsonObject) -> None:
        """Announce an item of a campaign; if it never reports, its verdict is undecided."""
        plan, known = CasePlan.model_validate(case), decode(Requirement, requirement)
        self._claimed.setdefault(plan.id, plan)
        self._add_requirement(known)
        self.add_judgement(claim(item, known.id, plan))

    def add_hazards(self, hazards: Iterable[Hazard]) -> None:
        """Add hazards that the session has to answer for; the first of an id holds."""
        for hazard in hazards:
            self._hazards.setdefault(hazard.id, hazard)

    def _add_requirement(self, requirement: Requirement) -> None:
        self._requirements.setdefault(requirement.id, requirement)

    def add(self, report: ItemReport) -> None:
        """Add the report of an item.

        Raises:
            ConfigurationError: If its episodes cannot be written.
        """
        for part in report.parts:
            self.add(unpack_report(part))
        item = report.item
        for case in report.claimed:
            self._claimed.setdefault(case.id, case)
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
        self._resume.add(report.notes, report.searched)
        for judgement in report.judgements:
            self.add_judgement(_asked_by(report, judgement))
        self.searches.add(report.recorded_as or item, report.searches)
        for monitor in report.monitors:
            key = monitor.case, monitor.component, monitor.target, monitor.monitor
            self._monitors[key] = monitor
        if report.retried:
            self.waive(item, "rerun", "the item was run again")

    def add_traces(self, traces: Iterable[JsonObject]) -> None:
        """Add the files of traces: ``{id, component, digest, trace}``, in any order.

        Raises:
            ConfigurationError: If they cannot be written.
        """
        for trace in traces:
            self._spool.add_trace(trace)

    def add_judgement(self, judgement: Judgement) -> None:
        """Add what an item asked, or was to decide."""
        self._judgements.setdefault(judgement)

    def doubt(self, doubt: Doubt) -> None:
        """Record why the episodes of a case cannot be trusted."""
        self._clashes.setdefault((doubt.case, doubt.component), doubt.reason)

    def waive(self, item: str, kind: WaiverKind, reason: str) -> None:
        """Record that an item's failure is excused: ``xfail``, ``rerun`` or ``skip``.

        That an item was run again excuses nothing if it failed all the same; see :meth:`fail`.
        """
        if kind == "rerun" and item in self._failed:
            return
        self._waivers[item] = Waiver(kind, reason)

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
        lines = SessionRecord(self.head(status), self.directory or Path(), self._spool.__iter__)
        return conclude(lines)

    def head(self, status: Status) -> RecordHead:
        """Make the head of the record, apart from what follows from its episodes."""
        cases = dict(self._cases)
        for case in self._unreported_cases():
            known = cases.setdefault((case.id, case.component), case)
            cases[case.id, case.component] = max(known, case, key=attrgetter("planned"))
        judgements = self._answerable_judgements()
        failed = {"failed_items": sorted(self._failed)} if self._failed else {}
        return RecordHead.model_validate(
            {
                **_UNCONCLUDED,
                **self.header,
                "schema_version": SCHEMA_VERSION,
                "status": status,
                "resume": {**_NO_EPISODES, **self._resume.to_json(self.header["resume"])},
                "component_under_test": self._components.to_json(),
                "models": self._models.to_json(),
                "measures": sorted(self._measures.values(), key=attrgetter("place", "name")),
                **self._hazards_json(),
                "requirements": [self._requirements[name] for name in sorted(self._requirements)],
                "cases": [
                    {**case.to_json(), **_unmeasured(case), "repeat": self._repeats.get(key)}
                    for key, case in cases.items()
                ],
                "judgements": judgements,
                **failed,
                "waivers": {item: self._waivers[item] for item in sorted(self._waivers)},
                "doubts": [
                    Doubt(case, component, reason)
                    for (case, component), reason in sorted(self._clashes.items())
                ],
                "verdicts": [],
                "searches": self.searches.entries(self._waivers),
                "monitors": [self._monitors[key] for key in sorted(self._monitors)],
            }
        )

    def _hazards_json(self) -> JsonObject:
        """The record's key ``hazards``, if there are any."""
        hazards = [self._hazards[name] for name in sorted(self._hazards)]
        return {"hazards": hazards} if hazards else {}

    def _add_measures(self, measures: Iterable[MeasureInfo]) -> None:
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
            first = self._spool.add(episode)
            if first != episode["digest"]:
                self._clashes[episode["case"], episode["component"]] = (
                    f"infrastructure: nondeterministic: the episode {episode['id']} was run twice, "
                    f"with the digests {first[:12]} and {episode['digest'][:12]}"
                )
        for chain in report.chains:
            self._spool.add_chain(chain)
        self.add_traces(report.traces)

    def _unreported_cases(self) -> Iterator[CasePlan]:
        """Yield the cases of which something is to be decided, and of which nothing was reported.

        What an item searched it does not decide.
        """
        searched = self.searches.answered
        for judgement in self._judgements:
            key = judgement.item, judgement.requirement, judgement.case
            unreported = judgement.case not in self._components_of and key not in searched
            if judgement.kind == "claim" and unreported:
                yield self._with_component(self._claimed[judgement.case])

    def _with_component(self, case: CasePlan) -> CasePlan:
        """Put the component's name into an expected case, if it is known by now."""
        if case.component != UNKNOWN_COMPONENT:
            return case
        names = self._components_of.get(case.id) or self._components.names
        return case.replace(component=names[0]) if len(names) == 1 else case

    def _answerable_judgements(self) -> list[Judgement]:
        """List all judgements, sorted; claims name their component as far as it is known."""
        judgements = []
        for judgement in self._judgements:
            if judgement.kind == "claim" and judgement.component == UNKNOWN_COMPONENT:
                case = self._with_component(self._claimed[judgement.case])
                judgements.append(replace(judgement, component=case.component))
            else:
                judgements.append(judgement)
        return sorted(
            judgements,
            key=lambda judgement: (
                judgement.item, judgement.attempt, judgement.requirement, judgement.case,
                judgement.component, judgement.kind, judgement.check,
            ),
        )  # fmt: skip
