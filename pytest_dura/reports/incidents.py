"""Incidents: what one episode violated, and the event that stands before it.

Reads the episodes that verdicts name, and their twins, in one pass, and keeps of each what a
sentence needs.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from pytest_dura.core.episode import RECORDED
from pytest_dura.core.measures import MeasureInfo
from pytest_dura.core.metrics import TracedFault
from pytest_dura.core.state import Event
from pytest_dura.evidence.case_model import CaseEntry
from pytest_dura.evidence.episode_model import EpisodeEntry
from pytest_dura.evidence.item_verdicts import ItemVerdict
from pytest_dura.evidence.text import name, one_line
from pytest_dura.reports.twin_cases import TwinCase, twin_cases
from pytest_dura.reports.wording import names_text
from pytest_dura.requirements.campaign_verdicts import Counterexample
from pytest_dura.requirements.model import FAULTS, Requirement
from pytest_dura.requirements.pairs import PairTable
from pytest_dura.requirements.shortfalls import own_failure_clause, pair_shortfall, shortfall

KINDS = ("safety", "security", "recovery", "performance")
"""Kinds of requirements, the gravest first."""
_MAX_DETAIL = 240
_MOST_NAMED = 3
"""Names in a clause."""
"""Characters of what an event says."""
OWN_FAILURE = "component_failure"
"""Kind of the event that the component itself failed."""
_GRAVE_KINDS = frozenset({"critical", "halt", OWN_FAILURE})
"""Kinds of events that the loop itself gives and that end a run, or make it worthless."""
_MANIFESTED = "fault_manifested"
_TELLING = ("recovery", "unsafe", "security", "alert", _MANIFESTED)
"""Kinds of events that say why a violation follows, the most telling first."""
_SHOWS_PERFORMANCE = "performance_fail"
TICK = 1e-6
"""Slack in seconds when two times of one clock are compared."""
_ENDS = {
    "goal": "reached its goal",
    "time": "ended at its time limit",
    "iterations": "ended at its limit of decisions",
    "truncated": "was ended by its plant",
    "critical": "ended critical",
    "halt": "was halted",
    "recorded": "was recorded and not run, and ended",
    "violation": "ended at a violation",
    "decided": "ended once its requirements were decided",
    "lost": "ended its process by a call of the component",
    "infrastructure": "was ended by an infrastructure error",
}


@dataclass(frozen=True)
class TwinOutcome:
    """What the run of the same seed did without the faults, or without a role.

    Args:
        without: ``faults``, or the role that it lacks.
        episode: Its id.
        sentence: What it did, and how it ended.
        grave: Whether something grave happened in it.
        violates: Whether it violates the worst requirement of the cause; ``None`` if not known.
        same_end: Whether it ended as the run itself did, and not at its goal.
    """

    without: str
    episode: str
    sentence: str
    grave: bool
    violates: bool | None
    same_end: bool


EpisodeKey = tuple[str, str]
"""Id of an episode, and the component's name."""


