"""DuraSession: the one object of a pytest session, and the plan of what it runs.

The plan comes from ``--dura-scenarios`` or from arguments that name scenario items, such as
``intersection/nominal::SAF-1``: which cases run as a gate, and which requirements judge each.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from pytest_dura.core.errors import ConfigurationError, did_you_mean
from pytest_dura.plugin.context import Planned, SessionContext
from pytest_dura.plugin.event_hook import EventHook
from pytest_dura.plugin.items.outcomes import Decided, ItemJudged, item_results
from pytest_dura.plugin.items.property_tests import PropertyTests
from pytest_dura.plugin.items.scenario_items import Selection, ShardHooks
from pytest_dura.plugin.messages import usage_errors
from pytest_dura.plugin.options import Options, possible_items
from pytest_dura.plugin.session.episodes import SharedEpisodes
from pytest_dura.plugin.session.evidence import SessionEvidence
from pytest_dura.plugin.session.executor import SessionExecutor
from pytest_dura.plugin.session.formula_engines import FormulaEngines
from pytest_dura.plugin.session.recorder import ItemRecorder
from pytest_dura.plugin.session.repeats import Repeats
from pytest_dura.plugin.session.roles import SessionRoles

if TYPE_CHECKING:
    from pytest_dura.campaign.events import EventStream
    from pytest_dura.campaign.runner import Runner
    from pytest_dura.plugin.session.progress import ProgressDisplay, WorkerProgress


Chosen = tuple[str, str]
"""A case and a requirement; "" stands for all of its requirements."""


def _scenario_arguments(context: DuraSession) -> dict[str, Chosen]:
    """Return the arguments that name a case, or its file, with their case and requirement.

    Raises:
        ConfigurationError: For an unknown requirement of a case, and scenarios that cannot be read.
    """
    chosen = {}
    for argument, path in possible_items(context.config):
        requirement = argument.partition("::")[2]
        name = _case_name(context, path)
        if name is not None:
            chosen[argument] = (name, _requirement_name(context, name, requirement))
    return chosen


def _case_name(context: DuraSession, path: str) -> str | None:
    """Return the case that an argument names, if there is such a case."""
    file = context.config.invocation_params.dir / path
    try:
        library = context.library()
    except ConfigurationError as error:
        if context.options.activated or file.exists():
            raise
        # The argument may be a misspelt path or a scenario: the message names both.
        raise ConfigurationError(
            f"file or directory not found: {path}\n"
            f"and it names no scenario as long as these cannot be read:\n{error}"
        ) from None
    # Terminal lines are relative to where pytest was started.
    relative = os.path.relpath(os.path.normpath(file), context.config.rootpath)
    relative = relative.replace(os.sep, "/")
    for name in (path, relative):
        if re.split(r"[+~]", name, maxsplit=1)[0] in library.scenarios:
            return context.runner.case(name).id
    if file.is_file():
        for name, scenario in library.scenarios.items():
            if scenario.file and Path(scenario.file).resolve() == file.resolve():
                return context.runner.case(name).id
    return None


def _requirement_name(context: DuraSession, name: str, requirement: str) -> str:
    known = context.runner.case(name).requirements
    if requirement and requirement not in known:
        raise ConfigurationError(
            f"the case {name!r} has no requirement {requirement!r}",
            found=f"{name}::{requirement}",
            expected="one of " + ", ".join(known) if known else "a case with requirements",
            remedy=did_you_mean(requirement, known),
        )
    return requirement


def make_plan(context: DuraSession, chosen: Mapping[str, Chosen]) -> list[Planned]:
    """List the cases of the scenarios, or those that arguments name, with their requirements.

    Args:
        context: The session's context, which takes in each case.
        chosen: What the arguments name, if any do.

    Raises:
        ConfigurationError: For a scenario that nothing would judge, and options that match none.
    """
    from pytest_dura.library.cases import expand_cases, select_cases

    options, library, plan = context.options, context.library(), []
    if chosen:
        # A case of our own arguments may have other faults than its scenario.
        named = {name: context.runner.case(name) for name, _ in chosen.values()}
        selected = select_cases(list(named.values()), options.select)
    else:
        scenarios = context.gate_scenarios()
        selected = expand_cases(scenarios, options.faults, options.select, library.faults)
        if not selected and not options.list_only:
            raise ConfigurationError(
                "there is no scenario to run: each of the project's own is on request",
                key="--dura-scenarios",
                found=", ".join(sorted(scenarios)),
                expected="at least one scenario without `on_request: true`",
                remedy="name some with --dura-select, or run the built-in ones by "
                "--dura-scenarios=builtin",
            )
    cases, choices = {case.id: case for case in selected}, set(chosen.values())
    for name in sorted(cases):
        case = cases[name]
        case.scenario.paced(options.clock)
        if not (case.requirements or chosen or options.list_only):
            raise ConfigurationError(
                f"the scenario {name!r} has no requirements, so nothing would judge it",
                file=case.scenario.file or None,
                key="requirements",
                expected="at least one requirement where a scenario is run as a gate",
                remedy="name requirements, or leave the scenario out with --dura-select",
            )
        requirements = case.requirements
        if chosen:
            requirements = tuple(
                requirement
                for requirement in case.requirements
                if (name, requirement) in choices or (name, "") in choices
            )
        if requirements:
            context.register_case(case)
            plan.append(Planned(case, requirements))
    return plan


class DuraSession(SessionContext):
    """The parts of one pytest session, and what they do together at its beginning.

    Args:
        config: The session's configuration.
    """

    def __init__(self, config: pytest.Config) -> None:
        super().__init__(config)
        options = self.options
        self.roles = SessionRoles(config, options.generator, options.domain, options.simulator)
        self.executor = SessionExecutor(
            options.executor,
            at_once=self.guests.at_once(),
            is_worker=self.is_worker,
            alone=getattr(config, "workerinput", {}).get("workercount", 1) == 1,
            collect_only=config.option.collectonly,
        )
        self.formulas = FormulaEngines(both=options.second_engine)
        self.shared = SharedEpisodes(self, self.executor, self.formulas)
        self.repeats = Repeats(self, self.executor)
        self.properties = PropertyTests(self)
        self.selection = Selection(self)
        self.evidence = SessionEvidence(
            self,
            roles=self.roles,
            properties=self.properties,
            selection=self.selection,
            shared=self.shared,
            executor=self.executor,
            formulas=self.formulas,
            shard=lambda: self.shard,
        )
        self.recorder = ItemRecorder(
            self,
            shared=self.shared,
            formulas=self.formulas,
            executor=self.executor,
            take=self.evidence.take,
        )
        self.parts_of_workers = (
            self.executor,
            self.properties,
            self.selection,
            self.shared,
            self.formulas,
        )
        """Parts whose workers send what they know to the controller at their end."""

    @cached_property
    def shard(self) -> ShardHooks | None:
        """Hooks that keep the items of one shard, if the session is one."""
        return None if self.options.shard is None else ShardHooks(self, self.options.shard)

    def start(self) -> None:
        """Check everything that can be checked before something runs, and plan.

        Raises:
            pytest.UsageError: For options and files that cannot be used.
        """
        if self.active:
            self.extend_import_path()
        with usage_errors():
            self.guests.begin()
            self.roles.check()
            self.make_plan()
            self.roles.resolve(self)
            self.evidence.given.read()
            self.formulas.check()
            if self.active:
                self.executor.connect()
                self.evidence.start()

    def begin_evidence(self, items: Sequence[pytest.Item]) -> None:
        """Begin the record of a session that runs episodes.

        Args:
            items: Those that will ask for episodes.

        Raises:
            pytest.UsageError: If it cannot be written.
        """
        self.extend_import_path()
        with usage_errors():
            self.executor.choose(self, items)
            self.shared.executor_chosen()
            self.evidence.start()
            self.executor.start(self.plan, self.roles.chosen())

    def take_arguments(self) -> None:
        """Leave to pytest the arguments that name files, and none if scenarios run alone."""
        left = [] if self.runs_scenarios_alone else self.config.args
        self.config.args = [argument for argument in left if argument not in self.own_arguments]

    @cached_property
    def progress(self) -> WorkerProgress | ProgressDisplay | None:
        """What follows the progress of this process; ``None`` where nothing shows it."""
        from pytest_dura.plugin.session.progress import make_progress

        return make_progress(self.config, self.options.progress_interval, self.guests.requests)

    @cached_property
    def runner(self) -> Runner:
        """Runner of episodes. Its roles follow the fixtures that the current item sees."""
        from pytest_dura.campaign.runner import Runner
        from pytest_dura.plugin.items.property_tests import counterexample_store
        from pytest_dura.search import falsify_case

        return Runner(
            self.library,
            self.options.seed,
            simulator=self.roles.chosen_simulator(),
            roles=self.roles.chosen(),
            runs=self.options.runs,
            faults=self.options.faults,
            time_budget=self.options.time_budget,
            end_when_decided=self.options.end_when_decided,
            clock=self.options.clock,
            events=self.events,
            twins=self.options.twins,
            recorded=self.options.evidence_level != "summary",
            store=self.shared.store(),
            role_timeout=self.options.role_timeout,
            resolver=self.resolver,
            falsifier=partial(falsify_case, store=counterexample_store(self)),
        )

    @cached_property
    def events(self) -> EventStream:
        """Stream of what happens; those who follow it are called in the order of this list."""
        from pytest_dura.campaign.events import (
            EpisodeUsed,
            EventStream,
            Progress,
            SearchedEpisodeUsed,
        )
        from pytest_dura.plugin.session import allure_results, junit_properties

        events = EventStream()
        self.recorder.subscribe(events)
        events.subscribe(EpisodeUsed, self.repeats.episode_used)
        events.subscribe(SearchedEpisodeUsed, self.properties.searched_used)
        if self.progress is not None:
            events.subscribe(Progress, self.progress.update)
        junit_properties.subscribe(self, events)
        allure_results.subscribe(self, events)
        EventHook(self.config, partial(self.recorder.remark, "problem")).subscribe(events)
        return events

    def judge_item(self, item: pytest.Item, report: pytest.TestReport, decided: Decided) -> None:
        """Emit the results of an item that uses the runner.

        Args:
            item: The item.
            report: Its report, which is not passed on yet.
            decided: What it decided.
        """
        results = item_results(self, item, decided)
        self.events.emit(ItemJudged(item, report, results))

    def make_plan(self) -> None:
        """Plan what the arguments name.

        Raises:
            ConfigurationError: For arguments and scenarios that cannot be used.
        """
        chosen = _scenario_arguments(self)
        self.own_arguments = set(chosen)
        options = self.options
        if options.brings_cases or options.list_only or chosen:
            self.plan += make_plan(self, chosen)
            self.roles.check_plan(self.plan)
        else:
            self._check_faults_used()

    def _check_faults_used(self) -> None:
        """Refuse fault campaigns that nothing of this session would run."""
        given = Options.faults.given(self.config)
        if given:
            raise ConfigurationError(
                "--dura-faults is about scenario cases, and the arguments name none",
                key="--dura-faults",
                found=given[0],
                expected="--dura-scenarios, or a case among the arguments",
                remedy="add --dura-scenarios; a test function names its faults in the marker dura",
            )


_STASH_KEY = pytest.StashKey[DuraSession]()


def session_of(config: pytest.Config) -> DuraSession:
    """Return the one session object of a configuration, made at the first call."""
    if _STASH_KEY not in config.stash:
        config.stash[_STASH_KEY] = DuraSession(config)
    return config.stash[_STASH_KEY]
