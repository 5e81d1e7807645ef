"""ItemRecorder: collects what the current item used and decided, for its report.

It also keeps the traces of the item's episodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import pytest

from pytest_dura.core.errors import DuraError
from pytest_dura.plugin.context import replay_command
from pytest_dura.plugin.items.markers import marked_requirements
from pytest_dura.plugin.items.outcomes import (
    Decided,
    ItemResult,
    UsedEpisodes,
    check_passed,
    episode_of,
    failed_assertion,
    given_to,
    marked_target,
    outcome_of_test,
    status_of_test,
    without_verdict,
)
from pytest_dura.plugin.items.scenario_items import RECORDED_AS
from pytest_dura.plugin.messages import failure_text, printed
from pytest_dura.plugin.session.trace_keeper import TraceKeeper

if TYPE_CHECKING:
    from collections.abc import Callable

    from pytest_dura.campaign.events import (
        EpisodeUsed,
        EventStream,
        FactEstablished,
        FaultsTraced,
        MonitorsMeasured,
        SearchedEpisodeUsed,
        SearchEnded,
        VerdictReached,
    )
    from pytest_dura.core.role_spec import RoleSpec
    from pytest_dura.evidence.case_model import CasePlan
    from pytest_dura.evidence.lines import Line, RemarkKind
    from pytest_dura.execution.memory import EpisodeKey
    from pytest_dura.library.cases import Case
    from pytest_dura.plugin.context import SessionContext
    from pytest_dura.plugin.session.episodes import SharedEpisodes
    from pytest_dura.plugin.session.executor import SessionExecutor
    from pytest_dura.plugin.session.formula_engines import FormulaEngines
    from pytest_dura.requirements.episode_verdicts import JudgedEpisode
    from pytest_dura.requirements.model import Requirement


def case_plan(
    case: Case, component: str, planned: int, runs_override: int | None, off: list[str]
) -> CasePlan:
    """Return a case as the evidence holds it.

    Args:
        case: The case.
        component: Name of the component under test.
        planned: Its episodes.
        runs_override: What replaced the number that its scenario plans, if something did.
        off: Roles that are switched off.
    """
    from pytest_dura.evidence.case_model import CasePlan
    from pytest_dura.evidence.entry import plain_data

    data = {
        "order": case.scenario.order,
        "id": case.id,
        "scenario": case.scenario.name,
        "faults": [fault.plain() for fault in case.faults],
        "component": component,
        "without": list(case.without),
        **({"reference": case.reference} if case.reference else {}),
        "off": off,
        "requirements": list(case.requirements),
        "variation": {
            # A range of single numbers has no pieces.
            path: {k: v for k, v in spread.model_dump(mode="json").items() if v is not None}
            for path, spread in case.scenario.variation.items()
        },
        "planned": planned,
        "runs_override": runs_override,
        **({} if case.scenario.seed is None else {"seed": case.scenario.seed}),
    }
    return CasePlan.from_data(plain_data(data))


REPORT_ATTRIBUTE = "dura"
"""Attribute of a test report: a list of packed lines. pytest and xdist carry such attributes along,
and unlike ``user_properties`` they do not end up in JUnit files, where kilobytes per test have no
place."""
MOST_PENDING = 64
"""Lines that are held as they are, before they are packed."""
_ATTEMPT = pytest.StashKey[int]()
_HAS_FAILED = pytest.StashKey[bool]()
"""Whether an attempt at the item has failed."""


class ItemRecorder:
    """Records what items use and decide, in whichever process runs them.

    Args:
        context: The session's context.
        shared: What could not be shared, and what searches took over.
        formulas: Where two engines for formulas differ.
        executor: Who simulates.
        take: Takes packed lines of an item that uses a great many episodes.
    """

    def __init__(
        self,
        context: SessionContext,
        *,
        shared: SharedEpisodes,
        formulas: FormulaEngines,
        executor: SessionExecutor,
        take: Callable[[str], None],
    ) -> None:
        self.context = context
        self._shared, self._executor, self._take = shared, executor, take
        self._formulas = formulas
        self._item: pytest.Item | None = None
        self._pending: list[Line] = []
        """Lines of the current item, which may hold secrets."""
        self._packed: list[str] | None = None
        """Earlier lines of it, apart from those that were taken; ``None`` if it used nothing."""
        self._held: list[tuple[str, str, list[str] | None]] = []
        """What no report has carried yet: node id, phase and packed lines."""
        self._sent: set[Any] = set()
        """What this process has reported, and does not report again."""
        self._decisions = Decided()
        self._recorded: set[tuple[EpisodeKey, bool]] = set()
        self._used: dict[str, UsedEpisodes] = {}
        self._decided: set[tuple[str, str]] = set()
        self._components: set[tuple[str, bytes, bool]] = set()
        self._cases: dict[tuple[str, str], CasePlan] = {}
        self._claimed: dict[tuple[str, str, int], CasePlan] = {}
        """Cases on which items of this process are to decide something, by what claims say."""
        self._own_hazards_reported = False
        self._last_episode: JudgedEpisode | None = None
        self._body_passed = False
        """Whether the body of the current test came to its end without a failure."""
        level, directory = context.options.evidence_level, context.options.evidence
        self.traces = TraceKeeper(level, directory, context.redact)

    def subscribe(self, events: EventStream) -> None:
        """Record what the runner emits."""
        from pytest_dura.campaign import events as kinds

        events.subscribe(kinds.EpisodeUsed, self.episode_used)
        events.subscribe(kinds.EpisodeUsed, self.traces.episode_used)
        events.subscribe(kinds.SearchedEpisodeUsed, self.searched_used)
        events.subscribe(kinds.VerdictReached, self.verdict_reached)
        events.subscribe(kinds.SearchEnded, self.search_ended)
        events.subscribe(kinds.MonitorsMeasured, self.monitors_measured)
        events.subscribe(kinds.FactEstablished, self.fact_established)
        events.subscribe(kinds.FaultsTraced, self.faults_traced)

    def episode_used(self, event: EpisodeUsed) -> None:
        """Record an episode."""
        from pytest_dura.evidence.episodes import episode_record
        from pytest_dura.evidence.lines import EpisodeLine

        case, episode, planned = event.case, event.episode, event.planned
        self._used.setdefault(case.id, UsedEpisodes(case)).add(episode)
        generator = episode.spec.roles["generator"]
        self._case_used(case, generator, planned)
        self.context.guests.used(episode.spec)
        key = self.context.runner.key(episode)
        use = key, planned > 0
        if use not in self._recorded:
            self._recorded.add(use)
            origin = self.context.runner.store.earlier.origin(key)
            requirements = self.context.runner.requirements_of(case)
            record = episode_record(
                episode, planned=planned > 0, origin=origin, requirements=requirements
            )
            self._add_once(episode.described_measures)
            self.add([EpisodeLine(record)])
        self._last_episode = episode

    def searched_used(self, event: SearchedEpisodeUsed) -> None:
        """Note an episode of a case that a strategy chose, which is no sample."""
        case, episode = event.case, event.episode
        self._used.setdefault(case.id, UsedEpisodes(case)).add(episode)
        self._component_used(episode.spec.roles["generator"])
        self.context.guests.used(episode.spec)

    def verdict_reached(self, event: VerdictReached) -> None:
        """Record the verdict on a campaign, and keep the traces of its counterexamples."""
        verdict, requirement = event.verdict, event.requirement
        used = self._used.pop(verdict.case, None)
        for counterexample in verdict.counterexamples:
            episode = used and used.episode(self.context.runner, counterexample.episode)
            if used and episode:
                self.traces.violated(episode)
                if counterexample is verdict.counterexamples[0]:  # the worst
                    self.traces.keep_twins(used.case, episode, self.context.runner.fetch)
        if verdict.pairs is not None:
            self._used.pop(verdict.pairs.case, None)
        self._decisions.results.append(ItemResult(requirement, verdict=verdict))
        self.add([event.judgement])
        self._decided.add((verdict.requirement, verdict.case))
        self._requirement_used(requirement)
        self._planned(verdict.case, verdict.component, verdict.planned)

    def search_ended(self, event: SearchEnded) -> None:
        """Record a search for violations, whatever its test makes of it."""
        from pytest_dura.evidence.searches import RecordedSearch
        from pytest_dura.requirements.model import Requirement

        case, search = event.case, event.search
        spec = self.context.runner.task(case).spec
        self._component_used(spec.roles["generator"])
        self._units_used(case)
        self.context.guests.used(spec)
        library = self.context.library().requirements
        for outcome in search.outcomes:
            name = outcome.requirement
            known = library.get(name) or self.context.marked.get(name)
            self._requirement_used(known or Requirement(name, check=outcome.check))
            self._decisions.searched.add(name)
            self._decided.add((name, case.id))
        known_search = RecordedSearch(
            **vars(search),
            scenario=case.scenario.name,
            simulator=spec.simulator.path,
            roles={name: role.path for name, role in spec.roles.items()},
        )
        self.add([known_search])

    def monitors_measured(self, event: MonitorsMeasured) -> None:
        """Record how good a case's monitors are."""
        self.add(event.qualities)

    def fact_established(self, event: FactEstablished) -> None:
        """Record what a further table rests on."""
        from pytest_dura.evidence.model import Fact

        self.add([Fact(event.table, event.about, event.order, dict(event.data))])

    def faults_traced(self, event: FaultsTraced) -> None:
        """Record the causal chain of each fault of an episode."""
        from pytest_dura.evidence.lines import FaultTrace

        episode = event.episode
        component = episode.spec.component
        self.add(FaultTrace(component, episode.id, fault) for fault in event.chains)

    def remark(self, kind: RemarkKind, text: str) -> None:
        """Record a sentence on the session; see :class:`Remark`."""
        from pytest_dura.evidence.lines import Remark

        self.add([Remark(kind, text)])

    def add(self, lines: Iterable[Line]) -> None:
        """Record lines, and pack what was recorded once there is a great deal of it.

        Args:
            lines: Lines of the current item; none if it used what this process has reported.
        """
        item, self._packed = self._item, self._packed or []
        for line in lines:
            from pytest_dura.evidence.lines import asked_by

            about = ("",) if item is None else (
                item.nodeid, item.stash.get(RECORDED_AS, ""), item.stash.get(_ATTEMPT, 1)
            )  # fmt: skip
            self._pending.append(asked_by(line, *about))
        if len(self._pending) >= MOST_PENDING:
            self._pack()
            if not self.context.is_worker:
                for text in self._packed:
                    self._take(text)
                self._packed.clear()

    def _add_once(self, lines: Iterable[Line]) -> None:
        """Record lines that this process has not reported yet."""
        new = [line for line in lines if line not in self._sent]
        self._sent.update(new)
        self.add(new)

    def _pack(self) -> None:
        if self._pending and self._packed is not None:
            from pytest_dura.evidence.lines import pack_lines

            self._packed.append(pack_lines(self._pending, self.context.redact))
            self._pending.clear()

    def outcome_of(self, error: DuraError) -> BaseException:
        """Turn one of our own errors into a failure or a skip with its message."""
        verdict = getattr(error, "verdict", None)
        if verdict is not None and verdict.too_few and self.context.options.warn_undecided:
            return pytest.skip.Exception(failure_text(error))
        return pytest.fail.Exception(failure_text(error))

    def body_ended(self, item: pytest.Function) -> None:
        """End the observation of the episode: what is read from now on is not the test."""
        episode = episode_of(item)
        if episode is not None:
            from pytest_dura.plugin.items.observed_episode import observations_of

            observations_of(episode).end()

    def body_passed(self, item: pytest.Function) -> None:
        """Fail a test that passed if the episodes that it looked at do not support that."""
        self._body_passed = True
        check_passed(self.context, item, self._used, self._decided)

    def attach(
        self, item: pytest.Item, call: pytest.CallInfo[None], report: pytest.TestReport
    ) -> Decided:
        """Let the report carry what the item recorded; returns what it decided."""
        if report.failed:
            item.stash[_HAS_FAILED] = True
        if call.when == "teardown":
            self._forget_item()
            if self._executor.is_lost:  # what there is by now can be resumed
                item.session.shouldstop = "all worker processes have ended"
        if call.when == "setup":
            self._add_claims(item)
        if call.when == "call":
            self._call_reported(item, call, report)
        traces, problems = self.traces.take()
        problems += self._formulas.take_differences()
        for problem in problems:
            self.remark("problem", problem)
        for note in self._shared.take_problems():
            self.remark("note", note)
        lines: list[Line] = [*traces, *self._shared.take_searched(), *self.context.guests.take()]
        if lines:
            self.add(lines)
        return self._hold(item, report.when or "")

    def _hold(self, item: pytest.Item, when: str) -> Decided:
        """Hold what the item has recorded until a report is passed on; returns its decisions."""
        self._pack()
        self._held.append((item.nodeid, when, self._packed))
        decisions = self._decisions.without_secrets(self.context.redact)
        self._packed, self._decisions = None, Decided()
        return decisions

    def passed_on(self, report: pytest.TestReport) -> None:
        """Let a report carry what was recorded until it was made, as it is passed on.

        Of an attempt that a plugin tries again the report may never be passed on, or there is none:
        the next one carries what it would have.
        """
        made = [(name, when) for name, when, _ in self._held]
        if (report.nodeid, report.when) in made:
            end = made.index((report.nodeid, report.when)) + 1
            carried, self._held = self._held[:end], self._held[end:]
            recorded = [packed for *_, packed in carried if packed is not None]
            if recorded:
                setattr(report, REPORT_ATTRIBUTE, list(chain.from_iterable(recorded)))
        elif self.context.is_worker:  # a plugin passes it on for the second time
            vars(report).pop(REPORT_ATTRIBUTE, None)

    def attempt_begins(self, item: pytest.Item) -> None:
        """Begin an attempt at an item, which other plugins may try several times."""
        number = item.stash.get(_ATTEMPT, 0) + 1
        if number > 1:
            # A plugin may begin the next attempt without a report on the one before.
            self._hold(item, "")
            self._forget_item()
        self._item, item.stash[_ATTEMPT] = item, number

    def attempt_ends(self, item: pytest.Item, error: BaseException | None) -> None:
        """Record the outcome of an attempt at an item, whether or not it is reported.

        Args:
            item: An item that uses the runner, and has been called.
            error: What it raised, if anything.
        """
        excinfo = None if error is None else pytest.ExceptionInfo.from_exception(error)
        self._keep_failed_trace(excinfo)
        if marked_target(item, ["episode"]) is not None:
            self._test_outcome(item, excinfo)
        if error is None and item.stash.get(_HAS_FAILED, False):
            self.remark("retried", item.nodeid)

    def _call_reported(
        self, item: pytest.Item, call: pytest.CallInfo[None], report: pytest.TestReport
    ) -> None:
        if call.excinfo is not None and marked_target(item, ["episode"]) is not None:
            episode = given_to(item, "episode")
            if episode is not None:
                command = replay_command(self.context, episode.id)
                report.sections.append(("dura", printed(f"{episode.id}, replay: {command}")))
        # A test that skips itself, or is expected to fail, came to no verdict either.
        if report.skipped and without_verdict(self.context, item, self._decided):
            self.remark("objection", f"{item.nodeid} ended without a verdict")

    def _forget_item(self) -> None:
        self._used.clear()
        self._decided.clear()
        self._last_episode = None
        self._body_passed = False

    def _keep_failed_trace(self, excinfo: pytest.ExceptionInfo[BaseException] | None) -> None:
        """Keep the trace of the last episode of a failed test that asked for no verdict."""
        if self._last_episode is None or self._decided or excinfo is None:
            return
        status, detail = status_of_test(self._last_episode, excinfo.value)
        if status == "violated" and not detail.startswith("undecided: "):
            self.traces.violated(self._last_episode)

    def _case_used(self, case: Case, generator: RoleSpec, planned: int) -> None:
        component = self._component_used(generator)
        if (case.id, component) not in self._cases:
            plan = self._plan(case, component, planned)
            self._cases[case.id, component] = plan
            self.add([plan])
            self._units_used(case)
            known = self.context.library().requirements
            for name in case.requirements:
                self._requirement_used(known[name])
        self._planned(case.id, component, planned)

    def _units_used(self, case: Case) -> None:
        """Note the units of the signals that a case's domain, or its world, declares."""
        from pytest_dura.evidence.lines import SignalUnit

        units = case.scenario.units.items()
        self._add_once([SignalUnit(signal, unit) for signal, unit in units])

    def _plan(self, case: Case, component: str, planned: int) -> CasePlan:
        runs, off = self.context.options.runs, case.roles_off(self.context.runner.roles)
        return case_plan(case, component, planned, runs, off)

    def _component_used(self, generator: RoleSpec) -> str:
        """Describe a component under test; returns its name."""
        from pytest_dura.core.episode import canonical
        from pytest_dura.evidence.lines import UsedComponent
        from pytest_dura.library.roles import LocalRole
        from pytest_dura.provenance import describe_component

        component = generator.label
        key = generator.path, canonical(generator.params), generator.opaque
        if key not in self._components:
            factory = type(generator.instance) if generator.opaque else generator.resolve()
            file, root = None, self.context.config.rootpath
            if isinstance(generator, LocalRole):
                file = root / generator.path.rpartition(":")[0]
            description = describe_component(generator.path, factory, generator.params, file, root)
            sources = description.pop("sources")
            named = {"name": component, **description, "opaque": generator.opaque}
            self.add([UsedComponent(named, sources)])
            self._components.add(key)
        self.add([])
        return component

    def _planned(self, case: str, component: str, planned: int) -> None:
        known = self._cases.get((case, component))
        if known is not None and known.planned < planned:
            self._cases[case, component] = known.replace(planned=planned)
            self.add([self._cases[case, component]])

    def _requirement_used(self, requirement: Requirement) -> None:
        if requirement not in self._sent:
            self._add_once([requirement])
            self._hazards_named(requirement.mitigates)

    def _hazards_named(self, names: Sequence[str]) -> None:
        """Record the named hazards, and once in each process all those of the user's files."""
        library = self.context.library()
        own = () if self._own_hazards_reported else library.own_hazards
        self._own_hazards_reported = True
        self._add_once(library.hazards[name] for name in sorted({*names, *own}))

    def _add_claims(self, item: pytest.Item) -> None:
        """Record what a test is to decide: if it ends before it does, that is undecided."""
        run, target = marked_target(item, ["episode"]), marked_target(item)
        requirements = [] if target is None else marked_requirements(self.context, item)
        if target is None or not requirements:
            return
        campaign = given_to(item, "campaign")
        from pytest_dura.evidence.conclusions.verdicts import UNKNOWN_COMPONENT, test_function
        from pytest_dura.evidence.gather import claim
        from pytest_dura.evidence.lines import ClaimedCase

        component = getattr(campaign, "component", None) or UNKNOWN_COMPONENT
        key = target.case.id, component, target.planned
        if key not in self._claimed:
            self._claimed[key] = self._plan(target.case, component, target.planned)
            self.add([ClaimedCase.from_data(self._claimed[key].to_json())])
        for requirement in requirements:
            self._requirement_used(requirement)
            decides = test_function(item.nodeid) if run is not None else item.nodeid
            if run is None:
                decides = item.stash.get(RECORDED_AS, "") or decides
            # The items on single runs of a case claim the same.
            self._add_once([claim(decides, requirement.id, self._claimed[key])])

    def _test_outcome(
        self, item: pytest.Item, excinfo: pytest.ExceptionInfo[BaseException] | None
    ) -> None:
        """Record the outcome of a test on one episode for the requirements in its markers."""
        target, episode = marked_target(item, ["episode"]), given_to(item, "episode")
        if target is None or episode is None:
            return
        self._planned(target.case.id, episode.spec.component, target.planned)
        error = None if excinfo is None else excinfo.value
        failed = "" if excinfo is None or self._body_passed else failed_assertion(item, excinfo)
        for requirement in marked_requirements(self.context, item):
            self._requirement_used(requirement)
            of_case = self.context.runner.requirements_of(target.case)
            judged, judgement = outcome_of_test(
                requirement, of_case, target, episode, error=error, failed=failed
            )
            if judged.verdict == "violated":
                self.traces.violated(episode)
            result = ItemResult(requirement, judged=judged, judgement=judgement)
            self._decisions.results.append(result)
            self.add([judgement])