@dataclass(frozen=True)
class BriefRun:
    """The part of an episode that a sentence on it needs; thousands of whole ones are too many."""

    id: str
    case: str
    seed: int
    validity: str
    termination: str
    seconds: float
    faults: tuple[TracedFault, ...]
    grave: Event | None
    notable: tuple[str, ...]
    telling: tuple[Event, ...]
    kept_control: bool
    """Whether recovery took over for good."""
    details: Mapping[str, str]
    """What checks say of it, by the ids of the requirements that it violates."""

    @classmethod
    def of(cls, episode: EpisodeEntry, measures: Sequence[MeasureInfo]) -> BriefRun:
        """Take it from an episode.

        Args:
            episode: The episode.
            measures: What its simulator declares.
        """
        marks = _Marks(measures)
        telling = tuple(
            event for event in episode.events if event.kind in _TELLING or marks.is_measure(event)
        )
        control = episode.outcome.switching
        return cls(
            id=episode.id,
            case=episode.case,
            seed=episode.seed,
            validity=episode.validity,
            termination=episode.termination,
            seconds=episode.timings.simulated_seconds,
            faults=tuple(episode.faults),
            grave=marks.grave_event(episode),
            notable=marks.notable(episode),
            telling=telling[:_MOST_EVENTS],
            kept_control=control.takeovers > control.returns,
            details={
                own: one_line(found.detail, _MAX_DETAIL)
                for own, found in episode.verdicts.items()
                if found.status == "violated" and found.detail
            },
        )

    def event_before(
        self, time: float | None, *, kind: str, last: float | None, compares_faults: bool
    ) -> Event | None:
        """The event that stands before a violation; ``None`` without any.

        Args:
            time: When the requirement was violated first, in s; ``None`` if that is not known.
            kind: Of the requirement.
            last: When the last requirement was violated, in s; a grave event counts up to then.
            compares_faults: Whether a pair with and without faults was judged.
        """
        end = self.seconds
        if self.grave is not None and self.grave.time <= (end if last is None else last) + TICK:
            return self.grave
        until = (end if time is None else time) + TICK
        before = [event for event in self.telling if event.time <= until]
        if compares_faults:
            return next((event for event in before if event.kind == _MANIFESTED), None)
        measured = [event for event in before if event.kind == _SHOWS_PERFORMANCE]
        if kind == "performance" and measured:
            return measured[0]
        for kinds in (_TELLING, (_SHOWS_PERFORMANCE,)):
            named = [event for event in before if event.kind in kinds]
            if named:
                same = [event for event in named if event.tick == named[-1].tick]
                return min(same, key=lambda event: kinds.index(event.kind))
        return None

    def end_text(self) -> str:
        """How and when it ended."""
        end = _ENDS.get(self.termination, f"ended ({name(self.termination)})")
        return f"{end} at t = {self.seconds:.2f} s"


_MOST_EVENTS = 400
"""Events of an episode that are looked at."""


class _Marks:
    """What a domain declares as grave or notable."""

    def __init__(self, measures: Sequence[MeasureInfo]) -> None:
        self._grave = [each for each in measures if each.severity == "grave"]
        self._notable = [each for each in measures if each.severity == "notable"]
        self._names = {each.name for each in measures}
        self._kinds = {each.event for each in self._grave if each.event}

    def grave_event(self, episode: EpisodeEntry) -> Event | None:
        """The first grave event; that of a declared measure before the loop's own of that tick."""
        grave = [
            event
            for event in episode.events
            if event.kind in self._kinds or event.kind in _GRAVE_KINDS
        ]
        return min(
            grave, key=lambda event: (event.tick, event.kind not in self._kinds), default=None
        )

    def is_measure(self, event: Event) -> bool:
        """Whether it says that a declared measure went beyond its limit."""
        return event.kind == _SHOWS_PERFORMANCE and event.subject in self._names

    def notable(self, episode: EpisodeEntry) -> tuple[str, ...]:
        """What declared measures say of it, in their own words."""
        values = episode.outcome.measures
        marked = [each for each in [*self._grave, *self._notable] if values.get(each.name) is True]
        return tuple(one_line(each.meaning, _MAX_DETAIL) for each in marked)


@dataclass
class OwnFailures:
    """How often a component failed by itself in the planned runs of a case.

    Args:
        runs: Planned runs.
        failed: Those in which it did.
        episode: Id of the first one; empty without any.
        event: Its first failure there.
    """

    runs: int = 0
    failed: int = 0
    episode: str = ""
    event: Event | None = None

    def add(self, episode: EpisodeEntry) -> bool:
        """Take in a run; returns whether it is the first one with a failure."""
        if not episode.planned:
            return False
        self.runs += 1
        event = next((each for each in episode.events if each.kind == OWN_FAILURE), None)
        self.failed += event is not None
        if event is None or self.event is not None:
            return False
        self.episode, self.event = episode.id, event
        return True

    @property
    def everywhere(self) -> bool:
        """Whether it failed in each run."""
        return self.failed > 0 and self.failed == self.runs


@dataclass
class Episodes:
    """Those episodes that causes are made of, and their twins.

    Args:
        briefs: By id and component.
        twins: Of a case and component, the cases of its twins.
        raised: Of a case and component, how often the component failed by itself.
    """

    briefs: dict[EpisodeKey, BriefRun]
    twins: Mapping[tuple[str, str], list[TwinCase]]
    raised: Mapping[tuple[str, str], OwnFailures]

    @classmethod
    def read(
        cls,
        cases: Sequence[CaseEntry],
        measures: Sequence[MeasureInfo],
        episodes: Iterable[EpisodeEntry],
        failures: Sequence[ItemVerdict],
    ) -> Episodes:
        """Read them in one pass over the episodes.

        Args:
            cases: Those of twins among them.
            measures: What simulators declare.
            episodes: All that verdicts may name.
            failures: The verdicts that are not supported.
        """
        twins = twin_cases(cases)
        wanted: set[EpisodeKey] = set()
        for verdict in failures:
            named = [each.episode for each in verdict.counterexamples]
            named += [*verdict.unseen_crashes, *verdict.open[:1]]
            if verdict.first_uncounted is not None:
                named.append(verdict.first_uncounted.episode)
            for of_verdict in named:
                wanted.add((of_verdict, verdict.component))
                number = of_verdict.rpartition("#")[2]
                for twin in twins.get((verdict.case, verdict.component), ()):
                    wanted.add((f"{twin.id}#{number}", twin.component))
        briefs: dict[EpisodeKey, BriefRun] = {}
        raised = {(each.case, each.component): OwnFailures() for each in failures}
        for episode in episodes:
            key = episode.id, episode.component
            failed = raised.get((episode.case, episode.component))
            first = failed is not None and failed.add(episode)
            # A verdict rests on planned episodes; one run by hand may bear the same id.
            if first or (key in wanted and (episode.planned or key not in briefs)):
                briefs[key] = BriefRun.of(episode, measures)
        return cls(briefs, twins, raised)

    def get(self, episode: str, component: str) -> BriefRun | None:
        """The episode; ``None`` where the record does not have it."""
        return self.briefs.get((episode, component))

    def twins_of(self, brief: BriefRun, component: str) -> Iterator[tuple[TwinCase, BriefRun]]:
        """Runs of the same seed, each with its case."""
        number = brief.id.rpartition("#")[2]
        for case in self.twins.get((brief.case, component), ()):
            twin = self.get(f"{case.id}#{number}", case.component)
            if twin is not None and twin.seed == brief.seed:
                yield case, twin


@dataclass(frozen=True)
class Violation:
    """A violation of one requirement in one episode."""

    requirement: Requirement
    verdict: ItemVerdict
    counterexample: Counterexample

    @property
    def badness(self) -> tuple[bool, int, float]:
        """Sorts the worst first."""
        time = self.counterexample.time
        waived = self.verdict.waiver is not None
        return waived, KINDS.index(self.requirement.kind), float("inf") if time is None else time


@dataclass
class Incident:
    """All that one episode violated, and the event that stands before it.

    Args:
        brief: The episode; ``None`` where the record does not have it.
        violations: At least one.
    """

    episode: str
    component: str
    brief: BriefRun | None
    violations: list[Violation] = field(default_factory=list)

    @cached_property
    def worst(self) -> Violation:
        """The violation of the gravest requirement, the first of equals."""
        return min(self.violations, key=lambda violation: violation.badness)

    @cached_property
    def event(self) -> Event | None:
        """What happened: the grave event if it stands before the violation, or the last telling."""
        if self.brief is None:
            return None
        times = [each.counterexample.time for each in self.violations]
        known = [time for time in times if time is not None]
        return self.brief.event_before(
            self.worst.counterexample.time,
            kind=self.worst.requirement.kind,
            # A pair, or a check that states no time, may follow from anything in the run.
            last=max(known) if len(known) == len(times) else None,
            compares_faults=self.compares_faults,
        )

    @property
    def compares_faults(self) -> bool:
        """Whether the worst violation is one of a pair with and without faults."""
        pairs = self.worst.verdict.pairs
        return pairs is not None and pairs.without == FAULTS

    @property
    def signature(self) -> str:
        """Kind of what happened; objects and figures in it differ from run to run."""
        if self.event is None:
            return ""
        own = self.event.kind == OWN_FAILURE
        return own_failure_key(self.event) if own else self.event.kind

    @property
    def verdict_keys(self) -> frozenset[tuple[str, str]]:
        """Requirement and case of all that it violates."""
        return frozenset((each.verdict.requirement, each.verdict.case) for each in self.violations)

    @property
    def rank(self) -> tuple[tuple[bool, int], int, float]:
        """Sorts the worst incident first: gravest kind, most requirements, largest violation."""
        margin = self.worst.counterexample.margin
        return self.worst.badness[:2], -len(self.violations), 0.0 if margin is None else margin


def own_failure_key(event: Event) -> str:
    """What failures of a component with one cause share: what it raised, and where."""
    return f"{OWN_FAILURE} {event.detail}"


_PLACE = re.compile(r"\(([^()\s]+:\d+(?: in [^()\s]+)?)\)$")
"""Where an exception was raised, at the end of its text."""


def own_failure_step(component: str, detail: str) -> str:
    """What to do about a component that failed by itself."""
    place = _PLACE.search(detail)
    where = f", at {name(place[1])}" if place else ""
    return f"Repair {component} first{where}: until then no verdict is on what it decides."


def amount_text(
    requirement: Requirement,
    check: str,
    margin: float | None,
    time: float | None,
    *,
    units: Mapping[str, str],
    measures: Sequence[MeasureInfo] = (),
) -> str:
    """Say by how much an episode misses a requirement, in units; empty where that is not known.

    Args:
        requirement: As it was judged.
        check: What judged it.
        margin: Of the episode, negative or 0.
        time: When it was violated first, in s.
        units: Of signals, by name.
        measures: Declared ones, which have the units of pairs.
    """
    paired = requirement.paired
    if paired is not None and paired.measure:
        unit = next((each.unit for each in measures if each.function == paired.measure), "")
        return one_line(pair_shortfall(paired, margin, unit), _MAX_DETAIL)
    return one_line(shortfall(check, margin, time, units), _MAX_DETAIL)


def what_happened(brief: BriefRun, event: Event | None, *, time: float | None) -> str:
    """One sentence on a violation.

    Args:
        brief: The episode.
        event: Of :meth:`BriefRun.event_before`.
        time: When it was violated first, in s.
    """
    if event is not None:
        parts = [event_clause(event, brief)]
    else:  # a recorded trace had no roles
        parts = [] if brief.termination == RECORDED else ["no role had objected"]
    if parts and (event is None or event.kind != _MANIFESTED):
        parts[0] += _fault_clause(brief, event.time if event else time)
    if event is None or event is not brief.grave:
        parts.append(f"the run {brief.end_text()}")
        parts += [f"it is one of the {text}" for text in brief.notable if text.startswith("runs ")]
    text = one_line("; ".join(parts), 2 * _MAX_DETAIL + 200)
    return f"{text[:1].upper()}{text[1:]}."


def event_clause(event: Event, brief: BriefRun) -> str:
    """What an event says, as a clause that begins with its time."""
    subject, detail = name(event.subject), one_line(event.detail, _MAX_DETAIL)
    what = f"{name(event.kind.replace('_', ' '))}: {subject}"
    colon = f": {detail}" if detail else ""
    if event is brief.grave and detail and event.kind != OWN_FAILURE:
        what, colon = detail, ""
    elif event.kind == OWN_FAILURE:
        what, colon = own_failure_clause(subject, detail), ""
    elif event.kind == "recovery":
        last = [each for each in brief.telling if each.kind == "recovery"][-1:] == [event]
        kept = " for the rest of the run" if last and brief.kept_control else ""
        what, colon = f"recovery ({subject}) took over{kept}", f" ({detail})" if detail else ""
    elif event.kind == "unsafe":
        what = f"{subject} found the proposal unsafe"
    elif event.kind == "alert":
        what = f"an alert on {subject}"
    elif event.kind == _MANIFESTED:
        fault = next((each for each in brief.faults if each.id == event.subject), None)
        what = f"the fault {subject} began to change {'it' if fault is None else _target(fault)}"
    elif event.kind == _SHOWS_PERFORMANCE:
        what = f"{subject} was beyond its limit"
    return f"at t = {event.time:.2f} s {what}{colon}"


def _target(fault: TracedFault) -> str:
    """What a fault changed, for those who read it."""
    if not fault.read_by:
        return name(fault.target)
    return f"what {names_text(fault.read_by, _MOST_NAMED)} read"


def _fault_clause(brief: BriefRun, time: float | None) -> str:
    """The fault that had an effect before a time, or that none had; empty without a fault."""
    if not brief.faults:
        return ""
    active = manifested(brief, time)
    if not active:
        names = names_text([fault.id for fault in brief.faults], _MOST_NAMED)
        later = [fault.manifested_at for fault in brief.faults if fault.manifested_at is not None]
        when = f"before the fault {names} had any effect"
        return f", {when} (t = {min(later):.2f} s)" if later else f"; the fault {names} had none"
    fault = active[0]
    return (
        f"; the fault {name(fault.id)} changed {_target(fault)} from t = {fault.manifested_at:.2f} "
        "s on"
    )


def manifested(brief: BriefRun, time: float | None) -> list[TracedFault]:
    """Faults that had an effect by a time, the first one first."""
    active = [
        (fault.manifested_at, place, fault)
        for place, fault in enumerate(brief.faults)
        if fault.manifested_at is not None and (time is None or fault.manifested_at <= time + TICK)
    ]
    return [fault for _, _, fault in sorted(active, key=lambda entry: entry[:2])]


def twin_outcomes(episodes: Episodes, incident: Incident) -> Iterator[TwinOutcome]:
    """What the runs of the same seed did, as far as the record has them."""
    brief, worst = incident.brief, incident.worst
    if brief is None:
        return
    requirement = worst.requirement.id
    for case, twin in episodes.twins_of(brief, incident.component):
        violates = _twin_violates(brief, case, worst)
        if twin.grave is not None:
            what = event_clause(twin.grave, twin)
            own = incident.event if twin.grave.kind == OWN_FAILURE else None
            if own is not None and own_failure_key(own) == own_failure_key(twin.grave):
                subject, time = name(twin.grave.subject), twin.grave.time
                what = f"{subject} failed in the same way at t = {time:.2f} s"
            ended = "ended there" if twin.termination == "critical" else twin.end_text()
            sentence = f"{what}, and the run {ended}"
        else:
            sentence = f"nothing grave happened, and the run {twin.end_text()}"
        if violates is not None:
            also = "violates it as well" if violates else "does not violate it"
            sentence = f"it {also} ({name(requirement)}): {sentence}"
        text = case.text[0].upper() + case.text[1:]
        sentence = one_line(f"{text}: {sentence}.", 2 * _MAX_DETAIL + 200)
        alike = twin.termination == brief.termination != "goal"
        yield TwinOutcome(case.without, twin.id, sentence, twin.grave is not None, violates, alike)


def _twin_violates(brief: BriefRun, case: TwinCase, worst: Violation) -> bool | None:
    """Whether the twin violates the worst requirement too, as far as the record tells."""
    requirement, pairs = worst.requirement.id, worst.verdict.pairs
    if case.without == FAULTS:
        compared = [fault for fault in brief.faults if fault.violated_without is not None]
        if any(requirement in (fault.violated_without or ()) for fault in compared):
            return True
        if any(requirement in fault.violated for fault in compared):
            return False
    if isinstance(pairs, PairTable) and pairs.case == case.id and not pairs.incomplete:
        if not pairs.both and not pairs.only_without:
            return False
        if not pairs.only_with and not pairs.neither:
            return True
    return None
